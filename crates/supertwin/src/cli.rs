//! The command line's grammar.

use clap::{Args, Parser, Subcommand};
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
    /// Validate configuration files and print what was understood, with units
    Check(CheckArguments),
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
