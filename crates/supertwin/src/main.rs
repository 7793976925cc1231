//! The `supertwin` command: a digital twin of an underwater vehicle that inspects net pens.
//!
//! Exit status: 0 done, 1 the verdict is no, 2 the call or its input is wrong, 130 interrupted.

mod check;
mod cli;
mod clock;
mod doctor;
mod failure;
mod operate;
mod output;
mod placement;
mod run;
mod serve;
mod tables;
mod tool;
mod top;
mod verify;
mod watch;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    let cli = cli::Cli::parse();
    let done = match &cli.verb {
        cli::Verb::Run(arguments) => run::run(arguments, &cli.library()),
        cli::Verb::Up(arguments) => serve::up(arguments, &cli.library()),
        cli::Verb::Serve(arguments) => serve::serve(arguments, &cli.library()),
        cli::Verb::Verify(arguments) => verify::verify(&cli, arguments),
        cli::Verb::Check(arguments) => check::check(arguments, &cli.library()),
        cli::Verb::Set(arguments) => operate::set(arguments, &cli.library()),
        cli::Verb::Get(arguments) => operate::get(arguments, &cli.library()),
        cli::Verb::List(arguments) => watch::list(arguments, &cli.library()),
        cli::Verb::Echo(arguments) => watch::echo(arguments, &cli.library()),
        cli::Verb::Hz(arguments) => watch::hz(arguments, &cli.library()),
        cli::Verb::Top(arguments) => top::top(arguments, &cli.library()),
        cli::Verb::Doctor(arguments) => doctor::doctor(arguments, &cli.library()),
    };
    match done {
        Ok(status) => status,
        Err(failure) => failure.report(),
    }
}
