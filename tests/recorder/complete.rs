//! A recording over the network is complete, and equals that of one process.

use super::shared;
use crate::support::{CONFIG, Place, ROV, SERVICES, recording_in};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Debug;
use supertwin_core::message::{FromSignals, Measurements, Nav, Reference, SignalValues, Thrust, Truth};
use supertwin_core::observe::Snapshot;
use supertwin_core::source::Columns;
use supertwin_core::{Message, Property, Signal, Tick};
use supertwin_lab::mission::Mission;
use supertwin_lab::{Library, ResolvedTrial, Scores, Twin, rescore, trial};
use supertwin_protocol::envelope::decode;
use supertwin_rerun::{Recording, read};

/// What a recording shows at a tick.
struct At<'a>(&'a Recording, i64);

impl SignalValues for At<'_> {
    fn numbers(&self, signal: &'static Signal) -> Option<&[f64]> {
        self.0.signal(signal)?.at(self.1)
    }
    fn label(&self, signal: &'static Signal) -> Option<&str> {
        let labels = self.0.label(signal);
        let next = labels.partition_point(|label| label.tick <= self.1);
        Some(&labels[next.checked_sub(1)?].value)
    }
}

/// The same numbers, bit for bit, at the same ticks.
fn same(path: &str, a: &Columns, b: &Columns) {
    assert_eq!((&a.names, a.width), (&b.names, b.width), "{path}");
    assert!(
        a.tick == b.tick && a.time_ns == b.time_ns,
        "{path}: other ticks: {} and {} rows",
        a.tick.len(),
        b.tick.len()
    );
    let bits = |columns: &Columns| columns.values.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    assert!(bits(a) == bits(b), "{path}: other values");
}

/// Every exact message is found again, field by field, in the signals of its tick; these messages, by tick.
fn found_again<M: Message + FromSignals + PartialEq + Debug>(recording: &Recording) -> BTreeMap<i64, M> {
    let found = recording.wires[M::KEY].iter().map(|message| {
        let sent = decode::<M>(&message.bytes).expect("is legal").data;
        assert_eq!(M::from_signals(&At(recording, message.tick)).as_ref(), Some(&sent), "tick {}", message.tick);
        (message.tick, sent)
    });
    found.collect()
}

/// Properties of a recording that are scores.
fn scores(recording: &Recording) -> BTreeMap<&String, &Property> {
    let names: Vec<String> = Scores::default().properties().into_keys().collect();
    recording.properties["result"].iter().filter(|(name, _)| names.contains(name) || *name == "hash").collect()
}

#[test]
fn a_recording_over_the_network_is_complete_and_equals_that_of_one_process() {
    let _beside = shared();
    let mut heard = [false; 4];
    for name in ["paper-gsta", "paper-agsta", "paper-pid"] {
        let place = Place::new();
        let short = ["--set", "trial.duration_s=20", "--set", "trial.score.from_s=5"];
        place.call(&[&["run", name, "--out", "batch", "--json"], &short[..]].concat()).well();
        let batch = read(&recording_in(&place.path().join("batch"))).expect("is read");

        let _router = place.start(&["serve", "router", "--json", "--listen", &place.socket]);
        let mut recorder =
            place.start(&["record", "--json", "--once", "--out", "net", "--vehicle", ROV, "--connect", &place.socket]);
        let lock_step = [&["--pace", "lockstep", "--witness", "recorder"][..], &short].concat();
        let services = SERVICES.map(|service| place.serve_rov(service, name, &place.socket, &lock_step));
        recorder.finish().well();
        for mut service in services {
            service.finish().well();
        }
        let net = read(&recording_in(&place.path().join("net"))).expect("is read");
        assert!(net.complete && batch.complete);

        // Every quantity that a block shows, at every tick, with the same bits.
        let library = Library::new(CONFIG, Vec::new());
        let resolved: ResolvedTrial = trial::load(&library, name).expect("is legal").swap_remove(0);
        let mut twin = Twin::new(&resolved, resolved.trial.seed).expect("is built");
        let mut shown = BTreeSet::new();
        let mut mission = Mission::new(&resolved.trial.mission, 0.02);
        for k in 0..200 {
            let tick = Tick { k, dt_s: 0.02 };
            while let Some(command) = mission.due(tick) {
                twin.command(tick, command).expect("is legal");
            }
            twin.step(tick);
            // Nobody needs the truth's exact messages; what is shown of it is all there is of it.
            let truth = Truth::from_signals(&At(&net, k.cast_signed()));
            assert_eq!(truth.as_ref(), Some(twin.truth()), "tick {k}");
            let snapshot = Snapshot::of(&twin);
            shown.extend(snapshot.vectors.iter().map(|(signal, _)| signal.path));
            shown.extend(snapshot.labels.iter().map(|(signal, _)| signal.path));
        }
        // Wires are cut by the mission of a batch run only; over the network they are cut for real.
        shown.remove("link/withheld");
        assert!(shown.len() > 40, "{shown:?}");
        for path in shown {
            match net.signals.get(path) {
                Some(columns) => same(path, columns, &batch.signals[path]),
                None => assert_eq!(net.labels[path], batch.labels[path], "{path}"),
            }
        }
        for (path, columns) in batch.signals.iter().filter(|(path, _)| *path != "link/withheld") {
            // Curves that are drawn beside others follow from them; constants among them have as many rows as batches.
            if path.starts_with("derived/") {
                assert!(net.signals.contains_key(path), "{path}");
            } else {
                same(path, &net.signals[path], columns);
            }
        }
        assert_eq!(net.signals["tracking/depth"].tick, (0..1000).collect::<Vec<_>>(), "every tick");
        let counts =
            [found_again::<Nav>(&net).len(), found_again::<Reference>(&net).len(), found_again::<Thrust>(&net).len()];
        assert_eq!(counts, [1000; 3]);
        for measured in found_again::<Measurements>(&net).into_values() {
            heard[0] |= measured.depth.is_some();
            heard[1] |= measured.compass.is_some();
            heard[2] |= measured.gyro.is_some();
            heard[3] |= measured.dvl.is_some_and(|dvl| dvl.velocity_m_per_s.is_some());
        }
        // Scores from the file alone are those of the run.
        assert_eq!(scores(&net), scores(&batch), "{name}");
        assert!(scores(&net).len() > 50);
        assert_eq!(rescore(&net).expect("can be scored").scores, rescore(&batch).expect("can be scored").scores);
        for service in SERVICES {
            assert_eq!(net.words[&format!("step/{service}")].len(), 1000, "the account of each step of {service}");
        }
    }
    assert_eq!(heard, [true; 4], "every sensor has been there at least once");
}
