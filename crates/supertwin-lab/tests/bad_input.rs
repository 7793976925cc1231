//! Bad configuration: each an error that names file, place, value and rule.

use crate::common::{CONFIG, library};
use std::fs;
use std::path::Path;
use supertwin_lab::{Library, Override, trial};

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("a folder");
    for entry in fs::read_dir(from).expect("a folder").flatten() {
        let (path, target) = (entry.path(), to.join(entry.file_name()));
        if path.is_dir() {
            copy(&path, &target);
        } else {
            fs::copy(&path, &target).expect("copied");
        }
    }
}

/// The error of a copied configuration in which a file was changed.
fn changed(file: &str, change: impl FnOnce(&str) -> String) -> String {
    let folder = tempfile::tempdir().expect("a folder");
    copy(Path::new(CONFIG), folder.path());
    let path = folder.path().join(file);
    fs::write(&path, change(&fs::read_to_string(&path).expect("a shipped file"))).expect("written");
    refused(&Library::new(folder.path(), Vec::new()), "paper-agsta")
}

/// The error of a trial that must be refused.
fn refused(library: &Library, name: &str) -> String {
    trial::load(library, name).expect_err("must be refused").to_string()
}

/// The error that a changed line causes.
fn broken(file: &str, was: &str, is: &str) -> String {
    changed(file, |text| {
        assert!(text.contains(was), "{file} does not contain {was}");
        text.replacen(was, is, 1)
    })
}

/// A file, what stands in it, what somebody wrote instead, and what is said of it.
const MISTAKES: &str = r#"
vehicles/argus-mini.toml | mass_kg = 90.0 | mass_kg = -90.0 | argus-mini.toml:14:11: true.rigid_body.mass_kg: -90: must be positive and finite
vehicles/argus-mini.toml | mass_kg = 90.0 | mass_kg = nan | argus-mini.toml:14:11: true.rigid_body.mass_kg: NaN: must be positive and finite
vehicles/argus-mini.toml | mass_kg = 90.0 | mass_kg = inf | true.rigid_body.mass_kg: inf: must be positive
vehicles/argus-mini.toml | mass_kg = 90.0 | mass_kg = "heavy" | argus-mini.toml:14:11: true.rigid_body.mass_kg: invalid type: string "heavy"
vehicles/argus-mini.toml | mass_kg = 90.0 | mas_kg = 90.0 | unknown field `mas_kg`
vehicles/argus-mini.toml | mass_kg = 90.0 | mas_kg = 90.0 | argus-mini.toml:14:1: true.rigid_body
vehicles/argus-mini.toml | mass_kg = 90.0 | mas_kg = 90.0 | did you mean `mass_kg`?
vehicles/argus-mini.toml | mass_kg = 90.0 |  | missing field `mass_kg`
vehicles/argus-mini.toml | direction = [1.0, -1.0, 0.0] | direction = [0.0, 0.0, 0.0] | thruster[1].direction = [0, 0, 0]: must not be zero
environments/rataren.toml | significant_height_m = 0.6 | significant_height_m = -0.6 | waves.significant_height_m: -0.6: must be zero or positive
environments/rataren.toml | direction_rad = [-3.14 | direction_rad = [7.0, -3.14 | direction_rad
controllers/agsta.toml | [law.agsta] | [law.agtsa] | agsta.toml:5:2: law: wanted exactly 1 element
controllers/agsta.toml | discretisation = "explicit" | discretisation = "implict" | did you mean `implicit`?
trials/paper-agsta.toml | vehicle = "argus-mini" | vehicle = "argus-mni" | did you mean `argus-mini`?
trials/paper-agsta.toml | command.guidance.depth_m = 3.5 | command.guidance.depth_m = 35 | mission at 0.00 s: depth_m = 35: must lie between 0 and 14
trials/paper-agsta.toml | command.guidance.depth_m = 3.5 | command.guidance.depht_m = 3.5 | did you mean `depth_m`?
trials/paper-agsta.toml | from_s = 17.0 | from_s = 170.0 | score.from_s = 170: must be less than duration_s = 120
trials/paper-agsta.toml | substeps = 2 | substeps = 0 | substeps = 0: must be between 1 and 1000
trials/paper-agsta.toml | controllers = ["agsta"] | controllers = [] | must name at least one controller
trials/paper-agsta.toml | seed = 1 | seed = -1 | seed: invalid value: integer `-1`
trials/paper-agsta.toml | duration_s = 120.0 | duration_s = | paper-agsta.toml:
"#;

#[test]
fn each_kind_of_bad_input_is_named() {
    let mut count = 0;
    for line in MISTAKES.trim().lines() {
        let [file, was, is, expected] = line.split('|').map(str::trim).collect::<Vec<_>>()[..] else {
            panic!("{line}")
        };
        let error = broken(file, was, is);
        assert!(error.contains(expected), "{is}:\n  got      {error}\n  expected {expected}");
        assert!(error.contains(".toml") || error.contains("argus"), "names its file: {error}");
        count += 1;
    }
    assert_eq!(count, 21);
}

#[test]
fn too_many_and_too_few_thrusters_are_refused() {
    let extra = "[[thruster]]\nname = \"x\"\nposition_m = [0.0, 0.0, 0.0]\ndirection = [1.0, 0.0, 0.0]\nmax_n = 1.0\ngroup = \"horizontal\"\n";
    let nine = broken("vehicles/argus-mini.toml", "[[thruster]]", &format!("{}[[thruster]]", extra.repeat(3)));
    assert!(nine.contains("9 thrusters given, must be 1 to 8"), "{nine}");
    // Only the horizontal four are left: nothing makes heave.
    let horizontal = |text: &str| text.split("[[thruster]]").take(5).collect::<Vec<_>>().join("[[thruster]]");
    let four = changed("vehicles/argus-mini.toml", horizontal);
    assert!(four.contains("the 4 thrusters can't make every wrench"), "{four}");
}

#[test]
fn unknown_trials_and_overrides_are_refused_with_what_there_is() {
    let unknown = refused(&library(&[]), "paper-agst");
    assert!(unknown.contains("no such trial") && unknown.contains("did you mean `paper-agsta`?"), "{unknown}");
    let section = "vehicles.mass_kg=1".parse::<Override>().expect_err("unknown section").to_string();
    assert!(section.contains("did you mean `vehicle`?"), "{section}");
    for (set, expected) in [
        ("vehicle.true.rigid_body.mass_kg=-5", "--set vehicle.true.rigid_body.mass_kg=-5: "),
        ("vehicle.true.rigid_body.mass_kg=-5", "must be positive"),
        (
            "environment.wave.significant_height_m=0.3",
            "--set environment.wave.significant_height_m=0.3: `wave` is not there; did you mean `waves`?",
        ),
        ("environment.waves.height_m=0.3", "unknown field `height_m`"),
        ("trial.duration_s=long", "trial.duration_s=long"),
        ("trial.duration_s=long", "invalid type: string \"long\""),
    ] {
        let error = refused(&library(&[set]), "paper-agsta");
        assert!(error.contains(expected), "{set}: {error}");
        assert!(!expected.starts_with("--set") || error.starts_with(expected), "{set}: {error}");
    }
}

#[test]
fn a_file_without_an_end_is_refused() {
    let error = refused(&library(&["trial.vehicle=/dev/zero"]), "fair");
    assert!(error.starts_with("/dev/zero: must have at most 1048576 bytes"), "{error}");
}

#[test]
fn every_shipped_trial_is_legal() {
    let names = library(&[]).names("trials");
    assert!(names.len() >= 10);
    for name in names {
        let trials = trial::load(&library(&[]), &name).unwrap_or_else(|error| panic!("{error}"));
        assert!(!trials.is_empty(), "{name}");
    }
    // Files that no trial names must still be read by one.
    for controller in library(&[]).names("controllers") {
        let set = format!("trial.controllers=[\"{controller}\"]");
        assert!(trial::load(&library(&[&set]), "fair").is_ok(), "{controller}");
    }
}
