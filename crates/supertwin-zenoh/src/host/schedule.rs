//! When to step: in lock step when all inputs are there, in real time by trigger or timer.

use super::{Ending, Host};
use std::time::Duration;
use supertwin_core::{EventKind, Severity, Wired};

/// First wait before an output is repeated in lock step, while no lap has been timed.
pub(super) const REPEAT_FIRST: Duration = Duration::from_millis(20);
/// The same in laps: what is only slow must not be taken for lost, or repetitions make it slower still.
const REPEAT_LAPS: u32 = 4;
/// The least that comes of it.
const REPEAT_LEAST: Duration = Duration::from_millis(2);
/// Longest wait between repetitions.
const REPEAT_MOST: Duration = Duration::from_millis(250);
/// After its last tick a service answers the others for this long, when nobody says that the run is over.
const LINGER: Duration = Duration::from_secs(2);
/// Before the first message of a run the others may take this long to come up.
const START_PATIENCE: Duration = Duration::from_secs(60);
/// The owner of time makes up for at most this much after it was stopped.
const CATCH_UP_S: f64 = 30.0;
/// Ticks by which a service may be ahead of the owner of time and still wait for it.
const LEVEL_TICKS: u64 = 50;

/// The shortest lap lately: a lap in which something was lost says nothing about the speed of the link.
pub(crate) fn shortest(known: Duration, lap: Duration) -> Duration {
    if known.is_zero() || lap < known { lap } else { known + (lap - known) / 256 }
}

impl<B: Wired + 'static> Host<B> {
    pub(super) fn poll_lock_step(&mut self) -> bool {
        let now = self.now;
        let done = self.options.ticks.is_some_and(|ticks| self.next >= ticks);
        let ready = self.ports.states().all(|port| port.ready(self.next));
        let seen = self.next.checked_sub(1);
        let witnessed = self.witnesses.iter().all(|witness| seen.is_none_or(|tick| witness.seen >= Some(tick)));
        let joined_late = !B::OWNS_TIME && self.run.is_empty();
        if ready && witnessed && !done && !joined_late {
            let before = core::mem::replace(&mut self.lap.began, now);
            self.step(self.next, true);
            if self.next > 1 {
                self.lap.shortest = shortest(self.lap.shortest, now.saturating_sub(before));
            }
            self.lap.repeat_after = self.repeat_first();
            return true;
        }
        if done && B::OWNS_TIME && ready && witnessed {
            for _ in 0..3 {
                self.say_stop(true, "complete");
            }
            self.ending = Some(Ending::Complete);
            return true;
        }
        let silent = now.saturating_sub(self.received_at);
        if done && !B::OWNS_TIME && silent > LINGER {
            self.ending = Some(Ending::Complete);
            return true;
        }
        let started = self.wires.iter().any(|wire| wire.held.is_some());
        let patience = if started { self.options.patience } else { START_PATIENCE.max(self.options.patience) };
        if silent > patience {
            let missing = self.ports.states().filter(|port| !port.ready(self.next)).map(|port| port.key.to_owned());
            let unseen = self.witnesses.iter().filter(|witness| witness.seen < seen);
            let waits = missing.chain(unseen.map(|witness| format!("witness {}", witness.name)));
            let (tick, waits) = (self.next, waits.collect::<Vec<_>>().join(", "));
            self.fail(format!("tick {tick}: waited {:.0} s for {waits}", silent.as_secs_f64()));
            return true;
        }
        if self.output.is_some() && now.saturating_sub(self.lap.sent_at) >= self.lap.repeat_after {
            self.send_again();
            self.lap.repeat_after = (self.lap.repeat_after * 2).min(REPEAT_MOST);
        }
        false
    }

    /// How long to wait for the others before saying the last output again.
    pub(super) fn repeat_first(&self) -> Duration {
        if self.lap.shortest.is_zero() {
            REPEAT_FIRST
        } else {
            (self.lap.shortest * REPEAT_LAPS).clamp(REPEAT_LEAST, REPEAT_MOST)
        }
    }

    pub(super) fn poll_real_time(&mut self) -> bool {
        let now = self.now;
        let interval = self.step_interval();
        if self.options.ticks.is_some_and(|ticks| self.next >= ticks) {
            self.ending = Some(Ending::Complete);
            return true;
        }
        if B::OWNS_TIME {
            let due = *self.schedule.due.get_or_insert(now);
            if now < due {
                return false;
            }
            // Behind by whole ticks: they are simulated, but only the newest is worth sending.
            let behind = (now - due).as_nanos() / interval.as_nanos().max(1);
            let ticks = u64::try_from(behind).unwrap_or(u64::MAX / 2);
            if ticks > (CATCH_UP_S / self.options.tick_s) as u64 {
                self.note(Severity::Error, EventKind::TicksLeftOut { ticks });
                self.next += ticks;
                self.counters.health.skipped += ticks;
                self.schedule.due = Some(now + interval);
            } else {
                for _ in 0..ticks {
                    self.step(self.next, false);
                }
                if ticks > 0 {
                    self.counters.health.deadline_misses += ticks;
                    self.note(Severity::Warning, EventKind::TicksLate { ticks });
                }
                self.schedule.due = Some(due + interval * u32::try_from(ticks + 1).unwrap_or(u32::MAX));
            }
            self.step(self.next, true);
            return true;
        }
        if let Some(tick) = self.schedule.trigger.take() {
            if tick >= self.next {
                if self.output.is_some() {
                    self.counters.health.skipped += tick - self.next;
                }
                self.step(tick, true);
                self.schedule.due = Some(now + 2 * interval);
                return true;
            }
            // Ahead of the owner of time: waits until it is level again.
            self.counters.health.late_triggers += 1;
            if self.next - tick < LEVEL_TICKS {
                self.schedule.due = Some(now + 2 * interval);
            }
            return false;
        }
        if let Some(due) = self.schedule.due
            && now >= due
        {
            self.counters.health.by_timer += 1;
            self.step(self.next, true);
            self.schedule.due = Some(if due + interval < now { now + interval } else { due + interval });
            return true;
        }
        false
    }
}
