//! `supertwin schema`: what messages look like, for clients in any language.

use crate::terminal;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use supertwin_operations::OperationError;
use supertwin_operations::save;
use supertwin_protocol::schema::{self, Described};

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  supertwin schema                               which messages there are, and their keys
  supertwin schema nav                           JSON Schema of estimator/nav, units and meaning of each field
  supertwin schema guidance_command              what `supertwin set` may send to guidance
  supertwin schema --save schemas                all as files, NAME.schema.json
  supertwin schema --json                        the list, for programs

Everything is generated from the types that write and read the messages (JSON Schema, draft 2020-12; the keyword
\"unit\" is ours). Payloads are JSON; keys are below supertwin/VEHICLE/.
Exit status: 0 done, 2 there is no such message or a file can't be written.")]
pub(crate) struct SchemaArguments {
    /// Which [default: a list of all]
    #[arg(value_name = "MESSAGE")]
    pub(crate) names: Vec<String>,

    /// Write them to this folder
    #[arg(long, value_name = "DIR")]
    pub(crate) save: Option<PathBuf>,

    /// Replace files that exist
    #[arg(long, requires = "save")]
    pub(crate) force: bool,

    /// Print the list as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// One message in the JSON array of `--json`.
#[derive(Debug, Serialize)]
struct Listed<'a> {
    name: &'a str,
    key: &'a str,
    about: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    file: Option<PathBuf>,
    /// When it was asked for by name and goes to no file.
    #[serde(skip_serializing_if = "Option::is_none")]
    schema: Option<&'a serde_json::Value>,
}

pub(crate) fn schema(arguments: &SchemaArguments) -> Result<ExitCode, OperationError> {
    let all = schema::all();
    let find = |name: &String| {
        all.iter().find(|one| one.name == name).ok_or_else(|| {
            let known: Vec<&str> = all.iter().map(|one| one.name).collect();
            OperationError::Option(format!("{name}: is no message; there are {}", known.join(", ")))
        })
    };
    let named = !arguments.names.is_empty();
    let chosen: Vec<&Described> =
        if named { arguments.names.iter().map(find).collect::<Result<_, _>>()? } else { all.iter().collect() };
    let mut listed = Vec::new();
    for one in chosen {
        let file = arguments.save.as_ref().map(|folder| save_to(folder, one, arguments.force)).transpose()?;
        let schema = (named && file.is_none()).then_some(&one.schema);
        listed.push(Listed { name: one.name, key: &one.key, about: one.about, file, schema });
    }
    if arguments.json {
        terminal::print_json(&listed)?;
        return Ok(ExitCode::SUCCESS);
    }
    for one in &listed {
        terminal::print(&match (&one.file, one.schema) {
            (Some(file), _) => file.display().to_string(),
            (None, Some(schema)) => format!("{schema:#}"),
            (None, None) => format!("{:20}{:28}{}", one.name, one.key, one.about),
        });
    }
    Ok(ExitCode::SUCCESS)
}

fn save_to(folder: &Path, one: &Described, force: bool) -> Result<PathBuf, OperationError> {
    let path = folder.join(format!("{}.schema.json", one.name));
    save(&path, format!("{:#}\n", one.schema).as_bytes(), force)?;
    Ok(path)
}
