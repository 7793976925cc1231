//! Does the vehicle do what it should? The paper's figures 3, 4 and 6, with the truth beside them.

use super::views::{Canvas, Legend, entity};
use rerun::blueprint::{ContainerLike, Grid, Vertical};
use supertwin_core::signal::reference;
use supertwin_core::signal::tracking::QUANTITIES;

pub(super) fn views(canvas: &mut Canvas) -> ContainerLike {
    let plots: Vec<_> = QUANTITIES
        .iter()
        .map(|quantity| canvas.signal(quantity.title, quantity.signal, Legend::Beside(0.16)))
        .collect();
    let mode = canvas.lanes("Guidance mode", &[entity(&reference::MODE)]);
    let six = Grid::new(plots).with_grid_columns(2);
    Vertical::new([six.into(), mode]).with_row_shares([7.0, 1.0]).with_name("Tracking").into()
}
