//! A lamp so close that its light differs from place to place.
//!
//! Under an environment that is a further lamp. Where lamps are known it is these that stand close: their light comes from
//! different directions at different places, and falls off.

use glam::Vec3;
use render::bvh::offset_origin;

use super::{Effect, Stage, Term, support::lamp_slope};
use crate::criticism::{
    horizon::Source, light::Light, observe::Observations, scene::Scene, transport::reflect,
};

/// Small white lamps at finite places around the object; the number is intensity.
pub struct NearFieldLight;

/// Distances that are tried, in radii of the object from its centre.
const DISTANCES: [f32; 3] = [1.6, 2.4, 3.6];

impl Effect for NearFieldLight {
    fn id(&self) -> &'static str {
        "near_field_light"
    }
    fn describe(&self) -> &'static str {
        "a lamp stands close to the object"
    }
    fn stage(&self) -> Stage {
        Stage::IncidentLight
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["finer_environment", "finer_albedo", "ground_bounce"]
    }
    fn shown_by(&self) -> &'static str {
        "move the object by its own width and leave the lights: light from near by changes, light from afar does not"
    }
    fn under(&self, _light: Light) -> bool {
        true
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        if let Some(lamps) = scene.horizon.lamps() {
            return vec![nearness(scene, lamps)];
        }
        let typical = f64::from(scene.typical());
        let mut terms = Vec::new();
        for &distance in &DISTANCES {
            for direction in directions() {
                let lamp = distance * scene.radius * direction;
                // A lamp outside the object only: within it there is no light to be seen.
                let field = field(scene, lamp);
                let [x, y, z] = [lamp.x, lamp.y, lamp.z].map(|v| v / scene.radius);
                let name = format!(
                    "intensity at ({x:.1}, {y:.1}, {z:.1}) radii (share of the middle value)"
                );
                // One stands for a lamp that adds about the middle value where it shines most.
                let largest = field.iter().fold(1e-12f32, |m, f| m.max(*f));
                let unit = (typical / f64::from(largest)) as f32;
                let field = field.iter().map(|f| unit * f).collect();
                terms.push(Term::new(name, 0.3, field).positive());
            }
        }
        terms
    }
    fn moved_lamps(
        &self,
        lamps: &[Source],
        seen: &Observations,
        beta: &[f64],
    ) -> Option<Vec<Source>> {
        let nearness = beta.first().copied().filter(|nearness| *nearness != 0.0)?;
        let nearness = nearness as f32 / radius(seen);
        let moved = lamps.iter().map(|lamp| Source { nearness, ..*lamp });
        Some(moved.collect())
    }
}

/// How close all known lamps stand: one over their distance.
fn nearness(scene: &Scene<'_>, lamps: &[Source]) -> Term {
    const STEP: f32 = 0.01;
    let step = STEP / radius(scene.seen);
    let mut field = vec![0.0; scene.size()];
    for (t, lamp) in lamps.iter().enumerate() {
        let at = |nearness| Source { nearness, ..*lamp };
        let (near, far) = (at(lamp.nearness + step), at(lamp.nearness - step));
        let slope = lamp_slope(scene, t, &near, &far, 2.0 * STEP);
        field.iter_mut().zip(slope).for_each(|(f, s)| *f += s);
    }
    let name = "nearness of all lamps: radii of the object to one of their distance".to_owned();
    Term::new(name, 0.05, field).positive().at_most(0.5)
}

/// Radius of what is seen of the object, from its middle.
fn radius(seen: &Observations) -> f32 {
    let lengths = seen.sites.iter().map(|s| s.point.position.length());
    lengths.fold(1e-9, f32::max)
}

/// 26 directions: faces, edges and corners of a cube.
fn directions() -> Vec<Vec3> {
    (0..27)
        .filter(|&i| i != 13)
        .map(|i| {
            let at = |k: i32| (k - 1) as f32;
            Vec3::new(at(i % 3), at(i / 3 % 3), at(i / 9)).normalize()
        })
        .collect()
}

/// Light of a small lamp of intensity one on every view.
fn field(scene: &Scene<'_>, lamp: Vec3) -> Vec<f32> {
    let reaching: Vec<Option<(Vec3, f32)>> = scene
        .seen
        .sites
        .iter()
        .map(|site| {
            let point = site.point.position;
            let to = lamp - point;
            let squared = to.length_squared();
            let direction = to / squared.sqrt();
            let cosine = site.point.normal.dot(direction);
            let facing = cosine > 0.0 && site.point.geometric_normal.dot(direction) > 0.0;
            // The object is all there is, so a shadow ray may end anywhere beyond it.
            let lit = facing && !scene.bvh.blocked(offset_origin(&site.point), direction);
            lit.then_some((direction, cosine * scene.radius.powi(2) / squared))
        })
        .collect();
    scene.on_views(|v| {
        let site = scene.seen.views[v].site as usize;
        let Some((direction, arriving)) = reaching[site] else {
            return [0.0; 3];
        };
        let normal = scene.seen.sites[site].point.normal;
        let (d, s) = reflect(scene.lobe, normal, direction, scene.outgoing(v));
        let albedo = scene.albedo_of(v);
        [0, 1, 2].map(|c| arriving * (albedo[c] * d + s))
    })
}
