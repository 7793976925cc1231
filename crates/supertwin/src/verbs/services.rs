//! What `serve` and `up` have in common: the router, and how services end.

use crate::arguments::PaceArgument;
use crate::terminal::{self, INTERRUPTED};
use std::process::ExitCode;
use std::sync::Arc;
use supertwin_operations::OperationError;
use supertwin_operations::router_access::RouterAccess;
use supertwin_protocol::Clock;
use supertwin_zenoh::router::News;
use supertwin_zenoh::{Ending, Finished, Link, Router};

/// Threads of a router that read from the network.
///
/// Zenoh closes a connection that is dead, and that it still has something to say to, in one of these, and waits up to
/// ten seconds for it. By default there are as few as processors: two topside programs behind a cut tether would
/// silence the vehicle's own services.
const READERS: &str = "(rx: (worker_threads: 8))";

/// Starts this program again, in this process, with enough threads for a router: Zenoh reads their number from the
/// environment alone, once.
pub(super) fn with_enough_readers() {
    use std::os::unix::process::CommandExt;
    const NAME: &str = "ZENOH_RUNTIME";
    let (None, Ok(program)) = (std::env::var_os(NAME), std::env::current_exe()) else { return };
    let error = std::process::Command::new(program).args(std::env::args_os().skip(1)).env(NAME, READERS).exec();
    terminal::warn(&format!("warning: the router has few threads; set {NAME}='{READERS}': {error}"));
}

/// Whom the router lets in; what is exposed is said before anything is opened.
pub(super) fn router_access(link: &Link, open_to_everyone: bool) -> Result<RouterAccess, OperationError> {
    let access = RouterAccess::check(link, open_to_everyone)?;
    for exposure in &access.exposures {
        terminal::warn(&format!("warning: {exposure}"));
    }
    Ok(access)
}

/// Opens a router, which says on standard error what happens to its certificate; standard output belongs to results.
pub(super) fn open_router(link: &Link, clock: &Arc<dyn Clock>) -> Result<Router, OperationError> {
    let tell = |news: News| match news {
        News::Renewed(text) => terminal::warn(&text),
        News::Warning(text) => terminal::warn(&format!("warning: {text}")),
    };
    Ok(Router::open(link, Arc::clone(clock), tell)?)
}

/// Says who comes to the router, and who is turned away.
pub(super) fn tell_access(text: &str, refusal: bool) {
    terminal::warn(&format!("{}{text}", if refusal { "refused: " } else { "" }));
}

/// Exit status of a process whose services have ended.
pub(super) fn ending(finished: &Finished, pace: PaceArgument) -> ExitCode {
    let mut code = ExitCode::SUCCESS;
    for (service, ending) in &finished.endings {
        match ending {
            Ending::Complete => {}
            Ending::Stopped(_) if pace == PaceArgument::Realtime => {}
            Ending::Stopped(reason) if reason == "interrupted" => code = ExitCode::from(INTERRUPTED),
            Ending::Stopped(reason) | Ending::Failed(reason) => {
                let stopped = if matches!(ending, Ending::Stopped(_)) { " was stopped" } else { "" };
                terminal::warn(&format!("error: {service}{stopped}: {reason}"));
                return ExitCode::from(1);
            }
        }
    }
    code
}
