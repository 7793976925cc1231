//! What the paper measured in the field: table IV.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Columns of the paper's table IV.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PaperColumn {
    /// Case study 1.
    Gsta,
    /// Case study 2.
    Agsta,
    /// Case study 3.
    Pid,
}

/// Root-mean-square errors of one case study, in the order of [`supertwin_core::signal::tracking::QUANTITIES`].
#[must_use]
pub fn table_iv(column: PaperColumn) -> [f64; 6] {
    match column {
        PaperColumn::Gsta => [0.402, 0.078, 0.054, 0.077, 0.143, 0.090],
        PaperColumn::Agsta => [0.681, 0.055, 0.035, 0.046, 0.113, 0.097],
        PaperColumn::Pid => [0.820, 0.114, 0.048, 0.103, 0.078, 0.145],
    }
}
