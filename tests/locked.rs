//! From nothing to a locked vehicle, by the commands of the tutorial and as they stand there: in a network of its own, at
//! the tutorial's addresses.

use crate::support::console::{Script, Step, steps};
use crate::support::python::environment_with;
use crate::support::{CONFIG, Place, free_port};
use std::path::Path;

const PAGE: &str = include_str!("../docs/src/tutorials/locked.md");
const TOP: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
/// Where the tutorial's vehicle is.
const ADDRESS: &str = "192.168.2.2";

#[test]
fn the_commands_of_the_tutorial_lock_a_vehicle_and_steer_it_from_python() {
    let command = |step| match step {
        Step::Command { line, answer } if answer.is_empty() => line,
        other => panic!("no command: {other:?}"),
    };
    let commands: Vec<String> = steps(PAGE).into_iter().map(command).collect();
    assert!((5..=10).contains(&commands.len()), "at most ten commands: {commands:#?}");
    let place = Place::new();
    std::os::unix::fs::symlink(Path::new(TOP).join("tests"), place.path().join("tests")).expect("is linked");
    // Packages come from the world outside: they are fetched before the network is left.
    let packages: Vec<&str> = commands.iter().filter_map(|line| line.strip_prefix("pip install ")).collect();
    let python = environment_with("python-clients", &packages).join("bin");
    let mut script = Script::new(&format!("{}:{}", place.bin(&format!("--config '{CONFIG}'")), python.display()));
    // Those who can not have a network of their own need a free port.
    let (port, apart) = (free_port(), script.apart.is_some());
    let here = |line: &str| {
        if apart {
            return line.to_owned();
        }
        line.replace(&format!("{ADDRESS}:7447"), &format!("127.0.0.1:{port}")).replace(ADDRESS, "127.0.0.1")
    };
    script.line("export PYTHONDONTWRITEBYTECODE=1 PIP_DISABLE_PIP_VERSION_CHECK=1");
    if apart {
        script.line(&format!("ip address add {ADDRESS}/32 dev lo"));
    } else {
        script.line(&format!("export SUPERTWIN_CONNECT={}", place.socket));
    }
    for command in &commands {
        script.command(&here(command));
        if !apart && command.contains("zenoh-config") {
            let socket = place.socket.replace("unixsock-stream/", "");
            script.line(&format!("sed -i 's#/tmp/supertwin/router.sock#{socket}#; s#:7447#:{port}#' router.json5"));
        }
    }
    // What was steered is there; and nobody gets in without a certificate, nor past his role.
    let tls = here(&format!("tls/{ADDRESS}:7447"));
    let get = format!("supertwin get depth_m --connect {tls}");
    script.command(&format!("{get} --json --credentials pki/anna"));
    script.command(&format!("! {get}"));
    script.command("supertwin pki issue observer ben --vehicle argus-mini");
    script.command(&format!("! supertwin set depth_m 5 --connect {tls} --credentials pki/ben"));
    script.command(&format!("{get} --json --credentials pki/anna"));
    let answers = script.run(&place);
    let n = commands.len();
    let steered = commands.iter().position(|line| line.starts_with("python ")).expect("an operator in Python");
    assert!(answers[steered].contains("reached: "), "{}", answers[steered]);
    for depth in [&answers[n], &answers[n + 4]] {
        let depth: serde_json::Value = serde_json::from_str(depth).expect("JSON");
        assert_eq!(depth["value"]["constant"], 3.0, "{depth}");
    }
    assert!(answers[n + 1].contains("no router at"), "{}", answers[n + 1]);
}
