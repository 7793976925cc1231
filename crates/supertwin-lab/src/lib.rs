//! supertwin-lab
