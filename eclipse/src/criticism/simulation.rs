//! What of a reconstruction a diagnosis starts from.

use std::path::{Path, PathBuf};

use render::image::Image;

use super::transport::Lobe;
use crate::{
    capture::{Capture, Frame},
    files::read_limited,
    image_io::{self, ExrFile, ImageIoError},
    layout,
    reconstruction::Reconstruction,
};

/// Largest `settings.json`.
const MAX_SETTINGS: u64 = 1 << 20;

/// What of a reconstruction a diagnosis starts from.
#[derive(Clone, Debug)]
pub struct Simulation {
    /// Radiance, equirectangular, three channels; where lamps are known, one row with what each of them has.
    pub environment: Image,
    /// The lobe; `None` for Lambertian surfaces.
    pub lobe: Option<Lobe>,
    /// The photographs as it renders them.
    pub renders: Vec<Image>,
    /// What each frame's occluder lets through, if it has occluders: a part of the first model.
    pub occluders: Vec<Image>,
}

impl Simulation {
    /// Of a reconstruction in memory.
    pub fn of(reconstruction: &Reconstruction) -> Self {
        Self {
            environment: reconstruction.environment.clone(),
            lobe: lobe_or_usual(
                &reconstruction.materials,
                reconstruction.settings.lambertian,
            ),
            renders: reconstruction.renders.clone(),
            occluders: reconstruction.occluders.clone(),
        }
    }

    /// Of the folder that `reconstruct` wrote for this capture.
    ///
    /// # Errors
    /// A file that is missing, damaged or of another capture.
    pub fn load(folder: &Path, capture: &Capture) -> Result<Self, SimulationError> {
        let settings = settings_of(folder);
        let named = |key: &str| settings.as_ref()?.get(key).cloned();
        if let Some(with) =
            named("with").filter(|with| with.as_array().is_some_and(|w| !w.is_empty()))
        {
            return Err(SimulationError::With {
                path: folder.to_owned(),
                with: with.to_string(),
            });
        }
        let lambertian = named("lambertian")
            .and_then(|v| v.as_bool())
            .unwrap_or(false);
        let frames = capture.frames.len();
        let numbered = |name: &str, t: usize| folder.join(name).join(layout::numbered(t));
        let found = (0..)
            .take_while(|t| numbered(layout::RENDERS, *t).is_file())
            .count();
        if found != frames {
            return Err(SimulationError::Count {
                path: folder.join(layout::RENDERS),
                found,
                expected: frames,
            });
        }
        let render = |(t, frame): (usize, &Frame)| {
            let path = numbered(layout::RENDERS, t);
            let render = image_io::read_exr(&path)?.to_rgb();
            let size = |image: &Image| [image.width, image.height];
            let (found, expected) = (size(&render), size(&frame.image));
            if found != expected {
                return Err(SimulationError::Size {
                    path,
                    found,
                    expected,
                });
            }
            Ok(render)
        };
        let renders = capture.frames.iter().enumerate().map(render);
        let renders = renders.collect::<Result<_, _>>()?;
        let materials: Vec<Image> = (0..frames)
            .map(|t| {
                Ok(materials_of(&image_io::read_exr_file(&numbered(
                    layout::MATERIALS,
                    t,
                ))?))
            })
            .collect::<Result<_, ImageIoError>>()?;
        // A run without occluders leaves none.
        let occluders = if numbered(layout::OCCLUDERS, 0).is_file() {
            (0..frames)
                .map(|t| image_io::read_exr(&numbered(layout::OCCLUDERS, t)))
                .collect::<Result<_, _>>()?
        } else {
            Vec::new()
        };
        Ok(Self {
            environment: image_io::read_exr(&folder.join(layout::ENVIRONMENT))?.to_rgb(),
            lobe: lobe_or_usual(&materials, lambertian),
            renders,
            occluders,
        })
    }
}

/// The mean lobe of material images (`R G B alpha kappa`), where they hold an object that has one.
pub fn lobe_of(materials: &[Image]) -> Option<Lobe> {
    let (mut alpha, mut kappa, mut count) = (0.0f64, 0.0f64, 0u64);
    for image in materials.iter().filter(|image| image.channels == 5) {
        for pixel in image.data.chunks_exact(5) {
            if pixel[3] > 0.0 && pixel[..3].iter().any(|&a| a > 0.0) {
                alpha += f64::from(pixel[3]);
                kappa += f64::from(pixel[4]);
                count += 1;
            }
        }
    }
    let (alpha, kappa) = (alpha / count as f64, kappa / count as f64);
    (count > 0 && kappa > 1e-6).then_some(Lobe {
        alpha: alpha as f32,
        kappa: kappa as f32,
    })
}

/// The lobe of materials, or the usual one where a solver that was free to find one ended before it did: such a lobe is a part
/// of the model, not of the physics it lacks.
fn lobe_or_usual(materials: &[Image], lambertian: bool) -> Option<Lobe> {
    if lambertian {
        return None;
    }
    Some(lobe_of(materials).unwrap_or(Lobe::USUAL))
}

/// The settings of the reconstruction in a folder; `None` where it does not say.
fn settings_of(folder: &Path) -> Option<serde_json::Value> {
    let bytes = read_limited(&folder.join(layout::SETTINGS), MAX_SETTINGS).ok()?;
    serde_json::from_slice(&bytes).ok()
}

/// Why a reconstruction cannot be what a diagnosis starts from.
#[derive(Debug, thiserror::Error)]
pub enum SimulationError {
    /// An image cannot be read.
    #[error(transparent)]
    Image(#[from] ImageIoError),
    /// Renders of other photographs.
    #[error("{} holds {found} renders, but the capture has {expected} frames: name the folder that reconstruct wrote for this capture", path.display())]
    Count {
        /// Their folder.
        path: PathBuf,
        /// How many there are.
        found: usize,
        /// How many frames the capture has.
        expected: usize,
    },
    /// A reconstruction of photographs that had effects of the camera taken back.
    #[error(
        "{} was reconstructed with {with}, effects that a diagnosis looks for itself: name a reconstruction without `--with`, or none",
        path.display()
    )]
    With {
        /// The folder.
        path: PathBuf,
        /// The effects.
        with: String,
    },
    /// A render of another size than its photograph.
    #[error(
        "{} has {} × {} pixels, but the photograph {} × {}: name the folder that reconstruct wrote for this capture",
        path.display(), found[0], found[1], expected[0], expected[1]
    )]
    Size {
        /// The file.
        path: PathBuf,
        /// Its pixels across and down.
        found: [usize; 2],
        /// The photograph's.
        expected: [usize; 2],
    },
}

/// A material image from its file, channels in the order of [`layout::MATERIAL_CHANNELS`].
fn materials_of(file: &ExrFile) -> Image {
    let channels: Vec<Option<usize>> = layout::MATERIAL_CHANNELS
        .iter()
        .map(|name| file.channel_names.iter().position(|n| n == name))
        .collect();
    let image = &file.image;
    let mut out = Image::filled(image.width, image.height, 5, 0.0);
    for (target, source) in out
        .data
        .chunks_exact_mut(5)
        .zip(image.data.chunks_exact(image.channels))
    {
        for (t, channel) in target.iter_mut().zip(&channels) {
            *t = channel.map_or(0.0, |c| source[c]);
        }
    }
    out
}
