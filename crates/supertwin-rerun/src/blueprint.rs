//! The dashboards: which curves stand where when a recording is opened.
//!
//! Rerun 0.36 has no setters for the properties of a view, such as linked time axes. A [`Dashboard`] therefore
//! remembers properties by the path of their view, and [`messages`] puts them next to what Rerun itself writes.

use crate::APPLICATION;
use crate::chunks::{Problem, text};
use rerun::blueprint::{
    Blueprint, BlueprintActivation, BlueprintPanel, ContainerLike, Grid, Horizontal, SelectionPanel, Spatial3DView,
    StateTimelineView, Tabs, TextLogView, TimePanel, TimeSeriesView, Vertical,
};
use rerun::datatypes::{TimeRange, TimeRangeBoundary, VisibleTimeRange};
use rerun::external::re_sdk_types::blueprint::{archetypes as properties, components as values};
use rerun::log::{Chunk, LogMsg, RowId};
use rerun::time::{TimePoint, Timeline};
use rerun::{AsComponents, SerializedComponentBatch, StoreKind};
use values::Corner2D::{self, LeftTop, RightBottom, RightTop};

/// Views in their places, with what Rerun's own builders can't say.
pub struct Dashboard {
    root: ContainerLike,
    /// Path in the blueprint, and what stands there.
    properties: Properties,
}

/// Properties of views, and the stretch of time that curves show at first.
#[derive(Default)]
struct Properties {
    span_s: Option<f64>,
    list: Vec<(String, Vec<SerializedComponentBatch>)>,
}

/// The view that is embedded in every recording: the whole of a run whose length `span_s` is known.
#[must_use]
pub fn first_view(span_s: Option<f64>) -> Dashboard {
    let mut properties = Properties { span_s, ..Properties::default() };
    let tabs = [tracking(&mut properties), control(&mut properties)];
    Dashboard { root: Tabs::new(tabs).with_active_tab("0").into(), properties }
}

/// Does the vehicle do what it should? Measured, wanted and true, beside the picture.
fn tracking(properties: &mut Properties) -> ContainerLike {
    let plots = [
        ("Distance to net [m]", "/tracking/distance", RightTop),
        ("Total speed [m/s]", "/tracking/speed", RightBottom),
        ("Surge [m/s]", "/tracking/surge", RightTop),
        ("Sway [m/s]", "/tracking/sway", RightBottom),
        ("Depth [m]", "/tracking/depth", RightBottom),
        ("Heading [rad]", "/tracking/heading", RightBottom),
    ];
    let plots: Vec<_> = plots.map(|(name, path, corner)| curves(properties, name, path, corner)).into();
    let mode = StateTimelineView::new("Mode of guidance").with_origin("/guidance/reference/mode").into();
    // The state timeline knows no range of its own; linked, it shows what the time panel shows.
    set(properties, &mode, "TimeAxis", &properties::TimeAxis::new().with_link(values::LinkAxis::LinkToGlobal));
    let left = Vertical::new([picture(properties), mode]).with_row_shares([5.0, 1.0]);
    let right = Grid::new(plots).with_grid_columns(2);
    let both = Horizontal::new([left.into(), right.into()]).with_column_shares([0.75, 1.25]);
    both.with_name("Tracking").into()
}

/// How does the controller do it? Sliding variables, gains and forces.
fn control(properties: &mut Properties) -> ContainerLike {
    let mut plot = |name, path, corner| curves(properties, name, path, corner);
    let error = [
        plot("Sliding variable σ [m/s, m, rad]", "/controller/sigma", RightTop),
        plot("Gain k1 [N/√σ, N m/√σ]", "/controller/k1", LeftTop),
        plot("Requested wrench [N, N m]", "/controller/thrust/requested", RightTop),
    ];
    let integral = [
        plot("Integrator z [N, N m]", "/controller/z", RightTop),
        plot("Gain k2 [N/s, N m/s]", "/controller/k2", LeftTop),
        plot("Allocated wrench [N, N m]", "/controller/thrust/allocated", RightTop),
    ];
    let force = plot("Thruster force [N]", "/controller/thrust/force", RightTop);
    let events = TextLogView::new("Events").with_origin("/event").into();
    let last = Horizontal::new([events, force]).with_column_shares([2.0, 1.0]);
    let rows = [Horizontal::new(error).into(), Horizontal::new(integral).into(), last.into()];
    Vertical::new(rows).with_name("Control").into()
}

/// What happens around the vehicle, seen from behind it.
fn picture(properties: &mut Properties) -> ContainerLike {
    // The origin moves with the vehicle, so that it stays in view wherever it goes.
    let view = Spatial3DView::new("Vehicle, path (blue), DVL beams (red), net").with_origin("/world/vehicle");
    let view: ContainerLike = view.with_contents(["/world/**"]).into();
    // The path so far; everything else only as it is now.
    let range = TimeRange { start: TimeRangeBoundary::Infinite, end: TimeRangeBoundary::AT_CURSOR };
    let so_far = VisibleTimeRange { timeline: crate::TIME.into(), range };
    set(
        properties,
        &view,
        "ViewContents/overrides/world/path/visualizers",
        &properties::VisibleTimeRanges::new([so_far]),
    );
    let eye = properties::EyeControls3D::new()
        .with_kind(values::Eye3DKind::Orbital)
        .with_position([-6.0, 3.5, -3.5])
        .with_look_target([0.8, 0.0, 0.0])
        .with_eye_up([0.0, 0.0, -1.0]);
    set(properties, &view, "EyeControls3D", &eye);
    let water = properties::Background::new(values::BackgroundKind::SolidColor).with_color(0x0A1E_2AFF);
    set(properties, &view, "Background", &water);
    set(properties, &view, "LineGrid3D", &properties::LineGrid3D::new().with_visible(false));
    view
}

/// The curves of one signal over time.
fn curves(properties: &mut Properties, name: &str, path: &str, legend: Corner2D) -> ContainerLike {
    let view = TimeSeriesView::new(name).with_contents([path]).into();
    link_time(properties, &view);
    set(properties, &view, "PlotLegend", &properties::PlotLegend::new().with_corner(legend));
    view
}

/// All curves show the same stretch of time: all of it, or, when that is not known, what the time panel shows.
///
/// Linked axes ignore a range of their own and follow the cursor at the end of the run, which hides most of it.
fn link_time(properties: &mut Properties, view: &ContainerLike) {
    let axis = match properties.span_s {
        Some(span_s) => {
            let at = |t_s: f64| TimeRangeBoundary::Absolute(((t_s * 1e9) as i64).into());
            // A quarter more leaves room for the legends beside the curves.
            let range = TimeRange { start: at(0.0), end: at(1.25 * span_s) };
            properties::TimeAxis::new().with_link(values::LinkAxis::Independent).with_view_range(range)
        }
        None => properties::TimeAxis::new().with_link(values::LinkAxis::LinkToGlobal),
    };
    set(properties, view, "TimeAxis", &axis);
}

fn set(properties: &mut Properties, view: &ContainerLike, what: &str, property: &dyn AsComponents) {
    if let ContainerLike::View(view) = view {
        properties.list.push((format!("{}/{what}", view.blueprint_path()), property.as_serialized_batches()));
    }
}

/// What has to be written for the viewer to show `dashboard`, the command that makes it so at the end.
///
/// # Errors
/// When Rerun refuses the dashboard.
pub fn messages(dashboard: Dashboard) -> Result<Vec<LogMsg>, String> {
    compose(dashboard).map_err(text)
}

fn compose(dashboard: Dashboard) -> Result<Vec<LogMsg>, Problem> {
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
    let stream = rerun::RecordingStreamBuilder::new(APPLICATION).enabled(true).send_properties(false);
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
    for (path, batches) in dashboard.properties.list {
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

    #[test]
    fn every_curve_is_linked_to_the_others_and_has_a_legend() {
        let dashboard = first_view(None);
        let count = |what: &str| dashboard.properties.list.iter().filter(|(path, _)| path.ends_with(what)).count();
        assert_eq!(count("/TimeAxis"), 14);
        assert_eq!(count("/PlotLegend"), 13);
        assert_eq!(count("/EyeControls3D"), 1);
    }

    #[test]
    fn the_command_that_activates_comes_last() {
        let messages = messages(first_view(Some(120.0))).unwrap();
        assert!(matches!(messages.last(), Some(LogMsg::BlueprintActivationCommand(_))));
        let commands = messages.iter().filter(|message| matches!(message, LogMsg::BlueprintActivationCommand(_)));
        assert_eq!(commands.count(), 1);
        assert!(messages.iter().all(|message| message.store_id().application_id().as_str() == APPLICATION));
    }
}
