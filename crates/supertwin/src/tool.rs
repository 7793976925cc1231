//! What the operator's tools have in common: a session without a namespace, the vehicle that is meant, Ctrl-C, tables.

use crate::cli::LinkArguments;
use crate::failure::{Failure, INTERRUPTED};
use comfy_table::presets::NOTHING;
use comfy_table::{CellAlignment, ContentArrangement, Table};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::sync::Arc;
use std::time::Duration;
use supertwin_lab::Library;
use supertwin_protocol::{Clock, SystemClock, keys};
use supertwin_zenoh::{Inbox, Interrupter, Link, Session, client, watch};

/// The four services of a vehicle.
pub(crate) const SERVICES: [&str; 4] = ["plant", "estimator", "guidance", "controller"];

/// A tool on the network.
pub(crate) struct Tool {
    pub(crate) session: Session,
    pub(crate) clock: Arc<dyn Clock>,
    pub(crate) inbox: Inbox,
    pub(crate) stop: Interrupter,
}

impl Tool {
    /// Joins the network as the arguments say.
    pub(crate) fn open(arguments: &LinkArguments, library: &Library) -> Result<Self, Failure> {
        Self::join(&arguments.link(library, "local", None, None))
    }

    /// Joins the network by `link`; Ctrl-C ends every wait from here on.
    pub(crate) fn join(link: &Link) -> Result<Self, Failure> {
        let clock: Arc<dyn Clock> = Arc::new(SystemClock::start());
        let inbox = Inbox::new(Arc::clone(&clock));
        let session = link.open()?;
        let (stop, on_signal) = (inbox.interrupter(), inbox.interrupter());
        let handle = move || {
            // The first one ends waits; who asks again does not want to wait for an answer either.
            if on_signal.interrupted() {
                std::process::exit(i32::from(INTERRUPTED));
            }
            on_signal.interrupt();
        };
        ctrlc::set_handler(handle).map_err(|cause| Failure::Call(format!("Ctrl-C can't be caught: {cause}")))?;
        Ok(Self { session, clock, inbox, stop })
    }

    /// Leaves the network.
    pub(crate) fn close(self) {
        drop(self.inbox);
        supertwin_zenoh::close(&self.session);
    }

    /// The vehicle that is meant: the one asked for, else the only one that is up.
    pub(crate) fn vehicle(&self, asked_for: Option<&str>) -> Result<String, Failure> {
        if let Some(name) = asked_for {
            return Ok(name.to_owned());
        }
        let mut up: Vec<String> = self.alive()?.into_iter().map(|(vehicle, ..)| vehicle).collect();
        up.dedup();
        match up.as_slice() {
            [only] => Ok(only.clone()),
            [] => Err(Failure::Verdict("no vehicle is up: start one with `supertwin up`".to_owned())),
            several => {
                Err(Failure::Call(format!("{} are up: say which, e.g. --vehicle {}", several.join(", "), several[0])))
            }
        }
    }

    /// Services that are up: vehicle, service, instance.
    pub(crate) fn alive(&self) -> Result<Vec<(String, String, String)>, Failure> {
        let mut alive = client::alive(&self.session)?;
        alive.retain(|(_, service, _)| service != "operator");
        Ok(alive)
    }

    /// The moment `s` seconds from now.
    pub(crate) fn after(&self, s: f64) -> Duration {
        // Longer than a year is for ever.
        self.clock.now() + Duration::from_secs_f64(s.min(3.2e7))
    }

    /// The full key of one that may be relative to the vehicle; checks it.
    pub(crate) fn key(&self, link: &LinkArguments, key: &str) -> Result<String, Failure> {
        let wrong = |cause: String| Failure::Call(format!("KEY {key}: {cause}"));
        watch::check_key(key).map_err(wrong)?;
        if key.starts_with("supertwin/") || key.starts_with("@") {
            return Ok(key.to_owned());
        }
        Ok(format!("{}/{key}", keys::namespace(&self.vehicle(link.vehicle.as_deref())?)))
    }
}

/// A bar on a terminal, for something that takes `for_s` seconds; nothing in a pipe.
pub(crate) fn progress(for_s: f64, what: &str, quiet: bool) -> ProgressBar {
    let visible = std::io::stderr().is_terminal() && !quiet;
    let target = if visible { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
    let bar = ProgressBar::with_draw_target(Some((for_s * 10.0).ceil() as u64), target);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {percent:>3} %  {msg}") {
        bar.set_style(style);
    }
    bar.set_message(what.to_owned());
    bar
}

/// A table without lines; columns from number `numbers` on are numbers.
pub(crate) fn table(header: &[&str], rows: Vec<Vec<String>>, numbers: usize) -> String {
    let mut table = Table::new();
    table.load_style(NOTHING).set_content_arrangement(ContentArrangement::Disabled).set_header(header.to_vec());
    for row in rows {
        table.add_row(row);
    }
    for (i, column) in table.column_iter_mut().enumerate() {
        column.set_padding((0, 2));
        if i >= numbers {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    let lines: Vec<String> = table.to_string().lines().map(|line| line.trim_end().to_owned()).collect();
    lines.join("\n")
}
