//! Inner products of many columns at once.

use pulp::Arch;
use rayon::prelude::*;

/// A row-major matrix of single precision.
pub struct Matrix {
    /// How many columns.
    pub columns: usize,
    rows: usize,
    /// From one row to the next: zeros follow the columns, so that every tile is whole.
    stride: usize,
    /// `[row][column]`.
    data: Vec<f32>,
}

/// Columns of a tile, which stays in registers, and rows that stay in the cache meanwhile.
const TALL: usize = 6;
const WIDE: usize = 32;
const ROWS: usize = 48;

impl Matrix {
    /// From its columns, of the rows that `rows` names.
    pub fn from_columns(columns: &[impl AsRef<[f32]> + Sync], rows: &[usize]) -> Self {
        let stride = columns.len() + WIDE;
        let mut data = vec![0.0; stride * rows.len()];
        data.par_chunks_mut(stride * 64)
            .zip(rows.par_chunks(64))
            .for_each(|(out, rows)| {
                for (out, &row) in out.chunks_exact_mut(stride).zip(rows) {
                    for (o, column) in out.iter_mut().zip(columns) {
                        *o = column.as_ref()[row];
                    }
                }
            });
        Self {
            columns: columns.len(),
            rows: rows.len(),
            stride,
            data,
        }
    }

    /// From columns that are `[observation][colour]`, of one colour on the observations that `rows` names.
    pub fn of_colour(columns: &[impl AsRef<[f32]> + Sync], rows: &[usize], colour: usize) -> Self {
        let values: Vec<usize> = rows.iter().map(|&i| 3 * i + colour).collect();
        Self::from_columns(columns, &values)
    }

    /// How many rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// One row.
    pub fn row(&self, row: usize) -> &[f32] {
        &self.data[row * self.stride..][..self.columns]
    }

    /// `N` columns of a row from one of them on; zeros where there are fewer.
    #[inline(always)]
    fn part<const N: usize>(&self, row: usize, from: usize) -> &[f32; N] {
        let part = self.data[row * self.stride + from..].first_chunk();
        part.expect("as many zeros follow the columns as a tile is wide")
    }

    /// The inner products of the columns `a` with the columns `b`, added to `out` (`[column][column]`, all of them), summed
    /// over these rows.
    pub fn products(
        &self,
        rows: std::ops::Range<usize>,
        a: std::ops::Range<usize>,
        b: std::ops::Range<usize>,
        out: &mut [f64],
    ) {
        let width = self.columns;
        if a.is_empty() {
            return;
        }
        let band = &mut out[a.start * width..a.end * width];
        band.par_chunks_mut(TALL * width)
            .enumerate()
            .for_each(|(tile, out)| {
                let first = a.start + tile * TALL;
                let tall = TALL.min(a.end - first);
                Arch::new()
                    .dispatch(|| self.strip(self, rows.clone(), first, tall, b.clone(), out));
            });
    }

    /// The inner products of all columns with all of another matrix of as many rows, `[column][other's column]`.
    pub fn cross(&self, other: &Self) -> Vec<f64> {
        let width = other.columns;
        let mut out = vec![0.0; self.columns * width];
        if width == 0 {
            return out;
        }
        let bands = out.par_chunks_mut(TALL * width).enumerate();
        bands.for_each(|(tile, out)| {
            let first = tile * TALL;
            let tall = TALL.min(self.columns - first);
            let rows = 0..self.rows();
            Arch::new().dispatch(|| self.strip(other, rows.clone(), first, tall, 0..width, out));
        });
        out
    }

    /// Products of columns from `first` on with the columns `b` of `other`, whose rows of products are `out`.
    #[inline(always)]
    fn strip(
        &self,
        other: &Self,
        rows: std::ops::Range<usize>,
        first: usize,
        tall: usize,
        b: std::ops::Range<usize>,
        out: &mut [f64],
    ) {
        let width = other.columns;
        let mut start = rows.start;
        while start < rows.end {
            let end = (start + ROWS).min(rows.end);
            let mut left = b.start;
            while left < b.end {
                let wide = WIDE.min(b.end - left);
                let mut sums = [[0.0f32; WIDE]; TALL];
                for row in start..end {
                    let right: &[f32; WIDE] = other.part(row, left);
                    let factors: &[f32; TALL] = self.part(row, first);
                    for (sums, factor) in sums.iter_mut().zip(factors) {
                        for (s, r) in sums.iter_mut().zip(right) {
                            *s = factor.mul_add(*r, *s);
                        }
                    }
                }
                for (k, sums) in sums[..tall].iter().enumerate() {
                    let target = &mut out[k * width + left..][..wide];
                    target
                        .iter_mut()
                        .zip(sums)
                        .for_each(|(t, s)| *t += f64::from(*s));
                }
                left += wide;
            }
            start = end;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_are_those_of_columns() {
        let columns: Vec<Vec<f32>> = (0..21)
            .map(|c| {
                (0..130)
                    .map(|r| ((r * 7 + c * 13) % 11) as f32 - 5.0)
                    .collect()
            })
            .collect();
        let rows: Vec<usize> = (0..130).filter(|r| r % 3 != 0).collect();
        let matrix = Matrix::from_columns(&columns, &rows);
        let mut out = vec![0.0; 21 * 21];
        matrix.products(0..rows.len(), 2..9, 0..21, &mut out);
        for i in 2..9 {
            for j in 0..21 {
                let direct: f32 = rows.iter().map(|&r| columns[i][r] * columns[j][r]).sum();
                assert_eq!(out[i * 21 + j], f64::from(direct));
            }
        }
        assert_eq!(out[21 * 9], 0.0);
        let other = Matrix::from_columns(&columns[3..8], &rows);
        let cross = matrix.cross(&other);
        assert_eq!(cross.len(), 21 * 5);
        assert_eq!(cross[4 * 5 + 2], out[4 * 21 + 5]);
    }
}
