//! Tunable parameters by name: the path into a configuration type is the name, and its checks are the rules.

use crate::Refusal;
use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// A new value for one parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ParameterChange {
    /// Names from the outside in, with dots: `law.pid.kp.surge`.
    pub path: String,
    /// The new value.
    pub value: Value,
}

/// The parameters of `config` as a tree of names and values.
#[must_use]
pub fn tree(config: &impl Serialize) -> Value {
    serde_json::to_value(config).unwrap_or(Value::Null)
}

/// `config` with one value changed. The type's own checks decide whether that is legal.
///
/// # Errors
/// When there is no such parameter, or the value breaks its rule.
pub fn changed<T: Serialize + DeserializeOwned>(config: &T, change: &ParameterChange) -> Result<T, Refusal> {
    let mut tree = tree(config);
    let mut place = &mut tree;
    for (depth, name) in change.path.split('.').enumerate() {
        let known = names(place);
        let next = match place {
            Value::Object(map) => map.get_mut(name),
            Value::Array(list) => name.parse::<usize>().ok().and_then(|i| list.get_mut(i)),
            _ => None,
        };
        let so_far: Vec<&str> = change.path.split('.').take(depth).collect();
        place = next.ok_or_else(|| {
            let place = if so_far.is_empty() { "the parameters".to_owned() } else { so_far.join(".") };
            Refusal(format!("{}: no such parameter; {place} has {known}", change.path))
        })?;
    }
    if place.is_object() {
        return Err(Refusal(format!("{} has parts: {}; set one of them", change.path, names(place))));
    }
    *place = change.value.clone();
    serde_json::from_value(tree).map_err(|error| Refusal(format!("{} = {}: {error}", change.path, change.value)))
}

fn names(place: &Value) -> String {
    match place {
        Value::Object(map) => map.keys().map(String::as_str).collect::<Vec<_>>().join(", "),
        Value::Array(list) => format!("the numbers 0 to {}", list.len().saturating_sub(1)),
        _ => "no parts".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::Positive;
    use serde_json::json;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Gains {
        kp: [Positive; 2],
        inner: Inner,
    }
    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Inner {
        beta: Positive,
    }

    fn gains() -> Gains {
        let positive = |x| Positive::try_from(x).expect("positive");
        Gains { kp: [positive(1.0), positive(2.0)], inner: Inner { beta: positive(3.0) } }
    }

    fn change(path: &str, value: Value) -> Result<Gains, Refusal> {
        changed(&gains(), &ParameterChange { path: path.to_owned(), value })
    }

    #[test]
    fn a_path_reaches_its_value_and_nothing_else() {
        let now = change("inner.beta", json!(4.5)).expect("legal");
        assert_eq!(now.inner.beta.get(), 4.5);
        assert_eq!(now.kp, gains().kp);
        assert_eq!(change("kp.1", json!(7)).expect("legal").kp[1].get(), 7.0);
    }

    #[test]
    fn what_breaks_a_rule_is_refused_with_path_value_and_rule() {
        for (path, value, says) in [
            ("inner.beta", json!(-1.0), "positive"),
            ("inner.beta", json!(null), "inner.beta"),
            ("inner.gamma", json!(1.0), "inner has beta"),
            ("nothing", json!(1.0), "inner, kp"),
            ("inner", json!(1.0), "has parts: beta"),
            ("kp.2", json!(1.0), "0 to 1"),
        ] {
            let refusal = change(path, value).expect_err(path);
            assert!(refusal.0.contains(says) && refusal.0.contains(path), "{refusal}");
        }
    }
}
