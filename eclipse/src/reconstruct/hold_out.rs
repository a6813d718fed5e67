//! Frames kept out of the fit: only where their occluder stands is fitted, on half of their pixels, to be judged on the
//! other half.
//!
//! Light, materials and the operator's outline stay as the other frames have them; what is a frame's own (where somebody
//! stands, or the harmonics of its mask) follows by damped Gauss-Newton steps.

mod data;

use autodiff::RunError;
use render::image::Image;

use data::Data;

use super::{
    cutout::FRAME_PARAMETERS,
    finish::Found,
    least_squares::{self, Linearisation, StepOptions},
    model::Shared,
    sky::{SkyAt, SkyModel},
};

/// Side of the blocks of pixels that alternate between fit and judgement.
const BLOCK: usize = 8;
const STEPS: usize = 8;
/// Products a step.
const PRODUCTS: usize = 20;
/// The damping of the first step.
const DAMPING: f32 = 10.0;

/// Whether a pixel of an image `width` wide is of the half that a held-out frame's occluder is fitted on.
pub fn fitted_half(width: usize, pixel: usize) -> bool {
    (pixel % width / BLOCK + pixel / width / BLOCK).is_multiple_of(2)
}

/// A render of a held-out photograph, of whose object `mask` is the coverage, times the gain of each channel that explains its
/// fitted half best: how well a model without an occluder of the frame's own can do by a number that stands for one.
pub fn gained(photograph: &Image, mask: &Image, render: &Image) -> Image {
    let mut products = [[0.0f64; 2]; 3];
    for p in (0..mask.data.len()).filter(|&p| mask.data[p] > 0.999) {
        if fitted_half(photograph.width, p) {
            for (c, [with, own]) in products.iter_mut().enumerate() {
                let value = f64::from(render.data[3 * p + c]);
                *with += value * f64::from(photograph.data[3 * p + c]);
                *own += value * value;
            }
        }
    }
    let gain = products.map(|[with, own]| if own > 0.0 { with / own } else { 1.0 });
    let mut gained = render.clone();
    for pixel in gained.data.chunks_exact_mut(3) {
        for (value, gain) in pixel.iter_mut().zip(gain) {
            *value = (f64::from(*value) * gain) as f32;
        }
    }
    gained
}

/// The parameters with those of the occluders of the frames `held` fitted to half of their pixels; `materials` are images
/// through each camera.
///
/// # Errors
/// When the tape refuses what it is given, which would be a bug.
pub fn fit(
    found: &Found<'_>,
    shared: &Shared,
    z: &[f32],
    materials: &[Image],
    held: &(dyn Fn(usize) -> bool + Sync),
) -> Result<Vec<f32>, RunError> {
    let mut z = z.to_vec();
    let occluders = &mut z[shared.ranges()[1].clone()];
    let own = own_parameters(&shared.sky, found.frames.len(), held);
    if own.is_empty() {
        return Ok(z);
    }
    let data = Data::new(found, shared, materials, held);
    let options = StepOptions {
        products: PRODUCTS,
        tolerance: 1e-6,
        albedo_precision: 1.0,
    };
    let mut damping = DAMPING;
    let mut at = Held::new(&data, shared, occluders, &own)?;
    for _ in 0..STEPS {
        let z = at.own_values(occluders);
        let step = least_squares::step(&mut at, &z, 1, damping, &options);
        let change = at.spread(&step.delta);
        let share = (1.0 / largest_change(&shared.sky, &change)).min(1.0);
        let mut candidate = occluders.to_vec();
        least_squares::add(&mut candidate, share, &change);
        let next = Held::new(&data, shared, &candidate, &own)?;
        if next.cost(&candidate) < at.cost(occluders) {
            occluders.copy_from_slice(&candidate);
            at = next;
            damping *= 0.3;
        } else {
            damping *= 8.0;
        }
    }
    Ok(z)
}

/// Which parameters of the occluders are of the frames `held` alone.
fn own_parameters(sky: &SkyModel, frames: usize, held: &dyn Fn(usize) -> bool) -> Vec<usize> {
    // Either way frames lie side by side; the outline that all frames share comes first.
    let shared = match sky {
        SkyModel::Clear => return Vec::new(),
        SkyModel::Cutout(_) => sky.parameters() - FRAME_PARAMETERS * frames,
        SkyModel::Harmonics(_) => 0,
    };
    (shared..sky.parameters())
        .filter(|i| held((i - shared) % frames))
        .collect()
}

/// How far a step goes, in units of what is far: a standard deviation of where somebody stands, three units of a logit.
fn largest_change(sky: &SkyModel, change: &[f32]) -> f32 {
    match sky {
        SkyModel::Harmonics(_) => sky.largest_change(change) / 3.0,
        _ => change.iter().fold(0.0f32, |most, c| most.max(c.abs())),
    }
    .max(1e-9)
}

/// The held-out frames' half of the pixels, linearised where their occluders are.
struct Held<'a> {
    data: &'a Data,
    sky: &'a SkyModel,
    at: SkyAt,
    own: &'a [usize],
    residual: Vec<f32>,
    /// Albedo is known here: nothing depends on it.
    none: (Vec<f32>, Vec<u32>),
}

impl<'a> Held<'a> {
    fn new(
        data: &'a Data,
        shared: &'a Shared,
        occluders: &[f32],
        own: &'a [usize],
    ) -> Result<Self, RunError> {
        let at = shared
            .sky
            .at(shared.mask_grid(), occluders)?
            .expect("frames of their own have masks");
        let residual = data.residuals(&at.passed);
        Ok(Self {
            data,
            sky: &shared.sky,
            at,
            own,
            none: (vec![0.0; residual.len()], vec![0; residual.len()]),
            residual,
        })
    }

    fn own_values(&self, occluders: &[f32]) -> Vec<f32> {
        self.own.iter().map(|&i| occluders[i]).collect()
    }

    /// Zero for what is not the held-out frames' own.
    fn spread(&self, own: &[f32]) -> Vec<f32> {
        let mut all = vec![0.0; self.sky.parameters()];
        self.own.iter().zip(own).for_each(|(&i, &v)| all[i] = v);
        all
    }

    fn cost(&self, occluders: &[f32]) -> f64 {
        least_squares::cost(&self.residual, &self.own_values(occluders), &[], 0.0)
    }
}

impl Linearisation for Held<'_> {
    fn residual(&self) -> &[f32] {
        &self.residual
    }

    fn by_albedo(&self) -> &[f32] {
        &self.none.0
    }

    fn groups(&self) -> &[u32] {
        &self.none.1
    }

    fn jvp(&mut self, v: &[f32]) -> Vec<f32> {
        let all = self.spread(v);
        let masks = self.sky.push(&mut self.at, &all);
        self.data.received(&masks)
    }

    fn vjp(&mut self, w: &[f32]) -> Vec<f32> {
        let masks = self.data.received_transpose(w);
        let all = self.sky.pull(&mut self.at, masks);
        self.own_values(&all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_are_blocks_and_equally_large() {
        let fitted = (0..128 * 128).filter(|&p| fitted_half(128, p)).count();
        assert_eq!(fitted, 128 * 128 / 2);
        assert!(fitted_half(128, 7) && !fitted_half(128, 8) && !fitted_half(128, 8 * 128));
    }

    /// Twice the render where it is fitted and four times where it is judged: the gain knows nothing of the latter.
    #[test]
    fn gains_are_of_the_fitted_half_alone() {
        let (width, height) = (32, 16);
        let of = |values: &dyn Fn(usize, usize) -> f32| Image {
            width,
            height,
            channels: 3,
            data: (0..3 * width * height)
                .map(|i| values(i / 3, i % 3))
                .collect(),
        };
        let render = of(&|p, c| 0.1 + 0.01 * (p % 7) as f32 + 0.1 * c as f32);
        let photograph = of(&|p, c| {
            let factor = if fitted_half(width, p) { 2.0 } else { 4.0 };
            factor * (1.0 + c as f32) * render.data[3 * p + c]
        });
        let mask = Image {
            channels: 1,
            data: vec![1.0; width * height],
            ..photograph.clone()
        };
        let gained = gained(&photograph, &mask, &render);
        for (i, (gained, render)) in gained.data.iter().zip(&render.data).enumerate() {
            let expected = 2.0 * (1.0 + (i % 3) as f32) * render;
            assert!(
                (gained - expected).abs() < 1e-5,
                "{i}: {gained}, {expected}"
            );
        }
    }
}
