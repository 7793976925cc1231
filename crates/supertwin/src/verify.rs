//! `supertwin verify`: the same bits in one process, in separate processes, and over a bad link.
