//! `supertwin zenoh-config`: the settings of a locked router and of its clients, and the matrix behind them.

use crate::failure::Failure;
use crate::output;
use crate::save::save;
use crate::tool::table;
use clap::Args;
use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use supertwin_pki::{self as pki, Credentials};
use supertwin_protocol::access::{self, COLUMNS, Row, Verb};
use supertwin_protocol::keys;
use supertwin_protocol::role::{Role, Scope, common_name};
use supertwin_zenoh::access_control;
use supertwin_zenoh::session::tls_settings;

/// Where a vehicle's own services come in, unless told otherwise.
const SOCKET: &str = "unixsock-stream//tmp/supertwin/router.sock";
/// Where everybody else comes in, unless told otherwise.
const TLS: &str = "tls/0.0.0.0:7447";

/// Where credentials are looked for, unless told otherwise: `ca.pem`, `ROLE.pem`, `ROLE.key`.
const INSTALLED: &str = "/etc/supertwin";

/// Arguments of `zenoh-config`.
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
pub(crate) fn zenoh_config(arguments: &ZenohConfigArguments) -> Result<ExitCode, Failure> {
    let Some(role) = arguments.role else {
        output::print(&matrix(arguments));
        return Ok(ExitCode::SUCCESS);
    };
    let name = arguments.vehicle.as_deref().unwrap_or_default();
    Scope::of(Some(name)).map_err(|cause| Failure::Call(format!("--vehicle {cause}")))?;
    check(role, arguments)?;
    let tls = tls(role, name, arguments.credentials.as_deref())?;
    let or = |given: &[String], default: &[&str]| -> Vec<String> {
        if given.is_empty() { default.iter().map(|text| (*text).to_owned()).collect() } else { given.to_vec() }
    };
    let text = if role == Role::Vehicle {
        access_control::router_file(name, &or(&arguments.listen, &[SOCKET, TLS]), &tls)
    } else {
        access_control::client_file(role, name, &or(&arguments.connect, &["tls/localhost:7447"]), &tls)
    };
    let Some(out) = &arguments.out else {
        output::print(
            if arguments.json { json!({ "text": text }).to_string() } else { text.trim_end().to_owned() }.as_str(),
        );
        return Ok(ExitCode::SUCCESS);
    };
    save(out, text.as_bytes(), arguments.force)?;
    let written = json!({ "file": out, "role": role, "vehicle": name });
    output::print(&if arguments.json { written.to_string() } else { format!("{}: {role} of {name}", out.display()) });
    Ok(ExitCode::SUCCESS)
}

/// What does not fit together.
fn check(role: Role, arguments: &ZenohConfigArguments) -> Result<(), Failure> {
    let wrong = |text: String| Err(Failure::Call(text));
    if role == Role::Vehicle && !arguments.connect.is_empty() {
        return wrong("--connect: the vehicle's router listens; its services use --connect with its socket".to_owned());
    }
    if role != Role::Vehicle && !arguments.listen.is_empty() {
        return wrong(format!("--listen: nobody connects to {role}; give its router with --connect"));
    }
    if let Some(endpoint) = arguments.connect.iter().find(|endpoint| !endpoint.starts_with("tls/")) {
        return wrong(format!(
            "--connect {endpoint}: must be tls/HOST:PORT, or there is nothing that could tell who comes"
        ));
    }
    Ok(())
}

/// Zenoh's settings for TLS. Absolute paths: whoever reads the file may stand elsewhere.
fn tls(role: Role, vehicle: &str, place: Option<&Path>) -> Result<Value, Failure> {
    let Some(place) = place else {
        return Ok(tls_settings(&Credentials::named(Path::new(INSTALLED), role.name()), role.listens()));
    };
    let found = Credentials::find(place)?;
    let certificate = pki::read(&found.certificate)?;
    let theirs = matches!(&certificate.scope, Some(Scope::Fleet))
        || matches!(&certificate.scope, Some(Scope::Vehicle(name)) if name == vehicle);
    if certificate.role != Some(role) || !theirs {
        let wanted =
            [Scope::Vehicle(vehicle.to_owned()), Scope::Fleet].map(|scope| common_name(role, &scope)).join(" or ");
        let path = found.certificate.display().to_string();
        return Err(Failure::Path { path, cause: format!("is {}: must be {wanted}", certificate.common_name) });
    }
    let absolute = |path: &Path| {
        let failed =
            |cause: std::io::Error| Failure::Path { path: path.display().to_string(), cause: cause.to_string() };
        std::path::absolute(path).map_err(failed)
    };
    let (ca, certificate, key) = (absolute(&found.ca)?, absolute(&found.certificate)?, absolute(&found.key)?);
    Ok(tls_settings(&Credentials { ca, certificate, key }, role.listens()))
}

fn matrix(arguments: &ZenohConfigArguments) -> String {
    let rows = access::matrix();
    if arguments.json {
        return as_json(&rows).to_string();
    }
    let header: Vec<&str> = ["key"].into_iter().chain(COLUMNS.map(Role::name)).chain(["why"]).collect();
    let cells = |keys: &[String], row: &Row, mark: &str| -> Vec<String> {
        let keys = keys.iter().map(|key| format!("{mark}{key}{mark}")).collect::<Vec<_>>().join(", ");
        let verbs = COLUMNS.map(|role| format!("{mark}{}{mark}", access::letters(row, role)));
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

fn as_json(rows: &[Row]) -> Value {
    let row = |row: &Row| {
        let allowed: Map<String, Value> = COLUMNS
            .iter()
            .map(|role| {
                (role.name().to_owned(), json!(row.verbs(*role).iter().map(|verb| verb.name()).collect::<Vec<_>>()))
            })
            .collect();
        json!({ "keys": row.keys, "allowed": allowed, "why": row.why })
    };
    json!({
        "below": keys::namespace("<vehicle>"),
        "verbs": Verb::ALL.map(Verb::name),
        "rows": rows.iter().map(row).collect::<Vec<_>>(),
    })
}
