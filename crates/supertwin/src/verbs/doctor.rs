//! `supertwin doctor`: what is wrong with this set-up, and what to do.

use crate::arguments::{LinkArguments, ToolArguments};
use crate::terminal::{self, Bar, INTERRUPTED, table};
use clap::Args;
use std::path::Path;
use std::process::ExitCode;
use supertwin_lab::Library;
use supertwin_operations::OperationError;
use supertwin_operations::doctor::prove::{Proof, ProofOptions, best, holders};
use supertwin_operations::doctor::{Diagnosis, Doctor, Finding, Grade};
use supertwin_protocol::access::{self, Verb};
use supertwin_zenoh::Link;
use supertwin_zenoh::access_control::Attempt;

#[derive(Debug, Args)]
#[command(mut_arg("json", |json| json.help("Print a JSON list")))]
#[command(after_help = "Examples:
  supertwin doctor
  supertwin doctor --zenoh config/zenoh/vehicle-router.json5     examines a router's file, then asks at its listeners
  supertwin doctor --connect tcp/192.168.2.2:7447 --json
  supertwin doctor --connect tls/192.168.2.2:7447 --credentials pki
                                                 for each holder in pki: tries what it may and may not

The proof of rights moves nothing: services refuse what it sends, and count it. It sees most on the vehicle's computer,
or with the vehicle's own credentials beside the others.
Exit status: 0 nothing is wrong (there may be warnings), 1 something is wrong, 2 the call is wrong.")]
pub(crate) struct DoctorArguments {
    #[command(flatten)]
    tool: ToolArguments,
}

/// Looks for what is wrong, and prints it as it is found.
pub(crate) fn doctor(arguments: &DoctorArguments, library: &Library) -> Result<ExitCode, OperationError> {
    let json = arguments.tool.json;
    let mut show = |diagnosis: Diagnosis<'_>| match diagnosis {
        Diagnosis::Warning(text) => terminal::warn(&format!("warning: {text}")),
        _ if json => {}
        Diagnosis::Finding(finding) => terminal::print(&text(finding)),
        Diagnosis::Proofs(proofs) => terminal::print(&format!("\n{}\n", matrix(proofs))),
    };
    let mut link = arguments.tool.link.link(library, "local", None, None);
    let holders = link.credentials.as_deref().map_or(Ok(Vec::new()), holders)?;
    // Of several, the one that sees most.
    link.credentials = best(&holders).map(Path::to_owned);
    let local = Link { patience_ms: 0, ..LinkArguments::default().link(library, "local", None, None) };
    let mut doctor = Doctor::new(&mut show);
    if let Some(link) = doctor.examine_settings(link)
        && let Some(mut network) = doctor.join(&link)?
    {
        terminal::interrupt_on_ctrl_c(network.inbox.interrupter())?;
        let vehicle = arguments.tool.link.vehicle.as_deref();
        let proof = ProofOptions { holders, link, local };
        let examined = doctor.examine_vehicle(&mut network, vehicle, &proof, &Bar::new(json));
        let interrupted = network.stop.interrupted();
        network.close();
        examined?;
        if interrupted {
            return Ok(ExitCode::from(INTERRUPTED));
        }
    }
    let found = doctor.found;
    if json {
        terminal::print(&serde_json::to_string(&found).unwrap_or_default());
    }
    let wrong = found.iter().any(|finding| finding.grade == Grade::Wrong);
    Ok(if wrong { ExitCode::from(1) } else { ExitCode::SUCCESS })
}

fn text(finding: &Finding) -> String {
    let grade = match finding.grade {
        Grade::Ok => "ok     ",
        Grade::Warning => "warning",
        Grade::Wrong => "wrong  ",
    };
    let remedy = finding.remedy.as_ref().map(|remedy| format!("\n         → {remedy}")).unwrap_or_default();
    format!("{grade}  {}: {}{remedy}", finding.check, finding.what)
}

/// What was found beside what is documented, a column for each holder.
fn matrix(proofs: &[Proof]) -> String {
    let header: Vec<&str> = ["key"].into_iter().chain(proofs.iter().map(|proof| proof.who.as_str())).collect();
    let rows = access::matrix();
    let cells = rows.iter().map(|row| {
        let cell = |proof: &Proof| -> String {
            let letters = row.letters(proof.role);
            let of_row = proof.attempts.iter().filter(|attempt| attempt.keys == row.keys);
            letters.chars().zip(of_row).map(|(letter, attempt)| mark(letter, attempt)).collect()
        };
        let more = if row.keys.len() > 1 { ", …" } else { "" };
        [format!("{}{more}", row.keys[0])].into_iter().chain(proofs.iter().map(cell)).collect()
    });
    format!(
        "{}\n\n{}; · may not; ? not tried; ! is not as documented",
        table(&header, cells.collect(), header.len()),
        Verb::ALL
            .map(|verb| format!("{} {verb}", verb.name().chars().take(1).collect::<String>().to_uppercase()))
            .join(", ")
    )
}

fn mark(letter: char, attempt: &Attempt) -> String {
    match attempt.observed {
        None if attempt.allowed => format!("{}?", letter.to_lowercase()),
        None => "?".to_owned(),
        Some(_) if attempt.differs() => format!("{letter}!"),
        Some(_) => letter.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attempt(allowed: bool, observed: Option<bool>) -> Attempt {
        Attempt { keys: vec!["clock/ping".to_owned()], verb: Verb::Get, allowed, observed }
    }

    #[test]
    fn marks_tell_what_was_tried_and_what_differs() {
        let attempts = [(true, None), (false, None), (true, Some(true)), (true, Some(false)), (false, Some(true))];
        let marks = attempts.map(|(allowed, observed)| mark('G', &attempt(allowed, observed)));
        assert_eq!(marks, ["g?", "?", "G", "G!", "G!"]);
    }
}
