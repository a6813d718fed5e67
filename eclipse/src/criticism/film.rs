//! The occluder of the last model on the page, frame by frame, as somebody at the object would see it.

use std::f32::consts::{PI, TAU};

use glam::Vec3;
use render::{image::Image, lat_long::LatLong};

use super::{
    diagnose::Outcome,
    diagnosis::{Diagnosis, Drawn, Verdict},
    plot,
};
use crate::image_io::ImageIoError;

/// Size of a picture of all directions.
const SIZE: [usize; 2] = [60, 30];
/// The place of the camera in it, sRGB.
const CAMERA: [f32; 3] = [0.85, 0.15, 0.1];

/// The strip and what is known of its error; nothing where no occluder is in the model.
///
/// # Errors
/// An image that cannot be encoded, which would be a bug.
pub fn strip(outcome: &Outcome<'_>) -> Result<String, ImageIoError> {
    let Some(silhouettes) = &outcome.silhouettes else {
        return Ok(String::new());
    };
    let mut figures = String::new();
    for (t, mask) in silhouettes.masks.iter().enumerate() {
        let eye = outcome.study.seen.eyes[t];
        let mut pictures = shown(mask, eye)?;
        if let Some(truth) = silhouettes.truth.get(t) {
            pictures += &shown(truth, eye)?;
        }
        let blocked = 100.0 * silhouettes.told.blocked[t];
        let hot = outcome.diagnosis.hot_spots.iter().any(|s| s.frame == t);
        let class = if hot { " class=\"hot\"" } else { "" };
        figures += &format!(
            "<figure{class}>{pictures}<figcaption>{t}: {blocked:.0} %</figcaption></figure>"
        );
    }
    let below = if silhouettes.truth.is_empty() {
        ""
    } else {
        " Below each the truth."
    };
    let by = match silhouettes.told.by {
        Drawn::Diagnosis => "",
        Drawn::Reconstruction => {
            " Drawn by a reconstruction with what was found, whose outlines are finer than the diagnosis' own."
        }
    };
    Ok(format!(
        "<h2>Light that the last model blocks</h2><p>All directions seen from the object, the camera's azimuth in the middle, up on top, the \
         camera red; white: light passes, black: it is blocked.{below} Under each its frame, red where the photograph had hot spots before, and the share of the light that is \
         blocked. World directions are in <code>{}</code>.{by}</p>{}<div class=\"film\">{figures}</div>",
        super::silhouette::FILE,
        said(&outcome.diagnosis)
    ))
}

/// What is known of the strip, in words.
fn said(d: &Diagnosis) -> String {
    let mut said = String::new();
    if d.verdict == Verdict::Unexplained {
        said += "<p>This is what the model needed to come closest; nobody need have stood there, since most of the mismatch remains.</p>";
    }
    let Some(told) = &d.occluders else {
        return said;
    };
    if let Some(error) = told.score.energy_weighted_error {
        let overlap = told.score.iou.map_or(String::new(), |iou| {
            format!(
                " Where at least half is blocked, the two overlap by {:.0} %.",
                100.0 * iou
            )
        });
        said += &format!(
            "<p>Against <code>truth/occluders.exr</code> the error is {error:.2} of the blocked light (0: perfect; 1: as if nothing were \
             blocked).{overlap}</p>"
        );
    }
    if let Some(problem) = &told.problem {
        said += &format!(
            "<p>Not compared with the truth: {}.</p>",
            super::page::escaped(problem)
        );
    }
    said
}

fn shown(mask: &Image, eye: Vec3) -> Result<String, ImageIoError> {
    plot::picture(&seen_from_object(mask, eye), |pixel| {
        [pixel[0], pixel[1], pixel[2]]
    })
}

/// A mask on all directions, turned so that the camera's azimuth is in the middle, with the camera in it.
fn seen_from_object(mask: &Image, eye: Vec3) -> Image {
    let [width, height] = SIZE;
    let grid = LatLong::new(mask.height, mask.width);
    let own = eye.y.atan2(eye.x);
    let mut picture = Image::filled(width, height, 3, 0.0);
    for (p, pixel) in picture.data.chunks_exact_mut(3).enumerate() {
        let across = ((p % width) as f32 + 0.5) / width as f32;
        let down = ((p / width) as f32 + 0.5) / height as f32;
        let (sin, cos) = (PI * down).sin_cos();
        let azimuth = own + (0.5 - across) * TAU;
        let direction = Vec3::new(sin * azimuth.cos(), sin * azimuth.sin(), cos);
        pixel.fill(grid.bilinear(direction).gather(&mask.data).clamp(0.0, 1.0));
    }
    let [_, down] = LatLong::coordinates(eye);
    let row = ((down * height as f32) as usize).min(height - 1);
    for column in [width / 2 - 1, width / 2] {
        picture.pixel_mut(column, row).copy_from_slice(&CAMERA);
    }
    picture
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_camera_is_in_the_middle_and_left_is_left() {
        // A body behind the camera at azimuth 120°, and a wall at azimuth 210°: to the left of who looks at the camera.
        let grid = LatLong::new(24, 48);
        let turned = |degrees: f32| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            Vec3::new(cos, sin, 0.0)
        };
        let mut mask = Image::filled(48, 24, 1, 1.0);
        for (k, share) in mask.data.iter_mut().enumerate() {
            let direction = grid.texel_direction(k / 48, k % 48);
            if direction.dot(turned(120.0)) > 0.95 {
                *share = 0.0;
            } else if direction.dot(turned(210.0)) > 0.95 {
                *share = 0.5;
            }
        }
        let eye = 4.0 * (turned(120.0) + Vec3::new(0.0, 0.0, 0.8));
        let picture = seen_from_object(&mask, eye);
        let at = |x: usize, y: usize| picture.pixel(x, y)[0];
        assert!(at(30, 15) < 0.01 && at(29, 14) < 0.01);
        assert!((at(15, 15) - 0.5).abs() < 0.01);
        assert!(at(45, 15) > 0.99 && at(0, 15) > 0.99);
        // 38.7° up: a row of 6° each, the eighth from the top.
        assert_eq!(picture.pixel(30, 8), CAMERA);
    }
}
