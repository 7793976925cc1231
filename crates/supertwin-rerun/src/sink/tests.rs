//! Disks that get full, and times of ticks.

use super::*;

static A: Signal = Signal { path: "test/a", components: &["x", "y"], units: &["m"], about: "" };

/// A disk with little room.
struct Small(usize);

impl Write for Small {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if bytes.len() > self.0 {
            return Err(io::ErrorKind::StorageFull.into());
        }
        self.0 -= bytes.len();
        Ok(bytes.len())
    }
    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn onto(target: Small, batch_ticks: usize) -> RerunSink {
    RerunSink::onto(Target::File(Box::new(target)), "disk", Options { batch_ticks, ..Default::default() })
}

fn run(mut sink: RerunSink, ticks: u64) -> Result<(), SinkError> {
    sink.begin(&RunHeader { name: "run".to_owned(), ..Default::default() })?;
    for k in 0..ticks {
        sink.tick(Tick { k, dt_s: 0.02 })?;
        sink.vector(&A, &[k as f64, 0.5]);
    }
    sink.finish(&Properties::new())
}

#[test]
fn a_full_disk_is_an_error_wherever_it_gets_full() {
    let enough = 10_000_000;
    run(onto(Small(enough), 100), 5000).unwrap();
    // From the first byte over the blueprint and the columns to the footer.
    for room in [0, 8, 20_000, 100_000, 200_000] {
        let error = run(onto(Small(room), 100), 5000).unwrap_err();
        assert_eq!(error.what, "disk", "{room}");
        assert!(error.cause.contains("no storage space"), "{room}: {error}");
    }
}

#[test]
fn a_full_disk_is_heard_before_the_end_of_a_long_run() {
    let mut sink = onto(Small(2_000_000), 10);
    sink.begin(&RunHeader { name: "run".to_owned(), ..Default::default() }).unwrap();
    let stopped = (0..1_000_000).find(|&k| {
        let refused = sink.tick(Tick { k, dt_s: 0.02 }).is_err();
        sink.vector(&A, &[k as f64, 0.5]);
        refused
    });
    assert!(stopped.is_some());
    assert!(sink.finish(&Properties::new()).is_err());
}

#[test]
fn times_are_rounded_once() {
    assert_eq!(nanos(Tick { k: 3, dt_s: 0.02 }), 60_000_000);
    assert_eq!(nanos(Tick { k: 1_000_000_007, dt_s: 0.02 }), 20_000_000_140_000_000);
}
