//! The command line's grammar: the verbs, and what several of them share. What one verb takes stands with what it does.

use crate::{
    check, compare, dashboard, doctor, export, operate, pki, recorder, repair, replay, run, schema, serve, show, sweep,
    top, verify, watch, zenoh_config,
};
use clap::{Args, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;
use supertwin_lab::{ConfigError, Library, Override, ResolvedTrial, trial};

/// Digital twin of an underwater vehicle that inspects net pens: GSTA, adaptive GSTA and PID net following.
#[derive(Debug, Parser)]
#[command(name = "supertwin", version, propagate_version = true, arg_required_else_help = true)]
pub(crate) struct Cli {
    /// What to do
    #[command(subcommand)]
    pub(crate) verb: Verb,

    /// Folder with the configuration files [default: ./config, else the one of the source tree]
    #[arg(long, global = true, value_name = "DIR", env = "SUPERTWIN_CONFIG")]
    pub(crate) config: Option<PathBuf>,

    /// Replace one value of a file, e.g. environment.waves.significant_height_m=0.3; may be repeated
    #[arg(long, global = true, value_name = "SECTION.PATH=VALUE")]
    pub(crate) set: Vec<Override>,
}

impl Cli {
    /// The configuration files of this call.
    pub(crate) fn library(&self) -> Library {
        let here = PathBuf::from("config");
        let root = self.config.clone().unwrap_or_else(|| {
            if here.join("trials").is_dir() {
                here
            } else {
                PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../config"))
            }
        });
        Library::new(root, self.set.clone())
    }
}

/// Verbs.
#[derive(Debug, Subcommand)]
pub(crate) enum Verb {
    /// Run trials in one process, as fast as possible; record and score them
    Run(run::RunArguments),
    /// Run a campaign of seeds and parameters on all cores; one table, one report
    Sweep(sweep::SweepArguments),
    /// All four services in one process, on Zenoh, with the router inside
    Up(serve::UpArguments),
    /// One service, or the router, in this process
    Serve(serve::ServeArguments),
    /// Record what flows on the network, and show it live
    Record(recorder::RecordArguments),
    /// Settings of a locked router and its clients; who may do what with which key
    ZenohConfig(zenoh_config::ZenohConfigArguments),
    /// Check that a trial has the same bits in one process, in four, and over a bad link
    Verify(verify::VerifyArguments),
    /// Validate configuration files and print what was understood, with units
    Check(check::CheckArguments),
    /// Command a vehicle or change a parameter, and hear whether it was obeyed
    Set(operate::SetArguments),
    /// Parameters, last accepted commands, and who has the authority
    Get(operate::GetArguments),
    /// Vehicles and services that are up, and the keys that flow
    List(watch::ListArguments),
    /// Print what is published on a key
    Echo(watch::EchoArguments),
    /// Rate, jitter, bytes and gaps of what is published on a key
    Hz(watch::HzArguments),
    /// Services live: ticks, rates, ages of inputs, gaps, step times
    Top(top::TopArguments),
    /// What is wrong with this set-up, and what to do
    Doctor(doctor::DoctorArguments),
    /// Certificates of the fleet: who may do what, until when
    Pki(pki::PkiArguments),
    /// What is in a recording, what is missing, and whether its scores are right
    Show(show::ShowArguments),
    /// Which of several runs is better, by how much, and how sure that is; a gate for CI
    Compare(compare::CompareArguments),
    /// Run blocks again on a recording: the same bits, or a what-if with other parameters
    Replay(replay::ReplayArguments),
    /// Make a damaged recording whole
    Repair(repair::RepairArguments),
    /// Write a recording as Parquet, CSV or MCAP
    Export(export::ExportArguments),
    /// List the viewer's dashboards, or write them as files
    Dashboard(dashboard::DashboardArguments),
    /// List the messages on the wires, or print and write their JSON Schemas
    Schema(schema::SchemaArguments),
}

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

/// Services.
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
    /// Its name in keys.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Plant => "plant",
            Self::Estimator => "estimator",
            Self::Guidance => "guidance",
            Self::Controller => "controller",
            Self::Shadow => "shadow",
            Self::Router => "router",
            Self::Recorder => "recorder",
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
    #[arg(long, value_name = "NAME", default_value = crate::recorder::WITNESS)]
    pub(crate) as_witness: String,

    #[command(flatten)]
    pub(crate) live: LiveArguments,
}

impl RecordingArguments {
    /// When a part is closed.
    pub(crate) fn rotation(&self) -> crate::recorder::Rotation {
        crate::recorder::Rotation {
            bytes: self.part_mb << 20,
            time: std::time::Duration::from_secs_f64(60.0 * self.part_min),
        }
    }
}
