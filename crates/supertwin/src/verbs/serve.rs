//! `supertwin serve SERVICE` and `supertwin up`: services on the network, one per process or all in one.

use super::record;
use crate::arguments::{
    LinkArguments, LiveArguments, PaceArgument, PlacementArguments, RECORDINGS, RecordingArguments, Service,
    open_patiently,
};
use crate::terminal::{self, Bar, INTERRUPTED};
use clap::Args;
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use supertwin_lab::Library;
use supertwin_operations::placement::{HostedService, Placement};
use supertwin_operations::recorder::{self, Recorder};
use supertwin_operations::router_access::RouterAccess;
use supertwin_operations::{OperationError, Progress as _, Stopwatch};
use supertwin_protocol::{Clock, SystemClock};
use supertwin_zenoh::router::News;
use supertwin_zenoh::{Ending, Engine, Finished, Link, Mailbox, Pace, Router, Session, close, session};

/// Arguments of `up`.
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

/// Arguments of `serve`.
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

/// Threads of a router that read from the network.
///
/// Zenoh closes a connection that is dead, and that it still has something to say to, in one of these, and waits up to
/// ten seconds for it. By default there are as few as processors: two topside programs behind a cut tether would
/// silence the vehicle's own services.
const READERS: &str = "(rx: (worker_threads: 8))";

/// Starts this program again, in this process, with enough threads for a router: Zenoh reads their number from the
/// environment alone, once.
fn with_enough_readers() {
    use std::os::unix::process::CommandExt;
    const NAME: &str = "ZENOH_RUNTIME";
    let (None, Ok(program)) = (std::env::var_os(NAME), std::env::current_exe()) else { return };
    let error = std::process::Command::new(program).args(std::env::args_os().skip(1)).env(NAME, READERS).exec();
    terminal::warn(&format!("warning: the router has few threads; set {NAME}='{READERS}': {error}"));
}

/// One service in this process.
pub(crate) fn serve(arguments: &ServeArguments, library: &Library) -> Result<ExitCode, OperationError> {
    if arguments.service == Service::Router {
        with_enough_readers();
    }
    if arguments.service == Service::Recorder {
        return record::record(&arguments.recording, &arguments.link, arguments.placement.json, library);
    }
    let mailbox = Arc::new(Mailbox::default());
    let stop = terminal::mailbox_stop_flag(&mailbox)?;
    let Some(hosted) = arguments.service.hosted() else {
        return router(arguments, library, &mailbox, &stop);
    };
    let placement = Placement::new(arguments.placement.options(), library)?;
    if arguments.service == Service::Shadow && placement.pace() == Pace::LockStep {
        return Err(OperationError::Option(
            "--pace lockstep: a shadow follows the vehicle's time, and nobody waits for it".into(),
        ));
    }
    let vehicle = placement.vehicle(arguments.link.vehicle.as_deref());
    let link = arguments.link.link(library, "local", None, Some(&vehicle));
    let Some(session) = open_patiently(link, &stop)? else { return Ok(ExitCode::from(INTERRUPTED)) };
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::start());
    let mut engine = Engine::new(Arc::clone(&mailbox), Arc::clone(&clock), stop, placement.tick_s());
    placement.host(hosted, &session, &mailbox, &clock, &mut engine)?;
    say(arguments.placement.json, &json!({ "serving": arguments.service.name(), "vehicle": vehicle }), || {
        format!("{} of {vehicle}: up; Ctrl-C ends it", arguments.service.name())
    });
    let finished = engine.run(|_| {});
    close(&session);
    if placement.pace() == Pace::LockStep {
        for (service, ticks, wall_s) in &finished.progress {
            let laps_per_s = *ticks as f64 / wall_s.max(1e-9);
            let result = json!({ "service": service, "ticks": ticks, "wall_s": wall_s, "laps_per_s": laps_per_s });
            say(arguments.placement.json, &result, || {
                format!("{service}: {ticks} ticks in {wall_s:.2} s, {laps_per_s:.0} laps per second")
            });
        }
    }
    Ok(ending(&finished, arguments.placement.pace))
}

/// All four services in this process, with the router inside.
pub(crate) fn up(arguments: &UpArguments, library: &Library) -> Result<ExitCode, OperationError> {
    with_enough_readers();
    let mailbox = Arc::new(Mailbox::default());
    let stop = terminal::mailbox_stop_flag(&mailbox)?;
    let mut options = arguments.placement.options();
    if let Some(name) = &arguments.name {
        options.trial.clone_from(name);
    }
    options.keep_digests = options.pace == Pace::LockStep;
    if options.pace == Pace::LockStep && arguments.record.is_some() {
        // The ring waits for the recorder rather than leave a tick out.
        options.witnesses.push(recorder::WITNESS.to_owned());
    }
    options.rejoins = false;
    let placement = Placement::new(options, library)?;
    let vehicle = placement.vehicle(arguments.link.vehicle.as_deref());
    let role = if arguments.link.connect.is_empty() { ("vehicle-router", Some("router")) } else { ("local", None) };
    let link = arguments.link.link(library, role.0, role.1, Some(&vehicle));
    let access = router_access(&link, arguments.open_to_everyone)?;
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::start());
    let router = match role.1 {
        Some(_) => Some(Router::open(&link, Arc::clone(&clock), certificate_news)?),
        None => None,
    };
    let session = match &router {
        Some(router) => router.session.clone(),
        None => match open_patiently(link, &stop)? {
            Some(session) => session,
            None => return Ok(ExitCode::from(INTERRUPTED)),
        },
    };
    let access_log = access.watch(&session, Some(&vehicle), &clock, tell_access)?;
    let mut engine = Engine::new(Arc::clone(&mailbox), Arc::clone(&clock), Arc::clone(&stop), placement.tick_s());
    for service in [HostedService::Plant, HostedService::Estimator, HostedService::Guidance, HostedService::Controller]
    {
        placement.host(service, &session, &mailbox, &clock, &mut engine)?;
    }
    let listening = router.as_ref().map_or_else(|| session::locators(&session), Router::locators);
    let recorder = arguments.recorder(&vehicle, &session, &clock)?;
    let started =
        json!({ "vehicle": vehicle, "run": placement.run(), "listening": listening, "access_rules": access.json() });
    say(arguments.placement.json, &started, || started_text(&placement, &vehicle, &listening, &access));
    let stopwatch = Stopwatch::start();
    let ticks = placement.ticks().filter(|_| placement.pace() == Pace::LockStep);
    let progress = Bar::new(arguments.placement.json || ticks.is_none());
    progress.begin(placement.run(), ticks.unwrap_or(0));
    let finished = engine.run(|done| {
        // Drawing is rate-limited by the bar; asking it costs more than a lap.
        if done.is_multiple_of(256) {
            progress.reach(done);
        }
    });
    progress.end();
    let wall_s = stopwatch.elapsed_s();
    recorder.map_or(Ok(()), recorder::Background::end)?;
    drop(access_log);
    match router {
        Some(router) => router.close(),
        None => close(&session),
    }
    if placement.pace() == Pace::LockStep {
        let laps_per_s = finished.ticks as f64 / wall_s;
        let result = json!({
            "hash": finished.digest.to_string(), "ticks": finished.ticks, "wall_s": wall_s, "laps_per_s": laps_per_s,
        });
        say(arguments.placement.json, &result, || {
            format!(
                "{} ticks in {wall_s:.2} s: {laps_per_s:.0} laps per second. State hash {}.",
                finished.ticks, finished.digest
            )
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
        let recorder = Recorder::new(session, Arc::clone(clock), live, options)?;
        Ok(Some(recorder.in_background(record::say(json))))
    }
}

fn started_text(placement: &Placement, vehicle: &str, listening: &[String], access: &RouterAccess) -> String {
    let pace = match placement.pace() {
        Pace::LockStep => "in lock step".to_owned(),
        Pace::RealTime(1.0) => "in real time".to_owned(),
        Pace::RealTime(factor) => format!("at {factor} times real time"),
    };
    let places = listening.join(", ");
    format!(
        "{vehicle} is up, run {} {pace}; reach it at {places}; {}\n\
         Try: supertwin top     supertwin set depth_m 5     (Ctrl-C ends it)",
        placement.run(),
        access.text()
    )
}

fn router(
    arguments: &ServeArguments,
    library: &Library,
    mailbox: &Arc<Mailbox>,
    stop: &Arc<AtomicBool>,
) -> Result<ExitCode, OperationError> {
    let link = arguments.link.link(library, "vehicle-router", Some("router"), None);
    let access = router_access(&link, arguments.open_to_everyone)?;
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::start());
    let router = Router::open(&link, Arc::clone(&clock), certificate_news)?;
    let access_log = access.watch(&router.session, None, &clock, tell_access)?;
    let listening = router.locators();
    say(arguments.placement.json, &json!({ "listening": listening, "access_rules": access.json() }), || {
        format!("router: listening on {}; {}; Ctrl-C ends it", listening.join(", "), access.text())
    });
    while !stop.load(Ordering::Relaxed) {
        mailbox.wait(&*clock, None);
    }
    drop(access_log);
    router.close();
    Ok(ExitCode::SUCCESS)
}

/// Whom the router lets in; what is exposed is said before anything is opened.
fn router_access(link: &Link, open_to_everyone: bool) -> Result<RouterAccess, OperationError> {
    let access = RouterAccess::check(link, open_to_everyone)?;
    for exposure in &access.exposures {
        terminal::warn(&format!("warning: {exposure}"));
    }
    Ok(access)
}

fn tell_access(text: &str, refusal: bool) {
    terminal::warn(&format!("{}{text}", if refusal { "refused: " } else { "" }));
}

/// What a router says about its certificate; standard output belongs to results.
fn certificate_news(news: News) {
    match news {
        News::Renewed(text) => terminal::warn(&text),
        News::Warning(text) => terminal::warn(&format!("warning: {text}")),
    }
}

fn say(json: bool, value: &serde_json::Value, text: impl FnOnce() -> String) {
    terminal::print(&if json { value.to_string() } else { text() });
}

fn ending(finished: &Finished, pace: PaceArgument) -> ExitCode {
    let mut code = ExitCode::SUCCESS;
    for (service, ending) in &finished.endings {
        match ending {
            Ending::Complete => {}
            Ending::Stopped(reason) if pace == PaceArgument::Realtime || reason == "interrupted" => {
                if pace == PaceArgument::Lockstep {
                    code = ExitCode::from(INTERRUPTED);
                }
            }
            Ending::Stopped(reason) => {
                terminal::warn(&format!("error: {service} was stopped: {reason}"));
                return ExitCode::from(1);
            }
            Ending::Failed(reason) => {
                terminal::warn(&format!("error: {service}: {reason}"));
                return ExitCode::from(1);
            }
        }
    }
    code
}
