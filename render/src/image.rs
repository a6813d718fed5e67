//! Floating-point images.

/// A row-major image of linear values, `channels` interleaved, row 0 at the top.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Values per pixel.
    pub channels: usize,
    /// `height × width × channels` values.
    pub data: Vec<f32>,
}

impl Image {
    /// An image filled with `value`.
    pub fn filled(width: usize, height: usize, channels: usize, value: f32) -> Self {
        Self {
            width,
            height,
            channels,
            data: vec![value; width * height * channels],
        }
    }

    /// The first three channels: alpha is dropped, a single channel repeated.
    pub fn to_rgb(&self) -> Self {
        let rgb = |pixel: &[f32]| match *pixel {
            [r, g, b, ..] => [r, g, b],
            _ => [pixel[0]; 3],
        };
        let pixels = self.data.chunks_exact(self.channels);
        Self {
            channels: 3,
            data: pixels.flat_map(rgb).collect(),
            ..*self
        }
    }

    /// The values of the pixel in column `x` of row `y`.
    pub fn pixel(&self, x: usize, y: usize) -> &[f32] {
        let start = (y * self.width + x) * self.channels;
        &self.data[start..start + self.channels]
    }

    /// The values of the pixel in column `x` of row `y`, to be changed.
    pub fn pixel_mut(&mut self, x: usize, y: usize) -> &mut [f32] {
        let start = (y * self.width + x) * self.channels;
        &mut self.data[start..start + self.channels]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alpha_is_dropped_and_grey_repeated() {
        let image = |channels: usize, data: &[f32]| Image {
            width: 2,
            height: 1,
            channels,
            data: data.to_vec(),
        };
        let rgb = image(3, &[1.0, 2.0, 3.0, 5.0, 6.0, 7.0]);
        let rgba = image(4, &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]);
        assert_eq!(rgba.to_rgb(), rgb);
        assert_eq!(rgb.to_rgb(), rgb);
        let grey = image(2, &[1.0, 9.0, 2.0, 9.0]).to_rgb();
        assert_eq!(grey.data, [1.0, 1.0, 1.0, 2.0, 2.0, 2.0]);
    }
}
