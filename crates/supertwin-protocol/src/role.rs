//! Who may be what on the network. A role and a vehicle make the common name of a certificate, which is all that Zenoh's
//! access control looks at: it compares literally.

use crate::keys;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// What a program may do, beyond what its link lets through.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, strum::Display, strum::IntoStaticStr,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Role {
    /// The vehicle's own router and services.
    Vehicle,
    /// The guidance service, topside.
    Guidance,
    /// People and programs that command.
    Operator,
    /// Those who only look.
    Observer,
    /// Those who keep everything.
    Recorder,
}

impl Role {
    /// All roles, in the order of the matrix's columns.
    pub const ALL: [Self; 5] = [Self::Vehicle, Self::Guidance, Self::Operator, Self::Observer, Self::Recorder];

    /// Its name, as in common names and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.into()
    }

    /// Whether others connect to it: its certificate names hosts, and theirs must not be able to stand for it.
    #[must_use]
    pub fn listens(self) -> bool {
        self == Self::Vehicle
    }
}

impl FromStr for Role {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|role| role.name() == text)
            .ok_or_else(|| format!("{text}: no such role; there are {}", Self::ALL.map(Self::name).join(", ")))
    }
}

/// Which vehicles a certificate counts for.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Scope {
    /// All of the fleet.
    Fleet,
    /// The one vehicle of this name.
    Vehicle(String),
}

impl Scope {
    /// What stands for the whole fleet in a common name; no vehicle may be called so.
    pub const FLEET: &str = "fleet";

    /// Of a vehicle by its name, or of the whole fleet.
    ///
    /// # Errors
    /// When the name could not be part of a key, or means the fleet.
    pub fn of(vehicle: Option<&str>) -> Result<Self, String> {
        match vehicle {
            None => Ok(Self::Fleet),
            Some(Self::FLEET) => Err("fleet: no vehicle can be called so, it stands for all of them".to_owned()),
            Some(name) if keys::is_name(name) => Ok(Self::Vehicle(name.to_owned())),
            Some(name) => Err(format!("{name}: must be 1 to 64 letters, digits, '-', '_' or '.'")),
        }
    }

    /// As it stands in a common name.
    #[must_use]
    pub fn name(&self) -> &str {
        match self {
            Self::Fleet => Self::FLEET,
            Self::Vehicle(name) => name,
        }
    }
}

impl fmt::Display for Scope {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The common name of a certificate: `operator.argus-mini`, or `operator.fleet`.
#[must_use]
pub fn common_name(role: Role, scope: &Scope) -> String {
    format!("{role}.{scope}")
}

/// Role and vehicles of a common name that [`common_name`] made.
#[must_use]
pub fn parse_common_name(text: &str) -> Option<(Role, Scope)> {
    let (role, scope) = text.split_once('.')?;
    let vehicle = Some(scope).filter(|scope| *scope != Scope::FLEET);
    Some((role.parse().ok()?, Scope::of(vehicle).ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_common_name_says_role_and_vehicle_and_nothing_else() {
        for role in Role::ALL {
            for scope in [Scope::Fleet, Scope::Vehicle("argus-mini".to_owned()), Scope::Vehicle("a.b".to_owned())] {
                assert_eq!(parse_common_name(&common_name(role, &scope)), Some((role, scope)));
            }
        }
        for wrong in ["", "operator", "operator.", "pilot.argus-mini", "operator.a/b", "Operator.fleet"] {
            assert_eq!(parse_common_name(wrong), None, "{wrong}");
        }
        assert!(Scope::of(Some("fleet")).is_err(), "it would be all vehicles");
        assert!("pilot".parse::<Role>().expect_err("none").contains("vehicle, guidance, operator"));
    }
}
