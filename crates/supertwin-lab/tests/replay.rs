//! Replay of what is hard to come by: lost telemetry, late steps that nothing was sent of, two writers, commands between.

use crate::common::kept::{Keeper, keep, without_rows};
use crate::common::{fly, load};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use supertwin_core::digest::{DigestProbe, block_digest};
use supertwin_core::message::{Nav, Thrust};
use supertwin_core::run::Properties;
use supertwin_core::source::Label;
use supertwin_core::{Block, Observe, Port, PortRule, Ports, RecordedRun, RunHeader, RunSink, Tick, signal};
use supertwin_lab::mission::{Mission, Parts};
use supertwin_lab::replay::{Messages, RING, Replay, Verification};
use supertwin_lab::{Blocks, ResolvedTrial, run};
use supertwin_plant::Plant;

const DT_S: f64 = 0.02;

fn label(tick: u64, value: &Value) -> Label {
    let k = i64::try_from(tick).expect("small");
    Label { tick: k, time_ns: k * 20_000_000, value: value.to_string() }
}

/// A run as a recorder on a network would have kept it: with the account of every step.
fn over_a_network(trial: &ResolvedTrial, ticks: u64) -> RecordedRun {
    let mut keeper = Keeper::default();
    let mut properties = run::properties(trial, 1, "realtime", &Properties::new());
    properties.remove("duration_s");
    keeper.begin(&RunHeader { name: "net".to_owned(), properties, ..RunHeader::default() }).expect("in memory");
    let parts = Parts::of(&Mission::new(&trial.trial.mission, DT_S)).expect("no links");
    let mut probe = DigestProbe::default();
    fly(trial, ticks, |tick, twin| {
        let k = tick.k;
        keeper.tick(tick).expect("in memory");
        twin.digest(tick, &mut probe).expect("is finite");
        twin.observe(&mut keeper);
        let of_controller = json!({"estimator/nav": [k], "guidance/reference": [k]});
        let mut used = [json!({}), json!({"plant/measurements": [k]}), json!({"estimator/nav": [k]}), of_controller];
        for at in [0, 1, 3].into_iter().filter(|_| k > 0) {
            used[at]["controller/thrust"] = json!([k - 1]);
        }
        for ((service, used), digest) in RING.iter().zip(used).zip(twin.digests) {
            let account = json!({
                "source": format!("{service}-a"), "seq": k + 1, "steps": k + 1, "used": used,
                "digest": format!("{digest:016x}"),
            });
            keeper.run.words.entry(format!("step/{service}")).or_default().push(label(k, &account));
        }
    });
    for (tick, command) in parts.guidance {
        let value = serde_json::to_value(command).expect("JSON");
        keeper.run.commands.entry("guidance".to_owned()).or_default().push(label(tick, &value));
    }
    keeper.run
}

fn verify(kept: &RecordedRun) -> Verification {
    verify_with(kept, Messages::default())
}

fn verify_with(kept: &RecordedRun, messages: Messages) -> Verification {
    Replay::new(kept, messages).expect("can be replayed").verify(None).expect("is replayed")
}

/// Changes the account of the step in a label.
fn edit(label: &mut Label, change: impl FnOnce(&mut Value)) {
    let mut account = serde_json::from_str(&label.value).expect("JSON");
    change(&mut account);
    label.value = account.to_string();
}

fn exact(verification: &Verification) -> BTreeMap<&str, (u64, u64)> {
    verification.blocks.iter().map(|block| (block.service, (block.steps, block.compared))).collect()
}

/// The recording without some of what one service told.
fn without(kept: &RecordedRun, service: &str, gone: impl Fn(i64) -> bool) -> RecordedRun {
    let mut kept = kept.clone();
    kept.words.get_mut(&format!("step/{service}")).expect("is there").retain(|words| !gone(words.tick));
    for (_, columns) in kept.signals.iter_mut().filter(|(path, _)| path.starts_with(&format!("{service}/"))) {
        *columns = without_rows(columns, &gone);
    }
    kept
}

#[test]
fn what_was_told_step_by_step_repeats_and_what_was_not_told_is_made_up_for_where_the_hash_proves_it() {
    let trial = load("paper-gsta", &[]);
    let kept = over_a_network(&trial, 1200);
    let whole = verify(&kept);
    assert!(whole.equal, "{:?}", whole.first);
    assert!(exact(&whole).values().all(|counts| *counts == (1200, 1200)), "{:?}", exact(&whole));

    // Telemetry of a block that nobody depends on: what it did in the gap follows from what it heard.
    let gap = |tick: i64| (300..310).contains(&tick);
    let lost = verify(&without(&kept, "controller", gap));
    let counts = exact(&lost);
    assert_eq!((counts["guidance"], counts["controller"].0), ((1200, 1200), 1190));
    // Thrust of the gap is gone: those who used it say so, from the first tick on at which it matters. In the plant that is
    // five ticks later: a thrust is under way for 0.1 s.
    for (service, first) in [("plant", 306), ("estimator", 301)] {
        let block = lost.blocks.iter().find(|block| block.service == service).expect("is there");
        assert_eq!(block.inexact[0].from_tick, first, "{service}: {:?}", block.inexact);
        assert!(block.inexact[0].why.contains("controller/thrust at tick 300"), "{:?}", block.inexact);
    }
    assert!(lost.first.is_none(), "a gap is no difference: {:?}", lost.first);

    // Nobody hears guidance but the controller.
    let lost = verify(&without(&kept, "guidance", gap));
    let counts = exact(&lost);
    assert_eq!((counts["guidance"], counts["estimator"], counts["plant"]), ((1190, 1190), (1200, 1200), (1200, 1200)));
    let controller = &lost.blocks[3];
    assert!(controller.inexact[0].why.contains("guidance/reference at tick 300"), "{:?}", controller.inexact);

    // Telemetry of every fifth tick; the hash of those proves that all between were right.
    let mut thinned = without(&kept, "estimator", |tick| tick % 5 != 0);
    thinned.signals = kept.signals;
    for (i, words) in thinned.words.get_mut("step/estimator").expect("is there").iter_mut().enumerate() {
        edit(words, |account| account["seq"] = json!(i + 1));
    }
    let thinned = verify(&thinned);
    assert!(thinned.equal && exact(&thinned)["estimator"] == (240, 240), "{:?}", thinned.blocks[1]);
}

#[test]
fn a_recording_that_begins_late_has_nothing_to_compare() {
    let mut late = over_a_network(&load("paper-gsta", &[]), 300);
    for service in RING {
        late = without(&late, service, |tick| tick < 100);
    }
    let late = verify(&late);
    assert!(!late.equal && late.first.is_none());
    for block in &late.blocks {
        // What depends on the past only through what it hears is found again: its hash says so.
        assert!(block.compared < 200, "{block:?}");
        assert!(block.inexact[0].why.contains("its first 100 steps are not in the recording"), "{block:?}");
    }
}

#[test]
fn one_bit_of_a_signal_or_of_a_hash_is_found_where_it_is() {
    let kept = over_a_network(&load("paper-gsta", &[]), 400);
    let mut bit = kept.clone();
    let columns = bit.signals.get_mut(signal::controller::SIGMA.path).expect("is there");
    let at = 333 * columns.width + 2;
    columns.values[at] = f64::from_bits(columns.values[at].to_bits() ^ 1);
    let first = verify(&bit).first.expect("differs");
    let sigma = signal::controller::SIGMA.path;
    assert_eq!((first.tick, first.signal.as_str(), first.component.as_str()), (333, sigma, "heave"));
    let mut hash = kept;
    let words = &mut hash.words.get_mut("step/guidance").expect("is there")[222];
    edit(words, |account| account["digest"] = json!("0123456789abcdef"));
    let first = verify(&hash).first.expect("differs");
    assert_eq!((first.tick, first.signal.as_str()), (222, "step/guidance"));
    assert_eq!(verify(&hash).blocks[2].compared, 400, "all others are what they were");
}

/// A plant that was late: it did steps that nothing was sent of, all with the thrust of the next one that was sent.
#[test]
fn a_plant_that_was_late_repeats_its_silent_steps() {
    let trial = load("paper-gsta", &[]);
    let mut keeper = Keeper::default();
    let properties = run::properties(&trial, 1, "realtime", &Properties::new());
    keeper.begin(&RunHeader { name: "late".to_owned(), properties, ..RunHeader::default() }).expect("in memory");
    let mut plant = Blocks::new(&trial, 1).expect("is built").plant;
    let mut ports = Ports::<Plant>::default();
    let thrust =
        |k: u64| Thrust { force_n: std::iter::repeat_n(5.0 + k as f64 / 10.0, 6).collect(), ..Thrust::default() };
    let mut messages = Messages::default();
    let mut probe = DigestProbe::default();
    let mut seq = 0;
    let mut newest = None;
    for k in 0..120_u64 {
        let silent = (50..65).contains(&k);
        let tick = Tick { k, dt_s: DT_S };
        // While it is late nothing arrives.
        if k > 0 && !(50..=65).contains(&k) {
            newest = Some(k - 1);
            messages.add(k - 1, "controller-a", thrust(k - 1));
            offer(&mut ports, k - 1, &thrust(k - 1));
        }
        if k == 51 {
            let value = json!({"thruster_gain": {"thruster": 2, "gain": 0.5}});
            plant.command(tick, &serde_json::from_value(value.clone()).expect("legal")).expect("is legal");
            keeper.run.commands.entry("plant".to_owned()).or_default().push(label(k, &value));
        }
        keeper.tick(tick).expect("in memory");
        let out = plant.step(tick, ports.input(tick, supertwin_core::OperatorLink::Present));
        let digest = block_digest(&mut probe, &plant, &out);
        probe.finish_tick();
        if silent {
            continue;
        }
        seq += 1;
        plant.observe(&mut keeper);
        out.observe(&mut keeper);
        let used = newest.map_or(json!({}), |newest| json!({ "controller/thrust": [newest] }));
        let account = json!({
            "source": "plant-a", "seq": seq, "steps": k + 1, "used": used, "digest": format!("{digest:016x}"),
        });
        keeper.run.words.entry("step/plant".to_owned()).or_default().push(label(k, &account));
    }
    let mut kept = keeper.run;
    let done = verify_with(&kept, messages.clone());
    assert!(done.equal && exact(&done)["plant"] == (105, 105), "{done:?}");

    // Without the command that applied in silence it is another plant; that is a doubt, and no difference.
    kept.commands.clear();
    let done = verify_with(&kept, messages);
    let plant = &done.blocks[0];
    assert!(done.first.is_none() && plant.inexact[0].from_tick == 65, "{plant:?}");
    assert!(plant.inexact[0].why.contains("15 steps before tick 65 were late"), "{plant:?}");
}

fn offer(ports: &mut Ports<Plant>, k: u64, thrust: &Thrust) {
    struct Offer<'a>(u64, &'a Thrust);
    impl supertwin_core::port::PortVisitor for Offer<'_> {
        fn port<M: supertwin_core::Message>(&mut self, _: usize, port: &mut Port<M>) {
            let message: &dyn std::any::Any = self.1;
            port.offer(self.0, message.downcast_ref::<M>().expect("the plant hears thrust").clone());
            assert_eq!(port.state.rule, PortRule::BEFORE);
        }
    }
    ports.visit(&mut Offer(k, thrust));
}

#[test]
fn of_two_writers_with_one_tick_the_one_that_a_block_was_listening_to_is_taken() {
    let trial = load("paper-gsta", &[]);
    let kept = over_a_network(&trial, 200);
    let mut messages = Messages::default();
    fly(&trial, 200, |Tick { k, .. }, twin| {
        if (100..110).contains(&k) {
            // A second estimator speaks up, and comes through first.
            messages.add(k, "estimator-b", Nav { depth_m: 99.0, ..Nav::default() });
        }
        messages.add(k, "estimator-a", twin.outputs().expect("has stepped").nav.clone());
    });
    let done = verify_with(&kept, messages);
    assert!(done.equal, "{:?}", done.first);
    assert!(!done.rebuilt.contains_key("estimator/nav") && done.rebuilt["controller/thrust"] == 200, "{done:?}");
}

#[test]
fn a_run_of_one_process_repeats_from_memory_with_its_hash() {
    for name in ["paper-agsta", "tether-cut"] {
        let (kept, outcome) = keep(&load(name, &["trial.duration_s=60"]), 2);
        let done = verify(&kept);
        assert!(done.equal && done.hash == Some(true), "{name}: {:?}", done.first);
        assert!(exact(&done).values().all(|counts| *counts == (outcome.ticks, outcome.ticks)), "{:?}", exact(&done));
    }
}

#[test]
fn words_that_are_no_account_are_named() {
    let mut kept = over_a_network(&load("paper-gsta", &[]), 20);
    let mut commands = kept.clone();
    let refused = |kept: &RecordedRun| Replay::new(kept, Messages::default()).expect_err("is refused").to_string();
    kept.words.get_mut("step/guidance").expect("is there")[7].value = "{}".to_owned();
    let error = refused(&kept);
    assert!(error.starts_with("net: step/guidance at tick 7: missing field"), "{error}");
    kept.words.remove("step/guidance");
    let error = refused(&kept);
    assert!(error.starts_with("net: nothing says which messages guidance used (step/guidance)"), "{error}");
    commands.commands.get_mut("guidance").expect("is there")[0].value = "{\"fly\":1}".to_owned();
    let error = refused(&commands);
    assert!(error.contains("command/guidance at tick 0") && error.contains("fly"), "{error}");
}
