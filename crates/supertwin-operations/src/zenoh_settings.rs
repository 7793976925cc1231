//! The settings of a locked router and of its clients, and the matrix of who may do what.

use crate::OperationError;
use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};
use supertwin_pki::{self as pki, Credentials};
use supertwin_protocol::access::{AccessRow, Verb};
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

/// What settings of a Zenoh session or router are made from.
#[derive(Clone, Debug)]
pub struct SettingsOptions {
    /// What they may.
    pub role: Role,
    /// Name of the vehicle on the network.
    pub vehicle: String,
    /// Where the vehicle's router listens; none: its unix socket and port 7447 with TLS.
    pub listen: Vec<String>,
    /// The vehicle's router, of others; none: `tls/localhost:7447`.
    pub connect: Vec<String>,
    /// Folder with the holder's certificate and key; `None`: where they are installed.
    pub credentials: Option<PathBuf>,
}

/// The text of a Zenoh configuration file.
///
/// # Errors
/// The options do not fit together, or the credentials are not of this role and vehicle.
pub fn settings(options: &SettingsOptions) -> Result<String, OperationError> {
    let (role, name) = (options.role, options.vehicle.as_str());
    Scope::of(Some(name)).map_err(|cause| OperationError::Option(format!("--vehicle {cause}")))?;
    check(options)?;
    let tls = tls(role, name, options.credentials.as_deref())?;
    let or = |given: &[String], default: &[&str]| -> Vec<String> {
        if given.is_empty() { default.iter().map(|text| (*text).to_owned()).collect() } else { given.to_vec() }
    };
    Ok(if role == Role::Vehicle {
        access_control::router_file(name, &or(&options.listen, &[SOCKET, TLS]), &tls)
    } else {
        access_control::client_file(role, name, &or(&options.connect, &["tls/localhost:7447"]), &tls)
    })
}

/// What does not fit together.
fn check(options: &SettingsOptions) -> Result<(), OperationError> {
    let role = options.role;
    let wrong = |text: String| Err(OperationError::Option(text));
    if role == Role::Vehicle && !options.connect.is_empty() {
        return wrong("--connect: the vehicle's router listens; its services use --connect with its socket".to_owned());
    }
    if role != Role::Vehicle && !options.listen.is_empty() {
        return wrong(format!("--listen: nobody connects to {role}; give its router with --connect"));
    }
    if let Some(endpoint) = options.connect.iter().find(|endpoint| !endpoint.starts_with("tls/")) {
        return wrong(format!(
            "--connect {endpoint}: must be tls/HOST:PORT, or there is nothing that could tell who comes"
        ));
    }
    Ok(())
}

/// Zenoh's settings for TLS. Absolute paths: whoever reads the file may stand elsewhere.
fn tls(role: Role, vehicle: &str, place: Option<&Path>) -> Result<Value, OperationError> {
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
        let cause = format!("is {}: must be {wanted}", certificate.common_name);
        return Err(OperationError::at(&found.certificate, &cause));
    }
    let absolute = |path: &Path| std::path::absolute(path).map_err(|cause| OperationError::at(path, &cause));
    let (ca, certificate, key) = (absolute(&found.ca)?, absolute(&found.certificate)?, absolute(&found.key)?);
    Ok(tls_settings(&Credentials { ca, certificate, key }, role.listens()))
}

/// The matrix, for programs.
#[must_use]
pub fn matrix_json(rows: &[AccessRow]) -> Value {
    let row = |row: &AccessRow| {
        let allowed: Map<String, Value> = Role::ALL
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
