//! A process that ends with its test: its lines, its errors, signals to it, its exit status.

use super::{CONFIG, LIMIT, ROV};
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, Condvar, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;
use supertwin_protocol::{Clock, SystemClock};
use tempfile::TempDir;

const SUPERTWIN: &str = env!("CARGO_BIN_EXE_supertwin");

/// Where a test happens: a folder of its own, with room for a router's socket. The program under test is called there,
/// with the shipped configuration and nothing of the environment.
pub struct Place {
    folder: TempDir,
    /// The endpoint of a router here.
    pub socket: String,
}

impl Place {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let socket = format!("unixsock-stream/{}/r.sock", folder.path().display());
        Self { folder, socket }
    }

    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Another program, called here.
    pub fn command(&self, program: &str) -> Command {
        let mut command = Command::new(program);
        for name in ["CONNECT", "CREDENTIALS", "ZENOH", "VEHICLE", "CONFIG", "PKI"] {
            command.env_remove(format!("SUPERTWIN_{name}"));
        }
        command.current_dir(self.path());
        command
    }

    /// Starts the program under test.
    pub fn start(&self, arguments: &[&str]) -> Process {
        self.start_in(None, arguments)
    }

    /// Starts it in a network namespace.
    pub fn start_in(&self, namespace: Option<&str>, arguments: &[&str]) -> Process {
        let mut command = self.command(if namespace.is_some() { "ip" } else { SUPERTWIN });
        if let Some(name) = namespace {
            command.args(["netns", "exec", name, SUPERTWIN]);
        }
        Process::start(command.args(["--config", CONFIG]).args(arguments))
    }

    /// Starts a service of the vehicle `rov` at a router.
    pub fn serve_rov(&self, service: &str, trial: &str, router: &str, more: &[&str]) -> Process {
        let words = ["serve", service, "--json", "--vehicle", ROV, "--trial", trial, "--connect", router];
        self.start(&[&words, more].concat())
    }

    /// Calls it and waits for its end.
    pub fn call(&self, arguments: &[&str]) -> Ended {
        self.start(arguments).finish()
    }

    /// A folder for the path in which `supertwin` is the program under test, called with these arguments before all others.
    /// A program and not a function of the shell: what is killed must be itself.
    pub fn bin(&self, arguments: &str) -> String {
        let bin = self.path().join("bin");
        let program = bin.join("supertwin");
        std::fs::create_dir_all(&bin).expect("a folder");
        std::fs::write(&program, format!("#!/bin/sh\nexec '{SUPERTWIN}' {arguments} \"$@\"\n")).expect("is written");
        std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).expect("is made a program");
        bin.display().to_string()
    }

    /// Calls a line of shell, in which `supertwin` is the program under test, and waits for its end.
    pub fn shell(&self, line: &str) -> Ended {
        self.start_shell(line).finish()
    }

    /// Starts a line of shell, in which `supertwin` is the program under test; a line that is left running says `exec`
    /// before it, so that what is killed is the program and not only the shell.
    pub fn start_shell(&self, line: &str) -> Process {
        let bin = self.bin(&format!("--config '{CONFIG}'"));
        let line = format!("PATH=\"{bin}:$PATH\"; export PATH; {line}");
        Process::start(self.command("sh").args(["-c", &line]))
    }
}

/// What a process left that has ended.
#[derive(Debug)]
pub struct Ended {
    /// `None`: a signal ended it.
    pub code: Option<i32>,
    /// Standard output that was not read before.
    pub out: String,
    /// Standard error.
    pub err: String,
}

impl Ended {
    /// Itself, if all went well.
    pub fn well(self) -> Self {
        assert_eq!(self.code, Some(0), "{self:?}");
        self
    }

    /// Itself, if the call was refused with status 2 and these words.
    pub fn refused(self, words: &str) -> Self {
        self.ends(2, words)
    }

    /// Itself, if it ended with this status and these words among its errors.
    pub fn ends(self, code: i32, words: &str) -> Self {
        assert_eq!(self.code, Some(code), "{words}: {self:?}");
        assert!(self.err.contains(words), "{words} is not in {self:?}");
        self
    }

    /// Standard output as JSON.
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.out).unwrap_or_else(|error| panic!("no JSON: {error}: {self:?}"))
    }
}

/// A process that ends with its test.
pub struct Process {
    child: Child,
    lines: Receiver<String>,
    errors: Arc<(Mutex<String>, Condvar)>,
    threads: Vec<JoinHandle<()>>,
    called: String,
    clock: SystemClock,
}

impl Process {
    /// Starts `command`; nobody types anything into it.
    pub fn start(command: &mut Command) -> Self {
        let called = format!("{command:?}");
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap_or_else(|error| panic!("{called}: {error}"));
        let (stdout, stderr) = (child.stdout.take().expect("is piped"), child.stderr.take().expect("is piped"));
        let (sender, lines) = channel();
        let errors = Arc::new((Mutex::new(String::new()), Condvar::new()));
        let heard = Arc::clone(&errors);
        let threads = vec![
            // Reads to the end, also when nobody listens any more: a full pipe would hold the process up.
            std::thread::spawn(move || {
                BufReader::new(stdout).lines().map_while(Result::ok).for_each(|line| drop(sender.send(line)));
            }),
            std::thread::spawn(move || {
                for line in BufReader::new(stderr).lines().map_while(Result::ok) {
                    *heard.0.lock().expect("not poisoned") += &(line + "\n");
                    heard.1.notify_all();
                }
            }),
        ];
        Self { child, lines, errors, threads, called, clock: SystemClock::start() }
    }

    /// Reads lines until `wanted` makes something of one.
    pub fn until<T>(&self, what: &str, mut wanted: impl FnMut(&str) -> Option<T>) -> T {
        let deadline = self.clock.now() + LIMIT;
        let mut lines = std::iter::from_fn(|| self.line(deadline, || format!("never said {what}")));
        let found = lines.find_map(|line| wanted(&line));
        found.unwrap_or_else(|| self.fail(&format!("ended before {what}")))
    }

    /// The next line, or nothing when standard output has ended.
    fn line(&self, deadline: Duration, late: impl Fn() -> String) -> Option<String> {
        match self.lines.recv_timeout(deadline.saturating_sub(self.clock.now())) {
            Err(RecvTimeoutError::Timeout) => self.fail(&late()),
            line => line.ok(),
        }
    }

    /// The next line, as JSON.
    pub fn json(&self) -> Value {
        self.until("a line", |line| {
            Some(serde_json::from_str(line).unwrap_or_else(|error| self.fail(&format!("no JSON: {error}: {line}"))))
        })
    }

    /// Lines that have come and were not read.
    pub fn pending(&self) -> impl Iterator<Item = String> {
        self.lines.try_iter()
    }

    /// Standard error so far.
    pub fn errors(&self) -> String {
        self.errors.0.lock().expect("not poisoned").clone()
    }

    /// Waits until a line of standard error, after the first `after` of them, contains `words`; that line.
    pub fn until_error(&self, after: usize, words: &str) -> String {
        let (errors, grown) = &*self.errors;
        let line = |errors: &str| errors.lines().skip(after).find(|line| line.contains(words)).map(str::to_owned);
        let errors = errors.lock().expect("not poisoned");
        let (errors, _) =
            grown.wait_timeout_while(errors, LIMIT, |errors| line(errors).is_none()).expect("not poisoned");
        let found = line(&errors);
        drop(errors);
        found.unwrap_or_else(|| self.fail(&format!("never said {words}")))
    }

    fn fail(&self, what: &str) -> ! {
        panic!("{}: {what}; standard error: {}", self.called, self.errors())
    }

    /// Whether it runs.
    pub fn is_up(&mut self) -> bool {
        self.child.try_wait().expect("can be asked").is_none()
    }

    /// Sends a signal by its name, such as INT.
    pub fn signal(&self, name: &str) {
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args(["-s", name, &pid]).status().expect("kill exists").success());
    }

    /// kill -9, and waits until it is gone.
    pub fn kill(&mut self) {
        self.child.kill().expect("is there to be killed");
        self.child.wait().expect("ends");
    }

    /// Waits for its end.
    pub fn finish(&mut self) -> Ended {
        let deadline = self.clock.now() + LIMIT;
        let mut out = String::new();
        while let Some(line) = self.line(deadline, || format!("does not end, after {out}")) {
            out += &(line + "\n");
        }
        let code = self.child.wait().expect("ends").code();
        self.threads.drain(..).for_each(|thread| thread.join().expect("reads to the end"));
        Ended { code, out, err: self.errors() }
    }
}

impl Drop for Process {
    #[allow(clippy::print_stderr, reason = "what it said explains why the test failed")]
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
        if std::thread::panicking() && !self.errors().is_empty() {
            eprintln!("{}: {}", self.called, self.errors());
        }
    }
}
