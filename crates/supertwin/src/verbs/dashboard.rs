//! `supertwin dashboard`: the viewer's dashboards, as a list or as files.

use crate::arguments::positive;
use crate::terminal;
use clap::Args;
use clap::builder::PossibleValuesParser;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use supertwin_core::Capability;
use supertwin_lab::LAWS;
use supertwin_operations::OperationError;
use supertwin_operations::save;
use supertwin_rerun::blueprint::{self, About, DASHBOARDS, Dashboard, Description};

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin dashboard --list
  supertwin dashboard --save dashboards          one .rbl file each
  supertwin dashboard tracking --save . --law pid --span 150 --force
  rerun dashboards/tracking.rbl                  give one to the viewer that is open

Every recording carries all dashboards that suit it, as tabs, and shows the whole run. The files suit any recording;
without --span their time axes are linked and show half a minute on both sides of the cursor.
Exit status: 0 done, 2 the call is wrong or a file can't be written.")]
#[command(group(clap::ArgGroup::new("what").required(true).args(["list", "save"])))]
pub(crate) struct DashboardArguments {
    /// Which [default: all]
    #[arg(value_name = "NAME")]
    names: Vec<String>,

    /// Say which there are and what they show
    #[arg(long)]
    list: bool,

    /// Write them to this folder
    #[arg(long, value_name = "DIR")]
    save: Option<PathBuf>,

    /// For runs of this length: all plots show all of it
    #[arg(long, value_name = "S", value_parser = positive)]
    span: Option<f64>,

    /// For runs with this law; may be repeated [default: all]
    #[arg(long, value_name = "LAW", value_parser = PossibleValuesParser::new(own_laws().map(|(name, _)| name)))]
    law: Vec<String>,

    /// Replace files that exist
    #[arg(long)]
    force: bool,

    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// One dashboard in the JSON array of `--json`.
#[derive(Debug, Serialize)]
struct Listed {
    name: &'static str,
    about: &'static str,
    /// Titles of its views.
    views: Vec<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    file: Option<PathBuf>,
}

/// Laws of the vehicle's own, with what they show.
fn own_laws() -> impl Iterator<Item = (&'static str, &'static [Capability])> {
    LAWS.iter().copied().filter(|(_, capabilities)| !capabilities.contains(&Capability::External))
}

/// Lists dashboards, or writes their files.
pub(crate) fn dashboard(arguments: &DashboardArguments) -> Result<ExitCode, OperationError> {
    let wanted = own_laws().filter(|(name, _)| arguments.law.iter().any(|law| law == name));
    let capabilities: Vec<_> = wanted.flat_map(|(_, capabilities)| capabilities).copied().collect();
    let plain_law = !arguments.law.is_empty() && capabilities.is_empty();
    let about = About { span_s: arguments.span, capabilities, plain_law, network: true, ..About::default() };
    let mut listed = Vec::new();
    for described in chosen(&arguments.names)? {
        let dashboard = described.dashboard(&about);
        let views = dashboard.iter().flat_map(Dashboard::views).map(|view| view.name.clone()).collect();
        let file = match (&arguments.save, dashboard) {
            (None, _) => None,
            (Some(folder), Some(dashboard)) => Some(save_to(folder, dashboard, described.name, arguments.force)?),
            (Some(_), None) if arguments.names.is_empty() => continue,
            (Some(_), None) => {
                let cause =
                    "depends on the runs that it compares; `supertwin compare RUN RUN… --out FILE.rrd` writes it";
                return Err(OperationError::Option(format!("{}: {cause}", described.name)));
            }
        };
        listed.push(Listed { name: described.name, about: described.about, views, file });
    }
    if arguments.json {
        terminal::print_json(&listed)?;
    } else {
        let width = 2 + DASHBOARDS.iter().map(|described| described.name.len()).max().unwrap_or_default();
        for one in &listed {
            terminal::print(&match &one.file {
                Some(file) => file.display().to_string(),
                None => format!("{:width$}{}", one.name, one.about),
            });
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// The dashboards with these names; without names, all.
fn chosen(names: &[String]) -> Result<Vec<&'static Description>, OperationError> {
    if names.is_empty() {
        return Ok(DASHBOARDS.iter().collect());
    }
    let named = |name: &String| {
        let all = DASHBOARDS.iter().map(|described| described.name).collect::<Vec<_>>().join(", ");
        let found = DASHBOARDS.iter().find(|described| described.name == name);
        found.ok_or_else(|| OperationError::Option(format!("{name}: is no dashboard; there are {all}")))
    };
    names.iter().map(named).collect()
}

fn save_to(folder: &Path, dashboard: Dashboard, name: &str, force: bool) -> Result<PathBuf, OperationError> {
    let path = folder.join(format!("{name}.rbl"));
    let failed = |cause: String| OperationError::at(&path, &cause);
    save(&path, &blueprint::file(dashboard).map_err(failed)?, force)?;
    Ok(path)
}
