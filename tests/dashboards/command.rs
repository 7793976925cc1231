//! The command that lists and writes dashboards.

use crate::support::Place;
use std::fs;
use supertwin_rerun::blueprint::DASHBOARDS;

#[test]
fn the_command_lists_dashboards_and_writes_them_once() {
    let place = Place::new();
    let said = place.call(&["dashboard", "--list"]).out;
    assert!(DASHBOARDS.iter().zip(said.lines()).all(|(one, line)| line.starts_with(one.name)), "{said}");
    // What depends on the runs has no file, and the list says who writes it.
    assert!(said.lines().last().unwrap().starts_with("compare "), "{said}");
    assert!(said.contains("`supertwin compare --out`"), "{said}");

    let saved = place.call(&["dashboard", "--save", "here", "--json"]).json();
    let saved = saved.as_array().unwrap();
    assert_eq!(saved.len(), DASHBOARDS.len() - 1, "all but the one that depends on the runs");
    for (described, one) in DASHBOARDS.iter().zip(saved) {
        let name = described.name;
        assert_eq!((one["name"].as_str(), one["file"].as_str()), (Some(name), Some(&*format!("here/{name}.rbl"))));
        assert!(one["views"].as_array().is_some_and(|views| !views.is_empty()));
        let bytes = fs::read(place.path().join(format!("here/{name}.rbl"))).unwrap();
        assert!(bytes.starts_with(b"RRF"), "{name}");
    }
    // A file that is there is only replaced when asked to.
    let file = place.path().join("here/link.rbl");
    fs::write(&file, "precious").unwrap();
    let save = ["dashboard", "link", "--save", "here"];
    place.call(&save).refused("here/link.rbl: exists already; use --force to replace it");
    assert_eq!(fs::read(&file).unwrap(), b"precious");
    place.call(&[&save[..], &["--force"]].concat()).well();

    place.call(&["dashboard", "compare", "--save", "here"]).refused("compare: depends on the runs");
    place.call(&["dashboard", "trackings", "--list"]).refused("trackings: is no dashboard; there are overview");
}
