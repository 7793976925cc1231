//! The terminal: text, tables, progress, Ctrl-C, exit status. A closed pipe ends the program quietly, not with a panic.

use comfy_table::presets::{NOTHING, UTF8_FULL_CONDENSED};
use comfy_table::{CellAlignment, ContentArrangement, Row, Table};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;
use std::io::{IsTerminal, Write};
use std::ops::RangeBounds;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use supertwin_lab::RunError;
use supertwin_operations::{OperationError, Progress};
use supertwin_zenoh::{Interrupter, Mailbox};

/// Exit status of an interrupted call: 128 + SIGINT, as shells have it.
pub(crate) const INTERRUPTED: u8 = 130;

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

/// Prints a value as JSON over several lines.
pub(crate) fn print_json(value: &impl Serialize) -> Result<(), OperationError> {
    let text = serde_json::to_string_pretty(value)
        .map_err(|cause| OperationError::Option(format!("the result can't be written as JSON: {cause}")))?;
    print(&text);
    Ok(())
}

/// Prints a result: as one line of JSON, or the text for people.
pub(crate) fn print_result(json: bool, value: &serde_json::Value, text: impl FnOnce() -> String) {
    print(&if json { value.to_string() } else { text() });
}

/// Says what went wrong and gives the exit status.
pub(crate) fn report(error: &OperationError) -> ExitCode {
    warn(&format!("error: {error}"));
    match error {
        OperationError::Run { cause: RunError::NonFinite(_), .. }
        | OperationError::Client(_)
        | OperationError::Unmet(_) => ExitCode::from(1),
        _ => ExitCode::from(2),
    }
}

/// `1 run`, `2 runs`.
pub(crate) fn count(n: usize, one: &str, several: &str) -> String {
    format!("{n} {}", if n == 1 { one } else { several })
}

/// A bar on a terminal, nothing in a pipe.
pub(crate) struct Bar(ProgressBar);

impl Bar {
    /// Shown unless it is `quiet`.
    pub(crate) fn new(quiet: bool) -> Self {
        let shown = std::io::stderr().is_terminal() && !quiet;
        let target = if shown { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        let bar = ProgressBar::with_draw_target(None, target);
        if let Ok(style) = ProgressStyle::with_template("{bar:40} {percent:>3} %  {msg}  {eta} left") {
            bar.set_style(style);
        }
        Self(bar)
    }
}

impl Progress for Bar {
    fn begin(&self, stage: &str, steps: u64) {
        self.0.reset();
        self.0.set_length(steps);
        self.0.set_message(stage.to_owned());
    }
    fn advance(&self, steps: u64) {
        self.0.inc(steps);
    }
    fn reach(&self, steps: u64) {
        self.0.set_position(steps);
    }
    fn end(&self) {
        self.0.finish_and_clear();
    }
}

/// A flag that Ctrl-C and SIGTERM set; `wake` is called after that.
pub(crate) fn stop_flag(wake: impl Fn() + Send + 'static) -> Result<Arc<AtomicBool>, OperationError> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    on_ctrl_c(move || {
        flag.store(true, Ordering::Relaxed);
        wake();
    })?;
    Ok(stop)
}

/// The same, for somebody who waits for a mailbox.
pub(crate) fn mailbox_stop_flag(mailbox: &Arc<Mailbox>) -> Result<Arc<AtomicBool>, OperationError> {
    let mailbox = Arc::clone(mailbox);
    stop_flag(move || mailbox.wake())
}

/// Ctrl-C and SIGTERM end every wait. Who asks twice does not want to wait for an answer either.
pub(crate) fn interrupt_on_ctrl_c(waits: Interrupter) -> Result<(), OperationError> {
    on_ctrl_c(move || {
        if waits.interrupted() {
            std::process::exit(i32::from(INTERRUPTED));
        }
        waits.interrupt();
    })
}

fn on_ctrl_c(handle: impl Fn() + Send + 'static) -> Result<(), OperationError> {
    ctrlc::set_handler(handle).map_err(|cause| OperationError::Option(format!("Ctrl-C can't be caught: {cause}")))
}

/// A table with a frame, as wide as its cells.
pub(crate) fn framed_table(header: impl Into<Row>) -> Table {
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED).set_content_arrangement(ContentArrangement::Disabled).set_header(header);
    table
}

/// The table as text; the columns `numbers`, counted from 0, are numbers.
pub(crate) fn aligned(mut table: Table, numbers: impl RangeBounds<usize>) -> String {
    for (_, column) in table.column_iter_mut().enumerate().filter(|(i, _)| numbers.contains(i)) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table.to_string()
}

/// A table without lines; columns from number `numbers` on are numbers.
pub(crate) fn table(header: &[&str], rows: Vec<Vec<String>>, numbers: usize) -> String {
    let mut table = framed_table(header.to_vec());
    table.load_style(NOTHING).add_rows(rows);
    table.column_iter_mut().for_each(|column| {
        column.set_padding((0, 2));
    });
    let lines: Vec<String> = aligned(table, numbers..).lines().map(|line| line.trim_end().to_owned()).collect();
    lines.join("\n")
}
