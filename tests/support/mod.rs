//! What the tests share: pages of the book and what they show, processes that end with their test, who listens to a
//! vehicle, a tether to be cut.
#![allow(unreachable_pub, reason = "is for all modules of the program")]

pub mod console;
mod listener;
pub mod page;
mod process;
pub mod python;
mod tamper;
mod tether;
mod written;

pub use listener::{Events, Listener};
pub use process::{Ended, Place, Process};
pub use tamper::{Tamper, tampered};
pub use tether::{Cable, Proxy, free_port};
pub use written::until_written;

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The shipped configuration.
pub const CONFIG: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../config");
/// The four services of a vehicle.
pub const SERVICES: [&str; 4] = ["plant", "estimator", "guidance", "controller"];
/// The vehicle's name in tests over a network.
pub const ROV: &str = "rov";
/// Longest wait for anything in these tests: a recorder in a dev build takes half a minute to rewrite 20 s in larger pieces.
pub const LIMIT: Duration = Duration::from_secs(180);

/// All of these words are in a text.
pub fn assert_says(text: &str, all: &[&str]) {
    all.iter().for_each(|words| assert!(text.contains(words), "{words} is missing in\n{text}"));
}

/// Files in a folder, by name.
pub fn files_in(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    let mut files: Vec<PathBuf> = entries.collect();
    files.sort();
    files
}

/// The only recording in a folder, without its further parts.
pub fn recording_in(folder: &Path) -> PathBuf {
    let mut files = files_in(folder);
    files.retain(|path| !path.display().to_string().contains(".part"));
    assert_eq!(files.len(), 1, "{files:?}");
    files.remove(0)
}

/// Where a process listens that says so in its first line, e.g. by `tcp`.
pub fn listening(said: &Value, protocol: &str) -> String {
    let mut places = said["listening"].as_array().into_iter().flatten().filter_map(Value::as_str);
    places.find(|place| place.starts_with(protocol)).unwrap_or_else(|| panic!("no {protocol} in {said}")).to_owned()
}

/// A trial that follows the net from its first second, as a file in `folder`.
pub fn following(folder: &Path) -> String {
    let fair = include_str!("../../config/trials/fair.toml");
    let (head, _) = fair.split_once("[start]").expect("has a start");
    let head = head.replace(r#"["gsta", "agsta", "pid", "gsta-tuned", "pid-tuned"]"#, r#"["gsta-tuned"]"#);
    let text = format!(
        "{head}[start]\nbearing_rad = 0.5\nnet_distance_m = 3.0\ndepth_m = 4.0\nheading_offset_rad = 0.0\n\
         [score]\nfrom_s = 1.0\n\
         [[mission]]\nat_s = 0.0\ncommand.guidance.depth_m = 4.0\n\
         [[mission]]\nat_s = 0.0\ncommand.guidance.mode = \"follow_net\"\n"
    );
    let path = folder.join("following.toml");
    std::fs::write(&path, text).expect("is written");
    path.display().to_string()
}
