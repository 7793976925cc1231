//! `supertwin top`: services, rates, ages, gaps, step times, live.
