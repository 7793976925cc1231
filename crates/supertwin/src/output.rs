//! What goes to standard output; a closed pipe ends the program quietly instead of with a panic.

use std::io::Write;

/// Prints a text and a line break.
pub(crate) fn print(text: &str) {
    let mut out = std::io::stdout().lock();
    let written = out.write_all(text.as_bytes()).and_then(|()| out.write_all(b"\n")).and_then(|()| out.flush());
    if written.is_err() {
        std::process::exit(0);
    }
}

/// Prints a text and a line break to standard error; there is nowhere to report a failure of that to.
pub(crate) fn warn(text: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}
