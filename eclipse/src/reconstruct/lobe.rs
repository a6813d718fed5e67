//! The specular lobe of a whole object, and what it adds to the photographs beyond a diffuse surface.
//!
//! Light and occluders are solved for as if the surface were diffuse, on photographs from which the rest of the current
//! model (the coat's own reflection, and the diffuse light it takes away) is subtracted: a fixed-point iteration that
//! converges because the rest is a small part of the light. The lobe itself is fitted with light and occluders held.

use rayon::prelude::*;
use render::bvh::SurfacePoint;

use super::{
    patches::{Observations, View},
    shading::{Lobe, Scene, Shade},
};

/// About how many patches the lobe is fitted to.
const FITTED_PATCHES: usize = 250;
/// Members of a patch that stand for it.
const MEMBERS: usize = 2;
/// The narrowest lobe: beyond, the grid of light is too coarse to tell.
const NARROWEST: f32 = 0.08;
/// Precision of the albedo's tie to one half.
const TIE: f64 = 16.0;

/// The lobe that explains the photographs best under this light and these occluders.
///
/// `scene.lobe` is ignored. The albedo of every patch is eliminated in closed form.
pub fn fit(scene: &Scene<'_>, seen: &Observations) -> Lobe {
    let step = seen.patches.len().div_ceil(FITTED_PATCHES).max(1);
    let patches: Vec<usize> = (0..seen.patches.len()).step_by(step).collect();
    let views = Views::new(seen, &patches);
    let at = |alpha: f32, kappa: f32| {
        let lobe = Some(Lobe { alpha, kappa });
        views.shades(&Scene { lobe, ..*scene }, seen)
    };
    // The model is polynomial in κ: the diffuse part goes with (1 − κ)², the specular part is linear. Two renders span it.
    let best_kappa = |alpha: f32| {
        let (none, full) = (at(alpha, 0.0), at(alpha, 1.0));
        minimise(0.0, 1.0, 20, |root| {
            let kappa = root * root;
            views.cost(|view, c| {
                let (none, full) = (&none[view], &full[view]);
                (
                    (1.0 - kappa).powi(2) * none.diffuse[c],
                    (1.0 - kappa) * none.specular[c] + kappa * full.specular[c],
                )
            })
        })
    };
    let (alpha, _) = minimise(NARROWEST, 1.0, 9, |alpha| best_kappa(alpha).1);
    let kappa = best_kappa(alpha).0.powi(2);
    Lobe { alpha, kappa }
}

/// What `lobe` adds to every view beyond a diffuse surface of the same albedo, linear RGB.
pub fn correction(scene: &Scene<'_>, seen: &Observations, lobe: Lobe) -> Vec<[f32; 3]> {
    let patches: Vec<usize> = (0..seen.patches.len()).collect();
    let views = Views::new(seen, &patches);
    let plain = views.shades(
        &Scene {
            lobe: None,
            ..*scene
        },
        seen,
    );
    let coated = Scene {
        lobe: Some(lobe),
        ..*scene
    };
    let coated = views.shades(&coated, seen);
    let mut all = vec![[0.0; 3]; views.views.len()];
    for group in &views.groups {
        for c in 0..3 {
            let part = |v: usize| (coated[v].diffuse[c], coated[v].specular[c]);
            let albedo = views.albedo(group.clone(), c, &part);
            for v in group.clone() {
                let (diffuse, specular) = part(v);
                all[v][c] = albedo * (diffuse - plain[v].diffuse[c]) + specular;
            }
        }
    }
    all
}

/// The views of some patches, patch by patch.
struct Views {
    patches: Vec<usize>,
    views: Vec<View>,
    groups: Vec<std::ops::Range<usize>>,
}

impl Views {
    fn new(seen: &Observations, patches: &[usize]) -> Self {
        let offsets = seen.offsets();
        let (mut views, mut groups) = (Vec::new(), Vec::new());
        for &p in patches {
            let start = views.len();
            views.extend_from_slice(&seen.views[offsets[p] as usize..offsets[p + 1] as usize]);
            groups.push(start..views.len());
        }
        Self {
            patches: patches.to_vec(),
            views,
            groups,
        }
    }

    /// The shade of every view.
    fn shades(&self, scene: &Scene<'_>, seen: &Observations) -> Vec<Shade> {
        let members = |&p: &usize| -> &[SurfacePoint] {
            let all = &seen.patches[p].members;
            &all[..all.len().min(MEMBERS)]
        };
        let places: Vec<&[SurfacePoint]> = self.patches.iter().map(members).collect();
        let frames: Vec<Vec<u32>> = self
            .groups
            .iter()
            .map(|group| self.views[group.clone()].iter().map(|v| v.frame).collect())
            .collect();
        scene.shades(&places, &frames).concat()
    }

    /// Half the weighted square of what remains, each patch's albedo at its best; `part` is a view's diffuse and specular
    /// light in a channel.
    fn cost(&self, part: impl Fn(usize, usize) -> (f32, f32) + Sync) -> f64 {
        let of_group = |group: &std::ops::Range<usize>| -> f64 {
            (0..3)
                .map(|c| {
                    let part = |v: usize| part(v, c);
                    let albedo = self.albedo(group.clone(), c, &part);
                    let tie = 0.5 * TIE * f64::from(albedo - 0.5).powi(2);
                    let squares = group.clone().map(|v| {
                        let (diffuse, specular) = part(v);
                        let view = &self.views[v];
                        let off = view.value[c] - albedo * diffuse - specular;
                        0.5 * f64::from(view.weight[c]) * f64::from(off).powi(2)
                    });
                    tie + squares.sum::<f64>()
                })
                .sum()
        };
        // Collected first: the order of a sum must not depend on the threads.
        let costs: Vec<f64> = self.groups.par_iter().map(of_group).collect();
        costs.iter().sum()
    }

    fn albedo(
        &self,
        group: std::ops::Range<usize>,
        c: usize,
        part: &dyn Fn(usize) -> (f32, f32),
    ) -> f32 {
        let (mut top, mut bottom) = (0.5 * TIE, TIE);
        for v in group {
            let (diffuse, specular) = part(v);
            let view = &self.views[v];
            let weighted = f64::from(view.weight[c]) * f64::from(diffuse);
            top += weighted * f64::from(view.value[c] - specular);
            bottom += weighted * f64::from(diffuse);
        }
        (top / bottom).max(0.0) as f32
    }
}

/// Where a function of one minimum is least between `low` and `high`, and its value there, by golden sections.
fn minimise(mut low: f32, mut high: f32, rounds: usize, f: impl Fn(f32) -> f64) -> (f32, f64) {
    const GOLDEN: f32 = 0.618_034;
    let inner = |low: f32, high: f32| (high - GOLDEN * (high - low), low + GOLDEN * (high - low));
    let (mut a, mut b) = inner(low, high);
    let (mut at_a, mut at_b) = (f(a), f(b));
    for _ in 0..rounds {
        if at_a < at_b {
            (high, b, at_b) = (b, a, at_a);
            a = inner(low, high).0;
            at_a = f(a);
        } else {
            (low, a, at_a) = (a, b, at_b);
            b = inner(low, high).1;
            at_b = f(b);
        }
    }
    if at_a < at_b { (a, at_a) } else { (b, at_b) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn golden_sections_close_in_on_the_minimum() {
        let (x, y) = minimise(0.0, 1.0, 20, |x| f64::from((x - 0.3) * (x - 0.3)) + 2.0);
        assert!((x - 0.3).abs() < 1e-3, "{x}");
        assert!((y - 2.0).abs() < 1e-6, "{y}");
    }
}
