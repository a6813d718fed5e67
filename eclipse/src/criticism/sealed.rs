//! Sealed data, opened once: how much better a refitted model explains what no fit has seen.

use super::{
    fit::Fit,
    split::Role,
    statistics::{paired, sign_flips},
    study::Study,
};

/// Standard deviation of the albedo of a patch that no fit has seen, as wide as the texture's own prior: what a fit happens to
/// continue there must not count for or against an effect.
const UNSEEN: f64 = 0.25;

/// Squared errors on sealed data by block, in units of the first model's noise.
pub struct Errors {
    /// By frame and sealed patch, in frames that take part in the fit.
    pub patches: Vec<f64>,
    /// By frame and patch, in sealed frames; zero in the others.
    pub frames: Vec<f64>,
    /// Values on sealed patches and in sealed frames.
    pub counts: [usize; 2],
    /// Sum of squared plain differences, over both.
    pub squares: f64,
}

/// The change from one model to another.
#[derive(Clone, Copy, Debug, Default)]
pub struct Gain {
    /// Reduction of the squared error in units of the noise.
    pub gain: f64,
    /// Its standard error.
    pub error: f64,
    /// By signs of blocks.
    pub p: f64,
}

/// The errors of `fit`, measured by the noise of `judge`.
///
/// A site on a sealed patch has an albedo of its own that nobody knows: its random effect is integrated out. In a sealed
/// frame it is known from the other frames.
pub fn errors(study: &Study<'_>, fit: &Fit, judge: &Fit) -> Errors {
    let on_patch = |i: usize| study.role[i] == Role::SealedPatch;
    let in_frame = |i: usize| study.role[i] == Role::SealedFrame;
    let residual = fit.residual(study);
    // Shading is the judge's as well: two covariances would not be comparable.
    let mut white = residual.clone();
    // Texture is not known there better than its neighbours tell.
    let tau = judge.tau.map(|tau| tau.hypot(UNSEEN));
    judge
        .precision_with(study, &on_patch, tau)
        .whiten(&mut white);
    let known = judge.precision(study, &in_frame);
    // A patch in one frame is a block: what neighbours share there is one error, not many.
    let across = study.blocks();
    let block = |i: usize| study.seen.frame(i) as usize * across + study.block(i);
    let mut patches = vec![0.0; across * study.seen.frames];
    let mut frames = patches.clone();
    let mut counts = [0; 2];
    let mut squares = 0.0;
    for i in 0..study.seen.len() {
        for c in 0..3 {
            let k = 3 * i + c;
            let r = f64::from(residual[k]);
            if on_patch(i) {
                patches[block(i)] += f64::from(white[k]).powi(2);
                counts[0] += 1;
                squares += r * r;
            } else if in_frame(i) {
                frames[block(i)] += f64::from(known.weight()[k]) * r * r;
                counts[1] += 1;
                squares += r * r;
            }
        }
    }
    Errors {
        patches,
        frames,
        counts,
        squares,
    }
}

/// What `after` gains over `before`; sealed frames count only where `frames` says that the effect is the same in all.
pub fn gain(before: &Errors, after: &Errors, frames: bool) -> Gain {
    let mut differences: Vec<f64> = before
        .patches
        .iter()
        .zip(&after.patches)
        .filter(|(b, _)| **b > 0.0)
        .map(|(b, a)| b - a)
        .collect();
    if frames {
        differences.extend(
            before
                .frames
                .iter()
                .zip(&after.frames)
                .filter(|(b, _)| **b > 0.0)
                .map(|(b, a)| b - a),
        );
    }
    let (gain, error) = paired(&differences);
    Gain {
        gain,
        error,
        p: sign_flips(&differences),
    }
}

impl Errors {
    /// χ² over everything that counts.
    pub fn chi2(&self, frames: bool) -> f64 {
        let sum = self.patches.iter().sum::<f64>();
        if frames {
            sum + self.frames.iter().sum::<f64>()
        } else {
            sum
        }
    }

    /// Root mean square difference of values.
    pub fn rmse(&self) -> f64 {
        (self.squares / (self.counts[0] + self.counts[1]).max(1) as f64).sqrt()
    }
}
