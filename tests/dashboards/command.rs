//! The command that lists and writes dashboards.

use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use supertwin_rerun::blueprint::DASHBOARDS;

fn supertwin(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_supertwin"));
    command.current_dir(folder).args(arguments).stdin(Stdio::null()).output().unwrap()
}

#[test]
fn the_command_lists_dashboards_and_writes_them_once() {
    let folder = tempfile::tempdir().unwrap();
    let listed = supertwin(folder.path(), &["dashboard", "--list"]);
    let said = String::from_utf8(listed.stdout).unwrap();
    assert!(DASHBOARDS.iter().zip(said.lines()).all(|(one, line)| line.starts_with(one.name)), "{said}");
    // What depends on the runs has no file, and the list says who writes it.
    assert!(said.lines().last().unwrap().starts_with("compare "), "{said}");
    assert!(said.contains("`supertwin compare --out`"), "{said}");

    let saved = supertwin(folder.path(), &["dashboard", "--save", "here", "--json"]);
    let saved: Value = serde_json::from_slice(&saved.stdout).unwrap();
    let saved = saved.as_array().unwrap();
    assert_eq!(saved.len(), DASHBOARDS.len() - 1, "all but the one that depends on the runs");
    for (described, one) in DASHBOARDS.iter().zip(saved) {
        let name = described.name;
        assert_eq!((one["name"].as_str(), one["file"].as_str()), (Some(name), Some(&*format!("here/{name}.rbl"))));
        assert!(one["views"].as_array().is_some_and(|views| !views.is_empty()));
        let bytes = fs::read(folder.path().join(format!("here/{name}.rbl"))).unwrap();
        assert!(bytes.starts_with(b"RRF"), "{name}");
    }
    // A file that is there is only replaced when asked to.
    fs::write(folder.path().join("here/link.rbl"), "precious").unwrap();
    let again = supertwin(folder.path(), &["dashboard", "link", "--save", "here"]);
    assert_eq!(again.status.code(), Some(2));
    let said = String::from_utf8(again.stderr).unwrap();
    assert!(said.contains("here/link.rbl: exists already; use --force to replace it"), "{said}");
    assert_eq!(fs::read(folder.path().join("here/link.rbl")).unwrap(), b"precious");
    assert!(supertwin(folder.path(), &["dashboard", "link", "--save", "here", "--force"]).status.success());

    let none = supertwin(folder.path(), &["dashboard", "compare", "--save", "here"]);
    let refused = String::from_utf8(none.stderr).unwrap();
    assert!(none.status.code() == Some(2) && refused.contains("compare: depends on the runs"), "{refused}");

    let unknown = supertwin(folder.path(), &["dashboard", "trackings", "--list"]);
    assert_eq!(unknown.status.code(), Some(2));
    assert!(String::from_utf8(unknown.stderr).unwrap().contains("trackings: is no dashboard; there are overview"));
}
