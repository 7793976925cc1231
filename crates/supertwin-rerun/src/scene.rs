//! The picture in three dimensions: net, vehicle, its path and the beams of its DVL.

use crate::chunks::{Problem, Rows, Times, columns, fixed, text};
use rerun::log::Chunk;
use supertwin_core::run::Scene as Geometry;

/// Signal that moves the vehicle: north, east, depth, heading.
const POSE: &str = "/plant/truth/pose";
/// Signal with the range along each beam; 0 where nothing came back.
const RANGE: &str = "/plant/measurements/dvl_range";

/// The vehicle moves in the picture at every so many ticks.
const MOVE_EVERY: i64 = 5;
/// A piece of the path is drawn at every so many moves.
const PIECE: usize = 5;

const NET_COLOR: u32 = 0x7F9F_8FA0;
const BODY_COLOR: u32 = 0xF2C1_2EFF;
const PATH_COLOR: u32 = 0x4DA6_FFFF;
const BEAM_COLOR: u32 = 0xFF4B_4BC0;

/// What moves.
#[derive(Default)]
pub(crate) struct Scene {
    beams: [[f64; 3]; 4],
    /// The last piece of the path that is not drawn yet, starting where the drawn path ends.
    piece: Vec<[f32; 3]>,
}

impl Scene {
    pub(crate) fn new(geometry: &Geometry) -> Self {
        Self { beams: geometry.beams, piece: Vec::new() }
    }

    /// What does not move.
    pub(crate) fn fixed(geometry: &Geometry) -> Result<Vec<Chunk>, Problem> {
        let half = geometry.body_half_size_m.map(narrow);
        let nose = [half[0], 0.0, 0.0];
        let mut chunks = vec![
            fixed("world", &rerun::ViewCoordinates::RIGHT_HAND_Z_DOWN())?,
            // The first view has its origin here, and a view knows up and down only from its origin.
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
        if !geometry.net_lines_m.is_empty() {
            let strips = geometry.net_lines_m.iter().map(|line| line.iter().map(|point| point.map(narrow)));
            let net = rerun::LineStrips3D::new(strips.map(Iterator::collect::<Vec<_>>))
                .with_colors([NET_COLOR])
                .with_radii([rerun::Radius::new_ui_points(0.6)]);
            chunks.push(fixed("world/net", &net)?);
        }
        Ok(chunks)
    }

    /// What moves because of these rows.
    pub(crate) fn draw(&mut self, rows: &Rows) -> Result<Vec<Chunk>, Problem> {
        if rows.width != 4 {
            return Ok(Vec::new());
        }
        match rows.entity.to_string().as_str() {
            POSE => self.moves(rows),
            RANGE => self.pings(rows),
            _ => Ok(Vec::new()),
        }
    }

    fn moves(&mut self, rows: &Rows) -> Result<Vec<Chunk>, Problem> {
        let ticks = rows.times.ticks();
        let kept: Vec<u32> = (0..rows.times.len() as u32).filter(|&i| ticks[i as usize] % MOVE_EVERY == 0).collect();
        let poses: Vec<&[f64]> = kept.iter().map(|&i| &rows.values[i as usize * 4..][..4]).collect();
        let mut chunks = Vec::new();
        if kept.is_empty() {
            return Ok(chunks);
        }
        let place = |pose: &&[f64]| [narrow(pose[0]), narrow(pose[1]), narrow(pose[2])];
        let turn = |pose: &&[f64]| {
            let half = 0.5 * pose[3];
            rerun::Quaternion::from_xyzw([0.0, 0.0, narrow(half.sin()), narrow(half.cos())])
        };
        let transforms = rerun::Transform3D::update_fields()
            .with_many_translation(poses.iter().map(place))
            .with_many_quaternion(poses.iter().map(turn));
        chunks.push(columns(
            "world/vehicle".into(),
            rows.times.select(&kept),
            transforms.columns_of_unit_batches().map_err(text)?,
        )?);

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
            chunks.push(columns(
                "world/path".into(),
                rows.times.select(&ends),
                path.columns_of_unit_batches().map_err(text)?,
            )?);
        }
        Ok(chunks)
    }

    fn pings(&self, rows: &Rows) -> Result<Vec<Chunk>, Problem> {
        let mut strips = Vec::new();
        let mut lengths = Vec::new();
        for ranges in rows.values.chunks_exact(4) {
            let before = strips.len();
            for (beam, &range) in self.beams.iter().zip(ranges).filter(|(_, range)| **range > 0.0) {
                strips.push([[0.0; 3], beam.map(|x| narrow(x * range))]);
            }
            lengths.push(strips.len() - before);
        }
        let n = strips.len();
        let beams = rerun::LineStrips3D::new(strips)
            .with_colors(std::iter::repeat_n(BEAM_COLOR, n))
            .with_radii(std::iter::repeat_n(rerun::Radius::new_ui_points(1.0), n));
        let times: Times = rows.times.clone();
        Ok(vec![columns("world/vehicle/beams".into(), times, beams.columns(lengths).map_err(text)?)?])
    }
}

/// The picture is in single precision; the numbers themselves are recorded as signals.
fn narrow(x: f64) -> f32 {
    x as f32
}
