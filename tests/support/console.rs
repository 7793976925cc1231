//! A page of the book, done as a reader would: its files written, its commands typed, its answers compared.

use super::page::BOOK;
use super::{Place, Process};
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

const TOP: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");

/// What a reader does.
#[derive(Debug)]
pub enum Step {
    /// A block of TOML whose first line is `# NAME.toml`: the file of this name.
    File { name: String, text: String },
    /// A line after `$ `, and lines of what it answers; `…` stands for lines that are left out.
    Command { line: String, answer: Vec<String> },
}

/// The steps of a page, in order.
pub fn steps(page: &str) -> Vec<Step> {
    let mut steps = Vec::new();
    for block in page.split("\n```").skip(1).step_by(2) {
        let (language, block) = block.split_once('\n').expect("a block has lines");
        match language {
            "console" => {
                for line in block.lines() {
                    // A prompt may say on which machine.
                    match line.split_once("$ ").filter(|(prompt, _)| ["", "vehicle", "topside"].contains(prompt)) {
                        Some((_, line)) => steps.push(Step::Command { line: line.to_owned(), answer: Vec::new() }),
                        None => match steps.last_mut() {
                            Some(Step::Command { answer, .. }) => answer.push(line.to_owned()),
                            other => panic!("{line} answers nothing: {other:?}"),
                        },
                    }
                }
            }
            "toml" => {
                let first = block.lines().next().unwrap_or_default();
                if let Some(name) = first.strip_prefix("# ").filter(|name| name.ends_with(".toml")) {
                    steps.push(Step::File { name: name.to_owned(), text: block.to_owned() });
                }
            }
            _ => {}
        }
    }
    steps
}

/// Processes that a command leaves running, each of which says that it is up.
fn left_running(command: &str) -> usize {
    let each = |words: &str| words.split(';').next().map_or(0, |words| words.split_whitespace().count());
    match command.split_once("for service in ") {
        Some((_, words)) => each(words),
        None => usize::from(command.ends_with('&')),
    }
}

/// The program that enters a network of its own and a folder for sockets of its own, if the machine allows it.
fn apart() -> Option<[&'static str; 3]> {
    let mine = "mkdir -p /tmp/supertwin && mount -t tmpfs -o mode=700 none /tmp/supertwin && ip link set lo up";
    let ways = [["unshare", "-nm", "bash"], ["unshare", "-rnm", "bash"]];
    ways.into_iter().find(|[program, flags, shell]| {
        let mut command = Command::new(program);
        command.args([flags, shell, "-c", mine]).stdout(Stdio::null()).stderr(Stdio::null());
        command.status().is_ok_and(|status| status.success())
    })
}

/// Commands as they are typed, one after the other, each of which must succeed; in a network of its own, if the machine
/// allows it.
pub struct Script {
    text: String,
    /// What enters a network of its own, if it has one.
    pub apart: Option<[&'static str; 3]>,
    commands: usize,
}

impl Script {
    /// With these folders first on the path.
    pub fn new(path: &str) -> Self {
        let head = "set -e\ntrap 'kill $(jobs -p) 2>/dev/null || true; wait' EXIT\n";
        let mut script = Self { text: format!("{head}export PATH=\"{path}:$PATH\"\n"), apart: apart(), commands: 0 };
        if script.apart.is_some() {
            script.line("mount -t tmpfs -o mode=700 none /tmp/supertwin\nip link set lo up");
        }
        script
    }

    /// A line as it is.
    pub fn line(&mut self, line: &str) {
        self.text += line;
        self.text += "\n";
    }

    /// A command whose answer is kept, and that is waited for until what it leaves running is up.
    pub fn command(&mut self, line: &str) {
        let (i, n) = (self.commands, left_running(line));
        self.commands += 1;
        self.line(&format!("{{ {line}\n}} > answer.{i} 2>&1 || {{ cat answer.{i}; exit 1; }}"));
        if n > 0 {
            self.line(&format!("until [ $(grep -c 'Ctrl-C ends it' answer.{i}) -ge {n} ]; do sleep 0.1; done"));
        }
    }

    /// Does all of it in `place`; the answers of its commands.
    pub fn run(&self, place: &Place) -> Vec<String> {
        fs::write(place.path().join("script"), &self.text).expect("is written");
        let words = self.apart.as_ref().map_or(&["bash"][..], |words| &words[..]);
        let ended = Process::start(place.command(words[0]).args(&words[1..]).arg("script")).finish();
        assert_eq!(ended.code, Some(0), "{ended:?}\n{}", self.text);
        let answer = |i| fs::read_to_string(place.path().join(format!("answer.{i}"))).expect("was written");
        (0..self.commands).map(answer).collect()
    }
}

/// Does what a page of the book says, in a fresh folder with the shipped configuration. Returns how many lines of answers
/// it shows.
#[allow(clippy::print_stderr, reason = "who reads the tests' output should know what was not tried")]
pub fn follow(page: &str) -> usize {
    let text = fs::read_to_string(Path::new(BOOK).join(page)).unwrap_or_else(|error| panic!("{page}: {error}"));
    let steps = steps(&text);
    let place = Place::new();
    let copied = Command::new("cp").args(["-r", &format!("{TOP}/config")]).arg(place.path()).status();
    assert!(copied.expect("cp is there").success());
    let mut script = Script::new(&place.bin(""));
    let networked = steps.iter().any(|step| matches!(step, Step::Command { line, .. } if left_running(line) > 0));
    if networked && script.apart.is_none() {
        eprintln!("{page}: not tried, as this machine allows no network namespace");
        return steps.len();
    }
    let mut commands = Vec::new();
    for step in &steps {
        match step {
            Step::File { name, text } => {
                script.line(&format!(
                    "mkdir -p \"$(dirname {name})\"\ncat > {name} <<'END_OF_FILE'\n{text}\nEND_OF_FILE"
                ));
            }
            Step::Command { line, answer } => {
                // The viewer needs a screen, packages come from the world outside.
                let outside = ["rerun ", "pip "].iter().any(|other| line.starts_with(other));
                script.command(if outside { "true" } else { line });
                commands.push((line, answer));
            }
        }
    }
    let mut compared = 0;
    for (said, (line, answer)) in script.run(&place).iter().zip(commands) {
        let mut said_lines = said.lines().map(str::trim_end);
        for wanted in answer.iter().map(|line| line.trim_end()).filter(|line| *line != "…") {
            assert!(said_lines.any(|line| line == wanted), "{page}: $ {line}\nnever says\n{wanted}\nbut\n{said}");
            compared += 1;
        }
    }
    compared
}
