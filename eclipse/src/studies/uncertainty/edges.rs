//! Pixels beside rims and contacts, where a surface ends or another begins: what is found of one side is a part of the other's there.

use glam::Vec3;
use render::bvh::Bvh;

use super::spread::Spread;
use crate::studies::{StudyError, trial::Trial};

/// Neighbours whose normals differ by more, as a cosine, are of two surfaces or of a rim.
const TURNED: f32 = 0.7;

/// What of the albedo's errors is at edges.
pub(super) struct Edges {
    /// Shares of all pixels, and of the squared error.
    pub shares: [f64; 2],
    /// Rank correlation of errors and deviations elsewhere.
    pub elsewhere: f64,
}

impl Edges {
    /// Of the albedo's `spread`, which has a value for each pixel of all photographs and channel.
    pub(super) fn new(spread: &Spread, trial: &Trial) -> Result<Self, StudyError> {
        let at = at_edges(trial)?;
        let at: Vec<bool> = at.into_iter().flat_map(|edge| [edge; 3]).collect();
        Ok(Self {
            shares: spread.shares(&at),
            elsewhere: spread.without(&at).place(),
        })
    }
}

/// Of each pixel of all photographs whether a neighbour is not of the object, or turned away from it.
fn at_edges(trial: &Trial) -> Result<Vec<bool>, StudyError> {
    let bvh = Bvh::new(&trial.capture.mesh)?;
    let mut all = Vec::new();
    for frame in &trial.capture.frames {
        let (width, height) = (frame.camera.width, frame.camera.height);
        let normal = |p: usize| -> Option<Vec3> {
            let (x, y) = ((p % width) as f32 + 0.5, (p / width) as f32 + 0.5);
            let seen = bvh.seen(&frame.camera, x, y);
            seen.map(|(point, _)| point.normal)
        };
        let normals: Vec<Option<Vec3>> = (0..width * height).map(normal).collect();
        all.extend((0..normals.len()).map(|p| is_edge(&normals, width, p)));
    }
    Ok(all)
}

/// Of a pixel of an image of so many columns.
fn is_edge(normals: &[Option<Vec3>], width: usize, p: usize) -> bool {
    let Some(own) = normals[p] else {
        return true;
    };
    let (x, last) = (p % width, normals.len() - width);
    let beside = [
        (x > 0).then(|| p - 1),
        (x + 1 < width).then_some(p + 1),
        (p >= width).then(|| p - width),
        (p < last).then_some(p + width),
    ];
    let mut beside = beside.into_iter().flatten();
    beside.any(|q| normals[q].is_none_or(|other| own.dot(other) < TURNED))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_beside_another_surface_or_none_are_edges() {
        let (up, side) = (Some(Vec3::Z), Some(Vec3::X));
        let normals = [
            up, up, up, side, side, //
            up, up, up, side, side, //
            up, up, None, side, side,
        ];
        let edges: Vec<usize> = (0..15).filter(|&p| is_edge(&normals, 5, p)).collect();
        assert_eq!(edges, [2, 3, 7, 8, 11, 12, 13]);
    }
}
