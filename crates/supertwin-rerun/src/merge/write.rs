//! What follows from all runs together, and where the dashboard finds it.

use super::load::{Loaded, MEASURED, REFERENCE, is_tracked};
use super::series::{self, Series};
use super::{Label, Merge, of_run, scores};
use crate::blueprint::{self, Compared, Curves, Dashboard};
use crate::chunks::{Problem, Rows, Times, columns, fixed};
use crate::scene::NET;
use crate::sink::properties;
use crate::style;
use crate::writer::Job;
use rerun::external::re_log_types::{SetStoreInfo, StoreInfo, StoreSource};
use rerun::log::RowId;
use rerun::{EntityPath, RecordingInfo, StoreId};
use supertwin_core::axes::AXIS_NAMES;
use supertwin_core::run::Properties;
use supertwin_core::signal::tracking::QUANTITIES;
use supertwin_core::signal::{Component, controller, reference, truth};
use supertwin_core::source::Columns;

/// Rows of a piece.
const PIECE: usize = 8192;
/// References that are this near to each other are the same.
const SAME_REFERENCE: f64 = 1e-6;
/// More different references than these would hide what they are for.
const MOST_REFERENCES: usize = 3;
/// A vehicle moves in the picture this often.
const MOVE_EVERY_NS: i64 = 200_000_000;
/// Names beside vehicles are read up to so many.
const MOST_NAMES: usize = 8;

/// Where a vehicle is in the picture.
const PLACE: [Component; 3] = [truth::POSE.at("north"), truth::POSE.at("east"), truth::POSE.at("depth")];

/// Of a median, a single run, and the limits of a group.
const WIDTHS: [f32; 3] = [2.5, 1.5, 0.75];

/// Sends everything but the verbatim recordings.
pub(super) fn all(
    merge: &Merge,
    runs: &[Loaded],
    every: i64,
    store: &StoreId,
    send: &mut dyn FnMut(Job) -> Result<(), Problem>,
) -> Result<Compared, Problem> {
    let mut drawing = Drawing::new(merge, runs);
    drawing.tracking()?;
    drawing.references()?;
    drawing.differences()?;
    drawing.adaptation()?;
    drawing.scene()?;
    drawing.scores(every)?;
    let signals = if merge.all { drawing.modes() } else { drawing.signals()? };
    let source = StoreSource::Other(concat!("supertwin ", env!("CARGO_PKG_VERSION")).to_owned());
    let info = StoreInfo::new(store.clone(), source);
    send(Job::Message(SetStoreInfo { row_id: *RowId::new(), info }.into()))?;
    for message in blueprint::messages(Dashboard::compare(&drawing.compared, None))? {
        send(Job::Message(message))?;
    }
    send(Job::Chunk(fixed(EntityPath::properties(), &RecordingInfo::new().with_name(merge.name.as_str()))?))?;
    if let Some(job) = properties("compare", &about(merge, every))? {
        send(job)?;
    }
    drawing.jobs.into_iter().chain(signals).try_for_each(send)?;
    Ok(drawing.compared)
}

/// What is in the file and where it is from.
fn about(merge: &Merge, every: i64) -> Properties {
    let runs = merge.runs.iter().map(|run| {
        let files: Vec<_> = run.paths.iter().map(|path| path.display().to_string()).collect();
        format!("{}\t{}\t{} s\t{}", run.name, merge.groups[run.group], run.offset_ns as f64 / 1e9, files.join(", "))
    });
    let runs: Vec<String> = runs.collect();
    let baseline = merge.groups.get(merge.baseline).cloned().unwrap_or_default();
    let aligned_on = if merge.aligned_on.is_empty() { "start" } else { &merge.aligned_on };
    Properties::from([
        ("runs".to_owned(), runs.join("\n").into()),
        ("baseline".to_owned(), baseline.into()),
        ("aligned_on".to_owned(), aligned_on.to_owned().into()),
        ("every_ticks".to_owned(), (every as u64).into()),
    ])
}

/// What is written and shown so far.
struct Drawing<'a> {
    merge: &'a Merge,
    runs: &'a [Loaded],
    labels: Vec<Label>,
    /// Runs of each label.
    members: Vec<Vec<usize>>,
    /// Some labels are groups of several runs.
    several: bool,
    jobs: Vec<Job>,
    compared: Compared,
}

impl<'a> Drawing<'a> {
    fn new(merge: &'a Merge, runs: &'a [Loaded]) -> Self {
        let members = (0..merge.groups.len())
            .map(|group| (0..runs.len()).filter(|&run| merge.runs[run].group == group).collect::<Vec<_>>());
        let members: Vec<_> = members.collect();
        let several = members.iter().any(|members| members.len() > 1);
        let names = merge.groups.iter().enumerate();
        let labels = names.map(|(i, name)| Label { name: name.clone(), color: style::palette(i) });
        let times = || {
            runs.iter()
                .flat_map(|run| run.signals.values())
                .flat_map(|columns| columns.time_ns.first().into_iter().chain(columns.time_ns.last()))
        };
        let from = times().min().copied().unwrap_or(0) as f64 / 1e9;
        let to = times().max().copied().unwrap_or(0) as f64 / 1e9;
        let mut compared =
            Compared { several, baseline: merge.groups.get(merge.baseline).cloned(), ..Compared::default() };
        compared.about.from_s = from;
        compared.about.span_s = Some((to - from).max(1e-3));
        compared.aligned_on.clone_from(&merge.aligned_on);
        Self { merge, runs, labels: labels.collect(), members, several, jobs: Vec::new(), compared }
    }

    /// A curve per label in the plot `kind`, such as `error/sway`; `of` gives that of one run.
    fn curves(&mut self, kind: &str, of: impl Fn(usize, &Loaded) -> Option<Series>) -> Result<(), Problem> {
        for label in 0..self.labels.len() {
            let members = self.members[label].iter().filter_map(|&run| of(run, &self.runs[run]));
            let members: Vec<Series> = members.filter(|series| !series.tick.is_empty()).collect();
            self.curve(kind, label, members)?;
        }
        Ok(())
    }

    fn curve(&mut self, kind: &str, label: usize, mut members: Vec<Series>) -> Result<(), Problem> {
        let label = self.labels[label].clone();
        let [median, single, limit] = WIDTHS;
        let entity = curve_entity(kind, &label);
        if !self.several {
            return members.pop().map_or(Ok(()), |series| self.draw(kind, &entity, &label, &[single], &series));
        }
        let spread = series::spread(&members);
        if spread.tick.is_empty() { Ok(()) } else { self.draw(kind, &entity, &label, &[median, limit, limit], &spread) }
    }

    /// Adds lines of these widths to a plot, as many as `series` has values a row. Curves of one name and colour are one line
    /// of the legend.
    fn draw(
        &mut self,
        kind: &str,
        entity: &EntityPath,
        label: &Label,
        widths: &[f32],
        series: &Series,
    ) -> Result<(), Problem> {
        let n = widths.len();
        let lines = rerun::SeriesLines::new()
            .with_names(std::iter::repeat_n(label.name.as_str(), n))
            .with_colors(std::iter::repeat_n(label.color, n))
            .with_widths(widths.iter().copied());
        self.jobs.push(Job::Chunk(fixed(entity.clone(), &lines)?));
        self.jobs.extend(pieces(entity, &series.tick, &series.time_ns, n, &series.values));
        let (color, name) = (Some(label.color), Some(label.name.clone()));
        let curves = Curves { entity: entity.to_string(), color, name, ..Curves::default() };
        self.compared.plots.entry(kind.to_owned()).or_default().push(curves);
        Ok(())
    }

    /// The six quantities, their errors, and what these come to.
    fn tracking(&mut self) -> Result<(), Problem> {
        for (i, quantity) in QUANTITIES.iter().enumerate() {
            let name = quantity.signal.name();
            let curve = format!("curve/{name}");
            let error = |which| {
                move |_: usize, run: &Loaded| {
                    Series::error(run.tracking(quantity)?, which, REFERENCE, quantity.is_angle())
                }
            };
            let measured = |_: usize, run: &Loaded| Series::of(run.tracking(quantity)?, MEASURED);
            // Runs of a group start in any direction: only what they deviate by can be put together.
            if self.several && quantity.is_angle() {
                self.curves(&curve, error(MEASURED))?;
            } else {
                self.curves(&curve, measured)?;
            }
            self.curves(&format!("error/{name}"), error(MEASURED))?;
            self.curves(&format!("rms/{name}"), |_, run| run.rms[0][i].clone())?;
            self.curves(&format!("true_rms/{name}"), |_, run| run.rms[1][i].clone())?;
        }
        Ok(())
    }

    /// What was wanted, where the runs do not each want something else.
    fn references(&mut self) -> Result<(), Problem> {
        for quantity in &QUANTITIES {
            if self.several && quantity.is_angle() {
                continue;
            }
            let mut references: Vec<Series> = Vec::new();
            for run in self.runs {
                let Some(reference) = run.tracking(quantity).and_then(|columns| Series::of(columns, REFERENCE)) else {
                    continue;
                };
                let same = |known: &Series| {
                    known.distance(&reference, quantity.is_angle()).is_some_and(|distance| distance <= SAME_REFERENCE)
                };
                match references.iter_mut().find(|known| same(known)) {
                    Some(known) if known.tick.len() < reference.tick.len() => *known = reference,
                    Some(_) => {}
                    None => references.push(reference),
                }
                if references.len() > MOST_REFERENCES {
                    break;
                }
            }
            if references.len() > MOST_REFERENCES {
                continue;
            }
            let label = Label { name: "reference".to_owned(), color: style::REFERENCE };
            for (i, reference) in references.iter().enumerate() {
                let kind = format!("curve/{}", quantity.signal.name());
                let entity = EntityPath::from(format!("compare/reference/{}/{}", quantity.signal.name(), i + 1));
                self.draw(&kind, &entity, &label, &[1.5], reference)?;
            }
        }
        Ok(())
    }

    /// Every run minus the one that it is held against.
    fn differences(&mut self) -> Result<(), Problem> {
        let (merge, runs) = (self.merge, self.runs);
        let against = |run: usize| merge.runs[run].against.filter(|&other| other != run).map(|other| &runs[other]);
        if (0..runs.len()).all(|run| against(run).is_none()) {
            return Ok(());
        }
        for (i, quantity) in QUANTITIES.iter().enumerate() {
            let kinds = ["difference/rms_", "difference/"].map(|kind| format!("{kind}{}", quantity.signal.name()));
            self.curves(&kinds[0], |run, loaded| {
                Some(loaded.rms[0][i].as_ref()?.minus(against(run)?.rms[0][i].as_ref()?, false))
            })?;
            self.curves(&kinds[1], |run, loaded| {
                let of = |run: &Loaded| Series::of(run.tracking(quantity)?, MEASURED);
                Some(of(loaded)?.minus(&of(against(run)?)?, quantity.is_angle()))
            })?;
            for kind in &kinds {
                // Alone it says nothing.
                if self.compared.plots.contains_key(kind) {
                    self.zero(kind)?;
                }
            }
        }
        Ok(())
    }

    /// The baseline differs from itself by nothing.
    fn zero(&mut self, kind: &str) -> Result<(), Problem> {
        let baseline = self.merge.baseline;
        let Some(label) = self.labels.get(baseline).cloned() else { return Ok(()) };
        let rows = |run: usize| self.runs[run].signals.values().max_by_key(|columns| columns.tick.len());
        let Some(columns) = self.members[baseline].first().and_then(|&run| rows(run)) else { return Ok(()) };
        let ends = |all: &[i64]| [all.first(), all.last()].map(|end| end.copied().unwrap_or(0)).to_vec();
        let zero = Series { tick: ends(&columns.tick), time_ns: ends(&columns.time_ns), values: vec![0.0, 0.0] };
        self.draw(kind, &curve_entity(kind, &label), &label, &[WIDTHS[1]], &zero)
    }

    /// Sliding variables and gains of the laws that have them.
    fn adaptation(&mut self) -> Result<(), Problem> {
        for (kind, signal) in [("sigma", &controller::SIGMA), ("k1", &controller::K1)] {
            for (i, axis) in AXIS_NAMES.iter().enumerate() {
                let kind = format!("{kind}/{axis}");
                self.curves(&kind, |_, run| Series::of(run.signals.get(signal.path)?, i))?;
            }
        }
        Ok(())
    }

    /// The pen, with the way of every vehicle and where it is.
    fn scene(&mut self) -> Result<(), Problem> {
        let scene = EntityPath::from("compare/scene");
        self.jobs.push(Job::Chunk(fixed(scene.clone(), &rerun::ViewCoordinates::RIGHT_HAND_Z_DOWN())?));
        let named = self.runs.len() <= MOST_NAMES;
        for run in self.runs {
            let net = run.moved(NET, &scene.join(&EntityPath::from("net")))?;
            if !net.is_empty() {
                self.jobs.extend(net.into_iter().map(Job::Chunk));
                self.compared.scene = true;
                break;
            }
        }
        for (run, loaded) in self.merge.runs.iter().zip(self.runs) {
            let Some(pose) = loaded.signals.get(truth::POSE.path).filter(|pose| pose.width == truth::POSE.width())
            else {
                continue;
            };
            let kept = now_and_then(&pose.time_ns);
            let place = |&row: &usize| PLACE.map(|part| pose.values[row * pose.width + part.index] as f32);
            let places: Vec<[f32; 3]> = kept.iter().map(place).collect();
            if places.is_empty() {
                continue;
            }
            let Label { name, color } = &self.labels[run.group];
            let of = |what: &str| {
                scene.join(&EntityPath::from(what)).join(&EntityPath::from_single_string(run.name.as_str()))
            };
            let way = rerun::LineStrips3D::new([places.clone()])
                .with_colors([*color])
                .with_radii([rerun::Radius::new_ui_points(if named { 1.75 } else { 1.0 })]);
            let mut marker = rerun::Points3D::update_fields()
                .with_colors([*color])
                .with_radii([rerun::Radius::new_ui_points(if named { 6.0 } else { 3.0 })]);
            if named {
                marker = marker.with_labels([name.as_str()]).with_show_labels(true);
            }
            let times = times(&pick(&pose.tick, &kept), &pick(&pose.time_ns, &kept));
            let moves = rerun::Points3D::update_fields().with_positions(places);
            self.jobs.push(Job::Chunk(fixed(of("path"), &way)?));
            self.jobs.push(Job::Chunk(fixed(of("vehicle"), &marker)?));
            self.jobs.push(Job::Chunk(columns(of("vehicle"), times, moves.columns_of_unit_batches())?));
            self.compared.scene = true;
        }
        Ok(())
    }

    fn scores(&mut self, every: i64) -> Result<(), Problem> {
        let mut after = Vec::new();
        if self.several {
            after.push(
                "Curves of a group: its median, and thin lines that a tenth of its runs are below and above."
                    .to_owned(),
            );
        }
        if !self.merge.aligned_on.is_empty() {
            after.push(format!("0 s is: {}.", self.merge.aligned_on));
        }
        if every > 1 {
            after.push(format!("Curves show one tick of {every}; the scores come from all of them."));
        }
        let words = scores::markdown(&self.merge.scores, &self.labels, &after.join(" "));
        let document = rerun::TextDocument::from_markdown(words);
        self.jobs.push(Job::Chunk(fixed("compare/scores/text", &document)?));
        for row in self.merge.scores.rows.iter().filter(|row| row.chart) {
            let bars = scores::bars(row, &self.labels)?;
            let entities = bars.iter().map(|bar| bar.entity_path().to_string()).collect();
            self.compared.bars.push((row.chart_title(&self.labels), entities));
            self.jobs.extend(bars.into_iter().map(Job::Chunk));
        }
        Ok(())
    }

    /// Where the modes of guidance will be.
    fn modes(&mut self) -> Vec<Job> {
        if !self.several {
            let has = |loaded: &Loaded| {
                loaded.drawings.iter().any(|piece| *piece.entity_path() == EntityPath::from(reference::MODE.path))
            };
            let runs = self.merge.runs.iter().zip(self.runs).filter(|(_, loaded)| has(loaded));
            self.compared.lanes = runs.map(|(run, _)| of_run(&run.name, reference::MODE.path).to_string()).collect();
        }
        Vec::new()
    }

    /// What was recorded, as far as the dashboard shows it.
    fn signals(&mut self) -> Result<Vec<Job>, Problem> {
        let mut jobs = self.modes();
        for (run, loaded) in self.merge.runs.iter().zip(self.runs) {
            let shown = |path: &str| path != truth::POSE.path && (!self.several || is_tracked(path));
            for (path, columns) in loaded.signals.iter().filter(|(path, _)| shown(path)) {
                let entity = of_run(&run.name, path);
                jobs.push(Job::Chunk(fixed(entity.clone(), &lines(path, columns))?));
                jobs.extend(pieces(&entity, &columns.tick, &columns.time_ns, columns.width, &columns.values));
            }
            if !self.several {
                jobs.extend(
                    loaded
                        .moved(reference::MODE.path, &of_run(&run.name, reference::MODE.path))?
                        .into_iter()
                        .map(Job::Chunk),
                );
            }
        }
        Ok(jobs)
    }
}

fn curve_entity(kind: &str, label: &Label) -> EntityPath {
    let plot = EntityPath::from("compare").join(&EntityPath::from(kind));
    plot.join(&EntityPath::from_single_string(label.name.as_str()))
}

/// How a signal looked in its recording.
fn lines(path: &str, columns: &Columns) -> rerun::SeriesLines {
    let bare = |name: &str| name.split(" [").next().unwrap_or_default().to_owned();
    let colors = columns.names.iter().enumerate().map(|(i, name)| style::color(path, &bare(name), i));
    rerun::SeriesLines::new().with_names(columns.names.iter().map(String::as_str)).with_colors(colors)
}

fn pieces<'a>(
    entity: &'a EntityPath,
    tick: &'a [i64],
    time_ns: &'a [i64],
    width: usize,
    values: &'a [f64],
) -> impl Iterator<Item = Job> + 'a {
    let rows = tick.chunks(PIECE).zip(time_ns.chunks(PIECE)).zip(values.chunks(PIECE * width.max(1)));
    rows.map(move |((tick, time_ns), values)| {
        let rows = Rows { entity: entity.clone(), times: times(tick, time_ns), width, values: values.to_vec() };
        Job::Batch(vec![rows])
    })
}

fn times(tick: &[i64], time_ns: &[i64]) -> Times {
    Times::new(tick.to_vec(), time_ns.to_vec())
}

/// Places of rows that are at least so far apart that something moves, and of the last.
fn now_and_then(time_ns: &[i64]) -> Vec<usize> {
    let mut kept = Vec::new();
    let mut next = i64::MIN;
    for (row, &time) in time_ns.iter().enumerate() {
        if time >= next || row + 1 == time_ns.len() {
            kept.push(row);
            next = time.saturating_add(MOVE_EVERY_NS);
        }
    }
    kept
}

fn pick(all: &[i64], rows: &[usize]) -> Vec<i64> {
    rows.iter().map(|&row| all[row]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vehicle_moves_now_and_then_and_at_the_end() {
        let times: Vec<i64> = (0..24).map(|k| k * 20_000_000).collect();
        assert_eq!(now_and_then(&times), [0, 10, 20, 23]);
        assert_eq!(now_and_then(&[]), [0; 0]);
    }

    #[test]
    fn long_curves_are_cut_into_pieces_with_all_rows() {
        let n = PIECE as i64 + 3;
        let tick: Vec<i64> = (0..n).collect();
        let values: Vec<f64> = (0..2 * n).map(|x| x as f64).collect();
        let entity = EntityPath::from("a");
        let rows = pieces(&entity, &tick, &tick, 2, &values).map(|job| match job {
            Job::Batch(mut rows) => rows.pop().map(|rows| (rows.times.len(), rows.values.len())),
            _ => None,
        });
        assert_eq!(rows.collect::<Vec<_>>(), [Some((PIECE, 2 * PIECE)), Some((3, 6))]);
    }
}
