//! The picture in three dimensions: net, vehicle with its thrusters, its path, the beams of its DVL, the current.

use crate::chunks::{Problem, Rows, columns, fixed};
use crate::style;
use rerun::log::Chunk;
use supertwin_core::Signal;
use supertwin_core::run::Scene as Geometry;
use supertwin_core::signal::measurements::dvl;
use supertwin_core::signal::{Component, estimator, truth};

/// The net, in the picture.
pub(crate) const NET: &str = "world/net";

/// The vehicle moves in the picture at every so many ticks.
const MOVE_EVERY: i64 = 5;
/// A piece of the path is drawn at every so many moves.
const PIECE: usize = 5;
/// Length of the arrow of a force.
const METRES_PER_NEWTON: f64 = 0.025;
/// Length of the arrow of the current.
const METRES_PER_SPEED: f64 = 5.0;
/// The arrow of the current starts so far above the vehicle.
const CURRENT_ABOVE_M: f64 = 0.8;

/// Where the vehicle is, and where it heads.
const PLACE: [Component; 3] = [truth::POSE.at("north"), truth::POSE.at("east"), truth::POSE.at("depth")];
const HEADING: Component = truth::POSE.at("heading");

const NET_COLOR: u32 = 0x7F9F_8FA0;
const BODY_COLOR: u32 = 0xF2C1_2EFF;
const PATH_COLOR: u32 = 0x4DA6_FFFF;
const THRUSTER_COLOR: u32 = 0x3030_30FF;
const FORCE_COLOR: u32 = 0xFF8C_1AFF;
const CURRENT_COLOR: u32 = 0x4CE0_E0FF;

/// What moves in the picture: path, beams and forces of the thrusters.
#[derive(Default)]
pub(crate) struct Scene {
    beams: [[f64; 3]; 4],
    /// Directions of the thrusters' forces.
    thrusters: Vec<[f64; 3]>,
    /// Nobody has said yet whether beams are good.
    unjudged: bool,
    /// The last piece of the path that is not drawn yet, starting where the drawn path ends.
    piece: Vec<[f32; 3]>,
}

impl Scene {
    pub(crate) fn new(geometry: &Geometry) -> Self {
        let thrusters = geometry.thrusters.iter().map(|thruster| thruster.direction).collect();
        Self { beams: geometry.beams, thrusters, unjudged: true, piece: Vec::new() }
    }

    /// What does not move.
    pub(crate) fn fixed(geometry: &Geometry) -> Result<Vec<Chunk>, Problem> {
        let half = geometry.body_half_size_m.map(narrow);
        let nose = [half[0], 0.0, 0.0];
        let mut chunks = vec![
            fixed("world", &rerun::ViewCoordinates::RIGHT_HAND_Z_DOWN())?,
            // The overview has its origin here, and a view knows up and down only from its origin.
            fixed("world/vehicle", &rerun::ViewCoordinates::RIGHT_HAND_Z_DOWN())?,
            fixed(
                "world/vehicle/body",
                &rerun::Boxes3D::from_half_sizes([half])
                    .with_fill_mode(rerun::FillMode::Solid)
                    .with_colors([BODY_COLOR]),
            )?,
            fixed(
                "world/vehicle/bow",
                &rerun::Arrows3D::from_vectors([[half[0].max(0.1) * 1.5, 0.0, 0.0]])
                    .with_origins([nose])
                    .with_colors([0xFFFF_FFFFu32])
                    .with_radii([half[2].max(0.02) * 0.2]),
            )?,
        ];
        chunks.extend([
            fixed(
                "world/vehicle/marker",
                &rerun::Points3D::new([[0.0; 3]])
                    .with_radii([rerun::Radius::new_ui_points(6.0)])
                    .with_colors([BODY_COLOR]),
            )?,
            fixed(
                "world/vehicle/beams",
                &rerun::LineStrips3D::update_fields().with_radii([rerun::Radius::new_ui_points(1.5)]),
            )?,
            fixed(
                "world/current",
                &rerun::Arrows3D::update_fields()
                    .with_colors([CURRENT_COLOR])
                    .with_radii([0.025])
                    .with_labels(["current"])
                    .with_show_labels(true),
            )?,
        ]);
        if !geometry.thrusters.is_empty() {
            let places = || geometry.thrusters.iter().map(|thruster| thruster.position_m.map(narrow));
            let n = geometry.thrusters.len();
            let housings = rerun::Boxes3D::from_centers_and_half_sizes(places(), vec![[0.07; 3]; n]);
            let housings = housings.with_fill_mode(rerun::FillMode::Solid).with_colors([THRUSTER_COLOR]);
            chunks.push(fixed("world/vehicle/thrusters", &housings)?);
            // Drawn from above the hull, where it can be seen.
            let above = places().map(|[x, y, z]| [x, y, z - half[2] * 1.05]);
            let forces = rerun::Arrows3D::update_fields().with_origins(above).with_colors([FORCE_COLOR]);
            chunks.push(fixed("world/vehicle/thrust", &forces.with_radii([0.03]))?);
        }
        if !geometry.net_lines_m.is_empty() {
            let strips = geometry.net_lines_m.iter().map(|line| line.iter().map(|point| point.map(narrow)));
            let net = rerun::LineStrips3D::new(strips.map(Iterator::collect::<Vec<_>>))
                .with_colors([NET_COLOR])
                .with_radii([rerun::Radius::new_ui_points(0.6)]);
            chunks.push(fixed(NET, &net)?);
        }
        Ok(chunks)
    }

    /// What moves because of these rows of `signal`.
    pub(crate) fn draw(&mut self, signal: &Signal, rows: &Rows) -> Result<Vec<Chunk>, Problem> {
        match signal.path {
            _ if rows.are_of(signal, &truth::POSE) => self.moves(rows),
            _ if rows.are_of(signal, &dvl::RANGE) => self.pings(rows),
            _ if rows.are_of(signal, &estimator::NET_PLANE_ACCEPTED) => self.judges(rows),
            path if path == truth::THRUSTER_FORCE.path && rows.width == self.thrusters.len() => self.pushes(rows),
            _ if rows.are_of(signal, &truth::CURRENT) => flows(rows),
            _ => Ok(Vec::new()),
        }
    }

    fn moves(&mut self, rows: &Rows) -> Result<Vec<Chunk>, Problem> {
        let kept = now_and_then(rows);
        let poses: Vec<&[f64]> = kept.iter().map(|&i| &rows.values[i as usize * rows.width..][..rows.width]).collect();
        let mut chunks = Vec::new();
        if kept.is_empty() {
            return Ok(chunks);
        }
        let place = |pose: &&[f64]| PLACE.map(|part| narrow(pose[part.index]));
        let turn = |pose: &&[f64]| {
            let half = 0.5 * pose[HEADING.index];
            rerun::Quaternion::from_xyzw([0.0, 0.0, narrow(half.sin()), narrow(half.cos())])
        };
        let transforms = rerun::Transform3D::update_fields()
            .with_many_translation(poses.iter().map(place))
            .with_many_quaternion(poses.iter().map(turn));
        chunks.push(columns("world/vehicle", rows.times.select(&kept), transforms.columns_of_unit_batches())?);
        // The current goes along, but does not turn with the vehicle.
        let above = |pose: &&[f64]| {
            let [north, east, depth] = PLACE.map(|part| pose[part.index]);
            [narrow(north), narrow(east), narrow(depth - CURRENT_ABOVE_M)]
        };
        let along = rerun::Transform3D::update_fields().with_many_translation(poses.iter().map(above));
        chunks.push(columns("world/current", rows.times.select(&kept), along.columns_of_unit_batches())?);

        let (mut strips, mut ends) = (Vec::new(), Vec::new());
        for (&row, pose) in kept.iter().zip(&poses) {
            self.piece.push(place(pose));
            if self.piece.len() > PIECE {
                let from_here_on = vec![place(pose)];
                strips.push(std::mem::replace(&mut self.piece, from_here_on));
                ends.push(row);
            }
        }
        if !ends.is_empty() {
            let n = ends.len();
            let path = rerun::LineStrips3D::new(strips)
                .with_colors(std::iter::repeat_n(PATH_COLOR, n))
                .with_radii(std::iter::repeat_n(rerun::Radius::new_ui_points(1.5), n));
            chunks.push(columns("world/path", rows.times.select(&ends), path.columns_of_unit_batches())?);
        }
        Ok(chunks)
    }

    /// All four beams of a ping; one that did not come back has no length.
    fn pings(&mut self, rows: &Rows) -> Result<Vec<Chunk>, Problem> {
        let beams = rows.values.chunks_exact(rows.width).flat_map(|ranges| self.beams.iter().zip(ranges));
        let strips = beams.map(|(beam, &range)| [[0.0; 3], beam.map(|x| narrow(x * range.max(0.0)))]);
        let strips = rerun::LineStrips3D::update_fields().with_strips(strips);
        let n = rows.times.len();
        let entity = "world/vehicle/beams";
        let mut chunks = vec![columns(entity, rows.times.clone(), strips.columns(std::iter::repeat_n(4, n)))?];
        if std::mem::take(&mut self.unjudged) && n > 0 {
            let plain = rerun::LineStrips3D::update_fields().with_colors([style::BEAM; 4]);
            chunks.push(columns(entity, rows.times.select(&[0]), plain.columns([4]))?);
        }
        Ok(chunks)
    }

    /// Which beams of a ping the estimator used.
    fn judges(&mut self, rows: &Rows) -> Result<Vec<Chunk>, Problem> {
        self.unjudged = false;
        let colors = rows.values.iter().map(|&used| if used > 0.5 { style::ACCEPTED } else { style::REJECTED });
        let colors = rerun::LineStrips3D::update_fields().with_colors(colors);
        let colors = colors.columns(std::iter::repeat_n(4, rows.times.len()));
        Ok(vec![columns("world/vehicle/beams", rows.times.clone(), colors)?])
    }

    /// The force of every thruster, where it acts.
    fn pushes(&self, rows: &Rows) -> Result<Vec<Chunk>, Problem> {
        let kept = now_and_then(rows);
        let forces = kept.iter().flat_map(|&i| &rows.values[i as usize * rows.width..][..rows.width]);
        let arrows = forces.zip(self.thrusters.iter().cycle());
        let arrows = arrows.map(|(force, direction)| direction.map(|x| narrow(x * force * METRES_PER_NEWTON)));
        let arrows = rerun::Arrows3D::update_fields().with_vectors(arrows);
        let arrows = arrows.columns(std::iter::repeat_n(rows.width, kept.len()));
        Ok(vec![columns("world/vehicle/thrust", rows.times.select(&kept), arrows)?])
    }
}

/// Where the water goes.
fn flows(rows: &Rows) -> Result<Vec<Chunk>, Problem> {
    let kept = now_and_then(rows);
    let arrows = kept.iter().map(|&i| {
        let row = &rows.values[i as usize * rows.width..];
        [0, 1, 2].map(|axis| narrow(row[axis] * METRES_PER_SPEED))
    });
    let arrows = rerun::Arrows3D::update_fields().with_vectors(arrows);
    let arrows = arrows.columns_of_unit_batches();
    Ok(vec![columns("world/current", rows.times.select(&kept), arrows)?])
}

/// Places of the rows at which the picture moves.
fn now_and_then(rows: &Rows) -> Vec<u32> {
    let ticks = &rows.times.ticks;
    (0..rows.times.len() as u32).filter(|&i| ticks[i as usize] % MOVE_EVERY == 0).collect()
}

/// The picture is in single precision; the numbers themselves are recorded as signals.
fn narrow(x: f64) -> f32 {
    x as f32
}
