//! The specular lobe of a whole object, fitted with light and occluders held.

use std::ops::Range;

use rayon::prelude::*;

use super::{
    patches::View,
    shading::{Lobe, Scene, Shade},
    surface::Surface,
};

/// About how many sites the lobe is fitted to.
const FITTED_SITES: usize = 300;
/// The narrowest lobe: beyond, the grid of light is too coarse to tell.
const NARROWEST: f32 = 0.08;
/// By what factor the width is sought about an earlier estimate.
const NEAR: f32 = 1.3;
/// Precision of the albedo's tie to one half.
const TIE: f64 = 16.0;

/// The lobe that explains the photographs best under this light and these occluders.
///
/// `scene.lobe` is what was found before, if anything: the search stays about it. The albedo of every site is eliminated in
/// closed form.
pub fn fit(scene: &Scene<'_>, surface: &Surface) -> Lobe {
    let step = surface.places.len().div_ceil(FITTED_SITES).max(1);
    let sites: Vec<usize> = (0..surface.places.len()).step_by(step).collect();
    let frames = surface.frames(&sites);
    let views = Views::new(surface, &sites);
    let at = |alpha: f32, kappa: f32| -> Vec<Shade> {
        let lobe = Some(Lobe { alpha, kappa });
        surface
            .shades(&Scene { lobe, ..*scene }, &sites, &frames)
            .concat()
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
    let (low, high, rounds) = match scene.lobe {
        Some(before) => (
            (before.alpha / NEAR).max(NARROWEST),
            (before.alpha * NEAR).min(1.0),
            5,
        ),
        None => (NARROWEST, 1.0, 9),
    };
    let (alpha, _) = minimise(low, high, rounds, |alpha| best_kappa(alpha).1);
    let kappa = best_kappa(alpha).0.powi(2);
    Lobe { alpha, kappa }
}

/// The views of some sites, site by site.
struct Views {
    views: Vec<View>,
    groups: Vec<Range<usize>>,
}

impl Views {
    fn new(surface: &Surface, sites: &[usize]) -> Self {
        let (mut views, mut groups) = (Vec::new(), Vec::new());
        for &s in sites {
            let start = views.len();
            views.extend_from_slice(&surface.seen.views[surface.views(s)]);
            groups.push(start..views.len());
        }
        Self { views, groups }
    }

    /// Half the weighted square of what remains, each site's albedo at its best; `part` is a view's diffuse and specular
    /// light in a channel.
    fn cost(&self, part: impl Fn(usize, usize) -> (f32, f32) + Sync) -> f64 {
        let of_group = |group: &Range<usize>| -> f64 {
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

    fn albedo(&self, group: Range<usize>, c: usize, part: &dyn Fn(usize) -> (f32, f32)) -> f32 {
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
