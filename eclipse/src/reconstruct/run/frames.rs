//! Which frames take part, and what there is to say about the others.

use crate::{capture::Capture, settings::Settings};

/// Which frames light and materials are fitted to.
pub(super) struct Frames {
    black: Vec<bool>,
    pub(super) held_out: Vec<bool>,
}

impl Frames {
    pub(super) fn new(capture: &Capture, settings: &Settings) -> Self {
        let black = |frame: &crate::capture::Frame| frame.image.data.iter().all(|&v| v <= 0.0);
        Self {
            black: capture.frames.iter().map(black).collect(),
            held_out: (0..capture.frames.len())
                .map(|t| settings.holds_out(t))
                .collect(),
        }
    }

    pub(super) fn fitted(&self, frame: usize) -> bool {
        !self.black[frame] && !self.held_out[frame]
    }

    pub(super) fn notes(
        &self,
        frames: &[crate::capture::Frame],
        masks: &[render::image::Image],
    ) -> Vec<String> {
        let black = self.black.iter().zip(frames).filter(|(black, _)| **black);
        let mut notes: Vec<String> = black
            .map(|(_, frame)| format!("frame {}: all black, left out of the fit", frame.name))
            .collect();
        for (mask, frame) in masks.iter().zip(frames) {
            if mask.data.iter().all(|&share| share > 0.5) {
                notes.push(format!(
                    "frame {}: its mask ended empty, nothing blocks half of the light anywhere",
                    frame.name
                ));
            }
        }
        notes
    }
}
