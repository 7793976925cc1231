//! `supertwin echo`: what is published on a key.

use crate::arguments::{ToolArguments, positive};
use crate::terminal;
use clap::Args;
use serde_json::{Value, json};
use std::process::ExitCode;
use supertwin_lab::Library;
use supertwin_operations::{OperationError, flows};
use supertwin_protocol::Received;

#[derive(Debug, Args)]
#[command(mut_arg("json", |json| json.help("Print one JSON object per line")))]
#[command(after_help = "Examples:
  supertwin echo 'event/**'                      what happened so far, and what happens
  supertwin echo estimator/nav --count 1 --json
  supertwin echo 'state/**' --for 10
  supertwin echo 'supertwin/*/health/*'          of all vehicles

Exit status: 0 done or stopped, 1 nothing was heard, 2 the call is wrong or there is no router.")]
pub(crate) struct EchoArguments {
    /// Key below the vehicle's, or a full one from supertwin/ on; * is one part, ** any number
    #[arg(value_name = "KEY")]
    key: String,

    /// End after this many samples
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    count: Option<u64>,

    /// End after this many seconds
    #[arg(long = "for", value_name = "S", value_parser = positive)]
    for_s: Option<f64>,

    #[command(flatten)]
    tool: ToolArguments,
}

/// Prints what is published on a key.
pub(crate) fn echo(arguments: &EchoArguments, library: &Library) -> Result<ExitCode, OperationError> {
    let mut network = arguments.tool.link.join(library)?;
    let key = network.key(arguments.tool.link.vehicle.as_deref(), &arguments.key)?;
    let end = arguments.for_s.map(|for_s| network.after(for_s));
    let mut past = flows::listen_with_history(&mut network, &key, end)?;
    let mut shown = 0;
    while arguments.count.is_none_or(|count| shown < count) {
        let Some(sample) = past.pop_front().or_else(|| network.inbox.next(end)) else { break };
        terminal::print(&if arguments.tool.json { sample_json(&sample).to_string() } else { sample_text(&sample) });
        shown += 1;
    }
    let (lost, interrupted) = (network.inbox.lost(), network.stop.interrupted());
    if lost > 0 {
        terminal::warn(&format!("warning: {lost} samples are not shown: they came faster than they could be printed"));
    }
    network.close();
    if shown == 0 && !interrupted {
        return Err(flows::nothing_received(&key, arguments.for_s.unwrap_or(0.0)));
    }
    Ok(ExitCode::SUCCESS)
}

fn sample_json(sample: &Received) -> Value {
    if sample.gone {
        return json!({ "key": sample.key, "deleted": true });
    }
    match serde_json::from_slice::<Value>(&sample.payload) {
        Ok(value) => json!({ "key": sample.key, "value": value }),
        Err(_) => json!({ "key": sample.key, "text": String::from_utf8_lossy(&sample.payload) }),
    }
}

fn sample_text(sample: &Received) -> String {
    let key = sample.key.splitn(3, '/').nth(2).unwrap_or(&sample.key);
    if sample.gone {
        return format!("{key}  deleted");
    }
    let Ok(value) = serde_json::from_slice::<Value>(&sample.payload) else {
        let text: String = String::from_utf8_lossy(&sample.payload).chars().filter(|c| !c.is_control()).collect();
        return format!("{key}  {text}");
    };
    let (tick, data) = (value["tick"].as_u64(), &value["data"]);
    match (tick, data["severity"].as_str(), data["text"].as_str()) {
        (Some(_), Some(severity), Some(text)) => {
            let t_s = value["sim_time_s"].as_f64().unwrap_or(0.0);
            format!("{t_s:9.2} s  {severity:<7}  {}: {text}", data["service"].as_str().unwrap_or(key))
        }
        (Some(tick), ..) if !data.is_null() => {
            format!("{key}  tick {tick}  seq {}  {data}", value["seq"])
        }
        _ => format!("{key}  {value}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(payload: &str) -> Received {
        let key = "supertwin/a/estimator/nav".to_owned();
        Received { key, payload: payload.into(), ..Received::default() }
    }

    #[test]
    fn samples_are_one_line_whatever_they_are() {
        let event = r#"{"tick":50,"seq":2,"source":"plant-1","sim_time_s":1.0,
            "data":{"tick":50,"service":"plant","severity":"warning","text":"late"}}"#;
        assert_eq!(sample_text(&sample(event)), "     1.00 s  warning  plant: late");
        let nav = r#"{"tick":50,"seq":2,"source":"e","data":{"depth_m":1.5}}"#;
        assert_eq!(sample_text(&sample(nav)), r#"estimator/nav  tick 50  seq 2  {"depth_m":1.5}"#);
        assert_eq!(sample_text(&sample("a\nb")), "estimator/nav  ab");
        assert_eq!(sample_json(&sample("\u{1}x"))["text"], "\u{1}x");
    }
}
