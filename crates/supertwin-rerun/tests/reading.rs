//! What is left of a damaged recording is read, and what is no recording is named.

#![allow(clippy::unwrap_used, reason = "a test that can not go on has failed")]

use crate::common::{assert_viewer_takes, fresh, header, play};
use crate::corpus::support::splitmix64;
use crate::python;
use rerun::external::re_log_encoding::DecoderApp;
use std::collections::BTreeSet;
use std::fs;
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use supertwin_core::run::Properties;
use supertwin_core::signal::tracking;
use supertwin_core::{RunHeader, RunSink};
use supertwin_rerun::repair::RepairError;
use supertwin_rerun::{Options, ReadError, Recording, RerunSink, read, read_selected, repair};

/// A recording that is read in some hundredths of a second, two batches long.
fn record(path: &Path, compress: bool) -> Recording {
    // Without dashboards most of the file is data: that is what should be damaged, thousands of times.
    let options = Options { batch_ticks: 30, compress, dashboards: false, ..Default::default() };
    let mut header = header("run-7");
    header.scene.net_lines_m.clear();
    let recording = crate::common::record(path, options, &header, 60);
    assert!(recording.complete, "{:?}", recording.damage);
    recording
}

fn rows(recording: &Recording) -> usize {
    recording.rows.values().sum()
}

/// Everything of `part` is in `all`, value by value.
fn assert_contains(all: &Recording, part: &Recording, why: &str) {
    for (path, columns) in &part.signals {
        let mut there = all.signals.get(path).map_or(&[][..], |columns| &columns.tick);
        for (row, tick) in columns.tick.iter().enumerate() {
            let skipped = there.iter().position(|other| other == tick);
            let at = skipped.unwrap_or_else(|| panic!("{why}: {path} has lost tick {tick}"));
            let found = all.signals[path].tick.len() - there.len() + at;
            assert_eq!(all.signals[path].row(found), columns.row(row), "{why}: {path} at tick {tick}");
            there = &there[at + 1..];
        }
    }
    for event in &part.events {
        assert!(all.events.contains(event), "{why}: {event:?} is lost");
    }
}

#[test]
fn a_file_cut_anywhere_gives_what_precedes_the_cut() {
    let (_folder, path) = fresh();
    let whole = record(&path, true);
    let length = fs::metadata(&path).unwrap().len();
    let file = fs::File::options().write(true).open(&path).unwrap();
    let cuts: BTreeSet<u64> = (0..length).step_by(997).chain(length - 200..length).collect();
    let (mut fewest, mut seen) = (usize::MAX, 0);
    // From the end, so that the file is only ever cut further.
    for cut in cuts.into_iter().rev() {
        file.set_len(cut).unwrap();
        match read(&path) {
            Err(ReadError::Empty { .. }) => assert!(cut < 12),
            Ok(left) => {
                assert!(cut >= 12 && !left.complete && !left.damage.is_empty(), "{cut}");
                assert_contains(&whole, &left, &format!("cut at {cut}"));
                // Nothing before the cut is missing.
                for (path, columns) in &left.signals {
                    assert!(whole.signals[path].values.starts_with(&columns.values), "{path} at {cut}");
                }
                let now = rows(&left);
                assert!(now <= rows(&whole).min(fewest), "{cut}");
                seen += usize::from(now < fewest);
                fewest = now;
            }
            Err(error) => panic!("{cut}: {error}"),
        }
    }
    assert!(seen > 20 && fewest == 0, "the file gets shorter bit by bit: {seen} {fewest}");
}

#[test]
fn a_flipped_byte_anywhere_costs_a_message_at_most() {
    let folder = tempfile::tempdir().unwrap();
    let cut = folder.path().join("cut.rrd");
    let mut seed = 7;
    for (compress, flips) in [(true, 60), (false, 40)] {
        let path = folder.path().join(format!("compress-{compress}.rrd"));
        let whole = record(&path, compress);
        let bytes = fs::read(&path).unwrap();
        let mut file = fs::File::options().write(true).open(&path).unwrap();
        let mut damaged = 0;
        // Any byte; and, as they decide about all others, those of the first messages and of the footer.
        let anywhere: Vec<usize> = (0..flips).map(|_| splitmix64(&mut seed) as usize % bytes.len()).collect();
        let places = anywhere.into_iter().chain((0..80).step_by(2)).chain((bytes.len() - 60..bytes.len()).step_by(3));
        for place in places {
            let flipped = bytes[place] ^ (splitmix64(&mut seed) as u8).max(1);
            let mut put = |byte: u8| {
                file.seek(SeekFrom::Start(place as u64)).unwrap();
                file.write_all(&[byte]).unwrap();
            };
            put(flipped);
            let left = read(&path).unwrap_or_else(|error| panic!("{place}: {error}"));
            put(bytes[place]);
            // A flipped letter in an entity's name moves a row to a name of its own: one more, and none is lost.
            assert!(rows(&left) <= rows(&whole) + 1, "{place}");
            damaged += usize::from(!left.complete);
            fs::write(&cut, &bytes[..place]).unwrap();
            if let Ok(before) = read(&cut) {
                assert_contains(&left, &before, &format!("flip at {place}"));
            }
            // A message is one batch of one entity.
            let lost = rows(&whole).saturating_sub(rows(&left));
            assert!(lost <= 30, "{place}: {lost} rows are lost: {:?}", left.damage.first());
        }
        // Nothing watches over the numbers of an uncompressed file.
        assert!(damaged > if compress { 60 } else { 40 }, "{damaged}");
    }
}

#[test]
fn what_follows_a_damage_is_read_as_well() {
    let (_folder, path) = fresh();
    let whole = record(&path, true);
    let bytes = fs::read(&path).unwrap();
    // The headers of several messages, and the footer that lists all of them.
    let (middle, end) = (bytes.len() / 2, bytes.len());
    let mut damaged = bytes.clone();
    damaged[middle..middle + 20_000].fill(0);
    damaged[end - 40..].fill(0xFF);
    fs::write(&path, &damaged).unwrap();
    let left = read(&path).unwrap();
    assert!(!left.complete && rows(&left) < rows(&whole) && rows(&left) > rows(&whole) / 2);
    assert_eq!(left.properties, whole.properties, "the results are from behind the damage");
    assert_contains(&whole, &left, "zeros");
    let lost: u64 = left.damage.iter().map(|damage| damage.bytes).sum();
    assert!((20_000..40_000).contains(&lost), "{:?}", left.damage);
    // Zeros anywhere are read without a panic, whatever they leave.
    for place in (0..end).step_by(end / 40 + 1) {
        let after = end.min(place + 64);
        fs::write(&path, [&bytes[..place], &vec![0; after - place], &bytes[after..]].concat()).unwrap();
        drop(read(&path));
    }
    // What follows the end is damage as well.
    for extra in [&b"x"[..], &[0; 64]] {
        fs::write(&path, [&bytes[..], extra].concat()).unwrap();
        assert!(!read(&path).unwrap().complete);
    }
    fs::write(&path, &bytes).unwrap();
    assert_eq!(read(&path).unwrap(), whole);
}

#[test]
fn what_is_no_recording_of_ours_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file.rrd");
    let error = |path: &Path| read(path).unwrap_err().to_string().replace(&path.display().to_string(), "FILE");
    assert!(error(&path).contains("No such file"));
    assert!(error(folder.path()).contains("is a directory"));
    fs::write(&path, "").unwrap();
    assert_eq!(error(&path), "FILE: the file is empty, or ends before a recording begins");
    fs::write(&path, "not a recording, but long enough to look like the end of one").unwrap();
    assert!(error(&path).starts_with("FILE: not a recording: Not an RRD file"), "{}", error(&path));
    fs::write(&path, b"RRF1\0\0\0\0\0\0\0\0some bytes of a file from 2023").unwrap();
    assert!(error(&path).contains("old, incompatible Rerun version"), "{}", error(&path));

    let other = rerun::RecordingStreamBuilder::new("somebody_elses").save(&path).unwrap();
    other.log("depth", &rerun::Scalars::single(1.0)).unwrap();
    other.disconnect();
    assert_eq!(error(&path), "FILE: a recording of \"somebody_elses\", must be one of \"supertwin\"");

    let empty = rerun::RecordingStreamBuilder::new("other").recording_id("x").send_properties(false);
    empty.save(&path).unwrap().disconnect();
    assert!(read(&path).is_err());
}

#[test]
fn a_newer_format_is_refused_and_a_missing_one_is_the_first() {
    let (_folder, path) = fresh();
    let with = |format: Option<u64>| {
        let properties = format.map(|format| ("format".to_owned(), format.into())).into_iter().collect();
        let mut sink = RerunSink::create(&path, Options { overwrite: true, ..Options::default() }).unwrap();
        sink.begin(&RunHeader { name: "run".to_owned(), properties, ..RunHeader::default() }).unwrap();
        play(&mut sink, 5).unwrap();
        sink.finish(&Properties::new()).unwrap();
        read(&path)
    };
    assert!(with(None).unwrap().complete);
    assert!(with(Some(1)).unwrap().complete);
    let error = with(Some(2)).unwrap_err();
    assert!(error.to_string().ends_with("format = 2: must be at most 1; a newer supertwin wrote this"), "{error}");
}

#[test]
fn only_what_is_asked_for_is_read() {
    let (_folder, path) = fresh();
    let whole = record(&path, false);
    let wanted = |path: &str| tracking::SIGNALS.iter().any(|signal| signal.path == path) || path == "event/guidance";
    let some = read_selected(&path, &wanted).unwrap();
    assert!(some.complete);
    assert_eq!(some.properties, whole.properties);
    assert_eq!(some.signals.len(), 6);
    assert!(some.signals.iter().all(|(path, columns)| whole.signals[path] == *columns));
    assert_eq!(some.events.len(), whole.events.iter().filter(|event| event.service == "guidance").count());
    assert!(some.labels.is_empty() && !whole.labels.is_empty());

    // The same of a file that has no list of its parts.
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
    let cut = read_selected(&path, &wanted).unwrap();
    assert!(!cut.complete);
    assert_eq!((&cut.signals, &cut.events), (&some.signals, &some.events));
}

/// What a recorder on the network writes besides signals.
fn record_wires(path: &Path, recording_id: &str, ticks: std::ops::Range<i64>) {
    let stream = rerun::RecordingStreamBuilder::new("supertwin").recording_id(recording_id).save(path).unwrap();
    stream.set_log_time_enabled(false);
    for k in ticks {
        stream.set_time("tick", rerun::time::TimeCell::from_sequence(k));
        stream.set_time("sim_time", rerun::time::TimeCell::from_duration_nanos(k * 20_000_000));
        for (clock, late_ns) in [("sender_clock", 0), ("recorder_clock", 1_000_000)] {
            let at = 1_700_000_000_000_000_000 + k * 20_000_000 + late_ns;
            stream.set_time(clock, rerun::time::TimeCell::from_timestamp_nanos_since_epoch(at));
        }
        let bytes = rerun::components::Blob::from(format!("{{\"tick\":{k}}}").into_bytes());
        let wire = rerun::AnyValues::default().with_component::<rerun::components::Blob>("bytes", [bytes]);
        stream.log("wire/estimator/nav", &wire).unwrap();
        stream.log("used/controller", &rerun::Scalars::new([k as f64, k as f64 - 1.0])).unwrap();
        if k % 10 == 3 {
            stream.log("command/guidance", &rerun::TextDocument::new(r#"{"depth_m":3.0}"#)).unwrap();
            stream.log("event/guidance", &rerun::TextLog::new("applied").with_level("INFO")).unwrap();
        }
    }
    stream.flush_blocking().unwrap();
    stream.disconnect();
}

#[test]
fn wires_commands_and_clocks_of_a_network_recording_come_back() {
    let (_folder, path) = fresh();
    record_wires(&path, "net-1", 0..30);
    let recording = read(&path).unwrap();
    assert!(recording.complete, "{:?}", recording.damage);
    let wire = &recording.wires["estimator/nav"];
    assert_eq!((wire.len(), wire[7].tick, wire[7].time_ns), (30, 7, 140_000_000));
    assert_eq!(wire[7].bytes, br#"{"tick":7}"#);
    assert_eq!(wire[7].clocks["sender_clock"], 1_700_000_000_140_000_000);
    assert_eq!(wire[7].clocks["recorder_clock"], 1_700_000_000_141_000_000);
    let used = &recording.signals["used/controller"];
    assert_eq!(used.at(7), Some(&[7.0, 6.0][..]));
    assert_eq!(used.clocks["sender_clock"][7], Some(1_700_000_000_140_000_000));
    let commands = &recording.commands["guidance"];
    assert_eq!(commands.iter().map(|command| command.tick).collect::<Vec<_>>(), [3, 13, 23]);
    assert_eq!(commands[0].value, r#"{"depth_m":3.0}"#);
    assert_eq!(recording.events.len(), 3, "commands are no events");
}

#[test]
fn the_parts_of_a_run_are_read_as_one() {
    let folder = tempfile::tempdir().unwrap();
    let part = |name: &str| folder.path().join(name);
    record_wires(&part("run.rrd"), "net-1", 0..10);
    record_wires(&part("run.part2.rrd"), "net-1", 10..20);
    record_wires(&part("run.part10.rrd"), "net-1", 20..30);
    record_wires(&part("runner.part2.rrd"), "net-2", 0..5);
    let gap = read(&part("run.rrd")).unwrap();
    assert_eq!((gap.parts, gap.wires["estimator/nav"].len()), (3, 30));
    assert!(!gap.complete && gap.damage[0].problem == "part 3 is not there", "{:?}", gap.damage);
    fs::rename(part("run.part10.rrd"), part("run.part3.rrd")).unwrap();
    let whole = read(&part("run.rrd")).unwrap();
    assert!(whole.complete, "{:?}", whole.damage);
    assert!(whole.signals["used/controller"].tick.iter().copied().eq(0..30));
    // A part by itself is a part by itself.
    assert_eq!(read(&part("run.part2.rrd")).unwrap().wires["estimator/nav"].len(), 10);
    // A part of another run is left out and named.
    fs::rename(part("runner.part2.rrd"), part("run.part4.rrd")).unwrap();
    let mixed = read(&part("run.rrd")).unwrap();
    assert_eq!(mixed.wires["estimator/nav"].len(), 30);
    for damage in mixed.damage {
        assert_eq!(damage.problem, "part of another run, \"supertwin\" \"net-2\"");
    }
}

#[test]
fn the_viewer_opens_a_recording() {
    let (_folder, path) = fresh();
    crate::common::record(&path, Options::default(), &header("follow_net adaptive seed 1"), 3000);
    assert_viewer_takes(&path);
    let viewer = python::viewer(&python::environment());
    let stats = python::succeed(Command::new(viewer).args(["rrd", "stats"]).arg(&path));
    let said = String::from_utf8_lossy(&stats.stdout).into_owned();
    assert!(said.contains("num_entity_paths"), "{said}");
}

#[test]
fn what_is_left_of_a_damaged_file_is_made_whole() {
    let (folder, path) = fresh();
    let out = folder.path().join("out.rrd");
    for compress in [true, false] {
        let whole = record(&path, compress);
        let bytes = fs::read(&path).unwrap();
        let middle = bytes.len() / 2;
        let cases: [(&str, Vec<u8>); 5] = [
            ("no footer", bytes[..bytes.len() - 2000].to_vec()),
            ("cut in the middle of a message", bytes[..middle + 13].to_vec()),
            // Longer than any batch of values: nothing watches over the numbers of an uncompressed file.
            ("damaged in the middle", [&bytes[..middle], &[0; 4000], &bytes[middle + 4000..]].concat()),
            ("damaged beginning", [&b"XXXX"[..], &bytes[4..]].concat()),
            ("lost introduction", [&bytes[..12], &[0xAA; 40], &bytes[52..]].concat()),
        ];
        for (case, damaged) in cases {
            fs::write(&path, &damaged).unwrap();
            let left = read(&path).unwrap();
            let done = repair(&path, &out, true).unwrap_or_else(|error| panic!("{case}: {error}"));
            assert!(!done.was_whole(), "{case}");
            assert_eq!(done.bytes, damaged.len() as u64, "{case}");
            assert_viewer_takes(&out);
            let repaired = read(&out).unwrap();
            assert!(repaired.complete, "{case}: {:?}", repaired.damage);
            assert_eq!((&repaired.signals, &repaired.events), (&left.signals, &left.events), "{case}");
            assert_eq!(repaired.properties, left.properties, "{case}");
            assert_contains(&whole, &repaired, case);
            if case == "damaged beginning" || case == "lost introduction" {
                assert_eq!(repaired.signals, whole.signals, "{case}");
            }
            // A second time there is nothing to do, and nothing is done.
            let again = folder.path().join("again.rrd");
            assert!(repair(&out, &again, false).unwrap().was_whole() && !again.exists(), "{case}");
        }
        fs::remove_file(&path).unwrap();
    }
}

#[test]
fn a_repair_says_what_is_missing_and_overwrites_only_when_told_to() {
    let (folder, path) = fresh();
    let out = folder.path().join("out.rrd");
    let mut header = header("run");
    header.properties.extend([("duration_s".to_owned(), 20.0.into()), ("tick_s".to_owned(), 0.02.into())]);
    crate::common::record(&path, Options { batch_ticks: 50, ..Options::default() }, &header, 1000);
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    fs::write(&out, "something dear").unwrap();
    let error = repair(&path, &out, false).unwrap_err();
    assert!(matches!(error, RepairError::Write { .. }) && error.to_string().contains("use --force"), "{error}");
    assert_eq!(fs::read(&out).unwrap(), b"something dear");
    let done = repair(&path, &out, true).unwrap();
    let last = done.last_tick.unwrap();
    assert!((300..700).contains(&last), "{last}");
    assert_eq!((done.lost_ticks, done.ended), (Some(999 - last as u64), false));
    assert!(done.lost_bytes < 2_000_000 && done.rows > 1000 && done.behind < 18);

    // In its own place.
    let before = read(&path).unwrap();
    repair(&path, &path, true).unwrap();
    assert_eq!(read(&path).unwrap().signals, before.signals);
    let names: Vec<PathBuf> = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(names.len(), 2, "{names:?}");
}

#[test]
fn where_nothing_is_left_nothing_is_written() {
    let (folder, path) = fresh();
    let out = folder.path().join("out.rrd");
    record(&path, true);
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..100]).unwrap();
    let error = repair(&path, &out, false).unwrap_err();
    assert!(matches!(error, RepairError::Nothing { .. }), "{error}");
    fs::write(&path, "").unwrap();
    assert!(matches!(repair(&path, &out, false), Err(RepairError::Read(ReadError::Empty { .. }))));
    assert!(!out.exists());
}

#[test]
fn a_repaired_file_is_encoded_as_the_damaged_one_was() {
    let (folder, path) = fresh();
    let out = folder.path().join("out.rrd");
    for compress in [true, false] {
        record(&path, compress);
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
        repair(&path, &out, true).unwrap();
        let repaired = fs::read(&out).unwrap();
        assert_eq!(repaired.len(), bytes.len(), "the same messages in the same encoding");
        let messages = |bytes: &[u8]| DecoderApp::decode_lazy(bytes).filter(Result::is_ok).count();
        assert_eq!(messages(&repaired), messages(&bytes));
        fs::remove_file(&path).unwrap();
    }
}

#[test]
fn a_table_of_any_other_array_is_no_signal() {
    let (_folder, path) = fresh();
    let stream = rerun::RecordingStreamBuilder::new("supertwin").recording_id("odd").save(&path).unwrap();
    stream.set_log_time_enabled(false);
    let numbers = Arc::new(rerun::external::arrow::array::Int8Array::from(vec![1]));
    let odd = rerun::AnyValues::default().with_component_from_data("anything", numbers);
    stream.set_time("tick", rerun::time::TimeCell::from_sequence(1));
    stream.log("test/odd", &odd).unwrap();
    stream.log("test/untimed", &rerun::Scalars::single(1.0)).unwrap();
    stream.disconnect();
    let recording = read(&path).unwrap();
    assert!(!recording.signals.contains_key("test/odd"));
    assert!(recording.damage.iter().any(|damage| damage.problem.contains("test/untimed: not on the timelines")));
}

#[test]
fn what_can_not_be_listed_is_damage_and_repaired_without() {
    let (folder, path) = fresh();
    let out = folder.path().join("out.rrd");
    let stream = rerun::RecordingStreamBuilder::new("supertwin").recording_id("names").save(&path).unwrap();
    let send = |tick: rerun::Timeline, archetype: &'static str, value: f64| {
        let numbers = Arc::new(rerun::external::arrow::array::Float64Array::from(vec![value]));
        let described = rerun::Scalars::descriptor_scalars().with_archetype(archetype.into());
        let batch = rerun::SerializedComponentBatch::new(numbers, described);
        let when = rerun::TimePoint::default().with(rerun::Timeline::new_duration("sim_time"), 0).with(tick, 0);
        let chunk = rerun::log::Chunk::builder("test/number");
        stream.send_chunk(chunk.with_serialized_batch(rerun::log::RowId::new(), when, batch).build().unwrap());
    };
    let [sequence, duration] = [rerun::Timeline::new_sequence("tick"), rerun::Timeline::new_duration("tick")];
    send(sequence, "rerun.archetypes.Scalars", 1.0);
    send(sequence, "rerun/archetypes.Scalars", 2.0);
    send(duration, "rerun.archetypes.Scalars", 3.0);
    stream.disconnect();

    let recording = read(&path).unwrap();
    assert_eq!(recording.signals["test/number"].values, [1.0]);
    let problems: Vec<_> = recording.damage.iter().map(|damage| damage.problem.as_str()).collect();
    assert!(problems.len() == 3 && problems[0].contains("is no component of"), "{problems:?}");
    assert!(problems[1].starts_with("timeline tick is a "), "{problems:?}");
    assert!(problems[2].starts_with("not closed"), "Rerun itself could not list it: {problems:?}");
    repair(&path, &out, false).unwrap();
    assert_viewer_takes(&out);
    assert_eq!(read(&out).unwrap().signals, recording.signals);
}
