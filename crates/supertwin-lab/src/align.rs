//! Runs laid beside each other: the event that is time zero in each, and the window around it.

use serde::Serialize;
use std::fmt;
use std::str::FromStr;
use supertwin_core::message::Mode;
use supertwin_core::signal::Component;
use supertwin_core::signal::reference::{MODE, SETPOINT};
use supertwin_core::{Event, EventKind, RecordedRun};

/// Its sign is the direction of travel.
const SPEED: Component = SETPOINT.at("speed");

/// What is time zero.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Alignment {
    /// The start of the run.
    Start,
    /// The vehicle begins to follow the net: guidance's mode becomes `follow_net`.
    Following,
    /// The direction of travel is reversed: the speed that is wanted along the net changes its sign.
    Reversed,
    /// A fault is injected: a command to the plant, or to the wires of a batch run, applies.
    Fault,
    /// An event happens whose `service: text` contains this; `*` stands for anything.
    Event(String),
}

impl fmt::Display for Alignment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Start => f.write_str("start"),
            Self::Following => f.write_str("following"),
            Self::Reversed => f.write_str("reversed"),
            Self::Fault => f.write_str("fault"),
            Self::Event(text) => write!(f, "event:{text}"),
        }
    }
}

impl FromStr for Alignment {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "start" => Ok(Self::Start),
            "following" => Ok(Self::Following),
            "reversed" => Ok(Self::Reversed),
            "fault" => Ok(Self::Fault),
            _ => match text.strip_prefix("event:").filter(|text| !text.is_empty()) {
                Some(text) => Ok(Self::Event(text.to_owned())),
                None => Err("must be start, following, reversed, fault, or event:TEXT".to_owned()),
            },
        }
    }
}

impl Alignment {
    /// Whether a signal, label, command or event is needed to find it.
    #[must_use]
    pub fn is_needed(&self, path: &str) -> bool {
        match self {
            Self::Start => false,
            Self::Following => path == MODE.path,
            Self::Reversed => path == SETPOINT.path,
            Self::Fault => path == "command/plant" || path == "event/mission",
            Self::Event(_) => path.starts_with("event/"),
        }
    }

    /// The tick of the first such event.
    ///
    /// # Errors
    /// What was looked for and is not there.
    pub fn find(&self, source: &RecordedRun) -> Result<i64, String> {
        match self {
            Self::Start => Ok(0),
            Self::Following => {
                let follows = source.label(&MODE).iter().find(|mode| mode.value == Mode::FollowNet.name());
                follows.map(|mode| mode.tick).ok_or_else(|| "it never follows the net".to_owned())
            }
            Self::Reversed => reversed(source).ok_or_else(|| "its direction is never reversed".to_owned()),
            Self::Fault => {
                let commanded = source.commands_of("plant").first();
                // A batch run has its commands among the events.
                let of_mission = source
                    .events
                    .iter()
                    .find(|event| matches!(&event.what, EventKind::CommandApplied { command } if command.is_fault()));
                let ticks = commanded.map(|command| command.tick).into_iter();
                let ticks = ticks.chain(of_mission.map(|event| event.tick as i64));
                ticks.min().ok_or_else(|| "no fault is injected in it".to_owned())
            }
            Self::Event(pattern) => {
                let fits = |event: &&Event| contains(&format!("{}: {}", event.service, event.what), pattern);
                let event = source.events.iter().find(fits);
                event.map(|event| event.tick as i64).ok_or_else(|| format!("none of its events contains {pattern:?}"))
            }
        }
    }
}

/// The first tick at which the wanted speed has the other sign than the last that was not zero.
fn reversed(source: &RecordedRun) -> Option<i64> {
    let columns = source.signal(&SETPOINT).filter(|columns| columns.width == SETPOINT.width())?;
    let mut before = 0.0;
    for (row, tick) in columns.values.chunks_exact(columns.width).zip(&columns.tick) {
        let speed = row[SPEED.index];
        if before * speed < 0.0 {
            return Some(*tick);
        }
        if speed != 0.0 {
            before = speed;
        }
    }
    None
}

/// Whether the pieces between the stars stand in the text, in this order.
fn contains(text: &str, pattern: &str) -> bool {
    let mut rest = text;
    pattern.split('*').all(|piece| match rest.find(piece) {
        Some(at) => {
            rest = &rest[at + piece.len()..];
            true
        }
        None => false,
    })
}

/// Farthest that a window may reach, thirty years.
const LONGEST_S: f64 = 1e9;

/// `FROM:TO` in seconds from time zero; what is left out is where the runs begin to be scored, and where they end.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WindowArgument {
    /// First moment, in seconds from time zero.
    pub from_s: Option<f64>,
    /// To here, which is no longer part of it.
    pub to_s: Option<f64>,
}

impl FromStr for WindowArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (from, to) = text.split_once(':').ok_or("must be written as FROM:TO, in seconds")?;
        let number = |text: &str| match text.trim() {
            "" => Ok(None),
            text => match text.parse::<f64>() {
                Ok(number) if libm::fabs(number) <= LONGEST_S => Ok(Some(number)),
                _ => Err(format!("{text:?}: must be a number of seconds, at most {LONGEST_S} either way")),
            },
        };
        let (from_s, to_s) = (number(from)?, number(to)?);
        if let (Some(from_s), Some(to_s)) = (from_s, to_s)
            && from_s >= to_s
        {
            return Err(format!("{from_s}:{to_s}: must begin before it ends"));
        }
        Ok(Self { from_s, to_s })
    }
}

/// Part of a run in seconds from its time zero.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Window {
    /// First moment, in seconds from time zero.
    pub from_s: f64,
    /// To here, which is no longer part of it.
    pub to_s: f64,
}

impl Window {
    /// What several runs have in common; a run that would leave less than half of it is passed over, so that one short
    /// run does not spoil all.
    #[must_use]
    pub fn common(windows: impl IntoIterator<Item = Self>) -> Option<Self> {
        windows.into_iter().filter(|window| window.length_s() > 0.0).reduce(|all, window| {
            let both = Self { from_s: all.from_s.max(window.from_s), to_s: all.to_s.min(window.to_s) };
            if 2.0 * both.length_s() < all.length_s() { all } else { both }
        })
    }

    fn length_s(self) -> f64 {
        self.to_s - self.from_s
    }
}

/// The moments of one run that are compared: every `tick_s` from time zero on.
///
/// A run whose ticks are shorter is looked at where the newest tick stood at each of these moments (zero-order hold).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Tick of the run that is time zero.
    pub origin: i64,
    /// Ticks of the run per moment, 1 when its own ticks are the moments.
    ticks_per_moment: f64,
    /// Seconds between the moments.
    pub tick_s: f64,
    /// The first moment, from time zero on.
    pub from: i64,
    /// The first moment that is not compared.
    pub to: i64,
}

impl Grid {
    /// The moments of `window`, `grid_s` apart, of a run with ticks of `tick_s` whose tick `origin` is time zero.
    #[must_use]
    pub fn new(origin: i64, tick_s: f64, window: Window, grid_s: f64) -> Self {
        // As `Tick::at_or_after`, but also before zero: half a microsecond of grace for decimal fractions.
        let moment = |t_s: f64| libm::ceil((t_s - 5e-7) / grid_s) as i64;
        let ratio = grid_s / tick_s;
        let ticks_per_moment = if libm::fabs(ratio - 1.0) < 1e-9 { 1.0 } else { ratio };
        Self { origin, ticks_per_moment, tick_s: grid_s, from: moment(window.from_s), to: moment(window.to_s) }
    }

    /// The run's tick at a moment: the newest one then.
    #[must_use]
    pub fn tick(&self, moment: i64) -> i64 {
        if !self.is_resampled() {
            return self.origin + moment;
        }
        self.origin + libm::floor(moment as f64 * self.ticks_per_moment + 1e-6) as i64
    }

    /// The moments, and the one before them, that lie in a run whose last tick is `last`.
    pub(crate) fn within(&self, last: i64) -> core::ops::Range<i64> {
        let moment = |tick: i64| libm::floor((tick - self.origin) as f64 / self.ticks_per_moment) as i64;
        let first = (moment(0)..).find(|moment| self.tick(*moment) >= 0).unwrap_or(0);
        first.max(self.from - 1)..self.to.min(moment(last) + 2)
    }

    /// Its ticks are not the moments.
    #[must_use]
    pub fn is_resampled(&self) -> bool {
        self.ticks_per_moment != 1.0
    }

    /// How many moments there are.
    #[must_use]
    pub fn len(&self) -> u64 {
        self.to.saturating_sub(self.from).max(0) as u64
    }

    /// There are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_read_as_they_are_written() {
        for word in ["start", "following", "reversed", "fault", "event:estimator: net * lost"] {
            assert_eq!(word.parse::<Alignment>().map(|alignment| alignment.to_string()), Ok(word.to_owned()));
        }
        let error = "folowing".parse::<Alignment>().expect_err("is no event");
        assert!(error.contains("event:TEXT"), "{error}");
        assert_eq!("17:63".parse(), Ok(WindowArgument { from_s: Some(17.0), to_s: Some(63.0) }));
        assert_eq!("-2.5:".parse(), Ok(WindowArgument { from_s: Some(-2.5), to_s: None }));
        assert_eq!(":".parse(), Ok(WindowArgument::default()));
        for wrong in ["17", "63:17", "a:b", "nan:", "5:5"] {
            assert!(wrong.parse::<WindowArgument>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn stars_stand_for_anything() {
        assert!(contains("estimator: net lost", "net lost") && contains("estimator: net lost", "estimator:*lost"));
        assert!(!contains("estimator: net lost", "lost*net") && contains("anything", "*"));
    }

    #[test]
    fn what_runs_have_in_common_is_not_spoilt_by_one_of_them() {
        let window = |from_s, to_s| Window { from_s, to_s };
        let common =
            Window::common([window(17.0, 120.0), window(29.0, 150.0), window(500.0, 600.0), window(0.0, 40.0)]);
        assert_eq!(common, Some(window(29.0, 120.0)));
        assert_eq!(Window::common([window(5.0, 5.0)]), None);
    }

    #[test]
    fn a_coarser_grid_takes_the_newest_tick() {
        let window = Window { from_s: -0.1, to_s: 0.3 };
        let same = Grid::new(100, 0.02, window, 0.02);
        assert_eq!((same.from, same.to, same.len(), same.tick(same.from)), (-5, 15, 20, 95));
        let finer = Grid::new(100, 0.01, window, 0.025);
        let ticks: Vec<i64> = (finer.from..finer.to).map(|moment| finer.tick(moment)).collect();
        // Moments at −100, −75, −50, … ms.
        assert_eq!(ticks, [90, 92, 95, 97, 100, 102, 105, 107, 110, 112, 115, 117, 120, 122, 125, 127]);
        assert!(finer.is_resampled() && !same.is_resampled());
        // However long the window is, no more is looked at than there is.
        assert_eq!(same.within(1000), -6..15);
        let endless = Grid::new(100, 0.02, Window { from_s: -1e12, to_s: 1e12 }, 0.02);
        assert_eq!(endless.within(109), -100..11);
    }
}
