//! What is changed in a replay, and from which block on that has an effect.

use super::ReplayError;
use crate::config::{ConfigError, Library, Loaded, Override};
use crate::ring::RING;
use crate::trial::{ControllerConfig, ResolvedTrial, stem};

/// The block with which a replay begins; those before it are as recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum FromBlock {
    /// Estimator, guidance and controller anew; measurements as recorded.
    Estimator,
    /// Guidance and controller anew; navigation as recorded.
    Guidance,
    /// The controller anew; navigation and references as recorded.
    Controller,
}

impl FromBlock {
    /// Its place in the ring.
    #[must_use]
    pub fn position(self) -> usize {
        match self {
            Self::Estimator => 1,
            Self::Guidance => 2,
            Self::Controller => 3,
        }
    }

    /// Name of the service that is replayed first.
    #[must_use]
    pub fn name(self) -> &'static str {
        RING[self.position()]
    }
}

/// What an override concerns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Concerns {
    /// This block is the first.
    Block(FromBlock),
    /// The plant's own: of no effect where the vehicle does not react.
    Plant,
    /// What the disturbance takes the place of.
    Sea,
    /// No block is replayed; the scores are computed anew.
    Score,
    /// What was recorded.
    Recorded,
}

fn concerns(over: &Override) -> Concerns {
    let path: Vec<&str> = over.path.iter().map(String::as_str).collect();
    match (over.section.as_str(), path.first().copied().unwrap_or_default()) {
        ("estimator", _) | ("vehicle", "nominal") | ("trial", "nominal_spread") | ("safety", "estimator") => {
            Concerns::Block(FromBlock::Estimator)
        }
        ("guidance", _) | ("safety", "guidance") => Concerns::Block(FromBlock::Guidance),
        ("controller", _)
        | ("safety", "controller" | "fallback")
        | ("vehicle", "allocation" | "thruster" | "propulsion") => Concerns::Block(FromBlock::Controller),
        ("vehicle", "true" | "unmodelled") | ("environment", "current" | "waves" | "tether") => Concerns::Sea,
        ("environment" | "sensors" | "vehicle", _) | ("safety", "plant") => Concerns::Plant,
        ("trial", "score") => Concerns::Score,
        _ => Concerns::Recorded,
    }
}

/// A recorded trial with something changed.
#[derive(Clone, Debug)]
pub struct Changed {
    /// The controller in the place of the recorded one.
    controller: Option<(String, Loaded<ControllerConfig>)>,
    overrides: Vec<Override>,
    /// With which block the replay begins.
    pub from: FromBlock,
    /// What was changed, in words, for properties.
    pub words: Vec<String>,
}

impl Changed {
    /// The overrides of this call and the controller file that it names. Without `from`, the replay begins with the first
    /// block that a change concerns; with nothing changed, with the estimator.
    ///
    /// # Errors
    /// When a file can't be used, or a change has no effect on what is replayed.
    pub fn new(
        library: &Library,
        controller: Option<&str>,
        from: Option<FromBlock>,
        closed_loop: bool,
    ) -> Result<Self, ReplayError> {
        let refuse = |over: &Override, why: &str| Err(ReplayError::Change(format!("--set {}: {why}", over.text)));
        let mut first: Option<FromBlock> = controller.map(|_| FromBlock::Controller);
        for over in &library.overrides {
            match concerns(over) {
                Concerns::Block(block) => {
                    if let Some(from) = from.filter(|from| block < *from) {
                        let why =
                            format!("concerns the {}, which --from {} leaves as recorded", block.name(), from.name());
                        return refuse(over, &why);
                    }
                    first = Some(first.map_or(block, |first| first.min(block)));
                }
                Concerns::Plant | Concerns::Sea if !closed_loop => {
                    return refuse(over, "concerns the plant, which is as recorded; see --closed-loop");
                }
                Concerns::Sea => {
                    return refuse(over, "in a closed loop the recorded disturbance takes its place");
                }
                Concerns::Recorded => return refuse(over, "is what was recorded; `supertwin run` does another run"),
                Concerns::Plant | Concerns::Score => {}
            }
        }
        let loaded = match controller {
            None => None,
            Some(name) => {
                let loaded: Loaded<ControllerConfig> = library.load("controller", "controllers", name)?;
                let mine = |over: &&Override| over.section == "controller" && !over.concerns(&loaded.table);
                if let Some(over) = library.overrides.iter().find(mine) {
                    return refuse(over, &format!("controller {name} has another law"));
                }
                Some((stem(&loaded.path), loaded))
            }
        };
        let mut words: Vec<String> = loaded.iter().map(|(name, _)| format!("controller {name}")).collect();
        words.extend(library.overrides.iter().map(|over| over.text.clone()));
        let from = from.or(first).unwrap_or(FromBlock::Estimator);
        Ok(Self { controller: loaded, overrides: library.overrides.clone(), from, words })
    }

    /// Nothing is changed.
    #[must_use]
    pub fn is_nothing(&self) -> bool {
        self.words.is_empty()
    }

    /// `trial` with the changes.
    ///
    /// # Errors
    /// Names the override and the rule that it breaks.
    pub fn apply(&self, trial: &ResolvedTrial) -> Result<ResolvedTrial, ConfigError> {
        if self.is_nothing() {
            return Ok(trial.clone());
        }
        let place = trial.path.display().to_string();
        let mut table: toml::Table = crate::config::parse(&place, &trial.text)?;
        let mut name = trial.controller_name.clone();
        if let Some((new, loaded)) = &self.controller {
            name.clone_from(new);
            table.insert("controller".to_owned(), toml::Value::Table(loaded.table.clone()));
            // A law has one name; the new one is in command.
            if let Some(toml::Value::Table(standby)) = table.get_mut("standby") {
                standby.remove(new);
            }
        }
        for over in &self.overrides {
            // Those of a controller file are in it already.
            if over.section == "controller" && self.controller.is_some() {
                continue;
            }
            let mut section = match table.remove(&over.section) {
                Some(toml::Value::Table(section)) => section,
                _ => toml::Table::new(),
            };
            if over.section == "controller" && !over.concerns(&section) {
                let message = "the recorded controller has another law".to_owned();
                return Err(ConfigError::Override { text: over.text.clone(), message });
            }
            over.apply(&mut section)?;
            table.insert(over.section.clone(), toml::Value::Table(section));
            // One by one, so that an error names the override that broke the rule.
            ResolvedTrial::from_text(&trial.name, &name, &table.to_string(), &place).map_err(|error| match error {
                ConfigError::Place { message, .. } | ConfigError::Combination { message, .. } => {
                    ConfigError::Override { text: over.text.clone(), message }
                }
                other => other,
            })?;
        }
        ResolvedTrial::from_text(&trial.name, &name, &table.to_string(), &place)
    }
}
