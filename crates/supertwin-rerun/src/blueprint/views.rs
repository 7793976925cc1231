//! Plots, pictures and lanes, with the properties that Rerun 0.36 has no setters for.
//!
//! A [`Canvas`] remembers properties by the path of their view; [`super::messages`] puts them next to what Rerun itself
//! writes.

use super::About;
use crate::style;
use rerun::blueprint::{
    BarChartView, ContainerLike, Spatial3DView, StateTimelineView, Tabs, TextDocumentView, TextLogView, TimeSeriesView,
};
use rerun::datatypes::{TimeRange, TimeRangeBoundary, VisibleTimeRange};
use rerun::external::re_sdk_types::blueprint::{archetypes as properties, components as values, datatypes};
use rerun::{AsComponents, SerializedComponentBatch};
use supertwin_core::Signal;
use supertwin_core::signal::Component;

/// What is being drawn so far.
#[derive(Debug)]
pub(super) struct Canvas {
    pub(super) about: About,
    pub(super) views: Vec<View>,
    /// Path in the blueprint, and what stands there.
    pub(super) properties: Vec<(String, Vec<SerializedComponentBatch>)>,
}

/// One view of a dashboard.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct View {
    /// Title that people read above the view.
    pub name: String,
    /// Identifier in the blueprint.
    pub id: String,
    /// Entities, or entities below a path that ends in `/**`.
    pub entities: Vec<String>,
    /// What is drawn, when it is a plot.
    pub curves: Vec<Curves>,
    /// Part of its width that is left of its legend.
    pub share: f64,
    /// Behind another view, until its tab is chosen.
    pub behind: bool,
    /// Background by which a program finds the plot in a picture; see [`super::Dashboard::mark_plots`].
    pub mark: Option<[u8; 3]>,
}

/// Curves of one entity in a plot.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curves {
    /// Entity with a leading slash.
    pub entity: String,
    /// Component that is shown, and how many there are; all of them without it.
    pub only: Option<(usize, usize)>,
    /// Colour instead of the signal's own.
    pub color: Option<u32>,
    /// Name instead of the signal's own.
    pub name: Option<String>,
    /// Broad, to be seen behind others that cover it.
    pub broad: bool,
}

/// Where a signal is in a recording.
pub(super) fn entity(signal: &Signal) -> String {
    format!("/{}", signal.path)
}

/// All signals that stand beside this one.
pub(super) fn siblings(signal: &Signal) -> String {
    format!("/{}/**", signal.path.rsplit_once('/').map_or(signal.path, |(below, _)| below))
}

/// Units of a signal, each once.
fn units(signal: &Signal) -> String {
    let mut units: Vec<&str> = Vec::new();
    for unit in signal.units {
        if !units.contains(unit) {
            units.push(unit);
        }
    }
    units.join(", ")
}

/// All components of the signal at `path`.
pub(super) fn all(path: &str) -> Curves {
    Curves { entity: format!("/{path}"), ..Curves::default() }
}

/// One component of a signal.
pub(super) fn only(component: Component) -> Curves {
    only_of(component, component.signal.width())
}

/// One component of a signal that shows only `width` of them.
pub(super) fn only_of(component: Component, width: usize) -> Curves {
    Curves { only: Some((component.index, width)), ..all(component.signal.path) }
}

impl Curves {
    /// In another colour.
    pub(super) fn in_color(mut self, color: u32) -> Self {
        self.color = Some(color);
        self
    }

    /// Broad, to be seen behind others that cover it.
    pub(super) fn broad(mut self) -> Self {
        self.broad = true;
        self
    }

    /// With another name; only for entities with one component, as equal names hide each other.
    pub(super) fn called(mut self, name: &str) -> Self {
        self.name = Some(name.to_owned());
        self
    }

    /// What differs from how the signal itself says it looks.
    fn differences(&self) -> Option<rerun::SeriesLines> {
        let (component, width) = self.only?;
        let mut lines = rerun::SeriesLines::new().with_visible_series((0..width).map(|i| i == component));
        if let Some(color) = self.color {
            lines = lines.with_colors(std::iter::repeat_n(color, width));
        }
        if let Some(name) = &self.name {
            lines = lines.with_names(std::iter::repeat_n(name.as_str(), width));
        }
        if self.broad {
            lines = lines.with_widths(std::iter::repeat_n(4.0, width));
        }
        Some(lines)
    }
}

/// Where a plot explains its colours.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Legend {
    /// Right of the curves, which leave it this share of their own width.
    Beside(f64),
    /// Over the curves.
    Over,
    /// Nowhere: the title says it.
    None,
}

impl Canvas {
    pub(super) fn new(about: &About) -> Self {
        Self { about: about.clone(), views: Vec::new(), properties: Vec::new() }
    }

    /// All components of a signal over time, with its units in the title.
    pub(super) fn signal(&mut self, name: &str, signal: &Signal, legend: Legend) -> ContainerLike {
        self.plot(&format!("{name} [{}]", units(signal)), &[all(signal.path)], legend)
    }

    /// One component of a signal over time, with its unit in the title.
    pub(super) fn component(&mut self, name: &str, component: Component) -> ContainerLike {
        self.plot(&format!("{name} [{}]", component.unit()), &[only(component)], Legend::None)
    }

    /// Curves over time.
    pub(super) fn plot(&mut self, name: &str, curves: &[Curves], legend: Legend) -> ContainerLike {
        let mut view = TimeSeriesView::new(name).with_contents(curves.iter().map(|curves| curves.entity.as_str()));
        for curves in curves {
            if let Some(lines) = curves.differences() {
                view = view.with_override(curves.entity.as_str(), &lines);
            }
        }
        let view = view.into();
        let room = if let Legend::Beside(room) = legend { room } else { 0.02 };
        self.link_time(&view, room);
        let shown = properties::PlotLegend::new().with_corner(values::Corner2D::RightTop);
        self.set(&view, "PlotLegend", &shown.with_visible(legend != Legend::None));
        self.remember(&view, name, curves.iter().map(|curves| curves.entity.clone()).collect());
        if let Some(kept) = self.views.last_mut() {
            kept.curves = curves.to_vec();
            kept.share = 1.0 / (1.0 + room);
        }
        view
    }

    /// States over time, a lane for each entity.
    pub(super) fn lanes(&mut self, name: &str, entities: &[String]) -> ContainerLike {
        let view = StateTimelineView::new(name).with_contents(entities.iter().map(String::as_str)).into();
        // It knows no range of its own; linked, it shows what the time panel shows.
        self.set(&view, "TimeAxis", &properties::TimeAxis::new().with_link(values::LinkAxis::LinkToGlobal));
        self.remember(&view, name, entities.to_vec());
        view
    }

    /// A view of a Markdown document.
    pub(super) fn document(&mut self, name: &str, entity: &str) -> ContainerLike {
        let view = TextDocumentView::new(name).with_origin(entity).with_contents([entity]).into();
        self.remember(&view, name, vec![entity.to_owned()]);
        view
    }

    /// Bars beside each other, one per entity.
    pub(super) fn bars(&mut self, name: &str, entities: &[String]) -> ContainerLike {
        let view = BarChartView::new(name).with_contents(entities.iter().map(String::as_str)).into();
        // It would say whole paths.
        self.set(&view, "PlotLegend", &properties::PlotLegend::new().with_visible(false));
        self.remember(&view, name, entities.to_vec());
        view
    }

    /// A view of all events in the order of their ticks.
    pub(super) fn events(&mut self, name: &str) -> ContainerLike {
        let view = TextLogView::new(name).with_origin("/event").into();
        let column = |kind, shown: bool| datatypes::TextLogColumn { visible: shown.into(), kind };
        // The service is in the entity's path, which needs more room than there is.
        let columns = [
            column(datatypes::TextLogColumnKind::EntityPath, false),
            column(datatypes::TextLogColumnKind::LogLevel, true),
            column(datatypes::TextLogColumnKind::Body, true),
        ];
        self.set(&view, "TextLogColumns", &properties::TextLogColumns::new().with_text_log_columns(columns));
        self.remember(&view, name, vec!["/event/**".to_owned()]);
        view
    }

    /// A picture seen from `eye`, which looks at `target`; both are relative to `origin`.
    pub(super) fn picture(
        &mut self,
        name: &str,
        origin: &str,
        contents: &[&str],
        eye: [f32; 3],
        target: [f32; 3],
    ) -> ContainerLike {
        let view = Spatial3DView::new(name).with_origin(origin).with_contents(contents.iter().copied()).into();
        // The path so far; everything else only as it is now.
        let range = TimeRange { start: TimeRangeBoundary::Infinite, end: TimeRangeBoundary::AT_CURSOR };
        let so_far = VisibleTimeRange { timeline: crate::TIME.into(), range };
        let path = "ViewContents/overrides/world/path/visualizers";
        self.set(&view, path, &properties::VisibleTimeRanges::new([so_far]));
        let eye = properties::EyeControls3D::new()
            .with_kind(values::Eye3DKind::Orbital)
            .with_position(eye)
            .with_look_target(target)
            .with_eye_up([0.0, 0.0, -1.0]);
        self.set(&view, "EyeControls3D", &eye);
        let water = properties::Background::new(values::BackgroundKind::SolidColor).with_color(style::WATER);
        self.set(&view, "Background", &water);
        self.set(&view, "LineGrid3D", &properties::LineGrid3D::new().with_visible(false));
        let entities = contents.iter().filter(|content| content.starts_with('/'));
        self.remember(&view, name, entities.map(|&entity| entity.to_owned()).collect());
        view
    }

    /// All curves show the same stretch of time: all of it, or, when that is not known, what the time panel shows.
    ///
    /// Linked axes ignore a range of their own and show half a minute around the cursor, which hides most of a run.
    fn link_time(&mut self, view: &ContainerLike, room: f64) {
        let axis = match self.about.span_s {
            Some(span_s) => {
                let from_s = self.about.from_s;
                let at = |t_s: f64| TimeRangeBoundary::Absolute(((t_s * 1e9) as i64).into());
                let range = TimeRange { start: at(from_s), end: at(from_s + (1.0 + room) * span_s) };
                properties::TimeAxis::new().with_link(values::LinkAxis::Independent).with_view_range(range)
            }
            None => properties::TimeAxis::new().with_link(values::LinkAxis::LinkToGlobal),
        };
        self.set(view, "TimeAxis", &axis);
    }

    fn set(&mut self, view: &ContainerLike, what: &str, property: &dyn AsComponents) {
        if let ContainerLike::View(view) = view {
            self.properties.push((format!("{}/{what}", view.blueprint_path()), property.as_serialized_batches()));
        }
    }

    fn remember(&mut self, view: &ContainerLike, name: &str, entities: Vec<String>) {
        if let ContainerLike::View(view) = view {
            let path = view.blueprint_path().to_string();
            let id = path.rsplit('/').next().unwrap_or_default().to_owned();
            self.views.push(View { name: name.to_owned(), id, entities, share: 1.0, ..View::default() });
        }
    }

    /// Numbers the plots, as [`super::Dashboard::mark_plots`] describes.
    pub(super) fn mark_plots(&mut self) {
        for (i, view) in self.views.iter_mut().enumerate().filter(|(_, view)| !view.curves.is_empty()) {
            let mark = [8 + i as u8 % 8, 0, 8 + i as u8 / 8];
            let [r, g, b] = mark;
            let background = properties::PlotBackground::new().with_color(u32::from_be_bytes([r, g, b, 255]));
            let background = background.with_show_grid(false).as_serialized_batches();
            self.properties.push((format!("view/{}/PlotBackground", view.id), background));
            view.mark = Some(mark);
        }
    }

    /// Views side by side as tabs, the first one in front.
    pub(super) fn tabs<const N: usize>(&mut self, views: [ContainerLike; N]) -> ContainerLike {
        let behind = self.views.len() + 1 - N;
        self.views[behind..].iter_mut().for_each(|view| view.behind = true);
        Tabs::new(views).with_active_tab("0").into()
    }
}
