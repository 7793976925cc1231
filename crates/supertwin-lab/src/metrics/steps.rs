//! Settling time and overshoot after steps of the set-points of distance, depth and heading.

use supertwin_core::frame::ssa;
use supertwin_core::message::Mode;
use supertwin_core::signal::Component;
use supertwin_core::signal::guidance::TARGET;
use supertwin_core::signal::reference::MODE;
use supertwin_core::source::{Columns, Label};
use supertwin_core::{RecordedRun, Tick};

/// Set-points before the reference models.
const DEPTH: Component = TARGET.at("depth");
const HEADING: Component = TARGET.at("heading");

/// Distance, depth, heading.
pub(super) const NAMES: [&str; 3] = ["distance", "depth", "heading"];
/// A smaller change from one moment to the next is a ramp, not a step; a smaller way to go is none.
const SMALLEST: [f64; 3] = [0.2, 0.1, 0.1];
/// Least half-width of the band in which a response has settled.
const BAND: [f64; 3] = [0.2, 0.1, 0.1];
/// The same as a share of the step.
const BAND_SHARE: f64 = 0.05;
/// So long it has to stay there.
const DWELL_S: f64 = 5.0;

pub(super) fn is_needed(path: &str) -> bool {
    path == TARGET.path || path == MODE.path
}

/// Set-points and responses at one moment, in the order of [`NAMES`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Moment {
    /// `None` while it is not in force.
    pub(super) target: [Option<f64>; 3],
    pub(super) measured: [f64; 3],
    pub(super) truth: [f64; 3],
}

/// The set-points in force, along a run.
pub(super) struct Targets<'a> {
    modes: &'a [Label],
    target: Option<&'a Columns>,
    mode: usize,
}

impl<'a> Targets<'a> {
    pub(super) fn new(source: &'a RecordedRun) -> Self {
        let target = source.signal(&TARGET).filter(|columns| columns.width == TARGET.width());
        Self { modes: source.label(&MODE), target, mode: 0 }
    }

    /// At a tick, with the distance that is wanted then.
    pub(super) fn at(&mut self, tick: Tick, distance_m: f64) -> [Option<f64>; 3] {
        let k = tick.k as i64;
        while self.modes.get(self.mode + 1).is_some_and(|next| next.tick <= k) {
            self.mode += 1;
        }
        let mode = self.modes.get(self.mode).filter(|mode| mode.tick <= k).map_or("", |mode| mode.value.as_str());
        let target = self.target.and_then(|target| target.at(k));
        let (follows, holds) = (mode == Mode::FollowNet.name(), mode == Mode::DepthHeadingHold.name());
        [
            follows.then_some(distance_m),
            target.filter(|_| follows || holds).and_then(|target| DEPTH.of(target)),
            // While it follows, the net gives the heading.
            target.filter(|_| holds).and_then(|target| HEADING.of(target)),
        ]
    }
}

/// The response to one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Response {
    pub(super) settled: bool,
    /// As long as it was watched when it did not settle.
    pub(super) settling_s: f64,
    /// Share of the step.
    pub(super) overshoot: f64,
}

/// Responses of the quantity `which` to the steps in `moments`, `tick_s` apart; the first is only what was before.
pub(super) fn responses(moments: &[Moment], tick_s: f64, which: usize, truth: bool) -> Vec<Response> {
    let mut found = Vec::new();
    let value = |moment: &Moment| if truth { moment.truth[which] } else { moment.measured[which] };
    let difference = |a: f64, b: f64| if which == 2 { ssa(a - b) } else { a - b };
    for i in 1..moments.len() {
        let Some(target) = moments[i].target[which] else { continue };
        let before = moments[i - 1].target[which];
        if before.is_some_and(|before| libm::fabs(difference(target, before)) < SMALLEST[which]) {
            continue;
        }
        let step = difference(target, value(&moments[i]));
        if libm::fabs(step) < SMALLEST[which] {
            continue;
        }
        // Watched while the set-point stays.
        let stays = |moment: &&Moment| moment.target[which].is_some_and(|now| libm::fabs(now - target) < 1e-9);
        let errors: Vec<f64> =
            moments[i..].iter().take_while(stays).map(|moment| difference(value(moment), target)).collect();
        let dwell = (DWELL_S / tick_s) as usize;
        if errors.len() <= dwell {
            continue;
        }
        let band = (BAND_SHARE * libm::fabs(step)).max(BAND[which]);
        let mut inside = 0;
        let settled = errors.iter().position(|error| {
            inside = if libm::fabs(*error) <= band { inside + 1 } else { 0 };
            inside > dwell
        });
        let side = if step > 0.0 { 1.0 } else { -1.0 };
        // Later excursions have other causes.
        let response = &errors[..settled.map_or(errors.len(), |last| last + 1)];
        let beyond = response.iter().map(|error| error * side).fold(0.0, f64::max);
        found.push(Response {
            settled: settled.is_some(),
            settling_s: settled.map_or(errors.len(), |last| last - dwell) as f64 * tick_s,
            overshoot: beyond / libm::fabs(step),
        });
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A second-order response to a depth step of 2 m at 1 s: overshoot exp(−πζ/√(1−ζ²)).
    fn moments(seconds: f64) -> Vec<Moment> {
        let (zeta, omega, tick_s) = (0.5, 1.0, 0.02);
        let damped = omega * f64::sqrt(1.0 - zeta * zeta);
        (0..(seconds / tick_s) as usize)
            .map(|i| {
                let t = i as f64 * tick_s - 1.0;
                let phase = damped * t;
                let rest = if t < 0.0 {
                    1.0
                } else {
                    (-zeta * omega * t).exp() * (phase.cos() + zeta * omega / damped * phase.sin())
                };
                let depth = 3.5 - 2.0 * rest;
                let target = if t < 0.0 { 1.5 } else { 3.5 };
                Moment {
                    target: [None, Some(target), None],
                    measured: [0.0, depth, 0.0],
                    truth: [0.0, depth + 5.0, 0.0],
                }
            })
            .collect()
    }

    #[test]
    fn a_second_order_response_is_measured_as_the_textbook_has_it() {
        let [response] = responses(&moments(40.0), 0.02, 1, false)[..] else { panic!("one step") };
        let overshoot = (-core::f64::consts::PI * 0.5 / f64::sqrt(0.75)).exp();
        assert!((response.overshoot - overshoot).abs() < 1e-4, "{response:?}");
        // The band of 0.1 m is 5 % of the step; the exact solution of |rest| = 0.05 for the last time is 5.285 s.
        assert!(response.settled && (response.settling_s - 5.29).abs() < 0.03, "{response:?}");
        assert!(responses(&moments(40.0), 0.02, 0, false).is_empty());
    }

    #[test]
    fn what_never_settles_counts_as_long_as_it_was_watched() {
        let [response] = responses(&moments(40.0), 0.02, 1, true)[..] else { panic!("one step") };
        assert!(!response.settled && (response.settling_s - 39.0).abs() < 0.05, "{response:?}");
        // Five seconds are needed to say anything.
        assert!(responses(&moments(5.0), 0.02, 1, false).is_empty());
    }

    #[test]
    fn a_ramp_is_no_step_and_the_heading_goes_the_short_way_round() {
        let ramp: Vec<Moment> = (0..2000)
            .map(|i| Moment { target: [None, Some(0.001 * f64::from(i)), None], measured: [0.0; 3], truth: [0.0; 3] })
            .collect();
        assert!(responses(&ramp, 0.02, 1, false).is_empty());
        let turn: Vec<Moment> = (0..1000)
            .map(|i| {
                let (target, heading) = if i < 10 { (3.0, 3.0) } else { (-3.0, if i < 60 { 3.0 } else { -3.0 }) };
                Moment { target: [None, None, Some(target)], measured: [0.0, 0.0, heading], truth: [0.0; 3] }
            })
            .collect();
        let [response] = responses(&turn, 0.02, 2, false)[..] else { panic!("one step") };
        assert!(
            response.settled && (response.settling_s - 1.0).abs() < 0.03 && response.overshoot == 0.0,
            "{response:?}"
        );
    }
}
