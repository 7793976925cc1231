//! No allocation in any `step`: a counting allocator proves it, from the second tick to the last.

mod common;

use common::load_all;
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use std::alloc::System;
use supertwin_core::Tick;
use supertwin_core::digest::DigestProbe;
use supertwin_lab::mission::Mission;
use supertwin_lab::{Blocks, Twin};
use supertwin_plant::Drive;

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// How often memory is asked for, changed or given back meanwhile.
fn allocated(what: impl FnOnce()) -> usize {
    let region = Region::new(ALLOCATOR);
    what();
    let change = region.change();
    change.allocations + change.reallocations + change.deallocations
}

#[test]
fn no_step_allocates_after_the_first_tick() {
    for name in ["paper-gsta", "paper-agsta", "paper-pid", "plane-filter", "tether-cut", "hand-over"] {
        for trial in load_all(name, &[]) {
            let mut twin = Twin::new(&trial, 1).expect("legal");
            let mut mission = Mission::new(&trial.trial.mission, 0.02);
            let mut probe = DigestProbe::default();
            for k in 0..trial.ticks() {
                let tick = Tick { k, dt_s: 0.02 };
                while let Some(command) = mission.due(tick) {
                    twin.command(tick, command).expect("accepted");
                }
                let allocated = allocated(|| {
                    twin.step(tick);
                    twin.digest(tick, &mut probe).expect("finite");
                });
                assert!(k == 0 || allocated == 0, "{name}/{}, tick {k}: {allocated}", trial.controller_name);
            }

            let mut driven = Twin::of(Blocks::nominal(&trial, 1).expect("legal"));
            driven.step(Tick { k: 0, dt_s: 0.02 });
            let allocated = allocated(|| {
                for k in 1..500 {
                    driven.drive(Drive { force_ned_n: [3.0, -2.0, 1.0], yaw_nm: 0.1 });
                    driven.step(Tick { k, dt_s: 0.02 });
                }
            });
            assert_eq!(allocated, 0, "{name}/{}, driven", trial.controller_name);
        }
    }
}
