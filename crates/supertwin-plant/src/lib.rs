//! supertwin-plant
