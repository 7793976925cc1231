//! supertwin-model
