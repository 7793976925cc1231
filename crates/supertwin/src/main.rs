//! The `supertwin` command: a digital twin of an underwater vehicle that inspects net pens.
//!
//! Exit status: 0 done, 1 the verdict is no, 2 the call or its input is wrong, 130 interrupted.

mod check;
mod cli;
mod clock;
mod compare;
mod dashboard;
mod doctor;
mod door;
mod export;
mod failure;
mod operate;
mod output;
mod pki;
mod placement;
mod prove;
mod recorder;
mod repair;
mod replay;
mod run;
mod save;
mod schema;
mod serve;
mod show;
mod sweep;
mod tables;
mod tool;
mod top;
mod verify;
mod watch;
mod zenoh_config;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    let cli = cli::Cli::parse();
    let done = match &cli.verb {
        cli::Verb::Run(arguments) => run::run(arguments, &cli.library()),
        cli::Verb::Sweep(arguments) => sweep::sweep(arguments, &cli.library()),
        cli::Verb::Up(arguments) => serve::up(arguments, &cli.library()),
        cli::Verb::Serve(arguments) => serve::serve(arguments, &cli.library()),
        cli::Verb::Record(arguments) => {
            recorder::record(&arguments.recording, &arguments.link, arguments.json, &cli.library())
        }
        cli::Verb::ZenohConfig(arguments) => zenoh_config::zenoh_config(arguments),
        cli::Verb::Verify(arguments) => verify::verify(&cli, arguments),
        cli::Verb::Check(arguments) => check::check(arguments, &cli.library()),
        cli::Verb::Set(arguments) => operate::set(arguments, &cli.library()),
        cli::Verb::Get(arguments) => operate::get(arguments, &cli.library()),
        cli::Verb::List(arguments) => watch::list(arguments, &cli.library()),
        cli::Verb::Echo(arguments) => watch::echo(arguments, &cli.library()),
        cli::Verb::Hz(arguments) => watch::hz(arguments, &cli.library()),
        cli::Verb::Top(arguments) => top::top(arguments, &cli.library()),
        cli::Verb::Doctor(arguments) => doctor::doctor(arguments, &cli.library()),
        cli::Verb::Pki(arguments) => pki::pki(arguments),
        cli::Verb::Show(arguments) => show::show(arguments),
        cli::Verb::Compare(arguments) => compare::compare(arguments, &cli.library()),
        cli::Verb::Replay(arguments) => replay::replay(arguments, &cli.library()),
        cli::Verb::Repair(arguments) => repair::repair(arguments),
        cli::Verb::Export(arguments) => export::export(arguments),
        cli::Verb::Dashboard(arguments) => dashboard::dashboard(arguments),
        cli::Verb::Schema(arguments) => schema::schema(arguments),
    };
    match done {
        Ok(status) => status,
        Err(failure) => failure.report(),
    }
}
