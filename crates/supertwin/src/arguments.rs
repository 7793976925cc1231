//! Options that several verbs share; what one verb takes stands in its own file.

use crate::terminal;
use clap::{Args, ValueEnum};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use supertwin_lab::{ConfigError, Library, ResolvedTrial, trial};
use supertwin_operations::placement::{HostedService, PlacementOptions};
use supertwin_operations::recorder::{Rotation, WITNESS};
use supertwin_operations::{NetworkClient, OperationError};
use supertwin_protocol::{FaultRates, SystemClock, keys};
use supertwin_zenoh::router::expiring;
use supertwin_zenoh::{Link, LinkError, Pace, Session};

/// Which trials; without any, the paper's three case studies.
#[derive(Debug, Args)]
pub(crate) struct TrialsArguments {
    /// Names in config/trials, or paths to trial files
    #[arg(value_name = "TRIAL", default_values = ["paper-gsta", "paper-agsta", "paper-pid"])]
    names: Vec<String>,
}

impl TrialsArguments {
    /// Reads them: one resolved trial per controller. What was to be replaced in a file must be of use to one of them.
    pub(crate) fn load(&self, library: &Library) -> Result<Vec<ResolvedTrial>, ConfigError> {
        let mut trials = Vec::new();
        for name in &self.names {
            trials.extend(trial::load(library, name)?);
        }
        library.all_used(&trials)?;
        Ok(trials)
    }
}

/// How to join the network.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Network")]
pub(crate) struct LinkArguments {
    /// Zenoh configuration in JSON5 [default: the one of config/zenoh that fits]
    #[arg(long, value_name = "FILE", env = "SUPERTWIN_ZENOH")]
    pub(crate) zenoh: Option<PathBuf>,

    /// Router to connect to, instead of the file's, e.g. tcp/192.168.2.2:7447; may be repeated
    #[arg(long, value_name = "ENDPOINT", env = "SUPERTWIN_CONNECT", value_delimiter = ' ')]
    pub(crate) connect: Vec<String>,

    /// Where to listen, instead of the file's; may be repeated
    #[arg(long, value_name = "ENDPOINT")]
    pub(crate) listen: Vec<String>,

    /// Certificate and key for tls/…: the folder of its holder, as `supertwin pki issue` makes it
    #[arg(long, value_name = "DIR|PREFIX", env = "SUPERTWIN_CREDENTIALS")]
    pub(crate) credentials: Option<PathBuf>,

    /// Replace one Zenoh setting, e.g. transport/link/tx/lease=1000; may be repeated
    #[arg(long, value_name = "PATH=JSON5")]
    pub(crate) zenoh_set: Vec<String>,

    /// Name of the vehicle on the network [default: services: the trial's; tools: the only one that is up]
    #[arg(long, value_name = "NAME", env = "SUPERTWIN_VEHICLE")]
    pub(crate) vehicle: Option<String>,
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
        let shipped = |role: &str| Some(library.root.join("zenoh").join(format!("{role}.json5")));
        let file: Option<PathBuf> = self.zenoh.clone().or_else(|| shipped(role).filter(|path| Path::exists(path)));
        Link {
            file,
            listen: self.listen.clone(),
            connect: self.connect.clone(),
            credentials: self.credentials.clone(),
            overrides: self.zenoh_set.clone(),
            mode,
            namespace: vehicle.map(keys::namespace),
            patience_ms: 3000,
        }
    }

    /// Joins the network as a tool does; Ctrl-C ends every wait from here on.
    pub(crate) fn join(&self, library: &Library) -> Result<NetworkClient, OperationError> {
        let client = NetworkClient::join(&self.link(library, "local", None, None))?;
        terminal::interrupt_on_ctrl_c(client.inbox.interrupter())?;
        Ok(client)
    }
}

/// What every operator's tool knows.
#[derive(Debug, Args)]
pub(crate) struct ToolArguments {
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,

    #[command(flatten)]
    pub(crate) link: LinkArguments,
}

/// How ticks follow each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum PaceArgument {
    /// By the wall clock
    Realtime,
    /// When all inputs of a tick are there: the same bits as `run`
    Lockstep,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Service {
    /// The twin of the vehicle, its sensors and the sea; owns time
    Plant,
    /// Measurements into navigation
    Estimator,
    /// Set-points into references
    Guidance,
    /// References into thrust; keeps the authority
    Controller,
    /// The twin beside a real vehicle, whose driver takes the plant's place
    Shadow,
    /// The router that all others connect to
    Router,
    /// What flows on the network, into recordings
    Recorder,
}

impl Service {
    /// The block that it hosts, and its name in keys; router and recorder host none.
    pub(crate) fn hosted(self) -> Option<(HostedService, &'static str)> {
        match self {
            Self::Plant => Some((HostedService::Plant, "plant")),
            Self::Estimator => Some((HostedService::Estimator, "estimator")),
            Self::Guidance => Some((HostedService::Guidance, "guidance")),
            Self::Controller => Some((HostedService::Controller, "controller")),
            Self::Shadow => Some((HostedService::Shadow, "shadow")),
            Self::Router | Self::Recorder => None,
        }
    }
}

/// What runs, and how.
#[derive(Clone, Debug, Args)]
pub(crate) struct PlacementArguments {
    /// Trial: a name in config/trials, or a path
    #[arg(long, value_name = "TRIAL", default_value = "paper-agsta")]
    pub(crate) trial: String,

    /// Which of the trial's controllers [default: its first]
    #[arg(long, value_name = "NAME")]
    pub(crate) controller: Option<String>,

    /// Seed instead of the trial's own
    #[arg(long, value_name = "N")]
    pub(crate) seed: Option<u64>,

    /// Real time or lock step
    #[arg(long, value_enum, default_value = "realtime")]
    pub(crate) pace: PaceArgument,

    /// Times real time
    #[arg(long, value_name = "FACTOR", default_value = "1", value_parser = positive)]
    pub(crate) rtf: f64,

    /// Simulated seconds [default: lock step: the trial's; real time: until it is stopped]
    #[arg(long, value_name = "S", value_parser = positive)]
    pub(crate) duration: Option<f64>,

    /// Leave the trial's timed commands out and wait for clients
    #[arg(long)]
    pub(crate) no_mission: bool,

    /// Name of the run; the plant's counts, the others adopt it [default: trial and a unique number]
    #[arg(long, value_name = "NAME")]
    pub(crate) run: Option<String>,

    /// Telemetry at every n-th tick, 0 for none
    #[arg(long, value_name = "N", default_value = "1")]
    pub(crate) telemetry_every: u64,

    /// Lock step: do not go on before this witness has seen each tick; may be repeated (plant only)
    #[arg(long, value_name = "NAME")]
    pub(crate) witness: Vec<String>,

    /// Lock step: seconds to wait for the others before giving up
    #[arg(long, value_name = "S", default_value = "10", value_parser = positive)]
    pub(crate) patience: f64,

    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,

    /// Lose this share of messages on purpose
    #[arg(long, hide = true, default_value = "0")]
    pub(crate) fault_drop: f64,

    /// Send this share of messages twice on purpose
    #[arg(long, hide = true, default_value = "0")]
    pub(crate) fault_double: f64,

    /// Seed of the two
    #[arg(long, hide = true, default_value = "1")]
    pub(crate) fault_seed: u64,
}

impl PlacementArguments {
    /// The same for the library; services that join a router by themselves again after a cut.
    pub(crate) fn options(&self) -> PlacementOptions {
        let faulty = self.fault_drop > 0.0 || self.fault_double > 0.0;
        PlacementOptions {
            trial: self.trial.clone(),
            controller: self.controller.clone(),
            seed: self.seed,
            pace: match self.pace {
                PaceArgument::Lockstep => Pace::LockStep,
                PaceArgument::Realtime => Pace::RealTime(self.rtf),
            },
            duration_s: self.duration,
            mission: !self.no_mission,
            run: self.run.clone(),
            telemetry_every: self.telemetry_every,
            witnesses: self.witness.clone(),
            faults: faulty.then_some(FaultRates {
                drop: self.fault_drop,
                double: self.fault_double,
                seed: self.fault_seed,
            }),
            patience: Duration::from_secs_f64(self.patience),
            one_process: false,
        }
    }
}

/// A finite number above zero.
pub(crate) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number > 0.0 && number.is_finite() => Ok(number),
        Ok(number) => Err(format!("{number}: must be positive and finite")),
        Err(error) => Err(error.to_string()),
    }
}

/// Where recordings of the network go unless told otherwise.
pub(crate) const RECORDINGS: &str = "runs/recorded";
/// Port of the live view: Rerun's own.
pub(crate) const LIVE_PORT: u16 = 9876;

/// A live view.
#[derive(Clone, Copy, Debug, Default, Args)]
#[command(next_help_heading = "Recording")]
pub(crate) struct LiveArguments {
    /// Serve a live view for Rerun viewers on this port of this machine, 0 for any [default port: 9876]
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "9876")]
    pub(crate) live: Option<u16>,

    /// Serve the live view as a web page as well, for browsers on this machine [default port: 9090]
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "9090")]
    pub(crate) live_web: Option<u16>,
}

/// How a recorder records.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Recording")]
pub(crate) struct RecordingArguments {
    /// Folder for recordings, one file per run and vehicle; nothing in it is ever replaced
    #[arg(long, value_name = "DIR", default_value = RECORDINGS)]
    pub(crate) out: PathBuf,

    /// No files, only the live view
    #[arg(long, requires = "live", conflicts_with = "out")]
    pub(crate) no_file: bool,

    /// Close a file and begin the next part when it has this many megabytes
    #[arg(long, value_name = "MB", default_value = "2048", value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub(crate) part_mb: u64,

    /// … or after this many minutes
    #[arg(long, value_name = "MIN", default_value = "10", value_parser = positive)]
    pub(crate) part_min: f64,

    /// End with the first run that ends
    #[arg(long)]
    pub(crate) once: bool,

    /// Lock step: the name that the plant was told with --witness
    #[arg(long, value_name = "NAME", default_value = WITNESS)]
    pub(crate) as_witness: String,

    #[command(flatten)]
    pub(crate) live: LiveArguments,
}

impl RecordingArguments {
    /// When a part is closed.
    pub(crate) fn rotation(&self) -> Rotation {
        Rotation { bytes: self.part_mb << 20, time: Duration::from_secs_f64(60.0 * self.part_min) }
    }
}

/// Opens a session, and waits for a router that is not there yet; `None` when interrupted.
pub(crate) fn open_patiently(mut link: Link, stop: &AtomicBool) -> Result<Option<Session>, OperationError> {
    link.patience_ms = 1000;
    if let Some(text) = expiring(&link.settings()?, &SystemClock::start()).map_err(LinkError::from)? {
        terminal::warn(&format!("warning: {text}"));
    }
    let mut warned = false;
    while !stop.load(Ordering::Relaxed) {
        match link.open() {
            Ok(session) => return Ok(Some(session)),
            Err(error @ LinkError::NoRouter { .. }) => {
                if !core::mem::replace(&mut warned, true) {
                    terminal::warn(&format!("waiting: {error}"));
                }
            }
            Err(error) => return Err(error.into()),
        }
    }
    Ok(None)
}
