//! The book's reference of configuration files, metrics and signals is that of the types.
#![allow(clippy::unwrap_used, reason = "a test that can not go on has failed")]

use crate::page::{check, head, row};
use serde_json::{Map, Value};
use std::fmt::Write;
use supertwin_core::{Signal, signal, unit};
use supertwin_lab::{metrics, schema};

/// One line for each value that a file may hold: its path, type, unit and meaning.
struct Lines<'a> {
    definitions: &'a Map<String, Value>,
    /// References that are being followed: a law may hold another law.
    open: Vec<&'a str>,
    lines: Vec<[String; 4]>,
}

impl<'a> Lines<'a> {
    /// The schema that a reference leads to.
    fn resolve(&self, schema: &'a Value) -> &'a Value {
        let name = schema["$ref"].as_str().and_then(|path| path.strip_prefix("#/$defs/"));
        name.map_or(schema, |name| &self.definitions[name])
    }

    /// Adds what stands below `path`; `about` is said of it where it is used.
    fn add(&mut self, path: &str, schema: &'a Value, about: &str) {
        let reference = schema["$ref"].as_str().unwrap_or_default();
        if !reference.is_empty() && self.open.contains(&reference) {
            return self.line(path, "as above", about);
        }
        self.open.push(reference);
        self.add_target(path, schema, about);
        self.open.pop();
    }

    fn add_target(&mut self, path: &str, schema: &'a Value, about: &str) {
        let target = self.resolve(schema);
        let said = if about.is_empty() { target["description"].as_str().unwrap_or_default() } else { about };
        // An option is a choice between a value and null.
        let choices = target["oneOf"].as_array().or(target["anyOf"].as_array());
        if let Some(choices) = choices {
            let choices: Vec<&Value> = choices.iter().filter(|choice| choice["type"] != "null").collect();
            let words: Vec<String> = choices.iter().flat_map(|choice| words(choice)).collect();
            if !words.is_empty() {
                self.line(path, &words.join(" \\| "), said);
            }
            for choice in choices.into_iter().filter(|choice| words_of(choice).is_empty()) {
                let optional = target["anyOf"].is_array();
                self.add(path, choice, if optional { about } else { "" });
            }
            return;
        }
        let words = words(target);
        if !words.is_empty() {
            return self.line(path, &words.join(" \\| "), said);
        }
        if let Some(properties) = target["properties"].as_object() {
            if ["surge", "sway", "heave", "yaw"].iter().all(|axis| properties.contains_key(*axis))
                && properties.len() == 4
                && properties["surge"]["$ref"].is_null()
            {
                let each = kind(&properties["surge"]);
                return self.line(path, &format!("{{ surge, sway, heave, yaw }}, each {each}"), said);
            }
            for (name, property) in properties {
                let here = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
                let own = property["description"].as_str().unwrap_or_default();
                // A field of which nothing is said, and what an arm holds, mean what is said of the whole.
                let target = self.resolve(property);
                let of_the_whole = target["description"].is_null() || properties.len() == 1;
                let inherits = own.is_empty() && of_the_whole && target["oneOf"].is_null();
                self.add(&here, property, if inherits { said } else { own });
            }
            return;
        }
        let items = &target["items"];
        if items.is_object() && !self.resolve(items)["properties"].is_null() {
            return self.add(&format!("{path}[]"), items, "");
        }
        self.line(path, &kind(target), said);
    }

    fn line(&mut self, path: &str, kind: &str, about: &str) {
        let place = path.trim_end_matches("[]");
        // Gains have their unit by axis.
        let [surge, yaw] = ["surge", "yaw"].map(|axis| unit::of_place(&format!("{place}.{axis}")));
        let unit = match (unit::of_place(place), surge, yaw) {
            (Some(unit), ..) => unit.to_owned(),
            (None, Some(surge), Some(yaw)) if kind.starts_with('{') => format!("{surge}; yaw {yaw}"),
            _ => String::new(),
        };
        self.lines.push([format!("`{path}`"), kind.to_owned(), unit, about.to_owned()]);
    }
}

/// The words that a value may be, if it is one of some words.
fn words_of(schema: &Value) -> Vec<&str> {
    let one = schema["const"].as_str().into_iter();
    one.chain(schema["enum"].as_array().into_iter().flatten().filter_map(Value::as_str)).collect()
}

fn words(schema: &Value) -> Vec<String> {
    words_of(schema).into_iter().map(|word| format!("`{word}`")).collect()
}

/// A type and its rule.
fn kind(schema: &Value) -> String {
    let types: Vec<&str> = match &schema["type"] {
        Value::String(one) => vec![one],
        Value::Array(several) => several.iter().filter_map(Value::as_str).filter(|one| *one != "null").collect(),
        _ => vec!["any value"],
    };
    let rule = schema["rule"].as_str().map(|rule| format!(", {rule}")).unwrap_or_default();
    let types = types.join(" or ");
    match &schema["items"] {
        items if items.is_object() => format!("list of {}", kind(items)),
        _ => format!("{types}{rule}"),
    }
}

#[test]
fn the_reference_of_configuration_files_is_that_of_the_types() {
    let mut text = "# Configuration files\n\n\
        Files are TOML, in `config/` or wherever `--config` points. There are no defaults for physical values; an unknown\n\
        name, a value that breaks its rule and a missing one are errors with file, line and path. `[]` stands for one\n\
        table of a list (`[[thruster]]`). `--set SECTION.PATH=VALUE` replaces a value for one call.\n\
        `supertwin check FILE` prints a file as it was understood.\n"
        .to_owned();
    for (folder, section, schema) in schema::all() {
        let schema = schema.to_value();
        let none = Map::new();
        let mut lines =
            Lines { definitions: schema["$defs"].as_object().unwrap_or(&none), open: Vec::new(), lines: Vec::new() };
        lines.add("", &schema, "");
        let set = section.map(|section| format!(" Section of `--set`: `{section}`.")).unwrap_or_default();
        let _ = write!(
            text,
            "\n## config/{folder}\n\n{}{set}\n\n{}",
            schema["description"].as_str().unwrap_or_default(),
            head(&["path", "value", "unit", "meaning"])
        );
        assert!(!lines.lines.is_empty(), "{folder} holds something");
        for [path, kind, unit, about] in &lines.lines {
            // The bars between words are escaped already.
            text += &format!("| {path} | {kind} | {unit} | {} |\n", about.replace('|', "\\|").replace('\n', " "));
        }
    }
    check("configuration.md", &text);
}

#[test]
fn the_reference_of_metrics_is_the_catalogue() {
    let mut text = "# Metrics\n\n\
        What `supertwin compare` knows, by families. A metric's name is that of its family and of its quantity\n\
        (`measured.depth_m`); it is also the name of the score in a recording's property `result` and of the column in a\n\
        sweep's table. *e* is value minus reference (the heading the short way round) at the moments *i* = 1…*n* of the\n\
        window, Δt apart. *measured* is what the estimator says, *true* is what the plant did.\n\n"
        .to_owned();
    text += &head(&["family", "quantities", "formula", "meaning", "better is"]);
    let mut families: Vec<(&metrics::Family, Vec<String>)> = Vec::new();
    for metric in metrics::all_metrics() {
        let quantity = metric.name.strip_prefix(metric.family.name).unwrap_or_default().trim_start_matches('.');
        let quantity = if quantity.is_empty() { "itself".to_owned() } else { format!("`{quantity}`") };
        let quantity = if metric.unit.is_empty() { quantity } else { format!("{quantity} [{}]", metric.unit) };
        match families.last_mut() {
            Some((family, quantities)) if family.name == metric.family.name => quantities.push(quantity),
            _ => families.push((metric.family, vec![quantity])),
        }
    }
    assert!(families.len() > 20, "the catalogue has families");
    for (family, quantities) in families {
        let better = format!("{:?}", family.better).to_lowercase();
        text += &row(&[&format!("`{}`", family.name), &quantities.join(", "), family.formula, family.about, &better]);
    }
    check("metrics.md", &text);
}

#[test]
fn the_reference_of_signals_is_what_is_declared() {
    let mut text = "# Signals\n\n\
        Every quantity that services and recordings show, at every tick or whenever there is one (a sonar ping). The path\n\
        is at once the entity in a recording, the name in telemetry and the first half of a column in exports. A signal\n\
        without components is one number, or a word where it has no unit either. A control law may show signals of its own\n\
        beside these.\n\n"
        .to_owned();
    text += &head(&["path", "components", "meaning"]);
    let mut signals: Vec<&Signal> = signal::all().collect();
    signals.sort_by_key(|signal| signal.path);
    assert!(signals.len() > 60, "only {} signals", signals.len());
    for signal in signals {
        let component = |(i, name): (usize, &&str)| match signal.unit(i) {
            "" => (*name).to_owned(),
            unit => format!("{name} [{unit}]"),
        };
        let mut components: Vec<String> = signal.components.iter().enumerate().map(component).collect();
        if components.is_empty() && !signal.unit(0).is_empty() {
            components.push(format!("[{}]", signal.unit(0)));
        }
        text += &row(&[&format!("`{}`", signal.path), &components.join(", "), signal.about]);
    }
    check("signals.md", &text);
}
