//! The messages of a recorded run by wire and tick: exact, where their bytes were recorded, else rebuilt from signals.

use std::any::Any;
use std::collections::{BTreeMap, BTreeSet};
use supertwin_core::message::{
    DepthSample, DvlPing, HeadingSample, MAX_THRUSTERS, Measurements, Mode, Nav, NavHealth, NavVariance, NetEstimate,
    Reference, Thrust, WrenchRequest, YawRateSample,
};
use supertwin_core::source::Columns;
use supertwin_core::{Axes, BodyAcceleration, BodyVelocity, Message, RunSource, Wrench};

/// Messages of one wire: by tick, with who sent them. Two who write the same wire may have the same tick.
#[derive(Clone, Debug)]
struct Of<M>(BTreeMap<u64, Vec<(String, M)>>);

impl<M> Default for Of<M> {
    fn default() -> Self {
        Self(BTreeMap::new())
    }
}

/// Everything that went over the wires of a run.
#[derive(Clone, Debug, Default)]
pub struct Messages {
    measurements: Of<Measurements>,
    nav: Of<Nav>,
    reference: Of<Reference>,
    thrust: Of<Thrust>,
    wrench_request: Of<WrenchRequest>,
}

impl Messages {
    /// The wire whose messages are `M`; `None` for a message that no block listens to.
    fn of<M: Message>(&self) -> Option<&Of<M>> {
        let wires: [&dyn Any; 5] = [&self.measurements, &self.nav, &self.reference, &self.thrust, &self.wrench_request];
        wires.into_iter().find_map(|wire| wire.downcast_ref())
    }

    fn of_mut<M: Message>(&mut self) -> Option<&mut Of<M>> {
        let wires: [&mut dyn Any; 5] =
            [&mut self.measurements, &mut self.nav, &mut self.reference, &mut self.thrust, &mut self.wrench_request];
        wires.into_iter().find_map(|wire| wire.downcast_mut())
    }

    /// Adds a message that `source` made at `tick`; a repetition is left out.
    pub fn add<M: Message>(&mut self, tick: u64, source: &str, message: M) {
        let Some(wire) = self.of_mut::<M>() else { return };
        let known = wire.0.entry(tick).or_default();
        if known.iter().all(|(other, _)| other != source) {
            known.push((source.to_owned(), message));
        }
    }

    /// In the place of whatever was made at `tick`.
    pub(crate) fn put<M: Message>(&mut self, tick: u64, message: M) {
        if let Some(wire) = self.of_mut::<M>() {
            wire.0.insert(tick, vec![(String::new(), message)]);
        }
    }

    /// The message made at `tick`: that of `writer`, if there are several.
    pub(crate) fn at<M: Message>(&self, tick: u64, writer: &str) -> Option<&(String, M)> {
        let all = self.of::<M>()?.0.get(&tick)?;
        all.iter().find(|(source, _)| source == writer).or_else(|| all.first())
    }

    /// Ticks at which messages were made, from `after` on (without it) to `until`.
    pub(crate) fn ticks<M: Message>(&self, after: Option<u64>, until: u64) -> Vec<u64> {
        let from = after.map_or(0, |after| after + 1);
        let wire = self.of::<M>().filter(|_| from <= until);
        wire.map(|wire| wire.0.range(from..=until).map(|(tick, _)| *tick).collect()).unwrap_or_default()
    }

    fn is_there<M: Message>(&self, tick: u64) -> bool {
        self.of::<M>().is_some_and(|wire| wire.0.contains_key(&tick))
    }

    /// Rebuilds from signals what has no exact bytes; how many that were, by wire.
    ///
    /// Every field of a message is a signal, with all its bits; what a message left out has no row at its tick. A beam
    /// range of zero stands for a beam that did not come back.
    pub fn rebuild(&mut self, source: &impl RunSource) -> BTreeMap<&'static str, u64> {
        let look = Look(source);
        let mut rebuilt = BTreeMap::new();
        let mut count = |key| *rebuilt.entry(key).or_default() += 1;
        // A plant that measured nothing at a tick sent a message all the same.
        let measured = ["plant/truth/pose"].iter().chain(TAKEN_AT).flat_map(|path| look.ticks(path));
        for tick in measured.collect::<BTreeSet<_>>() {
            if !self.is_there::<Measurements>(tick)
                && let Some(message) = look.measurements(tick)
            {
                self.add(tick, "", message);
                count(Measurements::KEY);
            }
        }
        for tick in look.ticks("estimator/nav/pose") {
            if !self.is_there::<Nav>(tick)
                && let Some(message) = look.nav(tick)
            {
                self.add(tick, "", message);
                count(Nav::KEY);
            }
        }
        for tick in look.ticks("guidance/reference/depth") {
            if !self.is_there::<Reference>(tick)
                && let Some(message) = look.reference(tick)
            {
                self.add(tick, "", message);
                count(Reference::KEY);
            }
        }
        for tick in look.ticks("controller/thrust/requested") {
            if !self.is_there::<Thrust>(tick)
                && let Some(message) = look.thrust(tick)
            {
                self.add(tick, "", message);
                count(Thrust::KEY);
            }
        }
        rebuilt
    }
}

/// When each sensor's part of [`Measurements`] was taken: there when the part is.
const TAKEN_AT: &[&str] = &[
    "plant/measurements/dvl_taken_at",
    "plant/measurements/depth_taken_at",
    "plant/measurements/heading_taken_at",
    "plant/measurements/yaw_rate_taken_at",
];

/// Looks messages up in signals.
struct Look<'a, S>(&'a S);

impl<S: RunSource> Look<'_, S> {
    fn ticks(&self, path: &str) -> Vec<u64> {
        let columns = self.0.signals().get(path);
        columns
            .map(|columns| columns.tick.iter().filter_map(|&tick| tick.try_into().ok()).collect())
            .unwrap_or_default()
    }

    fn row(&self, path: &str, tick: u64) -> Option<&[f64]> {
        self.0.signals().get(path).and_then(|columns: &Columns| columns.at(i64::try_from(tick).ok()?))
    }

    fn numbers<const N: usize>(&self, path: &str, tick: u64) -> Option<[f64; N]> {
        self.row(path, tick)?.try_into().ok()
    }

    fn number(&self, path: &str, tick: u64) -> Option<f64> {
        self.numbers::<1>(path, tick).map(|[number]| number)
    }

    fn measurements(&self, tick: u64) -> Option<Measurements> {
        let both = |taken_at: &str, path: &str| Some((self.number(taken_at, tick)?, self.number(path, tick)?));
        let gyro = both("plant/measurements/yaw_rate_taken_at", "plant/measurements/yaw_rate");
        let dvl = self.number("plant/measurements/dvl_taken_at", tick).and_then(|taken_at_s| {
            Some(DvlPing {
                taken_at_s,
                velocity_m_per_s: self.numbers("plant/measurements/dvl_velocity", tick),
                beam_range_m: self
                    .numbers::<4>("plant/measurements/dvl_range", tick)?
                    .map(|range_m| (range_m != 0.0).then_some(range_m)),
            })
        });
        Some(Measurements {
            dvl,
            depth: both("plant/measurements/depth_taken_at", "plant/measurements/depth")
                .map(|(taken_at_s, depth_m)| DepthSample { taken_at_s, depth_m }),
            compass: both("plant/measurements/heading_taken_at", "plant/measurements/heading")
                .map(|(taken_at_s, heading_rad)| HeadingSample { taken_at_s, heading_rad }),
            gyro: gyro.map(|(taken_at_s, yaw_rate_rad_per_s)| YawRateSample { taken_at_s, yaw_rate_rad_per_s }),
        })
    }

    fn nav(&self, tick: u64) -> Option<Nav> {
        let [depth_m, heading_rad] = self.numbers("estimator/nav/pose", tick)?;
        let velocity: [f64; 4] = self.numbers("estimator/nav/velocity", tick)?;
        let acceleration: [f64; 4] = self.numbers("estimator/nav/acceleration", tick)?;
        let disturbance: [f64; 4] = self.numbers("estimator/nav/disturbance", tick)?;
        let [depth_m2, heading_rad2, u, v, w, r, b_u, b_v, b_w, b_r] = self.numbers("estimator/nav/variance", tick)?;
        let net: [f64; 4] = self.numbers("estimator/nav/net", tick)?;
        let health: [f64; 6] = self.numbers("estimator/nav/health", tick)?;
        let [valid, dead_reckoning, depth_lost, heading_lost, thrust_unknown, restarted] =
            health.map(|flag| flag != 0.0);
        Some(Nav {
            depth_m,
            heading_rad,
            velocity: BodyVelocity::from(velocity),
            acceleration: BodyAcceleration::from(acceleration),
            disturbance: Wrench::from(disturbance),
            variance: NavVariance { depth_m2, heading_rad2, velocity: [u, v, w, r], disturbance: [b_u, b_v, b_w, b_r] },
            net: NetEstimate {
                distance_m: net[0],
                heading_rad: net[1],
                distance_variance_m2: net[2],
                heading_variance_rad2: net[3],
                valid,
            },
            health: NavHealth { dead_reckoning, depth_lost, heading_lost, thrust_unknown, restarted },
        })
    }

    fn reference(&self, tick: u64) -> Option<Reference> {
        let labels = self.0.labels().get("guidance/reference/mode")?;
        let at = labels.partition_point(|label| label.tick <= i64::try_from(tick).unwrap_or(i64::MAX));
        let name = &labels.get(at.checked_sub(1)?)?.value;
        let mode = [Mode::Neutral, Mode::DepthHeadingHold, Mode::FollowNet].into_iter().find(|m| m.name() == name)?;
        let [surge_m_per_s, sway_m_per_s, surge_m_per_s2, sway_m_per_s2] =
            self.numbers("guidance/reference/velocity", tick)?;
        let [depth_m, depth_m_per_s, depth_m_per_s2] = self.numbers("guidance/reference/depth", tick)?;
        let [heading_rad, heading_rad_per_s, heading_rad_per_s2] = self.numbers("guidance/reference/heading", tick)?;
        let [net_distance_m, speed_m_per_s] = self.numbers("guidance/reference/setpoint", tick)?;
        Some(Reference {
            mode,
            surge_m_per_s,
            surge_m_per_s2,
            sway_m_per_s,
            sway_m_per_s2,
            depth_m,
            depth_m_per_s,
            depth_m_per_s2,
            heading_rad,
            heading_rad_per_s,
            heading_rad_per_s2,
            net_distance_m,
            speed_m_per_s,
        })
    }

    fn thrust(&self, tick: u64) -> Option<Thrust> {
        let requested: [f64; 4] = self.numbers("controller/thrust/requested", tick)?;
        let allocated: [f64; 4] = self.numbers("controller/thrust/allocated", tick)?;
        let limited: [f64; 4] = self.numbers("controller/thrust/limited", tick)?;
        // A vehicle without thrusters has no such signal.
        let force_n = self.row("controller/thrust/force", tick).unwrap_or_default();
        Some(Thrust {
            force_n: force_n.iter().take(MAX_THRUSTERS).copied().collect(),
            requested: Wrench::from(requested),
            allocated: Wrench::from(allocated),
            limited: Axes::from(limited.map(|flag| flag != 0.0)),
            emergency_neutral: self.number("controller/thrust/emergency_neutral", tick)? != 0.0,
        })
    }
}
