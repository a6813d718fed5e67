//! Structural similarity (Wang et al. 2004) with a Gaussian window of three pixels, as the benchmark has it.

/// Width of the window's Gaussian in pixels.
const SIGMA: f64 = 1.5;
/// What keeps means and variances near zero from deciding: (0.01)² and (0.03)² for values up to 1.
const STABILISERS: [f64; 2] = [1e-4, 9e-4];

/// The mean over pixels and channels of two images with values in [0, 1]; dissimilar pixels count −1 at least.
pub(super) fn ssim(a: &[[f64; 3]], b: &[[f64; 3]], width: usize) -> f64 {
    let [c1, c2] = STABILISERS;
    let mut sum = 0.0;
    for channel in 0..3 {
        let map = |value: &dyn Fn(usize) -> f64| -> Vec<f64> {
            let values: Vec<f64> = (0..a.len()).map(value).collect();
            blurred(&values, width)
        };
        let (x, y) = (|i: usize| a[i][channel], |i: usize| b[i][channel]);
        let (mean_x, mean_y) = (map(&x), map(&y));
        let (xx, yy, xy) = (
            map(&|i| x(i) * x(i)),
            map(&|i| y(i) * y(i)),
            map(&|i| x(i) * y(i)),
        );
        for i in 0..a.len() {
            let (mx, my) = (mean_x[i], mean_y[i]);
            let spread = (xx[i] - mx * mx) + (yy[i] - my * my);
            let common = xy[i] - mx * my;
            let similar = (2.0 * mx * my + c1) * (2.0 * common + c2)
                / ((mx * mx + my * my + c1) * (spread + c2));
            sum += similar.clamp(-1.0, 1.0);
        }
    }
    sum / (3 * a.len()) as f64
}

/// Convolved with the window; beyond an edge lies the mirror image, the edge itself not repeated.
fn blurred(values: &[f64], width: usize) -> Vec<f64> {
    let height = values.len() / width;
    let side = (-0.5 / (SIGMA * SIGMA)).exp();
    let (middle, side) = (1.0 / (1.0 + 2.0 * side), side / (1.0 + 2.0 * side));
    // A picture of one pixel mirrors onto itself.
    let before = |at: usize, end: usize| if at == 0 { 1.min(end - 1) } else { at - 1 };
    let after = |at: usize, end: usize| {
        if at + 1 == end {
            end.saturating_sub(2)
        } else {
            at + 1
        }
    };
    let across: Vec<f64> = (0..values.len())
        .map(|i| {
            let (x, row) = (i % width, i / width * width);
            middle * values[i]
                + side * (values[row + before(x, width)] + values[row + after(x, width)])
        })
        .collect();
    (0..values.len())
        .map(|i| {
            let (x, y) = (i % width, i / width);
            let at = |y: usize| across[y * width + x];
            middle * at(y) + side * (at(before(y, height)) + at(after(y, height)))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_is_like_itself_and_unlike_its_negative() {
        let image: Vec<[f64; 3]> = (0..64).map(|i| [(i * i % 17) as f64 / 17.0; 3]).collect();
        assert!((ssim(&image, &image, 8) - 1.0).abs() < 1e-12);
        let negative: Vec<[f64; 3]> = image.iter().map(|p| p.map(|v| 1.0 - v)).collect();
        assert!(ssim(&image, &negative, 8) < 0.0);
    }

    #[test]
    fn two_flat_images_are_compared_by_their_means() {
        let similarity = ssim(&[[0.2; 3]; 16], &[[0.6; 3]; 16], 4);
        let expected = (2.0 * 0.2 * 0.6 + 1e-4) / (0.04 + 0.36 + 1e-4);
        assert!((similarity - expected).abs() < 1e-12, "{similarity}");
    }
}
