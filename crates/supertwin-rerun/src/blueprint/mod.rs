//! The dashboards: which curves stand where when a recording is opened.
//!
//! Each dashboard is one file here and one line of [`DASHBOARDS`], which says what it answers; each that suits any run is
//! also one file in the folder `dashboards`. Every recording carries all that suit it, as tabs.

mod adaptation;
mod compare;
mod estimation;
mod link;
mod overview;
mod thrusters;
mod tracking;
mod views;

use crate::chunks::text;
use crate::{APPLICATION, COMPARISON};
pub use compare::{Compared, TABS, Tab};
use rerun::StoreKind;
use rerun::blueprint::{
    Blueprint, BlueprintActivation, BlueprintPanel, ContainerLike, SelectionPanel, Tabs, TimePanel,
};
use rerun::external::re_log_encoding::Encoder;
use rerun::external::re_sdk_types::blueprint::components as values;
use rerun::log::{Chunk, LogMsg, RowId};
use rerun::time::{TimePoint, Timeline};
use supertwin_core::{Capability, Property, RunHeader};
use views::Canvas;
pub use views::{Curves, View};

/// All dashboards, in the order of the tabs.
pub static DASHBOARDS: &[Description] = &[
    Description::of_a_run(
        "overview",
        "where the vehicle is and what it is doing: 3-D picture, modes, events",
        overview::views,
    ),
    Description::of_a_run(
        "tracking",
        "measured, wanted and true signals: the paper's figures 3, 4 and 6",
        tracking::views,
    ),
    Description::of_a_run(
        "adaptation",
        "sliding variable, adaptive gains (figure 5), integrator, wrench, chattering",
        adaptation::views,
    ),
    Description::of_a_run(
        "estimation",
        "innovations with their gates, NIS, deviations, disturbance, beams, net plane",
        estimation::views,
    ),
    Description::of_a_run(
        "thrusters",
        "commands, forces, saturation, requested against allocated wrench",
        thrusters::views,
    ),
    Description {
        suits: |about| about.network,
        ..Description::of_a_run(
            "link",
            "ages, gaps, rates, step times and deadlines of the services; network recordings only",
            link::views,
        )
    },
    Description {
        name: "compare",
        about: "several runs side by side; only files of `supertwin compare --out` have it, for their runs' names",
        suits: |_| false,
        views: None,
    },
];

/// A dashboard.
#[derive(Debug)]
pub struct Description {
    /// Its name, and the name of its file.
    pub name: &'static str,
    /// What it answers, in one line.
    pub about: &'static str,
    /// Whether a run has what it shows.
    suits: fn(&About) -> bool,
    /// Draws it; `None` of the dashboard that depends on which runs are compared.
    views: Option<fn(&mut Canvas) -> ContainerLike>,
}

impl Description {
    const fn of_a_run(name: &'static str, about: &'static str, views: fn(&mut Canvas) -> ContainerLike) -> Self {
        Self { name, about, suits: |_| true, views: Some(views) }
    }

    /// The dashboard for a run; `None` of the one that depends on which runs are compared.
    #[must_use]
    pub fn dashboard(&self, about: &About) -> Option<Dashboard> {
        let mut canvas = Canvas::new(about);
        let root = self.views?(&mut canvas);
        Some(Dashboard { application: APPLICATION, root, canvas })
    }
}

/// Views in their places, with what Rerun's own builders can't say.
#[derive(Debug)]
pub struct Dashboard {
    application: &'static str,
    root: ContainerLike,
    canvas: Canvas,
}

/// What the dashboards depend on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct About {
    /// Length of the run, when it is known: all plots show all of it. Otherwise their time axes are linked, and they
    /// show the same stretch around the cursor.
    pub span_s: Option<f64>,
    /// Where that stretch begins; before 0 when time is counted from an event in the run.
    pub from_s: f64,
    /// What laws that come to command show; when none is known, everything is drawn.
    pub capabilities: Vec<Capability>,
    /// The laws that come to command are known, and have none of the capabilities.
    pub plain_law: bool,
    /// How many thrusters there are; 0 when that is not known.
    pub thrusters: usize,
    /// The services talked over a network.
    pub network: bool,
}

impl About {
    /// Of a run that begins like this.
    #[must_use]
    pub fn run(header: &RunHeader) -> Self {
        let properties = &header.properties;
        let words = |name: &str| match properties.get(name) {
            Some(Property::Text(text)) => text.split_whitespace().map(str::to_owned).collect(),
            _ => Vec::new(),
        };
        let capabilities = words("capabilities").iter().filter_map(|name| Capability::named(name)).collect();
        let plain_law = matches!(properties.get("capabilities"), Some(Property::Text(text)) if text.is_empty());
        let network =
            words("placement").first().is_some_and(|placement| !["batch", "replay"].contains(&placement.as_str()));
        let span_s = match properties.get("duration_s") {
            Some(Property::Number(span_s)) => Some(*span_s),
            _ => None,
        };
        Self { span_s, from_s: 0.0, capabilities, plain_law, thrusters: header.scene.thrusters.len(), network }
    }

    /// Whether a law with this can have been in command. Who steers from outside says nothing of the vehicle's own law.
    fn has(&self, capability: Capability) -> bool {
        let known = self.plain_law || self.capabilities.iter().any(|known| *known != Capability::External);
        !known || self.capabilities.contains(&capability)
    }
}

impl Dashboard {
    /// The dashboard with this name.
    #[must_use]
    pub fn named(name: &str, about: &About) -> Option<Self> {
        DASHBOARDS.iter().find(|described| described.name == name)?.dashboard(about)
    }

    /// All dashboards that suit a run, as tabs.
    #[must_use]
    pub fn all(about: &About) -> Self {
        let mut canvas = Canvas::new(about);
        let suiting = DASHBOARDS.iter().filter(|described| (described.suits)(about));
        let tabs: Vec<ContainerLike> = suiting.filter_map(|described| Some(described.views?(&mut canvas))).collect();
        Self { application: APPLICATION, root: Tabs::new(tabs).with_active_tab("0").into(), canvas }
    }

    /// The dashboard of runs that stand side by side, or the one of its [`TABS`] with this name.
    #[must_use]
    pub fn compare(compared: &Compared, only: Option<&str>) -> Self {
        let mut canvas = Canvas::new(&compared.about);
        let tabs = compare::tabs(&mut canvas, compared, only);
        Self { application: COMPARISON, root: Tabs::new(tabs).with_active_tab("0").into(), canvas }
    }

    /// Gives every plot a background of its own, almost black and without a grid: a program that looks at a picture
    /// knows where each plot is.
    pub fn mark_plots(&mut self) {
        self.canvas.mark_plots();
    }

    /// Its views, in no particular order.
    #[must_use]
    pub fn views(&self) -> &[View] {
        &self.canvas.views
    }
}

/// The content of a `.rbl` file.
///
/// # Errors
/// When Rerun refuses the dashboard.
pub fn file(dashboard: Dashboard) -> Result<Vec<u8>, String> {
    Encoder::encode(messages(dashboard)?.into_iter().map(Ok)).map_err(text)
}

/// What has to be written for the viewer to show `dashboard`, the command that makes it so at the end.
///
/// # Errors
/// When Rerun refuses the dashboard.
pub fn messages(dashboard: Dashboard) -> Result<Vec<LogMsg>, String> {
    let time = TimePanel::new()
        .with_state(values::PanelState::Collapsed)
        .with_timeline(crate::TIME)
        .with_play_state(values::PlayState::Following);
    let blueprint = Blueprint::new(dashboard.root)
        .with_auto_views(false)
        .with_auto_layout(false)
        .with_blueprint_panel(BlueprintPanel::from_state(values::PanelState::Collapsed))
        .with_selection_panel(SelectionPanel::from_state(values::PanelState::Collapsed))
        .with_time_panel(time);
    let stream = rerun::RecordingStreamBuilder::new(dashboard.application).enabled(true).send_properties(false);
    let (stream, storage) = stream.memory().map_err(text)?;
    blueprint.send(&stream, BlueprintActivation::default()).map_err(text)?;
    let (mut messages, mut activation, mut store) = (Vec::new(), None, None);
    for message in storage.take() {
        if message.store_id().kind() != StoreKind::Blueprint {
            continue;
        }
        store.get_or_insert_with(|| message.store_id().clone());
        match message {
            LogMsg::BlueprintActivationCommand(_) => activation = Some(message),
            _ => messages.push(message),
        }
    }
    let (Some(store), Some(activation)) = (store, activation) else {
        return Err("Rerun wrote no blueprint".to_owned());
    };
    let first = TimePoint::default().with(Timeline::new_sequence("blueprint"), 0);
    for (path, batches) in dashboard.canvas.properties {
        let chunk = Chunk::builder(path.as_str())
            .with_serialized_batches(RowId::new(), first.clone(), batches)
            .build()
            .map_err(text)?;
        messages.push(LogMsg::ArrowMsg(store.clone(), chunk.to_arrow_msg().map_err(text)?));
    }
    messages.push(activation);
    Ok(messages)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rerun::external::re_log_encoding::DecoderApp;
    use rerun::external::re_sdk_types::blueprint::archetypes::ViewBlueprint;
    use std::collections::BTreeSet;

    fn count(dashboard: &Dashboard, what: &str) -> usize {
        dashboard.canvas.properties.iter().filter(|(path, _)| path.ends_with(what)).count()
    }

    #[test]
    fn every_plot_has_a_time_axis_and_every_picture_an_eye() {
        let dashboard = Dashboard::all(&About { network: true, ..About::default() });
        let plots = dashboard.views().iter().filter(|view| !view.curves.is_empty()).count();
        let lanes = 4;
        assert_eq!(count(&dashboard, "/TimeAxis"), plots + lanes);
        assert_eq!(count(&dashboard, "/PlotLegend"), plots);
        assert_eq!(count(&dashboard, "/EyeControls3D"), 2);
        let ids: BTreeSet<_> = dashboard.views().iter().map(|view| &view.id).collect();
        assert_eq!(ids.len(), dashboard.views().len());
    }

    #[test]
    fn the_command_that_activates_comes_last() {
        let about = About { span_s: Some(120.0), ..About::default() };
        let messages = messages(Dashboard::all(&about)).unwrap();
        assert!(matches!(messages.last(), Some(LogMsg::BlueprintActivationCommand(_))));
        let commands = messages.iter().filter(|message| matches!(message, LogMsg::BlueprintActivationCommand(_)));
        assert_eq!(commands.count(), 1);
        assert!(messages.iter().all(|message| message.store_id().application_id().as_str() == APPLICATION));
    }

    #[test]
    fn what_is_known_of_a_run_comes_from_how_it_begins() {
        let mut header = RunHeader::default();
        assert_eq!(About::run(&header), About::default());
        header.properties.insert("capabilities".to_owned(), "".into());
        assert_eq!(About::run(&header), About { plain_law: true, ..About::default() });
        header.properties.insert("capabilities".to_owned(), "adaptive_gains integral".into());
        header.properties.insert("placement".to_owned(), "batch".into());
        header.properties.insert("duration_s".to_owned(), 30.0.into());
        let capabilities = vec![Capability::AdaptiveGains, Capability::Integral];
        assert_eq!(About::run(&header), About { span_s: Some(30.0), capabilities, ..About::default() });
        header.properties.insert("placement".to_owned(), "up".into());
        assert!(About::run(&header).network);
    }

    #[test]
    fn a_law_without_capabilities_has_its_errors_and_nothing_that_it_does_not_show() {
        let about = About { plain_law: true, ..About::default() };
        let dashboard = Dashboard::named("adaptation", &about).unwrap();
        let titles: Vec<&str> = dashboard.views().iter().map(|view| view.name.as_str()).collect();
        assert!(titles.contains(&"Surge error [m/s]"), "{titles:?}");
        assert!(titles.iter().all(|title| !["σ", "Gain", "integral"].iter().any(|word| title.contains(word))));
    }

    /// Titles of the views in a file.
    fn titles(bytes: &[u8]) -> Vec<String> {
        let mut titles = Vec::new();
        for message in DecoderApp::decode_lazy(std::io::Cursor::new(bytes)) {
            if let LogMsg::ArrowMsg(_, message) = message.unwrap() {
                let chunk = Chunk::from_arrow_msg(&message).unwrap();
                let name = ViewBlueprint::descriptor_display_name().component;
                titles.extend(chunk.iter_slices::<String>(name).flatten().map(|title| title.as_str().to_owned()));
            }
        }
        titles.sort();
        titles
    }

    #[test]
    fn the_files_in_the_folder_dashboards_are_those_that_would_be_written_now() {
        // Their identifiers are new every time, so they are compared by what they show.
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../dashboards");
        let mut written = BTreeSet::new();
        for described in DASHBOARDS {
            let about = About { network: true, ..About::default() };
            let Some(dashboard) = described.dashboard(&about) else { continue };
            let path = format!("{folder}/{}.rbl", described.name);
            let kept = titles(&std::fs::read(&path).unwrap());
            let advice = "supertwin dashboard --save dashboards --force";
            assert_eq!(kept, titles(&file(dashboard).unwrap()), "{path} is out of date: {advice}");
            assert!(!kept.is_empty());
            written.insert(format!("{}.rbl", described.name));
        }
        let there = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        assert_eq!(there.filter(|name| name.ends_with(".rbl")).collect::<BTreeSet<_>>(), written);
    }
}
