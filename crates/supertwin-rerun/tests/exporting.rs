//! What other programs read of an exported recording is what was recorded, number by number.

#![allow(clippy::unwrap_used, reason = "a test that can not go on has failed")]

use crate::common::{DT_S, fresh, header, play, results};
use crate::python;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use supertwin_core::signal::tracking;
use supertwin_core::{Probe, RunSink, Signal, Tick};
use supertwin_rerun::{Format, Options, Recording, RerunSink, export, read, read_selected};

static ODD: Signal = Signal { path: "test/odd", components: &["a", "b"], units: &["m", "s"], about: "" };
static ONE: Signal = Signal { path: "test/one", components: &[], units: &["m"], about: "" };

/// A short run, and after it numbers that are hard to write.
fn record(path: &Path) -> Recording {
    let mut sink = RerunSink::create(path, Options { batch_ticks: 64, ..Options::default() }).unwrap();
    sink.begin(&header("run-7")).unwrap();
    play(&mut sink, 150).unwrap();
    for k in 160..166 {
        sink.tick(Tick { k, dt_s: DT_S }).unwrap();
        let hard = [f64::NAN, f64::INFINITY, -0.0, 5e-324, 0.1 + 0.2, 1.797e308][k as usize - 160];
        sink.vector(&ODD, &[hard, k as f64]);
        if k % 2 == 0 {
            sink.scalar(&ONE, 1.0 / 3.0);
        }
    }
    sink.finish(&results()).unwrap();
    read(path).unwrap()
}

/// Every number by column and tick, as bits; the columns in their order.
type Numbers = BTreeMap<(String, i64), u64>;

/// NaN has many bits and one meaning.
fn bits(number: f64) -> u64 {
    if number.is_nan() { f64::NAN.to_bits() } else { number.to_bits() }
}

fn recorded(recording: &Recording) -> Numbers {
    let mut numbers = Numbers::new();
    for (path, columns) in &recording.signals {
        for (row, &tick) in columns.tick.iter().enumerate() {
            for (i, value) in columns.row(row).unwrap().iter().enumerate() {
                let name = columns.names[i].split(" [").next().unwrap();
                let scalar = columns.width == 1 && path.ends_with(name);
                let column = if scalar { path.clone() } else { format!("{path}:{name}") };
                numbers.insert((column, tick), bits(*value));
            }
        }
    }
    numbers
}

/// Lines of `column<tab>tick<tab>bits in hexadecimal`.
fn parsed(lines: &str) -> Numbers {
    let number = |line: &str| {
        let [column, tick, hex] = line.split('\t').collect::<Vec<_>>()[..] else { panic!("{line}") };
        let number = f64::from_bits(u64::from_str_radix(hex, 16).unwrap());
        ((column.to_owned(), tick.parse().unwrap()), bits(number))
    };
    lines.lines().map(number).collect()
}

fn assert_same(read: &Numbers, written: &Numbers) {
    for (place, number) in written {
        assert_eq!(read.get(place), Some(number), "{place:?}");
    }
    assert_eq!(read.len(), written.len(), "{:?}", read.keys().find(|place| !written.contains_key(*place)));
}

#[test]
fn a_data_frame_from_parquet_has_every_number_and_nothing_else() {
    let (folder, path) = fresh();
    let recording = record(&path);
    let done = export(&recording, Format::Parquet, &path.with_extension("parquet"), false).unwrap();
    assert_eq!(done.rows, 156);
    let program = "
import pyarrow.parquet, struct, sys
table = pyarrow.parquet.read_table('run.parquet')
ticks = table['tick'].to_pylist()
for name, column in zip(table.column_names[2:], table.columns[2:]):
    if str(column.type) == 'double':
        for tick, value in zip(ticks, column.to_pylist()):
            if value is not None:
                print(name, tick, struct.pack('>d', value).hex(), sep='\\t')
print(table.schema.metadata[b'supertwin.run'].decode(), file=sys.stderr)
assert table['sim_time_s'].to_pylist() == [tick * 20_000_000 / 1e9 for tick in ticks]
mode = dict(zip(ticks, table['guidance/reference/mode'].to_pylist()))
assert (mode[0], mode[99], mode[100], mode[149]) == ('neutral', 'neutral', 'depth_heading_hold', 'depth_heading_hold')
";
    assert_same(&parsed(&python::say(folder.path(), program, &[])), &recorded(&recording));
}

#[test]
fn a_spreadsheet_from_csv_has_every_number_and_nothing_else() {
    let (_folder, path) = fresh();
    let recording = record(&path);
    let path = path.with_extension("csv");
    let done = export(&recording, Format::Csv, &path, false).unwrap();
    let mut file = csv::Reader::from_path(&path).unwrap();
    let header = file.headers().unwrap().clone();
    assert_eq!((&header[0], &header[1], header.len()), ("tick", "sim_time_s", done.columns));
    let labels = recording.labels.len();
    let mut numbers = Numbers::new();
    let mut rows = 0;
    for row in file.records() {
        let row = row.unwrap();
        rows += 1;
        let tick: i64 = row[0].parse().unwrap();
        assert_eq!(row[1].parse::<f64>().unwrap(), tick as f64 * 20_000_000.0 / 1e9);
        for (name, value) in header.iter().zip(&row).skip(2).take(header.len() - 2 - labels) {
            if !value.is_empty() {
                numbers.insert((name.to_owned(), tick), bits(value.parse().unwrap()));
            }
        }
    }
    assert_eq!((rows, done.rows), (156, 156));
    assert_same(&numbers, &recorded(&recording));
}

#[test]
fn foxglove_finds_signals_and_events_in_an_mcap_file() {
    let (folder, path) = fresh();
    let recording = record(&path);
    let done = export(&recording, Format::Mcap, &path.with_extension("mcap"), false).unwrap();
    // The published reader, with its check of every checksum.
    let program = "
import json, struct, sys
from mcap.reader import make_reader
count, times, events, modes = 0, [], [], []
with open('run.mcap', 'rb') as file:
    reader = make_reader(file, validate_crcs=True)
    for schema, channel, message in reader.iter_messages(log_time_order=False):
        count += 1
        times.append(message.log_time)
        assert schema.encoding == 'jsonschema' and channel.message_encoding == 'json'
        body = json.loads(message.data)
        assert set(body) == set(json.loads(schema.data)['properties'])
        tick = message.log_time // 20_000_000
        if schema.name == 'foxglove.Log':
            assert channel.topic == '/events'
            events.append((tick, body['level'], body['name'], body['timestamp']['sec'], body['message']))
        elif channel.topic == '/guidance/reference/mode':
            modes.append((tick, body['value']))
        elif isinstance(body.get('value'), str):
            # Flags as lanes, which are drawn beside the mode.
            assert channel.topic.startswith('/derived/'), channel.topic
        else:
            assert channel.topic == '/' + schema.name
            for name, value in body.items():
                column = schema.name if name == 'value' else schema.name + ':' + name
                value = float('nan') if value is None else value
                print(column, tick, struct.pack('>d', value).hex(), sep='\\t')
    (metadata,) = [m.metadata for m in reader.iter_metadata() if m.name == 'supertwin.run']
    assert metadata['seed'] == '18446744073709551615'
assert times == sorted(times)
assert events == [(100, 2, 'guidance', 2, 'depth and heading hold')], events
assert modes == [(0, 'neutral'), (100, 'depth_heading_hold')], modes
assert count == int(sys.argv[1]), count
";
    let read = python::say(folder.path(), program, &[&done.rows.to_string()]);
    let mut expected = recorded(&recording);
    // JSON knows neither NaN nor infinity.
    for number in expected.values_mut().filter(|number| !f64::from_bits(**number).is_finite()) {
        *number = f64::NAN.to_bits();
    }
    assert_same(&parsed(&read), &expected);
}

#[test]
fn only_what_was_read_is_exported_and_nothing_is_overwritten() {
    let (folder, path) = fresh();
    record(&path);
    let some = read_selected(&path, &|path| path == tracking::DEPTH.path).unwrap();
    let out = folder.path().join("run.csv");
    assert_eq!(export(&some, Format::Csv, &out, false).unwrap().columns, 5);
    let before = fs::read(&out).unwrap();
    let head = b"tick,sim_time_s,tracking/depth:measured,tracking/depth:reference,tracking/depth:true\n";
    assert!(before.starts_with(head));
    let error = export(&some, Format::Csv, &out, false).unwrap_err().to_string();
    assert!(error.contains("run.csv: exists already; use --force"), "{error}");
    assert_eq!(fs::read(&out).unwrap(), before);
    export(&some, Format::Csv, &out, true).unwrap();
    let nothing = read_selected(&path, &|_| false).unwrap();
    let other = folder.path().join("other.csv");
    assert!(export(&nothing, Format::Csv, &other, false).unwrap_err().to_string().contains("no signal and no label"));
    assert!(export(&some, Format::Csv, &folder.path().join("no/where.csv"), false).is_err());
    let names = fs::read_dir(folder.path()).unwrap().count();
    assert_eq!(names, 2, "nothing unfinished is left");
}
