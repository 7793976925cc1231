//! How far a long operation has come, for whoever waits for it.

/// Shows progress, or none of it; called from any thread.
pub trait Progress: Sync {
    /// A stage of so many steps begins.
    fn begin(&self, _stage: &str, _steps: u64) {}
    /// So many more of its steps are done.
    fn advance(&self, _steps: u64) {}
    /// So many of its steps are done in all.
    fn reach(&self, _steps: u64) {}
    /// The stage is over, whether all steps were done or not.
    fn end(&self) {}
}

impl Progress for () {}
