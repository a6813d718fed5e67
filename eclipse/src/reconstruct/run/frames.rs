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
        let black: Vec<&str> = black.map(|(_, frame)| &*frame.name).collect();
        let empty = masks.iter().zip(frames);
        let empty = empty.filter(|(mask, _)| mask.data.iter().all(|&share| share > 0.5));
        let empty: Vec<&str> = empty.map(|(_, frame)| &*frame.name).collect();
        let of = [
            (black, "all black, left out of the fit"),
            (
                empty,
                "what occludes ended empty, nothing blocks half of the light anywhere",
            ),
        ];
        let said = of.into_iter().filter(|(names, _)| !names.is_empty());
        said.map(|(names, what)| format!("{}: {what}", named(&names)))
            .collect()
    }
}

/// Frames by name, of many the first.
fn named(names: &[&str]) -> String {
    const MOST: usize = 4;
    match names {
        [one] => format!("frame {one}"),
        few if few.len() <= MOST => format!("frames {}", few.join(", ")),
        many => format!(
            "frames {} and {} more",
            many[..MOST].join(", "),
            many.len() - MOST
        ),
    }
}
