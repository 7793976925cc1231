//! `supertwin serve SERVICE`: one service, or the router, in this process.

use super::record;
use super::services::{ending, open_router, router_access, tell_access, with_enough_readers};
use crate::arguments::{LinkArguments, PlacementArguments, RecordingArguments, Service, open_patiently};
use crate::terminal::{self, INTERRUPTED};
use clap::Args;
use serde_json::json;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use supertwin_lab::Library;
use supertwin_operations::OperationError;
use supertwin_operations::placement::Placement;
use supertwin_protocol::{Clock, SystemClock};
use supertwin_zenoh::{Mailbox, Pace, close};

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin serve router                         on the vehicle
  supertwin serve plant &  supertwin serve estimator &  supertwin serve controller &
  supertwin serve guidance --connect tcp/192.168.2.2:7447        topside
  supertwin serve router --listen tcp/127.0.0.1:0 --json         says on which port
  supertwin serve shadow --trial paper-agsta     beside a vehicle whose driver writes plant/measurements: takes the same
                                                 thrust, writes shadow/plant/measurements and shadow/plant/truth

Every service waits for its router, and joins again by itself after a cut.
Exit status: 0 done or stopped, 1 the run could not go on, 2 the call is wrong, 130 a lock-step run was interrupted.")]
pub(crate) struct ServeArguments {
    /// What to run
    #[arg(value_enum)]
    service: Service,
    #[command(flatten)]
    placement: PlacementArguments,
    #[command(flatten)]
    recording: RecordingArguments,
    #[command(flatten)]
    link: LinkArguments,
    /// Router: let other machines in although nothing tells who they are or what they may do
    #[arg(long, help_heading = "Network")]
    open_to_everyone: bool,
}

/// One service in this process.
pub(crate) fn serve(arguments: &ServeArguments, library: &Library) -> Result<ExitCode, OperationError> {
    let json = arguments.placement.json;
    if arguments.service == Service::Router {
        with_enough_readers();
    }
    if arguments.service == Service::Recorder {
        return record::record(&arguments.recording, &arguments.link, json, library);
    }
    let mailbox = Arc::new(Mailbox::default());
    let stop = terminal::mailbox_stop_flag(&mailbox)?;
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::start());
    let Some((hosted, name)) = arguments.service.hosted() else {
        return router(arguments, library, &mailbox, &clock, &stop);
    };
    let placement = Placement::new(arguments.placement.options(), library)?;
    if arguments.service == Service::Shadow && placement.pace == Pace::LockStep {
        return Err(OperationError::Option(
            "--pace lockstep: a shadow follows the vehicle's time, and nobody waits for it".into(),
        ));
    }
    let vehicle = placement.vehicle(arguments.link.vehicle.as_deref());
    let link = arguments.link.link(library, "local", None, Some(&vehicle));
    let Some(session) = open_patiently(link, &stop)? else { return Ok(ExitCode::from(INTERRUPTED)) };
    let engine = placement.host(&[hosted], &session, &mailbox, &clock, &stop)?;
    terminal::print_result(json, &json!({ "serving": name, "vehicle": vehicle }), || {
        format!("{name} of {vehicle}: up; Ctrl-C ends it")
    });
    let finished = engine.run(|_| {});
    close(&session);
    if placement.pace == Pace::LockStep {
        for (service, ticks, wall_s) in &finished.progress {
            let laps_per_s = *ticks as f64 / wall_s.max(1e-9);
            let result = json!({ "service": service, "ticks": ticks, "wall_s": wall_s, "laps_per_s": laps_per_s });
            terminal::print_result(json, &result, || {
                format!("{service}: {ticks} ticks in {wall_s:.2} s, {laps_per_s:.0} laps per second")
            });
        }
    }
    Ok(ending(&finished, arguments.placement.pace))
}

fn router(
    arguments: &ServeArguments,
    library: &Library,
    mailbox: &Mailbox,
    clock: &Arc<dyn Clock>,
    stop: &AtomicBool,
) -> Result<ExitCode, OperationError> {
    let link = arguments.link.link(library, "vehicle-router", Some("router"), None);
    let access = router_access(&link, arguments.open_to_everyone)?;
    let router = open_router(&link, clock)?;
    let access_log = access.watch(&router.session, None, clock, tell_access)?;
    let listening = router.locators();
    let result = json!({ "listening": listening, "access_rules": access.rules });
    terminal::print_result(arguments.placement.json, &result, || {
        format!("router: listening on {}; {}; Ctrl-C ends it", listening.join(", "), access.text())
    });
    while !stop.load(Ordering::Relaxed) {
        mailbox.wait(&**clock, None);
    }
    drop(access_log);
    router.close();
    Ok(ExitCode::SUCCESS)
}
