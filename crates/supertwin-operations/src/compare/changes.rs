//! How a group is configured otherwise than the baseline, in words.

use super::GroupReport;

/// Changes of the configuration that are printed per group; all of them are in the JSON.
const MOST_CHANGES: usize = 12;

/// What a group has otherwise than the baseline; `None`: nothing.
#[must_use]
pub fn changes_text(group: &GroupReport, markdown: bool) -> Option<String> {
    if group.changes.is_empty() {
        return None;
    }
    let none = || "(none)".to_owned();
    let mut lines: Vec<String> = group
        .changes
        .iter()
        .take(MOST_CHANGES)
        .map(|change| {
            let (before, after) =
                (change.baseline.clone().unwrap_or_else(none), change.here.clone().unwrap_or_else(none));
            format!("{}: {before} → {after}", change.path)
        })
        .collect();
    if group.changes.len() > MOST_CHANGES {
        lines.push(format!("… and {} more; --json has all", group.changes.len() - MOST_CHANGES));
    }
    let indent = if markdown { "- " } else { "  " };
    let gap = if markdown { "\n\n" } else { "\n" };
    let lines: Vec<String> = lines.into_iter().map(|line| format!("{indent}{line}")).collect();
    Some(format!("Configured otherwise{}:{gap}{}", other_task(group), lines.join("\n")))
}

/// Whether the two had the same to do; what is better at one task may be worse at the other.
fn other_task(group: &GroupReport) -> String {
    const TASK: [&str; 6] =
        ["trial.mission", "trial.start", "trial.score", "trial.duration_s", "environment", "sensors"];
    let differs = |part: &&str| group.changes.iter().any(|change| change.path.starts_with(*part));
    let parts: Vec<&str> = TASK.into_iter().filter(differs).collect();
    if parts.is_empty() { String::new() } else { format!(", and not the same task ({})", parts.join(", ")) }
}
