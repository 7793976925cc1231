//! No allocation in any `step`: a counting allocator proves it, from the second tick to the last.

mod common;

use common::load_all;
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use std::alloc::System;
use supertwin_core::Tick;
use supertwin_core::digest::DigestProbe;
use supertwin_lab::Twin;
use supertwin_lab::mission::Mission;

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

#[test]
fn no_step_allocates_after_the_first_tick() {
    for name in ["paper-gsta", "paper-agsta", "paper-pid", "plane-filter", "tether-cut", "hand-over"] {
        for trial in load_all(name, &[]) {
            let mut twin = Twin::new(&trial, 1).expect("legal");
            let mut mission = Mission::new(&trial.trial.mission, 0.02);
            let mut probe = DigestProbe::default();
            let mut allocated = 0;
            for k in 0..trial.ticks() {
                let tick = Tick { k, dt_s: 0.02 };
                while let Some(command) = mission.due(tick) {
                    twin.command(tick, command).expect("accepted");
                }
                let region = Region::new(ALLOCATOR);
                twin.step(tick);
                twin.digest(tick, &mut probe).expect("finite");
                let change = region.change();
                if k > 0 {
                    allocated += change.allocations + change.reallocations + change.deallocations;
                }
            }
            assert_eq!(allocated, 0, "{name}/{}", trial.controller_name);
        }
    }
}
