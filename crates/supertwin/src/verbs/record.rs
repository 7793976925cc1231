//! `supertwin record`: what flows on the network, into recordings and a live view.

use crate::arguments::{LIVE_PORT, LinkArguments, LiveArguments, RecordingArguments, open_patiently};
use crate::terminal::{self, INTERRUPTED};
use clap::Args;
use serde_json::{Value, json};
use std::process::ExitCode;
use std::sync::Arc;
use supertwin_lab::Library;
use supertwin_operations::OperationError;
use supertwin_operations::recorder::{Options, Recorder};
use supertwin_protocol::{Clock, SystemClock};
use supertwin_rerun::Live;
use supertwin_zenoh::{Inbox, close};

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin record                               every vehicle of this router, into runs/recorded
  supertwin record --live                        the same, and shows it as it comes
  supertwin record --vehicle argus-mini --out /data --part-min 10
  supertwin serve plant --pace lockstep --witness recorder &  supertwin record --once
                                                 the ring waits for the recorder: no tick is missing

Ctrl-C and SIGTERM close the files. After a crash or a kill of the recorder everything but the
last second is there, after a power cut what the system had written to the disk by then;
`supertwin repair` makes such a file whole.
Exit status: 0 stopped, 2 the call is wrong, 130 interrupted before a router was there.")]
pub(crate) struct RecordArguments {
    #[command(flatten)]
    pub(crate) recording: RecordingArguments,
    #[command(flatten)]
    pub(crate) link: LinkArguments,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// Serves a live view, if one is asked for, and says how to open it.
pub(crate) fn live(arguments: &LiveArguments, json: bool) -> Result<Option<Live>, OperationError> {
    let Some(port) = arguments.live.or(arguments.live_web.map(|_| LIVE_PORT)) else { return Ok(None) };
    let live =
        Live::serve(port, arguments.live_web).map_err(|error| OperationError::Option(format!("--live: {error}")))?;
    let (url, port) = (live.url(), live.port);
    let tunnel = format!("ssh -N -L {port}:127.0.0.1:{port} USER@THIS-MACHINE");
    if json {
        terminal::print(&json!({ "live": url, "page": live.page, "tunnel": tunnel }).to_string());
        return Ok(Some(live));
    }
    terminal::print(&format!("Live view: rerun {url}     (pip install rerun-sdk==0.36.3)"));
    if let Some(page) = &live.page {
        terminal::print(&format!("In a browser: {page}"));
    }
    terminal::print(&format!("From another machine first: {tunnel}"));
    Ok(Some(live))
}

/// What happened to a file, for people or programs.
pub(crate) fn say(json: bool) -> impl FnMut(&Value) {
    move |notice| {
        if let Some(text) = notice["warning"].as_str() {
            terminal::warn(&format!("warning: {text}"));
        } else if json {
            terminal::print(&notice.to_string());
        } else if let Some(path) = notice["recording"].as_str() {
            terminal::print(&format!("{}: recording to {path}", notice["vehicle"].as_str().unwrap_or_default()));
        } else if let Some(path) = notice["closed"].as_str() {
            terminal::print(&format!("closed {path}"));
        } else if let Some(cause) = notice["failed"].as_str() {
            terminal::warn(&format!("error: NOT RECORDING: {cause}"));
        }
    }
}

/// `supertwin record`, and `supertwin serve recorder`.
pub(crate) fn record(
    arguments: &RecordingArguments,
    link: &LinkArguments,
    json: bool,
    library: &Library,
) -> Result<ExitCode, OperationError> {
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::start());
    let inbox = Inbox::new(Arc::clone(&clock));
    let interrupter = inbox.interrupter();
    let stop = terminal::stop_flag(move || interrupter.interrupt())?;
    let Some(session) = open_patiently(link.link(library, "local", None, None), &stop)? else {
        return Ok(ExitCode::from(INTERRUPTED));
    };
    let live = live(&arguments.live, json)?;
    let options = Options {
        folder: (!arguments.no_file).then(|| arguments.out.clone()),
        rotation: arguments.rotation(),
        witness: arguments.as_witness.clone(),
        vehicle: link.vehicle.clone(),
        namespaced: false,
        once: arguments.once,
    };
    let mut recorder = Recorder::new(inbox, &session, clock, live, options)?;
    terminal::print_result(json, &json!({ "recorder": recorder.instance() }), || {
        "waiting for a vehicle; Ctrl-C closes the recordings".to_owned()
    });
    recorder.run(&stop, say(json))?;
    close(&session);
    Ok(ExitCode::SUCCESS)
}
