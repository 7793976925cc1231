//! The `supertwin` command: a digital twin of an underwater vehicle that inspects net pens.
//!
//! Exit status: 0 done, 1 the verdict is no, 2 the call or its input is wrong, 130 interrupted.

mod arguments;
mod terminal;
mod verbs;

use clap::{Parser, Subcommand};
use std::path::PathBuf;
use std::process::ExitCode;
use supertwin_lab::{Library, Override};
use verbs::{
    check, compare, dashboard, doctor, echo, export, get, hz, list, pki, record, repair, replay, run, schema, serve,
    set, show, sweep, top, up, verify, zenoh_config,
};

/// Digital twin of an underwater vehicle that inspects net pens: GSTA, adaptive GSTA and PID net following.
#[derive(Debug, Parser)]
#[command(name = "supertwin", version, propagate_version = true, arg_required_else_help = true)]
struct Cli {
    /// What to do
    #[command(subcommand)]
    verb: Verb,

    /// Folder with the configuration files [default: ./config, else the one of the source tree]
    #[arg(long, global = true, value_name = "DIR", env = "SUPERTWIN_CONFIG")]
    config: Option<PathBuf>,

    /// Replace one value of a file, e.g. environment.waves.significant_height_m=0.3; may be repeated
    #[arg(long, global = true, value_name = "SECTION.PATH=VALUE")]
    set: Vec<Override>,
}

impl Cli {
    /// The configuration files of this call.
    fn library(&self) -> Library {
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

#[derive(Debug, Subcommand)]
enum Verb {
    /// Run trials in one process, as fast as possible; record and score them
    Run(run::RunArguments),
    /// Run a campaign of seeds and parameters on all cores; one table, one report
    Sweep(sweep::SweepArguments),
    /// All four services in one process, on Zenoh, with the router inside
    Up(up::UpArguments),
    /// One service, or the router, in this process
    Serve(serve::ServeArguments),
    /// Record what flows on the network, and show it live
    Record(record::RecordArguments),
    /// Settings of a locked router and its clients; who may do what with which key
    ZenohConfig(zenoh_config::ZenohConfigArguments),
    /// Check that a trial has the same bits in one process, in four, and over a bad link
    Verify(verify::VerifyArguments),
    /// Validate configuration files and print what was understood, with units
    Check(check::CheckArguments),
    /// Command a vehicle or change a parameter, and hear whether it was obeyed
    Set(set::SetArguments),
    /// Parameters, last accepted commands, and who has the authority
    Get(get::GetArguments),
    /// Vehicles and services that are up, and the keys that flow
    List(list::ListArguments),
    /// Print what is published on a key
    Echo(echo::EchoArguments),
    /// Rate, jitter, bytes and gaps of what is published on a key
    Hz(hz::HzArguments),
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

fn main() -> ExitCode {
    let cli = Cli::parse();
    let library = cli.library();
    let done = match &cli.verb {
        Verb::Run(arguments) => run::run(arguments, &library),
        Verb::Sweep(arguments) => sweep::sweep(arguments, &library),
        Verb::Up(arguments) => up::up(arguments, &library),
        Verb::Serve(arguments) => serve::serve(arguments, &library),
        Verb::Record(arguments) => record::record(&arguments.recording, &arguments.link, arguments.json, &library),
        Verb::ZenohConfig(arguments) => zenoh_config::zenoh_config(arguments),
        Verb::Verify(arguments) => verify::verify(arguments, &library),
        Verb::Check(arguments) => check::check(arguments, &library),
        Verb::Set(arguments) => set::set(arguments, &library),
        Verb::Get(arguments) => get::get(arguments, &library),
        Verb::List(arguments) => list::list(arguments, &library),
        Verb::Echo(arguments) => echo::echo(arguments, &library),
        Verb::Hz(arguments) => hz::hz(arguments, &library),
        Verb::Top(arguments) => top::top(arguments, &library),
        Verb::Doctor(arguments) => doctor::doctor(arguments, &library),
        Verb::Pki(arguments) => pki::pki(arguments),
        Verb::Show(arguments) => show::show(arguments),
        Verb::Compare(arguments) => compare::compare(arguments, &library),
        Verb::Replay(arguments) => replay::replay(arguments, &library),
        Verb::Repair(arguments) => repair::repair(arguments),
        Verb::Export(arguments) => export::export(arguments),
        Verb::Dashboard(arguments) => dashboard::dashboard(arguments),
        Verb::Schema(arguments) => schema::schema(arguments),
    };
    match done {
        Ok(status) => status,
        Err(error) => terminal::report(&error),
    }
}
