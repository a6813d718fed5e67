//! Photographs that hold a few levels only: what rounding to them does to a value.

use render::image::Image;

/// Levels of eight bits.
const MOST: usize = 256;

/// The levels of photographs of eight bits or fewer.
pub struct Quantum {
    levels: Vec<f32>,
}

impl Quantum {
    /// The levels of these images; `None` where there are more than eight bits have.
    pub fn of<'a>(images: impl Iterator<Item = &'a Image>) -> Option<Self> {
        let mut levels: Vec<f32> = Vec::new();
        for value in images.flat_map(|image| &image.data) {
            if let Err(at) = levels.binary_search_by(|level| level.total_cmp(value)) {
                if levels.len() == MOST {
                    return None;
                }
                levels.insert(at, *value);
            }
        }
        (levels.len() > 1).then_some(Self { levels })
    }

    /// Variance of the rounding at a value: a twelfth of the squared distance of the levels around it.
    pub fn variance(&self, value: f32) -> f32 {
        let last = self.levels.len() - 1;
        let above = self.levels.partition_point(|level| *level < value);
        let above = above.clamp(1, last);
        (self.levels[above] - self.levels[above - 1]).powi(2) / 12.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eight_bits_are_told_from_more() {
        let mut image = Image::filled(40, 40, 3, 0.0);
        for (k, value) in image.data.iter_mut().enumerate() {
            *value = (k % 256) as f32 / 255.0;
        }
        let quantum = Quantum::of([&image].into_iter()).unwrap();
        let deviation = 1.0 / 255.0 / 12f32.sqrt();
        for value in [-1.0, 0.0, 0.3, 1.0, 2.0] {
            assert!((quantum.variance(value).sqrt() / deviation - 1.0).abs() < 1e-3);
        }
        image.data[7] = 0.0001;
        assert!(Quantum::of([&image].into_iter()).is_none());
    }
}
