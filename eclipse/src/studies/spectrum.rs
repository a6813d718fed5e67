//! Singular values, and Fourier transforms of a few hundred samples.

use std::f64::consts::TAU;

use nalgebra::{DMatrix, SVD};

use super::StudyError;

/// Steps allowed for each singular value; two or three do.
const ROUNDS: usize = 60;

/// Singular values, largest first.
///
/// A tall matrix is reduced to its triangular factor first, which has the same ones: AᵀA would lose half of the digits.
///
/// # Errors
/// An iteration that does not converge.
pub fn singular_values(matrix: &DMatrix<f64>) -> Result<Vec<f64>, StudyError> {
    let (rows, columns) = (matrix.nrows(), matrix.ncols());
    let square = if rows > columns {
        matrix.clone().qr().r()
    } else {
        matrix.clone()
    };
    let steps = ROUNDS * columns.max(1);
    let decomposition = SVD::try_new(square, false, false, f64::EPSILON, steps)
        .ok_or(StudyError::Singular { rows, columns })?;
    let mut values: Vec<f64> = decomposition.singular_values.iter().copied().collect();
    values.sort_by(|a, b| b.total_cmp(a));
    Ok(values)
}

/// A complex number, (real, imaginary).
pub type Complex = [f64; 2];

/// |z|.
pub fn magnitude(z: Complex) -> f64 {
    z[0].hypot(z[1])
}

/// The unitary discrete Fourier transform, x̂_k = n^−½ Σ x_j e^(−2πi jk/n), by its definition: a few hundred samples need no
/// better.
pub fn fourier(signal: &[f64]) -> Vec<Complex> {
    (0..signal.len()).map(|k| coefficient(signal, k)).collect()
}

/// Magnitudes of a row of F M Fᴴ: how a wave in the output depends on waves in the input.
pub fn wave_row(matrix: &DMatrix<f64>, index: usize) -> Vec<f64> {
    let columns = matrix.column_iter();
    // (F M)ᵢⱼ for every column, real and imaginary parts apart; magnitudes do not mind which sign the second transform has.
    let (real, imaginary): (Vec<f64>, Vec<f64>) = columns
        .map(|column| {
            let [re, im] = coefficient(column.as_slice(), index);
            (re, -im)
        })
        .unzip();
    let parts = fourier(&real).into_iter().zip(fourier(&imaginary));
    parts
        .map(|([a, b], [c, d])| magnitude([a - d, b + c]))
        .collect()
}

/// One coefficient of [`fourier`].
fn coefficient(signal: &[f64], k: usize) -> Complex {
    let n = signal.len();
    let scale = 1.0 / (n as f64).sqrt();
    let mut sum = [0.0; 2];
    for (j, x) in signal.iter().enumerate() {
        let (sin, cos) = (-TAU * (j * k % n) as f64 / n as f64).sin_cos();
        sum[0] += scale * x * cos;
        sum[1] += scale * x * sin;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(values: &[f64], expected: &[f64]) {
        assert_eq!(values.len(), expected.len());
        for (a, b) in values.iter().zip(expected) {
            assert!((a - b).abs() < 1e-12, "{values:?} {expected:?}");
        }
    }

    #[test]
    fn singular_values_of_matrices_known_by_heart() {
        // ((1, 1), (0, 1)): the golden ratio and its inverse.
        let shear = DMatrix::from_fn(2, 2, |i, j| if i <= j { 1.0 } else { 0.0 });
        let golden = 0.5 * (1.0 + 5.0_f64.sqrt());
        near(&singular_values(&shear).unwrap(), &[golden, 1.0 / golden]);
        // Tall, of rank one: |u| |v|.
        let outer = DMatrix::from_fn(6, 3, |i, j| (i as f64 + 1.0) * [2.0, -1.0, 2.0][j]);
        near(
            &singular_values(&outer).unwrap(),
            &[3.0 * 91.0_f64.sqrt(), 0.0, 0.0],
        );
    }

    #[test]
    fn small_singular_values_of_tall_matrices_keep_their_digits() {
        // Läuchli's matrix: √(n + ε²) and ε; ε² is lost in AᵀA.
        let epsilon = 1e-9;
        let matrix = DMatrix::from_fn(4, 3, |i, j| match i {
            0 => 1.0,
            i if i == j + 1 => epsilon,
            _ => 0.0,
        });
        let values = singular_values(&matrix).unwrap();
        assert!((values[0] - 3.0_f64.sqrt()).abs() < 1e-12);
        assert!((values[2] / epsilon - 1.0).abs() < 1e-6, "{values:?}");
    }

    #[test]
    fn a_wave_has_one_frequency_and_energy_is_kept() {
        let n = 48;
        let signal: Vec<f64> = (0..n)
            .map(|j| 3.0 + (TAU * 5.0 * j as f64 / n as f64).cos())
            .collect();
        let spectrum = fourier(&signal);
        let root = (n as f64).sqrt();
        for (k, z) in spectrum.iter().enumerate() {
            let expected = match k {
                0 => 3.0 * root,
                5 | 43 => 0.5 * root,
                _ => 0.0,
            };
            assert!((magnitude(*z) - expected).abs() < 1e-11, "{k}");
        }
        let energy: f64 = spectrum.iter().map(|z| magnitude(*z).powi(2)).sum();
        let direct: f64 = signal.iter().map(|x| x * x).sum();
        assert!((energy / direct - 1.0).abs() < 1e-12);
    }
}
