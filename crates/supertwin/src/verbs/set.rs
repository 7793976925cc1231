//! `supertwin set`: commands and parameters, with acknowledgement.

use crate::arguments::{ToolArguments, positive};
use crate::terminal::{self, Bar, INTERRUPTED};
use clap::Args;
use serde_json::json;
use std::process::ExitCode;
use supertwin_lab::Library;
use supertwin_operations::OperationError;
use supertwin_operations::orders::{self, Order};

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
    pairs: Vec<String>,

    /// Seconds to wait until it has applied
    #[arg(long, value_name = "S", default_value = "5", value_parser = positive, conflicts_with = "no_wait")]
    wait: f64,

    /// Leave as soon as the services have said when it will apply
    #[arg(long)]
    no_wait: bool,

    #[command(flatten)]
    tool: ToolArguments,
}

/// Sends what the arguments say, and prints what became of it.
pub(crate) fn set(arguments: &SetArguments, library: &Library) -> Result<ExitCode, OperationError> {
    let [pairs @ .., _] = arguments.pairs.as_slice() else { return Ok(ExitCode::SUCCESS) };
    if pairs.len().is_multiple_of(2) {
        let last = &arguments.pairs[pairs.len()];
        return Err(OperationError::Option(format!("NAME {last}: has no value; names and values come in turn")));
    }
    let orders: Vec<Order> =
        arguments.pairs.chunks_exact(2).map(|pair| Order::read(&pair[0], &pair[1])).collect::<Result<_, _>>()?;
    let mut network = arguments.tool.link.join(library)?;
    let vehicle = network.vehicle(arguments.tool.link.vehicle.as_deref())?;
    let wait_s = (!arguments.no_wait).then_some(arguments.wait);
    let done = orders::set(&mut network, &vehicle, &orders, wait_s, &Bar::new(arguments.tool.json))?;
    let interrupted = network.stop.interrupted();
    network.close();
    for warning in &done.warnings {
        terminal::warn(&format!("warning: {warning}"));
    }
    if arguments.tool.json {
        terminal::print(&json!({ "vehicle": vehicle, "client": done.client, "commands": done.outcomes }).to_string());
    }
    let mut code = ExitCode::SUCCESS;
    for outcome in &done.outcomes {
        let Order { name, value, .. } = &outcome.order;
        let what = if value.is_null() { format!("{name} restart") } else { format!("{name} {value}") };
        let tick = outcome.apply_tick.unwrap_or(0);
        let result = match outcome.status {
            "applied" => Ok(format!("{what}: applied at tick {}", outcome.applied_tick.unwrap_or(tick))),
            "scheduled" if arguments.no_wait => Ok(format!("{what}: applies at tick {tick}")),
            "scheduled" if interrupted => Err((INTERRUPTED, format!("interrupted: {what} applies at tick {tick}"))),
            "scheduled" => {
                let text = format!("scheduled for tick {tick}, not seen to apply within {} s", arguments.wait);
                Err((1, format!("error: {what}: {text}")))
            }
            status => {
                let reason = outcome.reason.as_deref().unwrap_or("");
                let status = if status == "refused" { "refused: " } else { "" };
                Err((1, format!("error: {what}: {status}{reason}")))
            }
        };
        match result {
            Ok(text) if !arguments.tool.json => terminal::print(&text),
            Ok(_) => {}
            Err((status, text)) => {
                terminal::warn(&text);
                code = ExitCode::from(status);
            }
        }
    }
    Ok(code)
}
