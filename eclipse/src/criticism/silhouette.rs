//! Which light the occluders of a model let pass, frame by frame, and how far that is from the truth where it is known.

use std::{collections::BTreeMap, io, path::Path};

use render::{convention::Convention, image::Image, lat_long::LatLong};

use super::{
    diagnosis::{Drawn, Occluders},
    effects::Mask,
    fit::Fit,
    given::Given,
    study::Study,
};
use crate::{
    capture::Capture,
    evaluate::{self, EvaluateError, OccluderScore, Truth},
    image_io::{ExrOptions, ImageIoError, write_exr_with},
    layout,
    reconstruction::Reconstruction,
};

/// The file in a diagnosis's folder: one map a frame, one below the other, as a capture's `truth/occluders.exr`.
pub const FILE: &str = "occluders.exr";
/// The folder and the file of a capture that hold the truth.
const TRUTH: [&str; 2] = ["truth", "occluders.exr"];
/// Places within a texel, across and down, that its value is the mean of: cells of occluders are as narrow as texels.
const WITHIN: [f32; 3] = [1.0 / 6.0, 0.5, 5.0 / 6.0];

/// The occluders of a model.
pub struct Silhouettes {
    /// What each frame's occluders let pass of the light from each direction of the world, seen from the object's middle.
    pub masks: Vec<Image>,
    /// The truth, where the capture has it.
    pub truth: Vec<Image>,
    /// What a diagnosis says of them.
    pub told: Occluders,
}

impl Silhouettes {
    /// Of the occluders in `fit` and those that the simulation has, `given`; `None` where nothing is blocked, or under known lamps.
    pub fn of(study: &Study<'_>, given: &[Image], fit: &Fit) -> Option<Self> {
        let grid = study.horizon.grid()?;
        let active = fit.active.iter();
        let parts: Vec<Mask> = active
            .filter_map(|active| active.effect.mask(&study.seen, &active.beta))
            .chain(Given::new(given).map(Given::into_mask))
            .collect();
        if parts.is_empty() {
            return None;
        }
        let frames = 0..study.seen.frames;
        let masks: Vec<Image> = frames.map(|t| drawn(grid, &parts, t)).collect();
        let light = (grid, fit.radiance.as_slice());
        Some(Self::told(study.capture, masks, light, Drawn::Diagnosis))
    }

    /// Of a reconstruction of `capture`: it draws finer than a diagnosis does. `None` where nothing is blocked in it.
    pub fn reconstructed(capture: &Capture, solved: &Reconstruction) -> Option<Self> {
        Given::new(&solved.occluders)?;
        let light = &solved.environment;
        let grid = LatLong::new(light.height, light.width);
        let (masks, light) = (solved.occluders.clone(), (grid, light.data.as_slice()));
        Some(Self::told(capture, masks, light, Drawn::Reconstruction))
    }

    /// Of masks on the grid of the light, `[texel][colour]`, that they block.
    fn told(
        capture: &Capture,
        masks: Vec<Image>,
        (grid, radiance): (LatLong, &[f32]),
        by: Drawn,
    ) -> Self {
        let blocked = masks.iter().map(|mask| blocked(grid, mask, radiance));
        let mut told = Occluders {
            by,
            blocked: blocked.collect(),
            score: OccluderScore::default(),
            problem: None,
        };
        let mut truth = Vec::new();
        match compared(capture, &masks) {
            Ok(None) => {}
            Ok(Some((score, known))) => (told.score, truth) = (score, known),
            // A diagnosis stands without: whoever kept the truth learns why there is no number.
            Err(error) => told.problem = Some(error.to_string()),
        }
        Self { masks, truth, told }
    }

    /// Writes [`FILE`].
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), ImageIoError> {
        let Some(first) = self.masks.first() else {
            return Ok(());
        };
        let stack = Image {
            height: first.height * self.masks.len(),
            data: self.masks.iter().flat_map(|m| m.data.clone()).collect(),
            ..*first
        };
        let convention = Convention::Blender.name().to_owned();
        let options = ExrOptions {
            metadata: BTreeMap::from([(layout::CONVENTION.to_owned(), convention)]),
            ..ExrOptions::default()
        };
        write_exr_with(&folder.join(FILE), &stack, &["Y"], &options)
    }
}

/// Removes [`FILE`] of an earlier diagnosis in the same folder.
///
/// # Errors
/// A file that cannot be removed.
pub fn remove(folder: &Path) -> io::Result<()> {
    let file = folder.join(FILE);
    if file.is_file() && !is_foreign(folder) {
        std::fs::remove_file(file)?;
    }
    Ok(())
}

/// Whether [`FILE`] is there and somebody else's: nothing was diagnosed in the folder yet.
pub fn is_foreign(folder: &Path) -> bool {
    folder.join(FILE).exists() && !folder.join("diagnosis.json").is_file()
}

/// The share of light that passes all `parts` in a frame.
fn drawn(grid: LatLong, parts: &[Mask], frame: usize) -> Image {
    let mut mask = Image::filled(grid.columns, grid.rows, 1, 0.0);
    let count = (WITHIN.len() * WITHIN.len()) as f32;
    for (texel, out) in mask.data.iter_mut().enumerate() {
        let places = WITHIN.iter().flat_map(|&x| WITHIN.map(|y| [x, y]));
        let passing = places.map(|place| {
            let (row, column) = (texel / grid.columns, texel % grid.columns);
            let from = grid.direction_within(row, column, place);
            parts.iter().map(|part| part(frame, from)).product::<f32>()
        });
        *out = passing.sum::<f32>() / count;
    }
    mask
}

/// The share of light that a mask blocks.
fn blocked(grid: LatLong, mask: &Image, radiance: &[f32]) -> f64 {
    let (mut taken, mut all) = (0.0, 0.0);
    for (texel, (share, rgb)) in mask.data.iter().zip(radiance.chunks_exact(3)).enumerate() {
        let power = rgb.iter().sum::<f32>() * grid.solid_angle(texel / grid.columns);
        taken += f64::from((1.0 - share) * power);
        all += f64::from(power);
    }
    if all > 0.0 { taken / all } else { 0.0 }
}

/// The error of masks against the capture's truth, and that; `None` where it has none.
fn compared(
    capture: &Capture,
    masks: &[Image],
) -> Result<Option<(OccluderScore, Vec<Image>)>, EvaluateError> {
    let [folder, file] = TRUTH;
    let folder = capture.path.join(folder);
    if !folder.join(file).is_file() {
        return Ok(None);
    }
    let Truth {
        environment: Some(light),
        occluders: Some(truth),
        ..
    } = evaluate::truth(&folder)?
    else {
        // Blocked light is weighed by the true one.
        return Ok(None);
    };
    let score = evaluate::occluders::compare(masks, &truth, &light)?;
    Ok(Some((score, truth)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_one_behind_the_other_and_light_weighs() {
        let grid = LatLong::new(4, 8);
        let upper: Mask = Box::new(|_, from| if from.z > 0.0 { 0.5 } else { 1.0 });
        let second: Mask = Box::new(|frame, from| match (frame, from.y > 0.0) {
            (1, true) => 0.0,
            _ => 1.0,
        });
        let parts = [upper, second];
        let [first, last] = [0, 1].map(|frame| drawn(grid, &parts, frame));
        assert_eq!(first.pixel(1, 0), [0.5]);
        assert_eq!(first.pixel(1, 3), [1.0]);
        // Columns 0 … 3 of the upper rows are at azimuths of 180° to 0°: where y is positive.
        assert_eq!(last.pixel(1, 0), [0.0]);
        assert_eq!(last.pixel(6, 0), [0.5]);
        let even = vec![1.0; 3 * grid.len()];
        assert!((blocked(grid, &first, &even) - 0.25).abs() < 1e-6);
        assert!((blocked(grid, &last, &even) - 0.625).abs() < 1e-6);
        let mut from_below = even;
        from_below[..3 * 16].fill(0.0);
        assert!(blocked(grid, &first, &from_below).abs() < 1e-9);
    }

    #[test]
    fn what_is_written_is_what_a_truth_is_read_from() {
        let folder = tempfile::tempdir().unwrap();
        let mask = |share: f32| Image::filled(8, 4, 1, share);
        let silhouettes = Silhouettes {
            masks: vec![mask(1.0), mask(0.25), mask(0.5)],
            truth: Vec::new(),
            told: Occluders {
                by: Drawn::Diagnosis,
                blocked: vec![0.0; 3],
                score: OccluderScore::default(),
                problem: None,
            },
        };
        silhouettes.write(folder.path()).unwrap();
        let read = evaluate::truth(folder.path()).unwrap();
        assert_eq!(read.occluders.unwrap(), silhouettes.masks);
        // Nothing here was diagnosed: the file stays.
        remove(folder.path()).unwrap();
        assert!(folder.path().join(FILE).is_file());
        std::fs::write(folder.path().join("diagnosis.json"), "{}").unwrap();
        remove(folder.path()).unwrap();
        assert!(!folder.path().join(FILE).exists());
        remove(folder.path()).unwrap();
    }
}
