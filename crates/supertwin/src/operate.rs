//! `supertwin set` and `supertwin get`: commands and parameters, with acknowledgement.
