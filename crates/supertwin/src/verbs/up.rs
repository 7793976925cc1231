//! `supertwin up`: all four services in one process, with the router inside.

use super::record;
use super::services::{ending, open_router, router_access, tell_access, with_enough_readers};
use crate::arguments::{LinkArguments, LiveArguments, PlacementArguments, RECORDINGS, open_patiently};
use crate::terminal::{self, Bar, INTERRUPTED};
use clap::Args;
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use supertwin_lab::Library;
use supertwin_operations::placement::{HostedService, Placement};
use supertwin_operations::recorder::{self, Recorder};
use supertwin_operations::router_access::RouterAccess;
use supertwin_operations::{OperationError, Progress as _};
use supertwin_protocol::{Clock, SystemClock};
use supertwin_zenoh::{Inbox, Mailbox, Pace, Router, Session, close, session};

/// The services of the ring.
const ALL_FOUR: [HostedService; 4] =
    [HostedService::Plant, HostedService::Estimator, HostedService::Guidance, HostedService::Controller];

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin up                                   the adaptive law on the paper's course, in real time
  supertwin up fair --controller pid-tuned --no-mission
                                                 waits for commands: supertwin set mode follow_net
  supertwin up --rtf 5                           five times real time
  supertwin up --record --live                   recorded, and shown in a viewer as it happens
  supertwin up --pace lockstep                   as fast as the processor, the same bits as `supertwin run`

Exit status: 0 done or stopped, 1 the run could not go on, 2 the call is wrong, 130 a lock-step run was interrupted.")]
pub(crate) struct UpArguments {
    /// Trial: a name in config/trials, or a path; the same as --trial
    #[arg(value_name = "TRIAL", conflicts_with = "trial")]
    name: Option<String>,
    #[command(flatten)]
    placement: PlacementArguments,
    /// Record into this folder
    #[arg(long, value_name = "DIR", num_args = 0..=1, default_missing_value = RECORDINGS, help_heading = "Recording")]
    record: Option<PathBuf>,
    #[command(flatten)]
    live: LiveArguments,
    #[command(flatten)]
    link: LinkArguments,
    /// Let other machines in although nothing tells who they are or what they may do
    #[arg(long, help_heading = "Network")]
    open_to_everyone: bool,
}

/// All four services in this process, with the router inside.
pub(crate) fn up(arguments: &UpArguments, library: &Library) -> Result<ExitCode, OperationError> {
    with_enough_readers();
    let json = arguments.placement.json;
    let mailbox = Arc::new(Mailbox::default());
    let stop = terminal::mailbox_stop_flag(&mailbox)?;
    let mut options = arguments.placement.options();
    if let Some(name) = &arguments.name {
        options.trial.clone_from(name);
    }
    let lock_step = options.pace == Pace::LockStep;
    if lock_step && arguments.record.is_some() {
        // The ring waits for the recorder rather than leave a tick out.
        options.witnesses.push(recorder::WITNESS.to_owned());
    }
    options.one_process = true;
    let placement = Placement::new(options, library)?;
    let vehicle = placement.vehicle(arguments.link.vehicle.as_deref());
    let own_router = arguments.link.connect.is_empty();
    let (role, mode) = if own_router { ("vehicle-router", Some("router")) } else { ("local", None) };
    let link = arguments.link.link(library, role, mode, Some(&vehicle));
    let access = router_access(&link, arguments.open_to_everyone)?;
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::start());
    let router = if own_router { Some(open_router(&link, &clock)?) } else { None };
    let session = match &router {
        Some(router) => router.session.clone(),
        None => match open_patiently(link, &stop)? {
            Some(session) => session,
            None => return Ok(ExitCode::from(INTERRUPTED)),
        },
    };
    let access_log = access.watch(&session, Some(&vehicle), &clock, tell_access)?;
    let engine = placement.host(&ALL_FOUR, &session, &mailbox, &clock, &stop)?;
    let listening = router.as_ref().map_or_else(|| session::locators(&session), Router::locators);
    let recorder = arguments.recorder(&vehicle, &session, &clock)?;
    let started =
        json!({ "vehicle": vehicle, "run": placement.run, "listening": listening, "access_rules": access.rules });
    terminal::print_result(json, &started, || started_text(&placement, &vehicle, &listening, &access));
    let began = clock.now();
    let ticks = placement.ticks.filter(|_| lock_step);
    let progress = Bar::new(json || ticks.is_none());
    progress.begin(&placement.run, ticks.unwrap_or(0));
    let finished = engine.run(|done| {
        // Drawing is rate-limited by the bar; asking it costs more than a lap.
        if done.is_multiple_of(256) {
            progress.reach(done);
        }
    });
    progress.end();
    let wall_s = (clock.now() - began).as_secs_f64();
    recorder.map_or(Ok(()), recorder::Background::end)?;
    drop(access_log);
    match router {
        Some(router) => router.close(),
        None => close(&session),
    }
    if lock_step {
        let (hash, ticks, laps_per_s) = (finished.digest.to_string(), finished.ticks, finished.ticks as f64 / wall_s);
        let result = json!({ "hash": hash, "ticks": ticks, "wall_s": wall_s, "laps_per_s": laps_per_s });
        terminal::print_result(json, &result, || {
            format!("{ticks} ticks in {wall_s:.2} s: {laps_per_s:.0} laps per second. State hash {hash}.")
        });
    }
    Ok(ending(&finished, arguments.placement.pace))
}

impl UpArguments {
    /// The recorder beside the services, if a recording or a live view is asked for.
    fn recorder(
        &self,
        vehicle: &str,
        session: &Session,
        clock: &Arc<dyn Clock>,
    ) -> Result<Option<recorder::Background>, OperationError> {
        let json = self.placement.json;
        let live = record::live(&self.live, json)?;
        if live.is_none() && self.record.is_none() {
            return Ok(None);
        }
        let options = recorder::Options {
            folder: self.record.clone(),
            rotation: recorder::Rotation::default(),
            witness: recorder::WITNESS.to_owned(),
            vehicle: Some(vehicle.to_owned()),
            namespaced: true,
            once: false,
        };
        let inbox = Inbox::new(Arc::clone(clock));
        let recorder = Recorder::new(inbox, session, Arc::clone(clock), live, options)?;
        Ok(Some(recorder.in_background(record::say(json))))
    }
}

fn started_text(placement: &Placement, vehicle: &str, listening: &[String], access: &RouterAccess) -> String {
    let pace = match placement.pace {
        Pace::LockStep => "in lock step".to_owned(),
        Pace::RealTime(1.0) => "in real time".to_owned(),
        Pace::RealTime(factor) => format!("at {factor} times real time"),
    };
    let places = listening.join(", ");
    format!(
        "{vehicle} is up, run {} {pace}; reach it at {places}; {}\n\
         Try: supertwin top     supertwin set depth_m 5     (Ctrl-C ends it)",
        placement.run,
        access.text()
    )
}
