//! A campaign as a list of runs: the same list on every machine, whatever part of it is done there.

use super::{MOST_RUNS, Parameter, Sweep};
use crate::config::{ConfigError, Library, Override};
use crate::trial::{self, ResolvedTrial, fits};
use std::collections::BTreeSet;
use toml::Value;

/// One choice of all parameters.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Point {
    /// Number of the grid point, from 0.
    pub grid: usize,
    /// Number of the sample, from 0; 0 where nothing is sampled.
    pub sample: usize,
    /// Per parameter, which of its values.
    pub choice: Vec<usize>,
}

/// A trial with one controller at one point: what is repeated with seeds.
#[derive(Clone, Debug)]
pub struct Configuration {
    /// Ready to be run.
    pub trial: ResolvedTrial,
    /// Number of the grid point.
    pub grid: usize,
    /// Number of the sample.
    pub sample: usize,
    /// Per parameter its value; `None` where the controller has no place for it.
    pub values: Vec<Option<Value>>,
}

/// One run of a campaign.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlannedRun {
    /// Trial, controller, point, seed: also the name of its recording.
    pub id: String,
    /// Index of its configuration.
    pub configuration: usize,
    /// Seed of the noise of sea, sensors and faults.
    pub seed: u64,
}

/// All runs of a campaign, in order: trials, then points, then controllers, then seeds.
#[derive(Clone, Debug)]
pub struct Plan {
    /// What is run.
    pub configurations: Vec<Configuration>,
    /// The runs; a run's index is its place here.
    pub runs: Vec<PlannedRun>,
}

impl Sweep {
    /// Number of grid points.
    ///
    /// # Errors
    /// When there are absurdly many.
    fn grid_points(&self) -> Result<usize, ConfigError> {
        let mut sizes = self.parameters.iter().filter(|parameter| !parameter.sampled).map(|one| one.values.len());
        let product = sizes.try_fold(1usize, |product, size| product.checked_mul(size));
        let few = |grid: &usize| grid.checked_mul(self.samples).is_some_and(|points| points <= MOST_RUNS);
        product.filter(few).ok_or_else(|| ConfigError::Combination {
            path: self.path.display().to_string(),
            message: format!("the parameters have more than {MOST_RUNS} points"),
        })
    }

    /// All points: the grid with its last parameter changing fastest, and at each of its points all samples.
    ///
    /// # Errors
    /// When there are absurdly many.
    pub fn points(&self) -> Result<Vec<Point>, ConfigError> {
        let grid_points = self.grid_points()?;
        let mut points = Vec::with_capacity(grid_points * self.samples);
        for grid in 0..grid_points {
            for sample in 0..self.samples {
                let mut rest = grid;
                let mut choice = vec![sample; self.parameters.len()];
                for (slot, parameter) in choice.iter_mut().zip(&self.parameters).rev() {
                    if !parameter.sampled {
                        *slot = rest % parameter.values.len();
                        rest /= parameter.values.len();
                    }
                }
                points.push(Point { grid, sample, choice });
            }
        }
        Ok(points)
    }

    /// Points at which one parameter differs from the first point, for each of its values, but for sampled ones the
    /// least and the greatest alone: enough to find every value that a rule forbids by itself.
    fn corners(&self) -> Vec<Point> {
        let mut choices = vec![vec![0; self.parameters.len()]];
        for (i, parameter) in self.parameters.iter().enumerate() {
            let number = |choice: &usize| parameter.values[*choice].as_float().unwrap_or(0.0);
            let all = 0..parameter.values.len();
            let ends = || {
                let least = all.clone().min_by(|a, b| number(a).total_cmp(&number(b)));
                let greatest = all.clone().max_by(|a, b| number(a).total_cmp(&number(b)));
                least.into_iter().chain(greatest).collect()
            };
            let own: Vec<usize> = if parameter.sampled { ends() } else { all.clone().collect() };
            for choice in own.into_iter().filter(|choice| *choice != 0) {
                let mut corner = vec![0; self.parameters.len()];
                corner[i] = choice;
                choices.push(corner);
            }
        }
        choices.into_iter().enumerate().map(|(i, choice)| Point { grid: i, sample: i, choice }).collect()
    }

    /// Reads everything that the sweep names, at every value of every parameter, but not at all combinations.
    ///
    /// # Errors
    /// The first thing that is wrong, with its place.
    pub fn check(&self, library: &Library) -> Result<(), ConfigError> {
        self.points()?;
        self.limits(library)?;
        let corners = self.corners();
        let of_trial = |trial: &String| corners.iter().map(|corner| self.resolve(library, trial, corner)).collect();
        let resolved: Result<Vec<Vec<Vec<ResolvedTrial>>>, ConfigError> = self.trials.iter().map(of_trial).collect();
        self.plan(resolved?, &corners).map(drop)
    }

    /// Reads a trial of the sweep at a point, once for each of its controllers.
    ///
    /// # Errors
    /// Names the sweep's file and the parameter, or the trial's file, with line, value and rule.
    pub fn resolve(&self, library: &Library, trial: &str, point: &Point) -> Result<Vec<ResolvedTrial>, ConfigError> {
        let mut overrides: Vec<(Override, &Parameter)> = Vec::new();
        for (parameter, choice) in self.parameters.iter().zip(&point.choice) {
            let of_this = parameter.overrides(*choice).map_err(|message| self.wrong(parameter, &message))?;
            overrides.extend(of_this.into_iter().map(|over| (over, parameter)));
        }
        if let Some((over, parameter)) =
            overrides.iter().find(|(over, _)| library.overrides.iter().any(|given| given.location() == over.location()))
        {
            let message = format!("{}: the sweep changes what --set fixes", over.location());
            return Err(self.wrong(parameter, &message));
        }
        trial::load(&library.with(overrides.iter().map(|(over, _)| over.clone())), trial).map_err(|error| match error {
            ConfigError::Override { text, message } => match overrides.iter().find(|(over, _)| over.text == text) {
                Some((over, parameter)) => self.wrong(parameter, &format!("{}: {message}", over.text)),
                None => ConfigError::Override { text, message },
            },
            // Pieces that do not fit together at this point: say at which.
            ConfigError::Combination { path, message } if !overrides.is_empty() => {
                let at: Vec<&str> = overrides.iter().map(|(over, _)| over.text.as_str()).collect();
                ConfigError::Combination { path, message: format!("{message} (with {})", at.join(", ")) }
            }
            error => error,
        })
    }

    /// The list of runs. `resolved` holds, for each trial and in it for each of [`Self::points`], what
    /// [`Self::resolve`] made of it.
    ///
    /// A controller that has no place for a parameter, such as a PID for a gain of AGSTA, runs once, not once per value.
    ///
    /// # Errors
    /// When a parameter concerns no controller, a name is unknown, or a run would be there twice.
    pub fn plan(&self, resolved: Vec<Vec<Vec<ResolvedTrial>>>, points: &[Point]) -> Result<Plan, ConfigError> {
        let mut configurations = Vec::new();
        let mut used = vec![false; self.parameters.len()];
        for of_trial in resolved {
            for (at_point, point) in of_trial.into_iter().zip(points) {
                for trial in at_point {
                    let laws: Vec<&str> = std::iter::once(&trial.controller)
                        .chain(trial.standby.iter().map(|(_, law)| law))
                        .map(|config| config.law.name())
                        .collect();
                    let concerned: Vec<bool> = self.parameters.iter().map(|one| one.concerns(&laws)).collect();
                    used.iter_mut().zip(&concerned).for_each(|(used, concerned)| *used |= concerned);
                    let of_sample = |parameter: &Parameter, concerned: &bool| parameter.sampled && *concerned;
                    let sampled = self.seed_per_sample
                        || self.parameters.iter().zip(&concerned).any(|(one, concerned)| of_sample(one, concerned));
                    let first = |i: usize| match self.parameters[i].sampled {
                        true => sampled || point.sample == 0,
                        false => concerned[i] || point.choice[i] == 0,
                    };
                    if !(0..self.parameters.len()).all(first) {
                        continue;
                    }
                    let value = |i: usize| concerned[i].then(|| self.parameters[i].values[point.choice[i]].clone());
                    let values = (0..self.parameters.len()).map(value).collect();
                    configurations.push(Configuration { trial, grid: point.grid, sample: point.sample, values });
                }
            }
        }
        if let Some((parameter, _)) = self.parameters.iter().zip(used).find(|(_, used)| !used) {
            return Err(self.wrong(parameter, "no controller here has this law"));
        }
        self.check_names(&configurations.iter().map(|one| one.trial.controller_name.as_str()).collect())?;
        let (grid, sampled) = (self.grid_points()? > 1, self.samples > 1);
        let mut runs = Vec::new();
        let mut ids = BTreeSet::new();
        for (configuration, one) in configurations.iter().enumerate() {
            let seeds = match self.seed_per_sample {
                true => vec![self.seeds[0].saturating_add(one.sample as u64)],
                false => self.seeds.clone(),
            };
            let mut name = crate::run::base_name(&one.trial);
            if grid {
                name += &format!("-grid{}", one.grid);
            }
            if sampled {
                name += &format!("-sample{}", one.sample);
            }
            for seed in seeds {
                let id = format!("{name}-seed{seed}");
                if !ids.insert(id.clone()) {
                    fits(&self.path, Err(format!("run {id} is there twice: trials need names of their own")))?;
                }
                runs.push(PlannedRun { id, configuration, seed });
            }
            if runs.len() > MOST_RUNS {
                fits(&self.path, Err(format!("more than {MOST_RUNS} runs")))?;
            }
        }
        Ok(Plan { configurations, runs })
    }
}
