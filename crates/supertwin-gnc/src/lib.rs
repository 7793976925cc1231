//! supertwin-gnc
