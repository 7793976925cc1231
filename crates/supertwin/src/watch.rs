//! `supertwin list`, `echo` and `hz`: what is alive and what flows.
