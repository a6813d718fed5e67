//! Light that the object sends to itself.

use glam::Vec3;
use rayon::prelude::*;
use render::{bvh::offset_origin, camera::Ray, math::Frame, sampler::SampleKey};

use super::{Effect, Stage, Term};
use crate::criticism::scene::Scene;

/// + η · (light that has been reflected by the object once before), η = 1 being physics.
pub struct Interreflection;

/// Rays a site sends out to see the object itself.
const RAYS: u32 = 96;

impl Effect for Interreflection {
    fn id(&self) -> &'static str {
        "interreflection"
    }
    fn describe(&self) -> &'static str {
        "the object lights itself, most in its concavities"
    }
    fn stage(&self) -> Stage {
        Stage::Transport
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["emission", "finer_albedo", "ground_bounce"]
    }
    fn shown_by(&self) -> &'static str {
        "light the object from one side so that one wall of a hollow is lit and the other is not: what the dark one shows comes from the object"
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        let light = reflected(scene);
        let field = scene.on_views(|v| {
            let albedo = scene.albedo_of(v);
            let site = scene.seen.views[v].site as usize;
            [0, 1, 2].map(|c| albedo[c] * light[site][c])
        });
        vec![Term::new("η (1 is physics)", 0.7, field).positive()]
    }
}

/// What an albedo of one would reflect of the object's own light, all bounces, at each site.
fn reflected(scene: &Scene<'_>) -> Vec<[f32; 3]> {
    let sites = &scene.seen.sites;
    // The light that each site sends out, at its mean over views.
    let mut radiosity = vec![[0.0f32; 3]; sites.len()];
    for (s, out) in radiosity.iter_mut().enumerate() {
        let views = scene.seen.offsets[s]..scene.seen.offsets[s + 1];
        for v in views.clone() {
            for c in 0..3 {
                out[c] += scene.albedo[3 * s + c].max(0.0) * scene.diffuse[3 * v + c]
                    / views.len() as f32;
            }
        }
    }
    let links: Vec<Vec<u32>> = sites
        .par_iter()
        .enumerate()
        .map(|(s, site)| {
            let frame = Frame::new(site.point.normal);
            let origin = offset_origin(&site.point);
            let mut stream = SampleKey {
                pixel: s as u32,
                dimension: 72,
                ..SampleKey::default()
            }
            .stream();
            (0..RAYS)
                .filter_map(|k| {
                    let [u, v] = stream.uniform_2d();
                    let r = ((k as f32 + u) / RAYS as f32).sqrt();
                    // The golden angle spreads the rays evenly.
                    let phi = 2.399_963 * k as f32 + v;
                    let local = Vec3::new(r * phi.cos(), r * phi.sin(), (1.0 - r * r).sqrt());
                    let direction = frame.to_world(local);
                    let hit = scene.bvh.closest(Ray { origin, direction })?;
                    let there = origin + hit.t * direction;
                    let nearest = (0..sites.len()).min_by(|&a, &b| {
                        let d = |i: usize| {
                            let p = &sites[i].point;
                            let away = if p.normal.dot(direction) > 0.0 {
                                4.0
                            } else {
                                1.0
                            };
                            away * p.position.distance_squared(there)
                        };
                        d(a).total_cmp(&d(b))
                    });
                    nearest.map(|n| n as u32)
                })
                .collect()
        })
        .collect();
    // A few rounds of gathering sum the bounces.
    let mut received = vec![[0.0f32; 3]; sites.len()];
    for _ in 0..4 {
        let sent: Vec<[f32; 3]> = (0..sites.len())
            .map(|s| {
                [0, 1, 2].map(|c| {
                    radiosity[s][c] + scene.albedo[3 * s + c].clamp(0.0, 1.0) * received[s][c]
                })
            })
            .collect();
        received = links
            .iter()
            .map(|link| {
                let mut sum = [0.0; 3];
                for &other in link {
                    for c in 0..3 {
                        sum[c] += sent[other as usize][c] / RAYS as f32;
                    }
                }
                sum
            })
            .collect();
    }
    received
}
