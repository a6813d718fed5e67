//! Inner products of many columns at once.

use std::ops::Range;

use pulp::{Arch, Simd, WithSimd};
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

/// Columns of a tile, down and, in vectors, across: its sums stay in registers.
const TALL: usize = 6;
const VECTORS: usize = 2;
/// Rows that stay in the cache meanwhile.
const ROWS: usize = 48;
/// Zeros after the columns: two of the widest vectors, of sixteen.
const PADDING: usize = 16 * VECTORS;

impl Matrix {
    /// From its columns, of the rows that `rows` names.
    pub fn from_columns(columns: &[impl AsRef<[f32]> + Sync], rows: &[usize]) -> Self {
        let stride = columns.len() + PADDING;
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

    /// `count` columns of a row from one of them on; zeros where there are fewer.
    #[inline(always)]
    fn part(&self, row: usize, from: usize, count: usize) -> &[f32] {
        &self.data[row * self.stride + from..][..count]
    }

    /// The inner products of the columns `a` with the columns `b`, `[column of a][column of b]`, summed over these rows; of a column
    /// with earlier ones, which are known by symmetry, not all are found, and the others are zero.
    pub fn products(&self, rows: Range<usize>, a: Range<usize>, b: Range<usize>) -> Vec<f64> {
        let width = b.len();
        let mut out = vec![0.0; a.len() * width];
        if out.is_empty() {
            return out;
        }
        let bands = out.par_chunks_mut(TALL * width).enumerate();
        bands.for_each(|(tile, out)| {
            let first = a.start + tile * TALL;
            Arch::new().dispatch(Strip {
                left: self,
                right: self,
                rows: rows.clone(),
                first,
                tall: TALL.min(a.end - first),
                columns: first.max(b.start)..b.end,
                origin: b.start,
                width,
                out,
            });
        });
        out
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
            Arch::new().dispatch(Strip {
                left: self,
                right: other,
                rows: 0..self.rows(),
                first,
                tall: TALL.min(self.columns - first),
                columns: 0..width,
                origin: 0,
                width,
                out,
            });
        });
        out
    }
}

/// Products of `tall` columns of one matrix from `first` on with the `columns` of another.
struct Strip<'a> {
    left: &'a Matrix,
    right: &'a Matrix,
    rows: Range<usize>,
    first: usize,
    tall: usize,
    columns: Range<usize>,
    /// The first column of the other matrix that `out` has room for, and for how many.
    origin: usize,
    width: usize,
    /// Rows of products.
    out: &'a mut [f64],
}

/// Sums are vectors by name: from arrays of numbers the compiler makes neither vectors nor registers of them.
impl WithSimd for Strip<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let lanes = S::F32_LANES;
        let mut start = self.rows.start;
        while start < self.rows.end {
            let end = (start + ROWS).min(self.rows.end);
            let mut at = self.columns.start;
            while at < self.columns.end {
                let wide = (VECTORS * lanes).min(self.columns.end - at);
                let mut sums = [[simd.splat_f32s(0.0); VECTORS]; TALL];
                for row in start..end {
                    let (right, _) = S::as_simd_f32s(self.right.part(row, at, VECTORS * lanes));
                    let right: [S::f32s; VECTORS] = *right.first_chunk().expect("whole vectors");
                    let factors = self.left.part(row, self.first, TALL);
                    let factors: [f32; TALL] = *factors.first_chunk().expect("a whole tile");
                    for k in 0..TALL {
                        let factor = simd.splat_f32s(factors[k]);
                        for v in 0..VECTORS {
                            sums[k][v] = simd.mul_add_e_f32s(factor, right[v], sums[k][v]);
                        }
                    }
                }
                for (k, sums) in sums[..self.tall].iter().enumerate() {
                    let mut found = [0.0f32; PADDING];
                    for (found, sum) in found.chunks_exact_mut(lanes).zip(sums) {
                        simd.partial_store_f32s(found, *sum);
                    }
                    let target = &mut self.out[k * self.width + at - self.origin..][..wide];
                    let pairs = target.iter_mut().zip(found);
                    pairs.for_each(|(t, s)| *t += f64::from(s));
                }
                at += wide;
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
        let out = matrix.products(0..rows.len(), 2..9, 0..21);
        assert_eq!(out.len(), 7 * 21);
        for i in 2..9 {
            for j in i..21 {
                let direct: f32 = rows.iter().map(|&r| columns[i][r] * columns[j][r]).sum();
                assert_eq!(out[(i - 2) * 21 + j], f64::from(direct));
            }
        }
        let among = matrix.products(0..rows.len(), 7..20, 7..20);
        assert_eq!(among[13 + 3], out[6 * 21 + 10]);
        let other = Matrix::from_columns(&columns[3..8], &rows);
        let cross = matrix.cross(&other);
        assert_eq!(cross.len(), 21 * 5);
        assert_eq!(cross[4 * 5 + 2], out[2 * 21 + 5]);
    }
}
