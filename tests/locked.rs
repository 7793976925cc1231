//! From nothing to a locked vehicle, by the commands of the tutorial and as they stand there: in a network of its own, at
//! the tutorial's addresses.

use crate::support::console::{Step, apart, left_running, steps};
use crate::support::{CONFIG, Place, Process};
use std::fmt::Write;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;

const PAGE: &str = include_str!("../docs/src/tutorials/locked.md");
const TOP: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
const SUPERTWIN: &str = env!("CARGO_BIN_EXE_supertwin");
/// Where the tutorial's vehicle is.
const ADDRESS: &str = "192.168.2.2";

/// A free port of this machine, for those who can't have a network of their own.
fn free_port() -> u16 {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    listener.local_addr().expect("is bound").port()
}

/// An environment for Python of its own, with pip.
fn python(place: &Place) -> PathBuf {
    let home = place.path().join("python");
    let made = Command::new("python3").args(["-m", "venv"]).arg(&home).status().expect("python3 is there");
    assert!(made.success());
    home.join("bin")
}

#[test]
fn the_commands_of_the_tutorial_lock_a_vehicle_and_steer_it_from_python() {
    let command = |step| match step {
        Step::Command { line, answer } if answer.is_empty() => line,
        other => panic!("no command: {other:?}"),
    };
    let commands: Vec<String> = steps(PAGE).into_iter().map(command).collect();
    assert!((5..=10).contains(&commands.len()), "at most ten commands: {commands:#?}");
    let place = Place::new();
    let bin = python(&place);
    std::os::unix::fs::symlink(Path::new(TOP).join("tests"), place.path().join("tests")).expect("is linked");
    // Packages come from the world outside: they are fetched before the network is left.
    let (install, _): (Vec<&String>, Vec<&String>) = commands.iter().partition(|line| line.starts_with("pip "));
    for line in &install {
        let words: Vec<&str> = line.split_whitespace().skip(1).collect();
        let done = Command::new(bin.join("pip")).args(["--quiet", "--disable-pip-version-check"]).args(words).status();
        assert!(done.expect("pip is there").success(), "{line}");
    }
    // A program and not a function of the shell: what is killed at the end must be the services themselves.
    let program = bin.join("supertwin");
    fs::write(&program, format!("#!/bin/sh\nexec '{SUPERTWIN}' --config '{CONFIG}' \"$@\"\n")).expect("is written");
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).expect("is made a program");
    let apart = apart();
    let port = free_port();
    let here = |line: &str| match apart {
        Some(_) => line.to_owned(),
        None => line.replace(&format!("{ADDRESS}:7447"), &format!("127.0.0.1:{port}")).replace(ADDRESS, "127.0.0.1"),
    };

    let mut script = format!(
        "set -e\ntrap 'kill $(jobs -p) 2>/dev/null; wait' EXIT\n\
         export PATH=\"{}:$PATH\" PYTHONDONTWRITEBYTECODE=1 PIP_DISABLE_PIP_VERSION_CHECK=1\n",
        bin.display()
    );
    match apart {
        Some(_) => {
            script += "mount -t tmpfs -o mode=700 none /tmp/supertwin\nip link set lo up\n";
            let _ = writeln!(script, "ip address add {ADDRESS}/32 dev lo");
        }
        None => {
            let _ = writeln!(script, "export SUPERTWIN_CONNECT={}", place.socket);
        }
    }
    for (i, command) in commands.iter().enumerate() {
        let _ = writeln!(script, "{{ {}\n}} > said.{i} 2>&1 || {{ cat said.{i}; exit 1; }}", here(command));
        let n = left_running(command);
        if n > 0 {
            let _ = writeln!(script, "until [ $(grep -c 'Ctrl-C ends it' said.{i}) -ge {n} ]; do sleep 0.1; done");
        }
        if apart.is_none() && command.contains("zenoh-config") {
            let socket = place.socket.replace("unixsock-stream/", "");
            let _ = writeln!(script, "sed -i 's#/tmp/supertwin/router.sock#{socket}#; s#:7447#:{port}#' router.json5");
        }
        let _ = writeln!(script, "echo did {i}");
    }
    // What was steered is there; and nobody gets in without a certificate, nor past his role.
    let tls = here(&format!("tls/{ADDRESS}:7447"));
    let _ = writeln!(
        script,
        "supertwin get depth_m --json --connect {tls} --credentials pki/anna > depth.json 2>&1 || {{ cat depth.json; exit 1; }}\n\
         if supertwin get depth_m --connect {tls} > stranger 2>&1; then echo a stranger got in; exit 1; fi\n\
         supertwin pki issue observer ben --vehicle argus-mini > /dev/null\n\
         if supertwin set depth_m 5 --connect {tls} --credentials pki/ben > viewer 2>&1; then echo a viewer commanded; exit 1; fi\n\
         supertwin get depth_m --json --connect {tls} --credentials pki/anna > after.json 2>&1\n\
         echo locked"
    );
    fs::write(place.path().join("script"), &script).expect("is written");
    let mut shell = match apart {
        Some([program, flags, shell]) => {
            let mut command = place.command(program);
            command.args([flags, shell]);
            command
        }
        None => place.command("bash"),
    };
    let mut running = Process::start(shell.arg("script"));
    let heard = |running: &Process, wanted: &str| {
        running.until(wanted, |line| {
            assert!(!line.contains("rror"), "{line}\n{script}");
            (line == wanted).then_some(())
        });
    };
    for i in 0..commands.len() {
        heard(&running, &format!("did {i}"));
    }
    heard(&running, "locked");
    let ended = running.finish();
    assert_eq!(ended.code, Some(0), "{ended:?}");

    let said = |name: &str| fs::read_to_string(place.path().join(name)).expect("was written");
    let python = commands.iter().position(|line| line.starts_with("python ")).expect("an operator in Python");
    assert!(said(&format!("said.{python}")).contains("reached: "), "{}", said(&format!("said.{python}")));
    for name in ["depth.json", "after.json"] {
        let depth: serde_json::Value = serde_json::from_str(&said(name)).expect("JSON");
        assert_eq!(depth["value"]["constant"], 3.0, "{depth}");
    }
    assert!(said("stranger").contains("no router at"), "{}", said("stranger"));
}
