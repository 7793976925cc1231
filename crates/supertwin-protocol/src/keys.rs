//! Every key that is no message's own, relative to the vehicle's namespace. No key is written anywhere else.

/// Namespace of a vehicle's services.
#[must_use]
pub fn namespace(vehicle: &str) -> String {
    format!("supertwin/{vehicle}")
}

/// Everything that a block shows at a tick.
#[must_use]
pub fn telemetry(service: &str) -> String {
    format!("telemetry/{service}")
}

/// Requests to a service; the last part is the command's name.
#[must_use]
pub fn command(service: &str, name: &str) -> String {
    format!("command/{service}/{name}")
}

/// A tunable parameter; the path's dots become slashes.
#[must_use]
pub fn param(service: &str, path: &str) -> String {
    if path.is_empty() { format!("param/{service}") } else { format!("param/{service}/{}", path.replace('.', "/")) }
}

/// A streaming set-point.
#[must_use]
pub fn setpoint(name: &str) -> String {
    format!("setpoint/{name}")
}

/// What the twin beside a real vehicle says in place of the plant.
#[must_use]
pub fn shadow(wire: &str) -> String {
    format!("shadow/{wire}")
}

/// Who may command, until when.
pub const LEASE: &str = "authority/lease";

/// The lease as the other services know it.
pub const LEASE_STATE: &str = "state/authority/lease";

/// Clock offset and round trip.
pub const PING: &str = "clock/ping";

/// Last accepted commands and parameters of a service.
#[must_use]
pub fn state(service: &str, name: &str) -> String {
    format!("state/{service}/{name}")
}

/// The newest message that a service holds of a wire: how one that starts anew learns what was in force.
#[must_use]
pub fn held(service: &str, wire: &str) -> String {
    format!("state/{service}/held/{wire}")
}

/// Events of a service.
#[must_use]
pub fn event(service: &str) -> String {
    format!("event/{service}")
}

/// Counters, once a second.
#[must_use]
pub fn health(service: &str) -> String {
    format!("health/{service}")
}

/// Who is up. The instance tells two of one name apart.
#[must_use]
pub fn alive(service: &str, instance: &str) -> String {
    format!("alive/{service}/{instance}")
}

/// A client that commands may show that it is there: its lease ends when this token does.
#[must_use]
pub fn operator(client: &str) -> String {
    format!("alive/operator/{client}")
}

/// In lock step: the run is over, and why.
#[must_use]
pub fn stop(service: &str) -> String {
    format!("stop/{service}")
}

/// In lock step: a witness has seen a tick; the ring does not go on without it.
#[must_use]
pub fn witness(name: &str) -> String {
    format!("witness/{name}")
}

/// Where an advanced publisher says its last number, answers for what it keeps, and shows itself. `**` of a rule does not
/// match it: each rule names it.
pub const ADVANCED: &str = "/@adv/**";

/// The same, of one key.
#[must_use]
pub fn advanced(key: &str) -> String {
    format!("{key}{ADVANCED}")
}

/// A client's name may be part of a key.
#[must_use]
pub fn is_name(name: &str) -> bool {
    let legal = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    !name.is_empty() && name.len() <= 64 && name.chars().all(legal)
}
