//! `supertwin get`: parameters, last accepted commands, and who has the authority.

use crate::arguments::ToolArguments;
use crate::terminal::{self, table};
use clap::Args;
use serde_json::Value;
use std::process::ExitCode;
use supertwin_lab::Library;
use supertwin_operations::{OperationError, orders, shortened};

/// Characters of a value in the table: descriptions may be long.
const LONGEST: usize = 60;

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
    name: Option<String>,

    #[command(flatten)]
    tool: ToolArguments,
}

/// Asks, and prints the answer.
pub(crate) fn get(arguments: &GetArguments, library: &Library) -> Result<ExitCode, OperationError> {
    let network = arguments.tool.link.join(library)?;
    let vehicle = network.vehicle(arguments.tool.link.vehicle.as_deref())?;
    let found = orders::get(&network, &vehicle, arguments.name.as_deref())?;
    network.close();
    terminal::print_result(arguments.tool.json, &found, || found_text(arguments.name.as_deref(), &found));
    Ok(ExitCode::SUCCESS)
}

fn found_text(name: Option<&str>, found: &Value) -> String {
    if name == Some("lease") {
        return lease_text(found);
    }
    if let Some(name) = name {
        if let Some(tick) = found["applied_tick"].as_u64() {
            return format!("{name} = {} since tick {tick}, by {}", found["value"], by(found));
        }
        let mut rows = Vec::new();
        flatten(name, found, &mut rows);
        return rows.iter().map(|(path, value)| format!("{path} = {value}")).collect::<Vec<_>>().join("\n");
    }
    let mut text = format!("{}\nauthority: {}", found["vehicle"].as_str().unwrap_or(""), lease_text(&found["lease"]));
    let mut rows = Vec::new();
    for (service, states) in found["states"].as_object().into_iter().flatten() {
        for (name, state) in states.as_object().into_iter().flatten() {
            rows.push(vec![
                service.clone(),
                name.clone(),
                state["value"].to_string(),
                state["applied_tick"].to_string(),
                by(state),
            ]);
        }
    }
    if !rows.is_empty() {
        text += "\n\n";
        text += &table(&["service", "command", "last value", "tick", "by"], rows, 5);
    }
    let mut rows = Vec::new();
    for (service, tree) in found["parameters"].as_object().into_iter().flatten() {
        flatten(service, tree, &mut rows);
    }
    if !rows.is_empty() {
        text += "\n\n";
        let rows = rows.into_iter().map(|(path, value)| vec![path, shortened(&value, LONGEST)]).collect();
        text += &table(&["parameter", "value"], rows, 2);
    }
    text
}

fn by(state: &Value) -> String {
    state["by"].as_str().unwrap_or("the mission").to_owned()
}

fn lease_text(lease: &Value) -> String {
    match (lease["holder"].as_str(), lease["expires_in_s"].as_f64()) {
        (Some(holder), Some(left_s)) => format!("{holder}, for another {left_s:.1} s"),
        _ if lease.is_null() => "unknown: its keeper, the controller, does not answer".to_owned(),
        _ => "nobody".to_owned(),
    }
}

/// Leaves of a tree with their paths.
fn flatten(path: &str, value: &Value, rows: &mut Vec<(String, String)>) {
    match value {
        Value::Object(map) if !map.is_empty() => {
            for (name, value) in map {
                flatten(&format!("{path}.{name}"), value, rows);
            }
        }
        leaf => rows.push((path.to_owned(), leaf.to_string())),
    }
}
