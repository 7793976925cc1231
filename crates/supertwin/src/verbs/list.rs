//! `supertwin list`: vehicles and services that are up, and the keys that flow.

use crate::arguments::{ToolArguments, positive};
use crate::terminal::{self, Bar, INTERRUPTED, table};
use clap::Args;
use serde_json::json;
use std::process::ExitCode;
use supertwin_lab::Library;
use supertwin_operations::OperationError;
use supertwin_operations::flows::{self, ListedKey, ListedVehicle};

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin list
  supertwin list --for 5 --json                  also what is seldom published
  supertwin list --connect tcp/192.168.2.2:7447

Exit status: 0 done (also when nobody is up), 2 the call is wrong or there is no router, 130 interrupted.")]
pub(crate) struct ListArguments {
    /// Seconds to listen for keys
    #[arg(long = "for", value_name = "S", default_value = "1.2", value_parser = positive)]
    for_s: f64,

    #[command(flatten)]
    tool: ToolArguments,
}

/// Listens and lists.
pub(crate) fn list(arguments: &ListArguments, library: &Library) -> Result<ExitCode, OperationError> {
    let mut network = arguments.tool.link.join(library)?;
    let only = arguments.tool.link.vehicle.as_deref();
    let listed = flows::list(&mut network, only, arguments.for_s, &Bar::new(arguments.tool.json))?;
    let result = json!({ "vehicles": listed, "for_s": arguments.for_s });
    terminal::print_result(arguments.tool.json, &result, || match listed.as_slice() {
        [] => "nobody is up: start a vehicle with `supertwin up`".to_owned(),
        up => up.iter().map(|vehicle| vehicle_text(vehicle, arguments.for_s)).collect::<Vec<_>>().join("\n"),
    });
    let interrupted = network.stop.interrupted();
    network.close();
    Ok(if interrupted { ExitCode::from(INTERRUPTED) } else { ExitCode::SUCCESS })
}

fn vehicle_text(vehicle: &ListedVehicle, for_s: f64) -> String {
    let services = vehicle.services.iter().map(|one| vec![one.service.clone(), one.instance.clone()]).collect();
    let key = |flow: &ListedKey| {
        let writers: Vec<&str> = flow.writers.iter().map(String::as_str).collect();
        vec![flow.key.clone(), writers.join(", "), flow.messages.to_string(), flow.bytes.to_string()]
    };
    let operators = &vehicle.operators;
    let by = if operators.is_empty() { String::new() } else { format!("\noperators: {}", operators.join(", ")) };
    format!(
        "{}{by}\n\n{}\n\n{}\n",
        vehicle.vehicle,
        table(&["service", "instance"], services, 2),
        table(&["key", "writer", &format!("in {for_s} s"), "bytes"], vehicle.keys.iter().map(key).collect(), 2)
    )
}
