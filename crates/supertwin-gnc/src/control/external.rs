//! The law `external`: a wrench from outside, with a substitute for the axes and the moments it leaves out.
//!
//! Allocation, limits and fallback stay on the vehicle. An axis that the request leaves out, and every axis when the
//! request is too old, is the substitute's; it takes over without a jump.

use super::{ControlLaw, Law, LawConfig, LawInput};
use nalgebra::Vector4;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use supertwin_core::message::WrenchRequest;
use supertwin_core::{Capability, Observe, Probe, signal};
use supertwin_model::Hydrodynamics;

/// Parameters of the law.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ExternalConfig {
    /// What steers where the request does not. Must not be `external` itself.
    pub substitute: Box<LawConfig>,
}

/// The law at work.
#[derive(Clone, Debug)]
pub struct External {
    substitute: Box<Law>,
    outside: [bool; 4],
    last: Vector4<f64>,
}

impl ControlLaw for External {
    type Config = ExternalConfig;
    const CAPABILITIES: &'static [Capability] = &[Capability::External];

    /// Fails when the substitute is itself external or can't be built.
    fn new(config: &ExternalConfig, model: &Hydrodynamics) -> Result<Self, String> {
        if matches!(*config.substitute, LawConfig::External(_)) {
            return Err("law.external.substitute = external: must be a law of the vehicle's own".to_owned());
        }
        Ok(Self { substitute: Box::new(config.substitute.build(model)?), outside: [false; 4], last: Vector4::zeros() })
    }

    fn step(&mut self, input: &LawInput<'_>) -> Vector4<f64> {
        let request = input.request.map_or([None; 4], WrenchRequest::to_array);
        let outside = request.map(|axis| axis.is_some_and(f64::is_finite));
        // An axis that comes back to the substitute continues from the last wrench; so do the others, which are its own.
        if (0..4).any(|i| self.outside[i] && !outside[i]) {
            let last = self.last;
            self.substitute.start_from(input, &last);
        }
        let mut tau = self.substitute.step(input);
        for i in 0..4 {
            if let (true, Some(wanted)) = (outside[i], request[i]) {
                tau[i] = wanted;
            }
        }
        self.outside = outside;
        self.last = tau;
        tau
    }

    /// Hands over to the substitute.
    fn start_from(&mut self, input: &LawInput<'_>, wrench: &Vector4<f64>) {
        self.substitute.start_from(input, wrench);
        self.last = *wrench;
    }

    fn keep_adapted(&mut self, other: &Self) {
        self.substitute.keep_adapted(&other.substitute);
        self.outside = other.outside;
        self.last = other.last;
    }

    fn reset(&mut self) {
        self.substitute.reset();
        self.outside = [false; 4];
        self.last = Vector4::zeros();
    }

    fn substitute(&self) -> Option<&Law> {
        Some(&self.substitute)
    }
}

impl Observe for External {
    fn observe<P: Probe>(&self, probe: &mut P) {
        probe.vector(&signal::controller::EXTERNAL, &self.outside.map(|flag| f64::from(u8::from(flag))));
        self.substitute.observe(probe);
    }
}
