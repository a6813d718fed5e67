//! Smaller images by means over areas: what a sensor of larger pixels would have seen.

use render::image::Image;

/// The size that an image of `size` is reduced to so that no side is longer than `longest`; its own where none is.
///
/// The longer side becomes `longest`, the other the nearest whole number of pixels.
pub fn reduced_size(size: [usize; 2], longest: usize) -> [usize; 2] {
    let (longest, own) = (longest.max(1), size[0].max(size[1]));
    if own <= longest {
        return size;
    }
    size.map(|side| ((2 * side * longest + own) / (2 * own)).max(1))
}

/// The image with fewer pixels, each the mean over the area that it covers, pixels that it covers in part counted in part.
///
/// Values are averaged as they are: of light in proportion to it ([`read_image`](super::read_image) gives that).
///
/// # Panics
/// When `size` has a side of none, or one longer than the image's.
pub fn reduce(image: &Image, size: [usize; 2]) -> Image {
    let [width, height] = size;
    assert!((1..=image.width).contains(&width) && (1..=image.height).contains(&height));
    if size == [image.width, image.height] {
        return image.clone();
    }
    let (channels, line) = (image.channels, image.width * image.channels);
    // What the shares of one pixel add up to. They are whole numbers, so that a constant stays what it is.
    let whole = image.width as f64 * image.height as f64;
    let mut data = Vec::with_capacity(width * height * channels);
    let mut sums = vec![0.0f64; width * channels];
    for row in 0..height {
        sums.fill(0.0);
        for (y, down) in shares(row, image.height, height) {
            let values = &image.data[y * line..][..line];
            for (column, sums) in sums.chunks_exact_mut(channels).enumerate() {
                for (x, across) in shares(column, image.width, width) {
                    let share = (down * across) as f64;
                    let pixel = &values[x * channels..][..channels];
                    for (sum, &value) in sums.iter_mut().zip(pixel) {
                        *sum += share * f64::from(value);
                    }
                }
            }
        }
        data.extend(sums.iter().map(|sum| (sum / whole) as f32));
    }
    Image {
        width,
        height,
        channels,
        data,
    }
}

/// The pixels that the `index`-th of `to` parts of a line of `from` pixels covers, with what it covers of each, in `to`-ths.
fn shares(index: usize, from: usize, to: usize) -> impl Iterator<Item = (usize, usize)> {
    let (start, end) = (index * from, (index + 1) * from);
    (start / to..end.div_ceil(to)).map(move |pixel| {
        let covered = end.min((pixel + 1) * to) - start.max(pixel * to);
        (pixel, covered)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longer_side_is_what_was_asked_for() {
        assert_eq!(reduced_size([2048, 2048], 512), [512, 512]);
        assert_eq!(reduced_size([6000, 4000], 1024), [1024, 683]);
        assert_eq!(reduced_size([30, 40], 40), [30, 40]);
        assert_eq!(reduced_size([1, 5000], 100), [1, 100]);
        assert_eq!(reduced_size([7, 3], 0), [1, 1]);
    }

    #[test]
    fn a_constant_stays_constant_whatever_the_size() {
        for value in [0.1f32, 1.0 / 3.0, 1e-20, 6e4] {
            let image = Image::filled(37, 23, 3, value);
            for size in [[36, 22], [10, 7], [1, 23], [37, 1], [1, 1]] {
                let small = reduce(&image, size);
                assert_eq!(small, Image::filled(size[0], size[1], 3, value));
            }
        }
    }

    #[test]
    fn light_is_neither_lost_nor_moved() {
        let mut image = Image::filled(9, 6, 1, 0.0);
        for (index, value) in image.data.iter_mut().enumerate() {
            *value = ((index * 29) % 17) as f32;
        }
        let mean = |image: &Image| image.data.iter().sum::<f32>() / image.data.len() as f32;
        for size in [[3, 2], [4, 4], [8, 5]] {
            assert!((mean(&reduce(&image, size)) - mean(&image)).abs() < 1e-5);
        }
        // A pixel that is cut in two gives each its half.
        let line = Image {
            width: 3,
            height: 1,
            channels: 1,
            data: vec![1.0, 4.0, 7.0],
        };
        assert_eq!(reduce(&line, [2, 1]).data, [2.0, 6.0]);
        // Channels stay apart.
        let two = Image {
            width: 2,
            height: 2,
            channels: 2,
            data: vec![0.0, 1.0, 2.0, 1.0, 4.0, 1.0, 2.0, 5.0],
        };
        assert_eq!(reduce(&two, [1, 1]).data, [2.0, 2.0]);
    }
}
