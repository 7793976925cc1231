//! Whatever stands in a configuration: it is refused in words, or makes blocks that step, and say so when a number is none.
//!
//! A payload is any number of lines `--set section.path=value`, then a line that names a section (`vehicle`), then the
//! text of its file; all other files are shipped ones. A section without a text is a shipped file too; `recorded` is a
//! whole trial as a recording keeps it.

use std::path::PathBuf;
use std::sync::OnceLock;
use supertwin_core::digest::DigestProbe;
use supertwin_core::message::Message;
use supertwin_core::observe::Snapshot;
use supertwin_core::{Refusal, Tick};
use supertwin_lab::config::SECTIONS;
use supertwin_lab::mission::Mission;
use supertwin_lab::run::scene;
use supertwin_lab::{ConfigError, Library, Override, ResolvedTrial, Twin, trial};

/// The shipped files.
const CONFIG: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../config");
/// Two laws, a mission that uses both, waves.
const TRIAL: &str = "hand-over";
/// Ticks of a legal twin, fewer when each has many steps.
const TICKS: u64 = 40;
/// Runge-Kutta steps of a legal twin.
const SUBSTEPS: u64 = 400;
/// Overrides of one payload.
const OVERRIDES: usize = 4;

/// One payload.
pub(crate) fn check(payload: &[u8]) {
    let Ok(payload) = core::str::from_utf8(payload) else { return };
    let mut rest = payload;
    let mut overrides = Vec::new();
    while let Some(line) = rest.strip_prefix("--set ").filter(|_| overrides.len() < OVERRIDES) {
        let (text, after) = line.split_once('\n').unwrap_or((line, ""));
        match text.parse::<Override>() {
            Ok(over) => overrides.push(over),
            Err(error) => return has_words(&error),
        }
        rest = after;
    }
    let (section, text) = rest.split_once('\n').unwrap_or((rest, ""));
    if section == "recorded" {
        return match ResolvedTrial::from_text("fuzz", "fuzz", text, "place") {
            Ok(trial) => legal(&trial),
            Err(error) => has_words(&error),
        };
    }
    let section = SECTIONS.into_iter().find(|known| *known == section);
    match load(overrides, section.filter(|_| !text.is_empty()), text) {
        Ok(trials) => {
            assert!(!trials.is_empty(), "a trial without a controller");
            trials.iter().take(2).for_each(legal);
        }
        Err(error) => has_words(&error),
    }
}

/// The shipped trial, with `text` as the file of a section.
fn load(mut overrides: Vec<Override>, section: Option<&str>, text: &str) -> Result<Vec<ResolvedTrial>, ConfigError> {
    let Some(section) = section else { return trial::load(&Library::new(CONFIG, overrides), TRIAL) };
    // In this order: an override of the payload may name another file again.
    let file = file();
    std::fs::write(&file, text).expect("a file for the text");
    let name = file.to_str().expect("a name in UTF-8");
    if section == "trial" {
        return trial::load(&Library::new(CONFIG, overrides), name);
    }
    let here = match section {
        "controller" => format!("trial.controllers=[{name:?}]"),
        _ => format!("trial.{section}={name:?}"),
    };
    overrides.insert(0, here.parse().expect("a legal override"));
    trial::load(&Library::new(CONFIG, overrides), TRIAL)
}

/// One file of this process, replaced by every payload.
fn file() -> PathBuf {
    static FOLDER: OnceLock<tempfile::TempDir> = OnceLock::new();
    FOLDER.get_or_init(|| tempfile::tempdir().expect("a folder")).path().join("fuzzed.toml")
}

/// An error says something, and can be shown on a terminal.
fn has_words(error: &ConfigError) {
    let text = error.to_string();
    assert!(!text.trim().is_empty(), "an error without words");
}

/// What was accepted can be recorded and read again, and its blocks step.
fn legal(trial: &ResolvedTrial) {
    let again = ResolvedTrial::from_text(&trial.name, &trial.controller_name, &trial.text, "recorded");
    let again = again.unwrap_or_else(|error| panic!("what was accepted is refused: {error}"));
    assert_eq!(again.trial, trial.trial);
    assert_eq!(again.vehicle, trial.vehicle);
    assert_eq!(again.environment, trial.environment);
    assert_eq!(again.sensors, trial.sensors);
    assert_eq!(again.estimator, trial.estimator);
    assert_eq!(again.guidance, trial.guidance);
    assert_eq!(again.safety, trial.safety);
    assert_eq!(again.controller, trial.controller);
    // Any seed, not only the one that was tried when it was loaded.
    let seed = trial.trial.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(1);
    let mut twin = Twin::new(trial, seed).unwrap_or_else(|error| panic!("not for seed {seed}: {error}"));
    scene(trial, seed).unwrap_or_else(|error| panic!("can't be drawn: {error}"));
    let mission = Mission::new(&trial.trial.mission, trial.trial.tick_s.get());
    let mut commands = mission.steps.iter().map(|(_, command)| command);
    let mut probe = DigestProbe::default();
    for k in 0..TICKS.min(SUBSTEPS / u64::from(trial.trial.substeps)).max(2).min(trial.ticks()) {
        let tick = Tick { k, dt_s: trial.trial.tick_s.get() };
        if k % 2 == 1
            && let Some(command) = commands.next()
        {
            // Early: the mission's own time may be hours from here.
            let _: Result<(), Refusal> = twin.command(tick, command);
        }
        twin.step(tick);
        match twin.digest(tick, &mut probe) {
            Err(error) => {
                assert!(!Snapshot::of(&twin).is_finite(), "all is well, and yet: {error}");
                return;
            }
            Ok(_) => {
                let shown = Snapshot::of(&twin);
                assert!(shown.is_finite(), "tick {k}: {:?} went unnoticed", shown.first_non_finite());
                let now = twin.outputs().expect("a step has been taken");
                let finite = now.measurements.is_finite() && now.nav.is_finite();
                assert!(finite && now.reference.is_finite() && now.thrust.is_finite(), "tick {k}: NaN on a wire");
                assert!(twin.truth().is_finite(), "tick {k}: NaN in the truth");
            }
        }
    }
    assert_eq!(twin.events_dropped, 0, "events that nobody hears of");
}
