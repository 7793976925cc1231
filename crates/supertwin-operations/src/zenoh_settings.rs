//! The settings of a locked router and of its clients, and the matrix of who may do what.

use crate::OperationError;
use serde_json::{Map, Value, json};
use std::path::Path;
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

/// The text of the Zenoh configuration file of `role` at the vehicle called `name`: of its router, which listens at
/// `listen` (without any: its unix socket and port 7447 with TLS), or of a client of its router at `connect` (without
/// any: `tls/localhost:7447`). `credentials` is the folder with the holder's certificate and key; `None`: where they are
/// installed.
///
/// # Errors
/// The options do not fit together, or the credentials are not of this role and vehicle.
pub fn settings(
    role: Role,
    name: &str,
    listen: &[String],
    connect: &[String],
    credentials: Option<&Path>,
) -> Result<String, OperationError> {
    Scope::of(Some(name)).map_err(|cause| OperationError::Option(format!("--vehicle {cause}")))?;
    check(role, listen, connect)?;
    let tls = tls(role, name, credentials)?;
    let or = |given: &[String], default: &[&str]| -> Vec<String> {
        if given.is_empty() { default.iter().map(|text| (*text).to_owned()).collect() } else { given.to_vec() }
    };
    Ok(if role == Role::Vehicle {
        access_control::router_file(name, &or(listen, &[SOCKET, TLS]), &tls)
    } else {
        access_control::client_file(role, name, &or(connect, &["tls/localhost:7447"]), &tls)
    })
}

/// What does not fit together.
fn check(role: Role, listen: &[String], connect: &[String]) -> Result<(), OperationError> {
    let wrong = |text: String| Err(OperationError::Option(text));
    if role == Role::Vehicle && !connect.is_empty() {
        return wrong("--connect: the vehicle's router listens; its services use --connect with its socket".to_owned());
    }
    if role != Role::Vehicle && !listen.is_empty() {
        return wrong(format!("--listen: nobody connects to {role}; give its router with --connect"));
    }
    if let Some(endpoint) = connect.iter().find(|endpoint| !endpoint.starts_with("tls/")) {
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
