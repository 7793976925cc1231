//! How far a long operation has come, for whoever waits for it.

/// Shows progress; called from any thread.
pub trait Progress: Sync {
    /// A stage of so many steps begins.
    fn begin(&self, stage: &str, steps: u64);
    /// So many more of its steps are done.
    fn advance(&self, steps: u64);
    /// So many of its steps are done in all.
    fn reach(&self, steps: u64);
    /// The stage is over, whether all steps were done or not.
    fn end(&self);
}

/// Shows no progress.
impl Progress for () {
    fn begin(&self, _: &str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn reach(&self, _: u64) {}
    fn end(&self) {}
}
