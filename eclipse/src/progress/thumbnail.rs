//! A map of all directions in a terminal: two pixels a character, the upper as the colour of ▀, the lower as its ground.

use ratatui::{buffer::Buffer, layout::Rect, style::Color, widgets::Widget};
use render::image::Image;

use crate::report::pictures;

/// The share of directions whose light must not clip.
const WHITE: f64 = 0.95;

/// A picture ready to be drawn at any size.
pub(super) struct Thumbnail {
    display: Image,
}

impl Thumbnail {
    /// Of linear radiance, as the report shows it.
    pub(super) fn new(environment: &Image) -> Self {
        let exposure = pictures::exposure(&[environment], WHITE, |_, _| true);
        Self {
            display: pictures::tonemapped(environment, exposure),
        }
    }

    /// The mean over the part of the picture that pixel (x, y) of `width` × `height` covers.
    fn colour(&self, [x, y]: [usize; 2], [width, height]: [usize; 2]) -> Color {
        let range = |k: usize, of: usize, side: usize| {
            let begin = (k * side / of).min(side - 1);
            begin..((k + 1) * side / of).clamp(begin + 1, side)
        };
        let mut sum = [0.0; 3];
        let mut count = 0.0;
        for row in range(y, height, self.display.height) {
            for column in range(x, width, self.display.width) {
                let pixel = self.display.pixel(column, row);
                (0..3).for_each(|c| sum[c] += pixel[c]);
                count += 1.0;
            }
        }
        let [r, g, b] = sum.map(|value: f32| (255.0 * value / count).round() as u8);
        Color::Rgb(r, g, b)
    }
}

impl Widget for &Thumbnail {
    fn render(self, area: Rect, buffer: &mut Buffer) {
        // Characters are twice as high as wide, and so are two pixels: the map keeps its shape.
        let width = area.width.min(4 * area.height);
        let height = width / 4;
        if height == 0 || self.display.data.is_empty() {
            return;
        }
        let size = [usize::from(width), 2 * usize::from(height)];
        for row in 0..height {
            for column in 0..width {
                let at = |half: u16| [usize::from(column), usize::from(2 * row + half)];
                if let Some(cell) = buffer.cell_mut((area.x + column, area.y + row)) {
                    cell.set_symbol("▀")
                        .set_fg(self.colour(at(0), size))
                        .set_bg(self.colour(at(1), size));
                }
            }
        }
    }
}
