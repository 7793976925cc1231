//! The command line's grammar.

use clap::{Args, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;
use supertwin_lab::{Library, Override};

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
    Run(RunArguments),
    /// All four services in one process, on Zenoh, with the router inside
    Up(UpArguments),
    /// One service, or the router, in this process
    Serve(ServeArguments),
    /// Check that a trial has the same bits in one process, in four, and over a bad link
    Verify(VerifyArguments),
    /// Validate configuration files and print what was understood, with units
    Check(CheckArguments),
    /// Command a vehicle or change a parameter, and hear whether it was obeyed
    Set(SetArguments),
    /// Parameters, last accepted commands, and who has the authority
    Get(GetArguments),
    /// Vehicles and services that are up, and the keys that flow
    List(ListArguments),
    /// Print what is published on a key
    Echo(EchoArguments),
    /// Rate, jitter, bytes and gaps of what is published on a key
    Hz(HzArguments),
    /// Services live: ticks, rates, ages of inputs, gaps, step times
    Top(TopArguments),
    /// What is wrong with this set-up, and what to do
    Doctor(DoctorArguments),
}

/// Arguments of `run`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin run                                  the paper's three trials, table IV beside ours
  supertwin run --seeds 20 --no-record           mean and standard deviation over 20 seeds
  supertwin run fair --seeds 20 --json           five controllers on equal terms
  supertwin run paper-agsta --set controller.law.agsta.beta.surge=4 --out runs/softer
  supertwin run my-trial.toml                    a trial of your own

Exit status: 0 done, 1 a run ended in NaN, 2 the call or its input is wrong, 130 interrupted (recordings are closed).")]
pub(crate) struct RunArguments {
    /// Names in config/trials, or paths to trial files [default: paper-gsta paper-agsta paper-pid]
    #[arg(value_name = "TRIAL")]
    pub(crate) trials: Vec<String>,

    /// Seed instead of the trial's own
    #[arg(long, value_name = "N", conflicts_with = "seeds")]
    pub(crate) seed: Option<u64>,

    /// Run this many seeds, counting up from the trial's own
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub(crate) seeds: Option<u64>,

    /// Folder for the recordings [default: a new numbered folder in runs/]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,

    /// Replace recordings that exist
    #[arg(long)]
    pub(crate) force: bool,

    /// Smaller recordings, about 40 per cent, that take twice as long
    #[arg(long)]
    pub(crate) compress: bool,

    /// Score only, write nothing
    #[arg(long, conflicts_with_all = ["out", "force", "compress"])]
    pub(crate) no_record: bool,

    /// Runs at the same time [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub(crate) jobs: Option<u16>,

    /// Print one JSON object instead of tables
    #[arg(long)]
    pub(crate) json: bool,
}

/// Arguments of `check`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin check                                every file of the configuration folder
  supertwin check config/trials/fair.toml        one trial with all its files
  supertwin check config/vehicles/argus-mini.toml --json

Exit status: 0 all legal, 2 something is not.")]
pub(crate) struct CheckArguments {
    /// Configuration files; the folder a file is in says what it is [default: all]
    #[arg(value_name = "FILE")]
    pub(crate) files: Vec<PathBuf>,

    /// Print one JSON object instead of lines
    #[arg(long)]
    pub(crate) json: bool,
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

    /// Replace one Zenoh setting, e.g. transport/link/tx/lease=1000; may be repeated
    #[arg(long, value_name = "PATH=JSON5")]
    pub(crate) zenoh_set: Vec<String>,

    /// Name of the vehicle on the network [default: services: the trial's; tools: the only one that is up]
    #[arg(long, value_name = "NAME", env = "SUPERTWIN_VEHICLE")]
    pub(crate) vehicle: Option<String>,
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
    /// The router that all others connect to
    Router,
}

impl Service {
    /// Its name in keys.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Plant => "plant",
            Self::Estimator => "estimator",
            Self::Guidance => "guidance",
            Self::Controller => "controller",
            Self::Router => "router",
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
fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number > 0.0 && number.is_finite() => Ok(number),
        Ok(number) => Err(format!("{number}: must be positive and finite")),
        Err(error) => Err(error.to_string()),
    }
}

/// Arguments of `up`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin up                                   the adaptive law on the paper's course, in real time
  supertwin up fair --controller pid-tuned --no-mission
                                                 waits for commands: supertwin set mode follow_net
  supertwin up --rtf 5                           five times real time
  supertwin up --pace lockstep                   as fast as the processor, the same bits as `supertwin run`

Exit status: 0 done or stopped, 1 the run could not go on, 2 the call is wrong, 130 a lock-step run was interrupted.")]
pub(crate) struct UpArguments {
    /// Trial: a name in config/trials, or a path; the same as --trial
    #[arg(value_name = "TRIAL", conflicts_with = "trial")]
    pub(crate) name: Option<String>,
    #[command(flatten)]
    pub(crate) placement: PlacementArguments,
    #[command(flatten)]
    pub(crate) link: LinkArguments,
}

/// Arguments of `serve`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin serve router                         on the vehicle
  supertwin serve plant &  supertwin serve estimator &  supertwin serve controller &
  supertwin serve guidance --connect tcp/192.168.2.2:7447        topside
  supertwin serve router --listen tcp/127.0.0.1:0 --json         says on which port

Every service waits for its router, and joins again by itself after a cut.
Exit status: 0 done or stopped, 1 the run could not go on, 2 the call is wrong, 130 a lock-step run was interrupted.")]
pub(crate) struct ServeArguments {
    /// Which
    #[arg(value_enum)]
    pub(crate) service: Service,
    #[command(flatten)]
    pub(crate) placement: PlacementArguments,
    #[command(flatten)]
    pub(crate) link: LinkArguments,
}

/// Arguments of `verify`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin verify                               the paper's three trials, 60 s each
  supertwin verify paper-agsta --duration 10
  supertwin verify --router tcp/127.0.0.1:7447   over a router that runs already, such as a stock zenohd

Each trial runs in one process; as four processes in lock step, connected only through a router; and again with a
tenth of all messages lost and a tenth sent twice.
Exit status: 0 the same bits everywhere, 1 not, 2 the call or its input is wrong, 130 interrupted.")]
pub(crate) struct VerifyArguments {
    /// Names in config/trials, or paths [default: paper-gsta paper-agsta paper-pid]
    #[arg(value_name = "TRIAL")]
    pub(crate) trials: Vec<String>,

    /// Simulated seconds
    #[arg(long, value_name = "S", default_value = "60", value_parser = positive)]
    pub(crate) duration: f64,

    /// Use this router instead of starting one
    #[arg(long, value_name = "ENDPOINT")]
    pub(crate) router: Option<String>,

    /// Print one JSON object instead of a table
    #[arg(long)]
    pub(crate) json: bool,
}

/// Arguments of `set`.
#[derive(Debug, Args)]
#[command(after_help = "Names:
  mode                       neutral, depth_heading_hold, follow_net
  depth_m  heading_rad       set-points; a number, or a profile in JSON: ramp, sine
  net_distance_m  speed_m_per_s
  direction                  starboard, port
  law NAME                   another of the trial's control laws, without a jump in the wrench
  neutral                    true: no force at once, asks for no authority; false: ends it
  estimator restart          forget everything and start from the next measurements
  dvl_silent_for_s SECONDS   the DVL fails
  thruster_gain JSON         e.g. '{\"thruster\":1,\"gain\":0.5}'
  SERVICE.PATH               a parameter, as `supertwin get` lists them

Examples:
  supertwin set depth_m 5
  supertwin set mode follow_net net_distance_m 2 speed_m_per_s 0.3      all at the same tick
  supertwin set depth_m '{\"ramp\":{\"to\":5,\"over_s\":20}}'
  supertwin set controller.law.agsta.beta.surge 4
  supertwin set neutral true                     emergency

Takes the authority, sends, gives it back, and waits until everything has applied.
Exit status: 0 applied, 1 refused or not applied in time, 2 the call is wrong or there is no router, 130 interrupted.")]
pub(crate) struct SetArguments {
    /// Names and values, in turn
    #[arg(value_name = "NAME VALUE", required = true, num_args = 2.., allow_negative_numbers = true)]
    pub(crate) pairs: Vec<String>,

    /// Seconds to wait until it has applied
    #[arg(long, value_name = "S", default_value = "5", value_parser = positive, conflicts_with = "no_wait")]
    pub(crate) wait: f64,

    /// Leave as soon as the services have said when it will apply
    #[arg(long)]
    pub(crate) no_wait: bool,

    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,

    #[command(flatten)]
    pub(crate) link: LinkArguments,
}

/// Arguments of `get`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin get                                  everything
  supertwin get controller                       all parameters of a service
  supertwin get controller.law.agsta.beta --json
  supertwin get depth_m                          the last command of this name that applied
  supertwin get lease                            who has the authority

Exit status: 0 done, 1 there is no such thing or nobody is up, 2 the call is wrong or there is no router.")]
pub(crate) struct GetArguments {
    /// A service, SERVICE.PATH of a parameter, the name of a command, or `lease` [default: everything]
    #[arg(value_name = "NAME")]
    pub(crate) name: Option<String>,

    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,

    #[command(flatten)]
    pub(crate) link: LinkArguments,
}

/// Arguments of `list`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin list
  supertwin list --for 5 --json                  also what is seldom published
  supertwin list --connect tcp/192.168.2.2:7447

Exit status: 0 done (also when nobody is up), 2 the call is wrong or there is no router, 130 interrupted.")]
pub(crate) struct ListArguments {
    /// Seconds to listen for keys
    #[arg(long = "for", value_name = "S", default_value = "1.2", value_parser = positive)]
    pub(crate) for_s: f64,

    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,

    #[command(flatten)]
    pub(crate) link: LinkArguments,
}

/// Arguments of `echo`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin echo 'event/**'                      what happened so far, and what happens
  supertwin echo estimator/nav --count 1 --json
  supertwin echo 'state/**' --for 10
  supertwin echo 'supertwin/*/health/*'          of all vehicles

Exit status: 0 done or stopped, 1 nothing was heard, 2 the call is wrong or there is no router.")]
pub(crate) struct EchoArguments {
    /// Key below the vehicle's, or a full one from supertwin/ on; * is one part, ** any number
    #[arg(value_name = "KEY")]
    pub(crate) key: String,

    /// End after this many samples
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) count: Option<u64>,

    /// End after this many seconds
    #[arg(long = "for", value_name = "S", value_parser = positive)]
    pub(crate) for_s: Option<f64>,

    /// Print one JSON object per line
    #[arg(long)]
    pub(crate) json: bool,

    #[command(flatten)]
    pub(crate) link: LinkArguments,
}

/// Arguments of `hz`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin hz estimator/nav
  supertwin hz 'telemetry/*' --for 20
  supertwin hz '**' --json                       everything of the vehicle

Exit status: 0 done, 1 nothing was heard, 2 the call is wrong or there is no router, 130 interrupted.")]
pub(crate) struct HzArguments {
    /// Key below the vehicle's, or a full one from supertwin/ on; * is one part, ** any number
    #[arg(value_name = "KEY")]
    pub(crate) key: String,

    /// Seconds to listen
    #[arg(long = "for", value_name = "S", default_value = "5", value_parser = positive)]
    pub(crate) for_s: f64,

    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,

    #[command(flatten)]
    pub(crate) link: LinkArguments,
}

/// Arguments of `top`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin top                                  redraws every second; Ctrl-C ends it
  supertwin top --json                           one snapshot as JSON
  supertwin top --count 60 --json > health.jsonl a minute, one object per line

Columns: age: greatest age of an input at a step, in ticks, during the last second; missing, double, late: messages
of all inputs since the start; step: microseconds; misses: ticks that began too late to be sent.
Exit status: 0 done or stopped, 1 nobody is up, 2 the call is wrong or there is no router.")]
pub(crate) struct TopArguments {
    /// End after this many snapshots [default: on a terminal: never; else 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) count: Option<u64>,

    /// Print one JSON object per snapshot
    #[arg(long)]
    pub(crate) json: bool,

    #[command(flatten)]
    pub(crate) link: LinkArguments,
}

/// Arguments of `doctor`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin doctor
  supertwin doctor --zenoh config/zenoh/vehicle-router.json5     examines a router's file, then asks at its listeners
  supertwin doctor --connect tcp/192.168.2.2:7447 --json

Exit status: 0 nothing is wrong (there may be warnings), 1 something is wrong, 2 the call is wrong.")]
pub(crate) struct DoctorArguments {
    /// Print a JSON list
    #[arg(long)]
    pub(crate) json: bool,

    #[command(flatten)]
    pub(crate) link: LinkArguments,
}
