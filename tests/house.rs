//! The rules of the house, as tests: arrows between crates and between modules, clocks, platform mathematics, module
//! headings, the top level.
#![allow(clippy::unwrap_used, reason = "a broken house may panic")]

#[path = "house/modules.rs"]
mod modules;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use toml::Table;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().unwrap()
}

fn crates() -> BTreeMap<String, Table> {
    let with_manifest = |entry: fs::DirEntry| {
        let manifest = fs::read_to_string(entry.path().join("Cargo.toml")).unwrap().parse().unwrap();
        (entry.file_name().into_string().unwrap(), manifest)
    };
    fs::read_dir(root().join("crates")).unwrap().map(Result::unwrap).map(with_manifest).collect()
}

/// Names of the packages that a section depends on, whatever they are renamed to, for every target.
fn dependencies(manifest: &Table, section: &str) -> Vec<String> {
    let targets = manifest.get("target").and_then(|targets| targets.as_table()).into_iter().flat_map(Table::values);
    let tables = std::iter::once(manifest).chain(targets.filter_map(|target| target.as_table()));
    let sections = tables.filter_map(|table| table.get(section).and_then(|section| section.as_table()));
    let package = |(key, value): (&String, &toml::Value)| {
        value.get("package").and_then(|name| name.as_str()).unwrap_or(key).to_owned()
    };
    sections.flatten().map(package).collect()
}

/// Rust files below a folder, without build output.
fn sources(folder: &Path) -> Vec<PathBuf> {
    let all = glob::glob(&format!("{}/**/*.rs", folder.display())).unwrap().flatten();
    let is_ours = |path: &PathBuf| path.strip_prefix(folder).unwrap().iter().all(|part| part != "target");
    all.filter(is_ours).collect()
}

/// The files of the crates and of the top-level tests, each with its text.
fn texts() -> Vec<(PathBuf, String)> {
    let all = [root().join("crates"), root().join("tests")].into_iter().flat_map(|folder| sources(&folder));
    all.map(|path| (path.clone(), fs::read_to_string(path).unwrap())).collect()
}

/// The sources of the crates, each by its name with its text.
fn crate_sources() -> Vec<(String, String)> {
    let named = texts().into_iter().map(|(path, text)| (path.display().to_string(), text));
    named.filter(|(name, _)| name.contains("/src/")).collect()
}

/// A text without its unit tests.
fn code(text: &str) -> &str {
    text.split("#[cfg(test)]").next().unwrap()
}

#[test]
fn crates_depend_on_each_other_only_along_the_arrows_of_the_design() {
    let allowed = BTreeMap::from([
        ("core", ""),
        ("model", "core"),
        ("plant", "core model"),
        ("gnc", "core model"),
        ("lab", "core model plant gnc"),
        ("rerun", "core"),
        ("protocol", "core"),
        ("pki", "protocol"),
        ("zenoh", "core protocol pki"),
        ("operations", "core lab rerun protocol pki zenoh"),
        ("supertwin", "core lab rerun protocol pki zenoh operations"),
    ]);
    let short = |name: &str| name.trim_start_matches("supertwin-").to_owned();
    for (name, manifest) in crates() {
        assert_eq!(manifest["package"]["name"].as_str(), Some(name.as_str()), "folder name = crate name");
        let allowed = allowed.get(&*short(&name)).unwrap_or_else(|| panic!("{name} is not in the design"));
        for section in ["dependencies", "dev-dependencies", "build-dependencies"] {
            for dependency in dependencies(&manifest, section) {
                let may = allowed.split(' ').any(|allowed| allowed == short(&dependency));
                assert!(may || !dependency.starts_with("supertwin"), "{name} may not name {dependency} ({section})");
            }
        }
    }
}

#[test]
fn each_outside_world_stands_in_one_manifest() {
    for (home, outsides) in [
        ("supertwin-zenoh", "zenoh zenoh-ext"),
        ("supertwin-pki", "rcgen x509-parser"),
        ("supertwin-rerun", "rerun parquet mcap"),
        ("supertwin", "clap indicatif comfy-table ctrlc"),
    ] {
        for (name, manifest) in crates().into_iter().filter(|(name, _)| name != home) {
            let named = dependencies(&manifest, "dependencies");
            let outside = outsides.split(' ').find(|outside| named.iter().any(|name| name == outside));
            assert_eq!(outside, None, "belongs to {home}, not to {name}");
        }
    }
}

#[test]
fn the_operations_know_no_terminal() {
    let folder = root().join("crates/supertwin-operations/src");
    for path in sources(&folder) {
        let text = fs::read_to_string(&path).unwrap();
        for word in ["io::stdout", "io::stderr", "IsTerminal", "process::exit", "ExitCode", "set_handler"] {
            assert!(!text.contains(word), "{}: {word} belongs to the command line", path.display());
        }
    }
    assert!(folder.join("lib.rs").is_file());
}

#[test]
fn every_dependency_says_why_it_is_there() {
    let manifest = fs::read_to_string(root().join("Cargo.toml")).unwrap();
    let (_, section) = manifest.split_once("[workspace.dependencies]\n").unwrap();
    let section = section.split("\n[").next().unwrap();
    let mut before = "";
    let mut seen = 0;
    for line in section.lines() {
        if line.contains(" = ") && !line.starts_with("supertwin") {
            seen += 1;
            assert!(before.starts_with('#'), "no reason above: {line}");
        }
        before = line;
    }
    assert!(seen > 10, "the section was not found");
}

#[test]
fn the_numerical_crates_read_no_clock_and_use_no_platform_mathematics() {
    const FORBIDDEN: &str = ".log( .sinh() .cosh() .exp2() .ln_1p() .asinh() .acosh() .atanh() f64::sin f64::cos f64::exp \
        f64::pow .sin() .cos() .tan() .sin_cos() .asin() .acos() .atan() .atan2( .exp() .exp_m1() .ln() .log2() .log10() \
        .powi( .powf( .hypot( .cbrt() .tanh() .mul_add( Instant SystemTime HashMap HashSet par_iter";
    const CRATES: [&str; 5] =
        ["supertwin-core", "supertwin-model", "supertwin-plant", "supertwin-gnc", "supertwin-lab"];
    let mut files = crate_sources();
    files.retain(|(path, _)| CRATES.iter().any(|name| path.contains(&format!("/{name}/src/"))));
    for (path, text) in &files {
        for (i, line) in code(text).lines().enumerate() {
            let line = line.split("//").next().unwrap();
            let word = FORBIDDEN.split_whitespace().find(|word| line.contains(word));
            assert_eq!(word, None, "{path}:{}: use libm, a tick, an ordered map", i + 1);
        }
    }
    assert!(files.len() > 30, "only {} files were read", files.len());
}

#[test]
fn every_module_begins_with_what_it_is() {
    for (path, text) in texts() {
        let heading = text.lines().next().unwrap_or_default();
        assert!(heading.starts_with("//! ") && heading.len() > 10, "{}: must begin with //!", path.display());
        assert!(!heading.contains("FIXME") && !heading.contains("TODO"), "{}: unfinished", path.display());
    }
}

/// Whether a line of the sources retypes the path of a signal: `"controller/sigma"`, `"/link/{service}/rate"`.
fn retypes_a_signal(line: &str) -> bool {
    const SERVICES: [&str; 8] =
        ["plant/", "estimator/", "guidance/", "controller/", "shadow/", "tracking/", "link/", "derived/"];
    // A message's key stands once, with the message.
    let words = line.split('"').skip(1).step_by(2).filter(|_| !line.contains("const KEY: "));
    words.map(|word| word.strip_prefix('/').unwrap_or(word)).any(|word| {
        let quantity = SERVICES.iter().find_map(|service| word.strip_prefix(service));
        quantity.is_some_and(|quantity| quantity.starts_with(|c: char| c.is_ascii_lowercase() || c == '{'))
    })
}

#[test]
fn a_signal_is_named_where_it_is_declared_and_nowhere_else() {
    assert!(retypes_a_signal(r#"let x = get("controller/sigma");"#) && retypes_a_signal(r#"(1, "/link/{service}/a")"#));
    assert!(!retypes_a_signal(r#"path.starts_with("link/")"#) && !retypes_a_signal("of controller/sigma"));
    // Where signals are declared; keys of the shadow's messages are made of the plant's.
    const DECLARED: [&str; 4] =
        ["supertwin-core/src/signal", "supertwin-core/src/message", "supertwin-plant/src/shadow.rs", "keys.rs"];
    let is_exempt = |name: &str| name.ends_with("/tests.rs") || DECLARED.iter().any(|place| name.contains(place));
    let mut files = crate_sources();
    files.retain(|(name, _)| !is_exempt(name));
    for (name, text) in &files {
        for (i, line) in code(text).lines().enumerate().filter(|(_, line)| !line.trim_start().starts_with("//")) {
            assert!(!retypes_a_signal(line), "{name}:{}: name the signal by its handle: {line}", i + 1);
        }
    }
    assert!(files.len() > 100, "only {} files were read", files.len());
}

#[test]
fn every_file_of_tests_is_part_of_a_program() {
    let folders = || crates().into_keys().map(|name| root().join("crates").join(name));
    let tests = || folders().chain([root()]).flat_map(|folder| sources(&folder.join("tests")));
    // Manifests and `#[path = "…"]` of crates name a file from elsewhere.
    let manifests = folders().map(|folder| folder.join("Cargo.toml"));
    let naming: String =
        manifests.chain(sources(&root().join("crates"))).map(|path| fs::read_to_string(path).unwrap()).collect();
    for path in tests() {
        // What declares it; without that, cargo makes a program of each file by itself.
        let above = ["main.rs", "mod.rs"].map(|name| path.with_file_name(name));
        let above = above.into_iter().chain([path.parent().unwrap().with_extension("rs")]).filter(|file| *file != path);
        let Some(above) = above.filter_map(|file| fs::read_to_string(file).ok()).next() else { continue };
        let name = path.file_stem().unwrap().to_string_lossy();
        let folder = path.parent().unwrap().file_name().unwrap().to_string_lossy();
        let named = above.contains(&format!("mod {name};")) || naming.contains(&format!("{folder}/{name}.rs\""));
        assert!(named, "{}: belongs to no program, and its tests never run", path.display());
    }
}

/// Whether a comment says no more than that there is something: a single word, or a phrase that fits anything.
fn says_nothing(comment: &str) -> bool {
    const PHRASES: &str = "this one, the value, the number, the file, the run, its name, does it, writes it, finds them, \
        how many, how often, from where, as given, as recorded, it is, time zero";
    let text = comment.trim_end_matches('.').to_lowercase();
    // A symbol stands for the equation above it, and a link for what is there.
    !comment.starts_with(['`', '[']) && (!text.contains(' ') || PHRASES.split(", ").any(|phrase| phrase == text))
}

#[test]
fn comments_of_items_say_something() {
    assert!(["Which.", "Does it.", "This one."].iter().all(|comment| says_nothing(comment)));
    assert!(["`β`.", "Pressure sensor.", "Ticks that were lost."].iter().all(|comment| !says_nothing(comment)));
    let files = crate_sources();
    for (name, text) in &files {
        let comment = |line: &str| line.trim_start().strip_prefix("/// ").map(str::to_owned);
        let lines: Vec<Option<String>> = text.lines().map(comment).collect();
        for (i, line) in lines.iter().enumerate() {
            // The last line of a longer comment may be short.
            let alone = i == 0 || lines[i - 1].is_none();
            let ends = lines.get(i + 1).is_none_or(Option::is_none);
            let empty = line.as_ref().is_some_and(|line| alone && ends && says_nothing(line));
            assert!(!empty, "{name}:{}: say which, in what unit, by which rule: {line:?}", i + 1);
        }
    }
    assert!(files.len() > 130, "only {} files were read", files.len());
}

#[test]
fn every_test_can_fail() {
    let mut tests = 0;
    for (path, text) in texts() {
        // A body ends where a closing brace stands at the attribute's own depth.
        let lines: Vec<&str> = text.lines().collect();
        for (i, line) in lines.iter().enumerate().filter(|(_, line)| line.trim() == "#[test]") {
            let indent = line.len() - line.trim_start().len();
            let end = format!("{}}}", " ".repeat(indent));
            let body: Vec<&str> = lines[i..].iter().copied().take_while(|line| *line != end).collect();
            let body = body.join("\n");
            // Only by what it finds: `unwrap` and `expect` merely say that it could not go on.
            let finds = |line: &str| {
                let code = line.split("//").next().unwrap_or_default();
                ["assert", "expect_err(", "unwrap_err(", "refused("].iter().any(|word| code.contains(word))
                    || (code.contains("panic!(") && !code.contains("unwrap_or_else"))
            };
            let place = format!("{}:{}", path.display(), i + 1);
            assert!(body.lines().skip(2).any(finds), "{place}: a test that can't fail");
            assert!(!body.contains(concat!("thread::", "sleep")), "{place}: wait for what is needed, not a while");
            assert!(!body.contains(concat!("#[", "ignore")), "{place}: an ignored test");
            tests += 1;
        }
    }
    assert!(tests > 50, "only {tests} tests were found");
}

#[test]
fn nobody_reads_a_sentence() {
    // An event is data; its sentence is made in one place and is for people. Old recordings have nothing but sentences.
    const MAKES: &str = "supertwin-core/src/event/sentence.rs";
    const READS_OLD_ONES: &str = "supertwin-rerun/src/event.rs";
    const READING: [&str; 7] =
        ["starts_with(", "ends_with(", "contains(", "find(", "split_once(", "strip_prefix(", "strip_suffix("];
    let event = fs::read_to_string(root().join("crates").join(MAKES)).unwrap();
    let (_, display) = code(&event).split_once("impl fmt::Display for EventKind").unwrap();
    let beginnings = display.split('"').skip(1).step_by(2).map(|text| text.split('{').next().unwrap());
    let sentences: Vec<&str> = beginnings.filter(|text| text.len() >= 12).collect();
    assert!(sentences.contains(&"command applied: ") && sentences.len() > 12, "{sentences:?}");
    let is_exempt = |place: &str| [MAKES, READS_OLD_ONES, "/tests.rs"].iter().any(|end| place.ends_with(end));
    let mut files = crate_sources();
    files.retain(|(place, _)| !is_exempt(place));
    for (place, text) in &files {
        let code: String = code(text).lines().flat_map(|line| line.split("//").next()).map(str::trim).collect();
        for sentence in &sentences {
            assert!(!code.contains(&format!("\"{sentence}")), "{place}: {sentence:?}: only {MAKES} has sentences");
        }
        for reading in READING {
            for made in ["what.to_string()", "event.text()", "event[\"text\"]", "data[\"text\"]"] {
                assert!(!code.contains(&format!("{made}.{reading}")), "{place}: {made}.{reading} reads a sentence");
            }
        }
    }
    assert!(files.len() > 150, "only {} files were read", files.len());
}

#[test]
fn the_top_level_holds_what_a_reader_expects_and_nothing_else() {
    const EXPECTED: &str = "Cargo.toml Cargo.lock crates config tests dashboards docs README.md ARCHITECTURE.md CHANGELOG.md \
        LICENSE-MIT LICENSE-APACHE .ci .git .gitignore clippy.toml rustfmt.toml deny.toml target runs";
    const NEEDED: &str = "README.md ARCHITECTURE.md CHANGELOG.md docs/book.toml LICENSE-MIT LICENSE-APACHE .ci/run";
    for entry in fs::read_dir(root()).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        let is_expected = EXPECTED.split_whitespace().any(|expected| expected == name);
        assert!(is_expected, "{name} does not belong on the top level");
    }
    for needed in NEEDED.split(' ') {
        assert!(root().join(needed).is_file(), "{needed} is missing");
    }
}
