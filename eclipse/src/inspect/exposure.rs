//! Levels of the photographs where they show the object.

use serde::Serialize;

use super::FrameInspection;
use crate::capture::{Capture, Frame};

/// Levels from this share of the capture's greatest value on count as clipped when many pixels reach them.
const AT_MAXIMUM: f32 = 0.999;

/// Levels of all photographs together.
#[derive(Clone, Debug, Serialize)]
pub struct ExposureInspection {
    /// Median over the frames of the object's median level, linear.
    pub median: f32,
    /// Median level of the brightest frame over that of the darkest that is not black: under one exposure, what shading makes of it.
    pub spread: f32,
    /// The greatest value on the object.
    pub maximum: f32,
    /// The share of the object's pixels that stand at it: more than a few are clipped.
    pub at_maximum: f32,
}

pub(super) fn inspect(capture: &Capture, frames: &[FrameInspection]) -> ExposureInspection {
    let mut medians: Vec<f32> = frames.iter().map(|frame| frame.median).collect();
    medians.sort_by(f32::total_cmp);
    let maximum = brightest_channels(&capture.frames).fold(0.0, f32::max);
    let threshold = AT_MAXIMUM * maximum;
    let (mut at, mut all) = (0usize, 0usize);
    for level in brightest_channels(&capture.frames) {
        all += 1;
        at += usize::from(level >= threshold);
    }
    // Black frames are told by their median; a ratio without meaning is not.
    let darkest = medians.iter().copied().find(|&median| median > 0.0);
    let brightest = medians.last().copied().unwrap_or(0.0);
    ExposureInspection {
        median: medians.get(medians.len() / 2).copied().unwrap_or(0.0),
        spread: darkest.map_or(1.0, |darkest| brightest / darkest),
        maximum,
        at_maximum: at as f32 / all.max(1) as f32,
    }
}

/// The median of the mean of the channels over the object's pixels.
pub(super) fn median_level(frame: &Frame) -> f32 {
    let mut levels: Vec<f32> = object_pixels(frame)
        .map(|pixel| pixel.iter().sum::<f32>() / 3.0)
        .collect();
    if levels.is_empty() {
        return 0.0;
    }
    let middle = levels.len() / 2;
    *levels.select_nth_unstable_by(middle, f32::total_cmp).1
}

fn brightest_channels(frames: &[Frame]) -> impl Iterator<Item = f32> {
    frames
        .iter()
        .flat_map(object_pixels)
        .map(|pixel| pixel.iter().copied().fold(0.0, f32::max))
}

fn object_pixels(frame: &Frame) -> impl Iterator<Item = &[f32]> {
    let pixels = frame.image.data.chunks_exact(frame.image.channels);
    pixels
        .zip(&frame.mask.data)
        .filter(|(_, mask)| **mask > 0.5)
        .map(|(pixel, _)| pixel)
}
