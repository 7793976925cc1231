//! `supertwin zenoh-config`: the settings of a locked router and of its clients, and the matrix behind them.

use crate::terminal;
use crate::terminal::table;
use clap::Args;
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;
use supertwin_operations::OperationError;
use supertwin_operations::save;
use supertwin_operations::zenoh_settings;
use supertwin_protocol::access::{self, AccessRow};
use supertwin_protocol::role::Role;

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin zenoh-config vehicle --vehicle argus-mini --credentials pki/argus-mini --out router.json5
  supertwin serve router --zenoh router.json5
  supertwin zenoh-config operator --vehicle argus-mini --credentials pki/anna --connect tls/192.168.2.2:7447 --out anna.json5
  supertwin set depth_m 5 --zenoh anna.json5     and in Python: zenoh.Config.from_file(\"anna.json5\")
  supertwin zenoh-config --matrix                who may do what with which key, and why
  supertwin zenoh-config --matrix --markdown     for documentation

Roles:
  vehicle    its router: services by unix socket, the others by TLS, each by the common name of its certificate
  guidance   the guidance service topside
  operator   commands
  observer   only looks
  recorder   keeps everything

Nothing is ever replaced without --force.
Exit status: 0 done, 2 the call is wrong or a file can't be written.")]
#[command(group = clap::ArgGroup::new("what").required(true).args(["role", "matrix"]))]
pub(crate) struct ZenohConfigArguments {
    /// For whom: vehicle, guidance, operator, observer or recorder
    #[arg(value_name = "ROLE", requires = "vehicle")]
    pub(crate) role: Option<Role>,

    /// Name of the vehicle on the network
    #[arg(long, value_name = "NAME", env = "SUPERTWIN_VEHICLE")]
    pub(crate) vehicle: Option<String>,

    /// vehicle: where its router listens; may be repeated [default: its unix socket and tls/0.0.0.0:7447]
    #[arg(long, value_name = "ENDPOINT")]
    pub(crate) listen: Vec<String>,

    /// Others: the vehicle's router, as its certificate names it; may be repeated [default: tls/localhost:7447]
    #[arg(long, value_name = "ENDPOINT", env = "SUPERTWIN_CONNECT", value_delimiter = ' ')]
    pub(crate) connect: Vec<String>,

    /// Folder with the holder's certificate and key, as `supertwin pki issue` makes it [default: /etc/supertwin with ROLE.pem]
    #[arg(long, value_name = "DIR", env = "SUPERTWIN_CREDENTIALS")]
    pub(crate) credentials: Option<PathBuf>,

    /// The written file [default: standard output]
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,

    /// Replace a file that exists
    #[arg(long)]
    pub(crate) force: bool,

    /// Print who may do what with which key, and why
    #[arg(long, conflicts_with_all = ["listen", "connect", "credentials", "out", "force"])]
    pub(crate) matrix: bool,

    /// The matrix as a table in Markdown
    #[arg(long, requires = "matrix", conflicts_with = "json")]
    pub(crate) markdown: bool,

    /// Print one JSON object
    #[arg(long)]
    pub(crate) json: bool,
}

/// Writes a file, or prints the matrix.
pub(crate) fn zenoh_config(arguments: &ZenohConfigArguments) -> Result<ExitCode, OperationError> {
    let Some(role) = arguments.role else {
        terminal::print(&matrix(arguments));
        return Ok(ExitCode::SUCCESS);
    };
    let vehicle = arguments.vehicle.clone().unwrap_or_default();
    let credentials = arguments.credentials.as_deref();
    let text = zenoh_settings::settings(role, &vehicle, &arguments.listen, &arguments.connect, credentials)?;
    let Some(out) = &arguments.out else {
        terminal::print_result(arguments.json, &json!({ "text": text }), || text.trim_end().to_owned());
        return Ok(ExitCode::SUCCESS);
    };
    save(out, text.as_bytes(), arguments.force)?;
    let written = json!({ "file": out, "role": role, "vehicle": vehicle });
    terminal::print_result(arguments.json, &written, || format!("{}: {role} of {vehicle}", out.display()));
    Ok(ExitCode::SUCCESS)
}

fn matrix(arguments: &ZenohConfigArguments) -> String {
    let rows = access::matrix();
    if arguments.json {
        return zenoh_settings::matrix_json(&rows).to_string();
    }
    let header: Vec<&str> = ["key"].into_iter().chain(Role::ALL.map(Role::name)).chain(["why"]).collect();
    let cells = |keys: &[String], row: &AccessRow, mark: &str| -> Vec<String> {
        let keys = keys.iter().map(|key| format!("{mark}{key}{mark}")).collect::<Vec<_>>().join(", ");
        let verbs = Role::ALL.map(|role| format!("{mark}{}{mark}", row.letters(role)));
        [keys].into_iter().chain(verbs).chain([row.why.to_owned()]).collect()
    };
    if arguments.markdown {
        let line = |cells: Vec<String>| format!("| {} |", cells.join(" | "));
        let mut lines =
            vec![line(header.iter().map(|&name| name.to_owned()).collect()), "|---".repeat(header.len()) + "|"];
        lines.extend(rows.iter().map(|row| line(cells(&row.keys, row, "`"))));
        return lines.join("\n");
    }
    // A line for each key: the longest of them would make the others' columns run away.
    let lines = rows.iter().flat_map(|row| {
        row.keys.iter().enumerate().map(move |(i, key)| {
            let mut line = cells(core::slice::from_ref(key), row, "");
            if i > 0 {
                line.pop();
            }
            line
        })
    });
    format!(
        "{}\n\nP put, S subscribe, G get, Q queryable, L liveliness token, D delete; of alive/… S and G are those of \
         liveliness.\nKeys are below supertwin/<vehicle>/. vehicle: whoever comes by the unix socket, or with the \
         vehicle's own certificate.",
        table(&header, lines.collect(), header.len())
    )
}
