//! Sealed data, opened once: how much better a refitted model explains what no fit has seen.

use rayon::prelude::*;

use super::{
    fit::Fit,
    frame_numbers::FrameNumbers,
    linear::{Cholesky, inner},
    precision::Precision,
    split::Role,
    statistics::{clustered, sign_flips},
    study::{DARK_PLACES, Study},
};

/// Bumps of the texture that change no value of a sealed patch by this much (of an albedo of one) are left out.
const REACHES: f32 = 1e-4;

/// Whose noise errors are measured by; outliers of either model are trusted less by both, or a few pixels at the edge of a highlight
/// would outweigh all others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Noise {
    /// As wide as the judge's own residuals: for comparisons.
    Estimated,
    /// The sensor's alone: for χ².
    Sensor,
}

/// What comparisons on sealed data are measured by: the noise and the texture of one model.
pub struct Judge {
    patches: Precision,
    frames: Precision,
    texture: Texture,
}

/// Squared errors on sealed data, in units of the judge's noise.
pub struct Errors {
    /// Of each place in each frame.
    cells: Vec<Cell>,
    /// Values on sealed patches and in sealed frames.
    pub counts: [usize; 2],
    /// Sums of the noise's weights there.
    weights: [f64; 2],
}

/// Errors of one place (a patch of surface, or of the background) in one frame.
#[derive(Clone, Copy, Default)]
struct Cell {
    /// On a sealed patch, in a frame that takes part in the fit.
    patch: f64,
    /// In a sealed frame.
    frame: f64,
    /// Values of either.
    values: [u32; 2],
}

/// The change from one model to another.
#[derive(Clone, Copy, Debug, Default)]
pub struct Gain {
    /// Reduction of the squared error in units of the noise.
    pub gain: f64,
    /// Its standard error, by places in frames. That an effect gains more in some frames or places than in others is its shape, not
    /// an error: whether they could be chance, all of one frame or place together, `p` asks.
    pub error: f64,
    /// Probability of so large a gain without the effect, by random signs of places or of frames, whichever is larger.
    pub p: f64,
}

impl Judge {
    /// The noise and the texture of `fit`, which is compared with `other`.
    pub fn new(study: &Study<'_>, fit: &Fit, other: &Fit, noise: Noise) -> Self {
        let precision = |role: Role| {
            let counted = |i: usize| study.role[i] == role;
            match noise {
                Noise::Estimated => fit.precision_beside(study, [fit, other], &counted),
                Noise::Sensor => fit.sensor_precision_beside(study, other, &counted),
            }
        };
        let patches = precision(Role::SealedPatch);
        Self {
            texture: Texture::new(study, fit, &patches),
            patches,
            frames: precision(Role::SealedFrame),
        }
    }

    /// The errors of `fit`.
    ///
    /// What a sealed patch's texture is nobody knows: its smooth part has its prior, as has what each site is beyond it, and both
    /// are integrated out. In a sealed frame they are known from the other frames; what is not known there are numbers of the
    /// frame's own, `unknown`, and what they can explain is taken out. Models that are compared must have the same of them.
    pub fn errors(&self, study: &Study<'_>, fit: &Fit, unknown: &FrameNumbers) -> Errors {
        let mut residual = fit.residual(study);
        let mut counts = [0; 2];
        let mut weights = [0.0; 2];
        for k in 0..residual.len() {
            let (kind, precision) = match study.role[k / 3] {
                Role::SealedPatch => (0, &self.patches),
                Role::SealedFrame => (1, &self.frames),
                Role::Development(_) | Role::Gutter => continue,
            };
            counts[kind] += 1;
            weights[kind] += f64::from(precision.weight()[k]);
        }
        let mut white = residual.clone();
        self.patches.whiten(&mut white);
        let products = self.texture.products(&white);
        unknown.take_out(study, self.frames.weight(), &mut residual);
        let places = Places::new(study);
        let mut cells = vec![Cell::default(); places.count * study.seen.frames];
        for i in 0..study.seen.len() {
            let cell = &mut cells[places.of(study, i)];
            let own = 3 * i..3 * i + 3;
            match study.role[i] {
                Role::SealedPatch => {
                    cell.patch += products[own].iter().sum::<f64>();
                    cell.values[0] += 3;
                }
                Role::SealedFrame => {
                    let weighed = |k: usize| {
                        f64::from(self.frames.weight()[k]) * f64::from(residual[k]).powi(2)
                    };
                    cell.frame += own.map(weighed).sum::<f64>();
                    cell.values[1] += 3;
                }
                Role::Development(_) | Role::Gutter => {}
            }
        }
        Errors {
            cells,
            counts,
            weights,
        }
    }
}

/// Patches of the surface, then those of the background.
struct Places {
    count: usize,
}

impl Places {
    fn new(study: &Study<'_>) -> Self {
        Self {
            count: study.seen.patches + DARK_PLACES,
        }
    }

    /// The index of the place and frame of an observation.
    fn of(&self, study: &Study<'_>, i: usize) -> usize {
        let place = match study.seen.views.get(i) {
            Some(view) => usize::from(study.seen.sites[view.site as usize].place.patch),
            None => {
                let dark = &study.seen.dark[i - study.seen.views.len()];
                study.seen.patches + dark.patch as usize % DARK_PLACES
            }
        };
        study.seen.frame(i) as usize * self.count + place
    }
}

/// What `after` gains over `before` on sealed patches and, where `frames` says so, in sealed frames.
pub fn gain(study: &Study<'_>, before: &Errors, after: &Errors, frames: bool) -> Gain {
    let of = |cell: &Cell| cell.patch + if frames { cell.frame } else { 0.0 };
    let pairs = before.cells.iter().zip(&after.cells).enumerate();
    let differences: Vec<Difference> = pairs
        .map(|(cell, (b, a))| Difference {
            cell,
            gain: of(b) - of(a),
            values: f64::from(b.values[0] + if frames { b.values[1] } else { 0 }),
        })
        .filter(|d| d.values > 0.0)
        .collect();
    judged(&differences, Places::new(study).count)
}

/// What one place in one frame gains.
struct Difference {
    cell: usize,
    gain: f64,
    values: f64,
}

/// Of cells that are counted frame by frame with so many places in each.
fn judged(differences: &[Difference], places: usize) -> Gain {
    let all = |of: fn(&Difference) -> f64| differences.iter().map(of).sum::<f64>();
    let gain = all(|d| d.gain);
    let each = gain / all(|d| d.values).max(1.0);
    let by = |cluster: fn(usize, usize) -> usize, of: &dyn Fn(&Difference) -> f64| {
        let pairs = differences.iter().map(|d| (cluster(d.cell, places), of(d)));
        clustered(pairs)
    };
    // About the same gain a value: cells differ in size.
    let scatter = by(|k, _| k, &|d| d.gain - each * d.values);
    let n = scatter.len() as f64;
    let squares: f64 = scatter.iter().map(|d| d * d).sum();
    let flipped = |cluster| sign_flips(&by(cluster, &|d| d.gain));
    Gain {
        gain,
        error: if n < 2.0 {
            f64::INFINITY
        } else {
            (squares * n / (n - 1.0)).sqrt()
        },
        p: flipped(|k, n| k % n).max(flipped(|k, n| k / n)),
    }
}

impl Errors {
    /// Values that count.
    pub fn count(&self, frames: bool) -> usize {
        self.counts[0] + if frames { self.counts[1] } else { 0 }
    }

    /// χ² over everything that counts.
    pub fn chi2(&self, frames: bool) -> f64 {
        let of = |cell: &Cell| cell.patch + if frames { cell.frame } else { 0.0 };
        self.cells.iter().map(of).sum()
    }

    /// Root mean square difference of the values that count, weighed by the noise; what the unknown texture of sealed patches may
    /// be is no difference.
    pub fn rmse(&self, frames: bool) -> f64 {
        let weights = self.weights[0] + if frames { self.weights[1] } else { 0.0 };
        (self.chi2(frames) / weights.max(1e-300)).sqrt()
    }
}

/// What the smooth texture may be on sealed patches, colour by colour.
struct Texture {
    /// Indices of the values on sealed patches, by colour.
    rows: [Vec<usize>; 3],
    /// Whitened columns of the bumps there, `[colour][bump][row]`.
    columns: [Vec<Vec<f64>>; 3],
    /// Of the columns' Gram matrix plus the unit prior.
    factor: [Cholesky; 3],
}

impl Texture {
    fn new(study: &Study<'_>, fit: &Fit, precision: &Precision) -> Self {
        let bumps = &fit.formation.texture;
        let on_patch = |i: usize| study.role[i] == Role::SealedPatch;
        let views: Vec<usize> = (0..study.seen.views.len())
            .filter(|&v| on_patch(v))
            .collect();
        let at = |v: usize, b: usize| bumps.at(study.seen.views[v].site as usize)[b];
        let reaching: Vec<usize> = (0..bumps.bumps)
            .filter(|&b| views.iter().any(|&v| at(v, b) > REACHES))
            .collect();
        let white: Vec<Vec<f32>> = reaching
            .par_iter()
            .map(|&b| {
                let mut column = vec![0.0; study.value.len()];
                for &v in &views {
                    for k in 3 * v..3 * v + 3 {
                        column[k] = at(v, b) * fit.slope[k] * fit.diffuse[k];
                    }
                }
                precision.whiten(&mut column);
                column
            })
            .collect();
        let rows = [0, 1, 2].map(|c| views.iter().map(|v| 3 * v + c).collect::<Vec<_>>());
        let columns = [0, 1, 2].map(|c: usize| {
            let of = |column: &Vec<f32>| rows[c].iter().map(|&k| f64::from(column[k])).collect();
            white.iter().map(of).collect::<Vec<Vec<f64>>>()
        });
        let factor = [0, 1, 2].map(|c: usize| with_prior(&columns[c]));
        Self {
            rows,
            columns,
            factor,
        }
    }

    /// Each value's part of eᵀ (1 + X Xᵀ)⁻¹ e = eᵀ (e − X (XᵀX + 1)⁻¹ Xᵀ e) for whitened errors `e`.
    fn products(&self, white: &[f32]) -> Vec<f64> {
        let mut products: Vec<f64> = white.iter().map(|&e| f64::from(e).powi(2)).collect();
        for c in 0..3 {
            let errors: Vec<f64> = self.rows[c].iter().map(|&k| f64::from(white[k])).collect();
            let mut numbers: Vec<f64> = self.columns[c].iter().map(|x| inner(x, &errors)).collect();
            self.factor[c].forward(&mut numbers);
            self.factor[c].backward(&mut numbers);
            for (row, &k) in self.rows[c].iter().enumerate() {
                let pairs = self.columns[c].iter().zip(&numbers);
                let explained: f64 = pairs.map(|(x, n)| x[row] * n).sum();
                products[k] -= errors[row] * explained;
            }
        }
        products
    }
}

/// The factor of XᵀX + 1.
fn with_prior(columns: &[Vec<f64>]) -> Cholesky {
    let n = columns.len();
    let lines: Vec<Vec<f64>> = (0..n)
        .into_par_iter()
        .map(|i| {
            (0..n)
                .map(|j| {
                    let own = if i == j { 1.0 } else { 0.0 };
                    if i <= j {
                        own + inner(&columns[i], &columns[j])
                    } else {
                        0.0
                    }
                })
                .collect()
        })
        .collect();
    // Of a symmetric matrix the upper half is enough.
    Cholesky::new(&lines.concat(), n, n)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_place_that_gains_is_no_proof() {
        // Ten frames of seven places.
        let all = |of: &dyn Fn(usize) -> f64| -> Vec<Difference> {
            let one = |cell| Difference {
                cell,
                gain: of(cell),
                values: 3.0,
            };
            (0..70).map(one).collect()
        };
        let everywhere = judged(&all(&|k| 1.0 + 0.5 * (k as f64).sin()), 7);
        assert!(everywhere.p < 0.02, "{everywhere:?}");
        let somewhere = judged(&all(&|k| if k % 7 == 3 { 9.0 } else { -0.1 }), 7);
        assert!(somewhere.gain > everywhere.gain);
        assert!(somewhere.p > 0.2, "{somewhere:?}");
        let once = judged(&all(&|k| if k / 7 == 3 { 9.0 } else { -0.1 }), 7);
        assert!(once.p > 0.2, "{once:?}");
        let never = judged(&all(&|_| -1.0), 7);
        assert!(never.gain < 0.0 && never.p == 1.0);
    }

    #[test]
    fn what_texture_may_do_is_integrated_out() {
        let columns = vec![vec![2.0, 0.0, 1.0], vec![0.0, 1.0, 1.0]];
        let texture = Texture {
            rows: [vec![0, 3, 6], Vec::new(), Vec::new()],
            factor: [with_prior(&columns), with_prior(&[]), with_prior(&[])],
            columns: [columns, Vec::new(), Vec::new()],
        };
        let mut white = vec![0.0; 9];
        (white[0], white[3], white[6], white[1]) = (1.0, -2.0, 0.5, 3.0);
        let found: f64 = texture.products(&white).iter().sum();
        // 1 + X Xᵀ = [[5, 0, 2], [0, 2, 1], [2, 1, 3]]; its inverse by cofactors over the determinant 17.
        let inverse = [[5.0, 2.0, -4.0], [2.0, 11.0, -5.0], [-4.0, -5.0, 10.0]];
        let e = [1.0, -2.0, 0.5];
        let direct: f64 = (0..3)
            .flat_map(|i| (0..3).map(move |j| (i, j)))
            .map(|(i, j)| e[i] * inverse[i][j] * e[j] / 17.0)
            .sum();
        assert!((found - direct - 9.0).abs() < 1e-9, "{found} {direct}");
    }
}
