//! Modules: which of them use which, and how long they are.
//!
//! Modules in one folder are looked at together. One uses another if a file in or below it has a path (`crate::…`,
//! `super::…`, in a `use` or in the code) into the other, also by way of a name that a module on the way takes from
//! elsewhere. A folder and what is in it may use each other: it is their common ground. Modules of unit tests don't count.

use super::{root, sources};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fs;

/// Most lines of a file that gives no reason.
const MOST_LINES: usize = 500;

/// How a reason begins; it stands among the first lines.
const REASON: &str = "// Longer than 500 lines: ";

/// Names of modules from the crate's root on.
type Path = Vec<String>;

/// The modules of a crate with their code.
type Modules = BTreeMap<Path, String>;

fn modules(name: &str) -> Modules {
    let source = root().join("crates").join(name).join("src");
    let module = |file: &std::path::PathBuf| {
        let below = file.strip_prefix(&source).unwrap().with_extension("");
        let mut path: Path = below.iter().map(|part| part.to_str().unwrap().to_owned()).collect();
        if path.last().is_some_and(|last| ["lib", "main", "mod"].contains(&last.as_str())) {
            path.pop();
        }
        (path, code(&fs::read_to_string(file).unwrap()))
    };
    sources(&source).iter().map(module).collect()
}

/// A text without its comments and its unit tests.
fn code(text: &str) -> String {
    let text = text.split("#[cfg(test)]\nmod ").next().unwrap();
    text.lines().flat_map(|line| [line.split("//").next().unwrap(), "\n"]).collect()
}

/// What the `use` statements of a text bring in: each path with the name that it gets.
fn uses(code: &str) -> Vec<(Path, String)> {
    let mut found = Vec::new();
    for statement in code.split_inclusive(';').filter_map(|text| text.strip_suffix(';')) {
        let starts = |(i, _): &(usize, &str)| {
            let before = statement[..*i].lines().last().unwrap_or_default().trim();
            before.is_empty() || before.starts_with("pub")
        };
        if let Some((i, _)) = statement.match_indices("use ").filter(starts).last() {
            expand(&statement[i + 4..], &[], &mut found);
        }
    }
    found
}

/// Expands the braces of a `use`.
fn expand(tree: &str, before: &[String], found: &mut Vec<(Path, String)>) {
    let tree = tree.trim();
    if let Some((prefix, group)) = tree.split_once('{') {
        let mut path = before.to_vec();
        path.extend(prefix.split("::").map(|part| part.trim().to_owned()).filter(|part| !part.is_empty()));
        let (mut depth, mut from) = (0, 0);
        let group = group.trim_end().trim_end_matches('}');
        for (i, c) in group.char_indices().chain([(group.len(), ',')]) {
            match c {
                '{' => depth += 1,
                '}' => depth -= 1,
                ',' if depth == 0 || i == group.len() => {
                    let closing = "}".repeat(usize::try_from(depth).unwrap_or_default());
                    expand(&format!("{}{closing}", &group[from..i]), &path, found);
                    from = i + 1;
                }
                _ => {}
            }
        }
    } else if !tree.is_empty() {
        let (tree, alias) = tree.split_once(" as ").map_or((tree, None), |(tree, alias)| (tree, Some(alias)));
        let parts =
            tree.split("::").map(|part| part.trim().to_owned()).filter(|part| part != "self" || before.is_empty());
        let path: Path = before.iter().cloned().chain(parts).collect();
        let name = alias.or(path.last().map(String::as_str)).unwrap_or_default().trim().to_owned();
        found.push((path, name));
    }
}

/// Paths in a text that begin at the root or one level up.
fn paths(code: &str) -> impl Iterator<Item = Path> {
    let begins = code.match_indices("crate::").chain(code.match_indices("super::")).map(|(i, _)| i);
    begins.map(|i| {
        let end = code[i..].find(|c: char| !c.is_alphanumeric() && c != '_' && c != ':').map_or(code.len(), |n| i + n);
        code[i..end].split("::").filter(|part| !part.is_empty()).map(str::to_owned).collect()
    })
}

/// The module in which a path of `from` ends.
fn target(modules: &Modules, from: &[String], path: &[String], depth: usize) -> Path {
    let mut here = from.to_vec();
    for part in path {
        match part.as_str() {
            "crate" => here.clear(),
            "self" => {}
            "super" => drop(here.pop()),
            name => {
                here.push(name.to_owned());
                if modules.contains_key(&here) {
                    continue;
                }
                here.pop();
                let taken = uses(modules.get(&here).map_or("", String::as_str));
                match taken.iter().find(|(path, taken)| taken == name && (path.len() > 1 || path[0] != *name)) {
                    // Its own modules, or our own crate's: what comes from other crates ends here.
                    Some((path, _)) if depth < 8 && ours(modules, &here, path) => {
                        here = target(modules, &here, path, depth + 1);
                    }
                    _ => return here,
                }
            }
        }
    }
    here
}

fn ours(modules: &Modules, from: &[String], path: &[String]) -> bool {
    let child: Path = from.iter().chain(&path[..1]).cloned().collect();
    ["crate", "self", "super"].contains(&path[0].as_str()) || modules.contains_key(&child)
}

/// Circles between modules of one folder, each as its way round with the files that go it.
fn circles(modules: &Modules) -> Vec<String> {
    // Folder, module, used module: by which file and path.
    let mut arrows: BTreeMap<(Path, String), BTreeMap<String, String>> = BTreeMap::new();
    for (module, code) in modules {
        let used = uses(code).into_iter().map(|(path, _)| path).filter(|path| ours(modules, module, path));
        for path in used.chain(paths(code)) {
            let to = target(modules, module, &path, 0);
            let common = module.iter().zip(&to).take_while(|(a, b)| a == b).count();
            if let (Some(a), Some(b)) = (module.get(common), to.get(common)) {
                let by = format!("{} has {}", module.join("/"), path.join("::"));
                arrows.entry((module[..common].to_vec(), a.clone())).or_default().entry(b.clone()).or_insert(by);
            }
        }
    }
    let mut found = BTreeMap::new();
    for (folder, start) in arrows.keys() {
        let mut seen = BTreeSet::new();
        let mut next = VecDeque::from([(start.clone(), vec![start.clone()], Vec::new())]);
        while let Some((at, way, why)) = next.pop_front() {
            for (to, by) in arrows.get(&(folder.clone(), at)).into_iter().flatten() {
                let why: Vec<String> = why.iter().chain([by]).cloned().collect();
                if to == start {
                    let members: BTreeSet<String> = way.iter().cloned().collect();
                    let way = format!("{} → {to}: {}", way.join(" → "), why.join("; "));
                    found.entry((folder.clone(), members)).or_insert(way);
                    next.clear();
                    break;
                }
                if seen.insert(to.clone()) {
                    next.push_back((to.clone(), way.iter().chain([to]).cloned().collect(), why));
                }
            }
        }
    }
    found.into_values().collect()
}

#[test]
fn modules_of_a_crate_use_each_other_in_no_circle() {
    let mut read = 0;
    for (name, _) in super::crates() {
        let modules = modules(&name);
        read += modules.len();
        let circles = circles(&modules);
        assert!(circles.is_empty(), "{name}:\n{}", circles.join("\n"));
    }
    assert!(read > 100, "only {read} modules were read");
}

#[test]
fn a_circle_is_found_wherever_it_hides() {
    let circles = |files: &[(&str, &str)]| {
        let path = |name: &str| name.split('/').filter(|part| !part.is_empty()).map(str::to_owned).collect();
        circles(&files.iter().map(|(name, text)| (path(name), code(text))).collect()).len()
    };
    let lib = ("", "pub mod a;\npub mod b;\nmod c;\npub use b::B;\n");
    assert_eq!(circles(&[lib, ("a", "use crate::b::B;\n"), ("b", "pub struct B;\n")]), 0);
    assert_eq!(circles(&[lib, ("a", "use crate::{\n    b::{B, C},\n    x,\n};\n"), ("b", "use super::a::A;\n")]), 1);
    // Renamed at the root.
    assert_eq!(circles(&[lib, ("a", "use crate::B;\n"), ("b", "fn f() { crate::a::f(); }\n")]), 1);
    assert_eq!(circles(&[lib, ("a", "use super::B;\n"), ("b", "// crate::a\n"), ("c", "use crate::a;\n")]), 0);
    assert_eq!(circles(&[lib, ("a", "use crate::b;\n"), ("b", "use crate::c;\n"), ("c", "use crate::a;\n")]), 1);
    let folder = ("a", "mod x;\nmod y;\nuse y::Y;\npub use x::X;\n");
    assert_eq!(circles(&[lib, folder, ("a/x", "use super::A;\n"), ("a/y", "use super::X;\n")]), 0);
    assert_eq!(circles(&[lib, folder, ("a/x", "use super::Y;\n"), ("a/y", "use super::X;\n")]), 1);
    assert_eq!(circles(&[lib, folder, ("a/x", "use crate::b::B;\n"), ("b", "use crate::a::y::Y;\n"), ("a/y", "")]), 1);
}

#[test]
fn a_long_file_says_why_it_is_not_several() {
    for (path, text) in super::texts() {
        let lines = text.lines().count();
        let reason = text.lines().take(40).any(|line| line.starts_with(REASON) && line.len() > REASON.len() + 20);
        assert_eq!(lines > MOST_LINES, reason, "{}: {lines} lines; a line {REASON}…: {reason}", path.display());
    }
}
