//! supertwin-rerun
