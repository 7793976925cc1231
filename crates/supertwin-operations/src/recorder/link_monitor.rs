//! The accounts of a recording: counters of the services as curves, the recorder's own, and clocks that step.

use super::run_recording::RunRecording;
use super::signal_registry::SignalRegistry;
use std::collections::BTreeMap;
use std::time::Duration;
use supertwin_core::Probe as _;
use supertwin_core::signal::link::{
    self, AGE, DEADLINE, GAPS, LAG, LOOP_TIME, MISSING, RATE, REFUSED, STEP_TIME, TRANSPORT, wire_gaps,
};
use supertwin_protocol::{Clock, Health};
use supertwin_rerun::Clocks;
use supertwin_zenoh::witness::RING;

/// Between two complaints of one kind.
const COMPLAINT: Duration = Duration::from_secs(1);
/// A clock that goes wrong by less is not mentioned.
const STEP_NS: i64 = 100_000_000;
/// What a network can do to a sender's clock.
const JITTER_NS: i64 = 500_000_000;
/// Messages that must agree before a sender's clock counts as stepped.
const AGREE: u32 = 10;

/// Counters and clocks.
#[derive(Debug, Default)]
pub(crate) struct LinkMonitor {
    /// When telemetry was last heard.
    pub(crate) received_at: Duration,
    /// Messages that were no messages, signals that changed their width, and the like.
    pub(crate) refused: u64,
    /// The last words of each state: a state that is told again is no news.
    pub(crate) states: BTreeMap<String, String>,
    complaints: BTreeMap<String, Duration>,
    healths: Vec<(String, Health)>,
    rates: BTreeMap<String, (u64, u64)>,
    health_due: Duration,
    /// Recorder's wall clock minus its steady one.
    offset_ns: Option<i64>,
    /// The same of the plant's clock and simulated time: agreed, candidate, how many agree.
    sender: Option<(i64, i64, u32)>,
    /// The plant's clock jumped by so many seconds, which has not been told yet.
    pub(crate) sender_step_s: Option<f64>,
}

impl LinkMonitor {
    /// Whether `what` may be said again.
    pub(crate) fn may_complain(&mut self, what: &str, now: Duration) -> bool {
        if self.complaints.len() > 1000 {
            self.complaints.clear();
        }
        let may = self.complaints.get(what).is_none_or(|last| now.saturating_sub(*last) >= COMPLAINT);
        if may {
            self.complaints.insert(what.to_owned(), now);
        }
        may
    }

    /// Once a second.
    pub(crate) fn health_is_due(&mut self, now: Duration) -> bool {
        let due = now >= self.health_due;
        if due {
            self.health_due = now + Duration::from_secs(1);
        }
        due
    }

    /// The recorder's clock jumped by so many seconds.
    pub(crate) fn clock_step(&mut self, clock: &dyn Clock) -> Option<f64> {
        let steady = i64::try_from(clock.now().as_nanos()).unwrap_or(i64::MAX);
        let offset = i64::try_from(clock.unix_ns()).unwrap_or(i64::MAX) - steady;
        let before = self.offset_ns.replace(offset)?;
        let step = offset - before;
        (step.abs() > STEP_NS).then_some(step as f64 / 1e9)
    }

    /// Looks at the plant's clock beside our own.
    pub(crate) fn sender(&mut self, clocks: Clocks) {
        let offset = clocks.sender_ns - clocks.recorder_ns;
        let (agreed, candidate, count) = self.sender.get_or_insert((offset, offset, 0));
        if (offset - *agreed).abs() < JITTER_NS {
            *count = 0;
        } else if *count > 0 && (offset - *candidate).abs() < STEP_NS {
            *count += 1;
            if *count >= AGREE {
                self.sender_step_s = Some((offset - *agreed) as f64 / 1e9);
                (*agreed, *count) = (offset, 0);
            }
        } else {
            (*candidate, *count) = (offset, 1);
        }
    }

    /// Keeps a service's counters until the next tick is written.
    pub(crate) fn health(&mut self, service: &str, health: Health) {
        if self.healths.len() < 64 {
            self.healths.push((service.to_owned(), health));
        }
    }

    /// Shows all counters that came since the last tick, and what this recording misses beside them.
    pub(crate) fn show(
        &mut self,
        registry: &mut SignalRegistry,
        missing: [u64; RING.len()],
        wires: &BTreeMap<String, u64>,
        clocks: Clocks,
        recording: &mut RunRecording,
    ) {
        if self.healths.is_empty() {
            return;
        }
        let mut show = |path: &str, components: &[&str], unit: &str, about: &str, values: &[f64]| {
            if let Some(signal) = registry.register(path, components, &[unit], about)
                && !values.is_empty()
                && signal.components.len() == components.len()
            {
                recording.vector(signal, values);
            }
        };
        for (service, health) in std::mem::take(&mut self.healths) {
            let mut show_account = |account: &link::Account, components: &[&str], values: &[f64]| {
                show(&account.path(&service), components, account.unit, account.about, values);
            };
            show_account(&STEP_TIME, STEP_TIME.components, &health.step_us);
            if health.loop_us != [0.0; 3] {
                show_account(&LOOP_TIME, LOOP_TIME.components, &health.loop_us);
            }
            let before = self.rates.insert(service.clone(), (health.clock_ns, health.steps));
            if let Some((clock_ns, steps)) = before
                && health.clock_ns > clock_ns
                && health.steps >= steps
            {
                let rate = (health.steps - steps) as f64 * 1e9 / (health.clock_ns - clock_ns) as f64;
                show_account(&RATE, &[], &[rate]);
            }
            let counts = [health.deadline_misses, health.skipped, health.by_timer, health.late_triggers];
            show_account(&DEADLINE, DEADLINE.components, &counts.map(|n| n as f64));
            let overflow = health.overflow[0] + health.overflow[1];
            let counts =
                [health.refused, overflow, health.telemetry_dropped, health.letters_dropped, health.not_finite];
            show_account(&REFUSED, REFUSED.components, &counts.map(|n| n as f64));
            let keys: Vec<&str> = health.inputs.keys().map(String::as_str).collect();
            let each = |of: fn(&supertwin_protocol::InputHealth) -> f64| -> Vec<f64> {
                health.inputs.values().map(of).collect()
            };
            show_account(&AGE, &keys, &each(|i| i.age_ticks_max as f64));
            show_account(&TRANSPORT, &keys, &each(|i| i.transport_ms_max));
            show_account(&MISSING, &keys, &each(|i| i.counts.missing as f64));
        }
        show(GAPS.path, GAPS.components, GAPS.unit(0), GAPS.about, &missing.map(|n| n as f64));
        for (key, missing) in wires {
            show(&wire_gaps(key), &[], GAPS.unit(0), GAPS.about, &[*missing as f64]);
        }
        let lag_ms = (clocks.recorder_ns - clocks.sender_ns) as f64 / 1e6;
        show(LAG.path, &[], LAG.unit(0), LAG.about, &[lag_ms]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A steady clock at one second, and a wall clock.
    struct Wall(u64);

    impl Clock for Wall {
        fn now(&self) -> Duration {
            Duration::from_secs(1)
        }
        fn unix_ns(&self) -> u64 {
            self.0
        }
    }

    #[test]
    fn a_clock_that_is_set_is_noticed_once() {
        let mut monitor = LinkMonitor::default();
        let steps = [5_000_000_000, 7_500_000_000, 7_500_000_000].map(|wall_ns| monitor.clock_step(&Wall(wall_ns)));
        assert_eq!(steps, [None, Some(2.5), None]);
    }

    #[test]
    fn a_backlog_is_no_clock_that_steps_and_a_clock_that_steps_is() {
        let mut monitor = LinkMonitor::default();
        let mut observe = |sender_ns: i64, recorder_ns: i64| {
            monitor.sender(Clocks { sender_ns, recorder_ns });
            monitor.sender_step_s.take()
        };
        let tick = 20_000_000;
        for k in 0..50 {
            assert_eq!(observe(k * tick, k * tick), None);
        }
        // Five seconds of messages arrive at once.
        for k in 50..300 {
            assert_eq!(observe(k * tick, 300 * tick), None);
        }
        let steps: Vec<f64> = (300..350).filter_map(|k| observe(k * tick - 3_000_000_000, k * tick)).collect();
        assert_eq!(steps, [-3.0]);
    }

    #[test]
    fn complaints_of_one_kind_come_once_a_second() {
        let mut monitor = LinkMonitor::default();
        let said: Vec<u64> = (0..3000).filter(|ms| monitor.may_complain("gap", Duration::from_millis(*ms))).collect();
        assert_eq!(said, [0, 1000, 2000]);
    }
}
