//! `supertwin serve SERVICE` and `supertwin up`: services on the network, one per process or all in one.

use crate::cli::{LinkArguments, PaceArgument, ServeArguments, Service, UpArguments};
use crate::clock::Stopwatch;
use crate::failure::{Failure, INTERRUPTED};
use crate::output;
use crate::placement::{Placement, stop_flag};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use supertwin_lab::Library;
use supertwin_zenoh::{
    Clock, Ending, Engine, Finished, Link, LinkError, Mailbox, Pace, Session, SystemClock, close, keys, session,
};

/// One service in this process.
pub(crate) fn serve(arguments: &ServeArguments, library: &Library) -> Result<ExitCode, Failure> {
    let mailbox = Arc::new(Mailbox::default());
    let stop = stop_flag(&mailbox)?;
    if arguments.service == Service::Router {
        return router(arguments, library, &mailbox, &stop);
    }
    let placement = Placement::new(&arguments.placement, library)?;
    let vehicle = placement.vehicle(arguments.link.vehicle.as_deref());
    let link = arguments.link.link(library, "local", None, Some(&vehicle));
    let Some(session) = open_patiently(link, &stop)? else { return Ok(ExitCode::from(INTERRUPTED)) };
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::start());
    let tick_s = placement.trial.trial.tick_s.get();
    let mut engine = Engine::new(Arc::clone(&mailbox), Arc::clone(&clock), stop, tick_s);
    placement.host(arguments.service, &session, &mailbox, &clock, &mut engine)?;
    say(arguments.placement.json, &json!({ "serving": arguments.service.name(), "vehicle": vehicle }), || {
        format!("{} of {vehicle}: up; Ctrl-C ends it", arguments.service.name())
    });
    let finished = engine.run(|_| {});
    close(&session);
    if placement.pace == Pace::LockStep {
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
pub(crate) fn up(arguments: &UpArguments, library: &Library) -> Result<ExitCode, Failure> {
    let mailbox = Arc::new(Mailbox::default());
    let stop = stop_flag(&mailbox)?;
    let mut asked_for = arguments.placement.clone();
    if let Some(name) = &arguments.name {
        asked_for.trial.clone_from(name);
    }
    let mut placement = Placement::new(&asked_for, library)?;
    placement.keep_digests = placement.pace == Pace::LockStep;
    placement.rejoins = false;
    let vehicle = placement.vehicle(arguments.link.vehicle.as_deref());
    let role = if arguments.link.connect.is_empty() { ("vehicle-router", Some("router")) } else { ("local", None) };
    let link = arguments.link.link(library, role.0, role.1, Some(&vehicle));
    warn_exposed(&link)?;
    let Some(session) = open_patiently(link, &stop)? else { return Ok(ExitCode::from(INTERRUPTED)) };
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::start());
    let tick_s = placement.trial.trial.tick_s.get();
    let mut engine = Engine::new(Arc::clone(&mailbox), Arc::clone(&clock), Arc::clone(&stop), tick_s);
    for service in [Service::Plant, Service::Estimator, Service::Guidance, Service::Controller] {
        placement.host(service, &session, &mailbox, &clock, &mut engine)?;
    }
    let listening = session::locators(&session);
    let started = json!({ "vehicle": vehicle, "run": placement.run, "listening": listening });
    say(arguments.placement.json, &started, || started_text(&placement, &vehicle, &listening));
    let stopwatch = Stopwatch::start();
    let ticks = placement.ticks.filter(|_| placement.pace == Pace::LockStep);
    let progress = output::progress(&placement.run, ticks.unwrap_or(0), arguments.placement.json || ticks.is_none());
    let finished = engine.run(|done| {
        // Drawing is rate-limited by the bar; asking it costs more than a lap.
        if done.is_multiple_of(256) {
            progress.set_position(done);
        }
    });
    progress.finish_and_clear();
    let wall_s = stopwatch.elapsed_s();
    close(&session);
    if placement.pace == Pace::LockStep {
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

fn started_text(placement: &Placement, vehicle: &str, listening: &[String]) -> String {
    let pace = match placement.pace {
        Pace::LockStep => "in lock step".to_owned(),
        Pace::RealTime(1.0) => "in real time".to_owned(),
        Pace::RealTime(factor) => format!("at {factor} times real time"),
    };
    let places = listening.join(", ");
    format!(
        "{vehicle} is up, run {} {pace}; reach it at {places}\n\
         Try: supertwin top     supertwin set depth_m 5     (Ctrl-C ends it)",
        placement.run
    )
}

fn router(
    arguments: &ServeArguments,
    library: &Library,
    mailbox: &Arc<Mailbox>,
    stop: &Arc<AtomicBool>,
) -> Result<ExitCode, Failure> {
    let link = arguments.link.link(library, "vehicle-router", Some("router"), None);
    warn_exposed(&link)?;
    let session = link.open()?;
    let listening = session::locators(&session);
    say(arguments.placement.json, &json!({ "listening": listening }), || {
        format!("router: listening on {}; Ctrl-C ends it", listening.join(", "))
    });
    let clock = SystemClock::start();
    while !stop.load(Ordering::Relaxed) {
        mailbox.wait(&clock, None);
    }
    close(&session);
    Ok(ExitCode::SUCCESS)
}

fn warn_exposed(link: &Link) -> Result<(), Failure> {
    for exposure in session::exposures(&link.settings()?) {
        output::warn(&format!("warning: {exposure}"));
    }
    Ok(())
}

/// Opens a session, and waits for a router that is not there yet; `None` when interrupted.
pub(crate) fn open_patiently(mut link: Link, stop: &AtomicBool) -> Result<Option<Session>, Failure> {
    link.patience_ms = 1000;
    let mut said = false;
    while !stop.load(Ordering::Relaxed) {
        match link.open() {
            Ok(session) => return Ok(Some(session)),
            Err(error @ LinkError::NoRouter { .. }) => {
                if !core::mem::replace(&mut said, true) {
                    output::warn(&format!("waiting: {error}"));
                }
            }
            Err(error) => return Err(error.into()),
        }
    }
    Ok(None)
}

fn say(json: bool, value: &serde_json::Value, text: impl FnOnce() -> String) {
    output::print(&if json { value.to_string() } else { text() });
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
                output::warn(&format!("error: {service} was stopped: {reason}"));
                return ExitCode::from(1);
            }
            Ending::Failed(reason) => {
                output::warn(&format!("error: {service}: {reason}"));
                return ExitCode::from(1);
            }
        }
    }
    code
}

impl LinkArguments {
    /// How to join the network; `role` names a file in `config/zenoh` that is used unless another is given.
    pub(crate) fn link(
        &self,
        library: &Library,
        role: &str,
        mode: Option<&'static str>,
        vehicle: Option<&str>,
    ) -> Link {
        let shipped = |role: &str| Some(library.root().join("zenoh").join(format!("{role}.json5")));
        let file: Option<PathBuf> = self.zenoh.clone().or_else(|| shipped(role).filter(|path| Path::exists(path)));
        Link {
            file,
            listen: self.listen.clone(),
            connect: self.connect.clone(),
            overrides: self.zenoh_set.clone(),
            mode,
            namespace: vehicle.map(keys::namespace),
            patience_ms: 3000,
        }
    }
}
