//! Light and texture where the photographs tell of them, as a dense system: what screening projects out, and what makes conjugate
//! gradients quick.
//!
//! Light has thousands of numbers, of which the photographs tell a few hundred directions; between the best and the worst of these
//! curvature falls by a factor of a million, and conjugate gradients on their own would need hundreds of products to get to the end of
//! each step. In the span of those directions the system is solved exactly instead, as it was when they were last looked for.

use std::sync::OnceLock;

use super::{
    confined::Inverse,
    fit::{Fit, FitError},
    gram::Matrix,
    linear::Cholesky,
    linearise::{self, Directions},
    precision::Precision,
    study::Study,
};

/// Whitened derivatives of the development data by light and texture at a fit.
pub struct Nuisance {
    /// Orthonormal directions of light, `[direction][number]`; the three colours share them.
    basis: Vec<Vec<f32>>,
    /// Columns, each `[observation][colour]`: of the directions of light, then of the texture's bumps. A column serves the three
    /// colours, each with a coefficient of its own.
    pub columns: Vec<Vec<f32>>,
    /// The observations of development.
    rows: Vec<usize>,
    /// Made when they are first solved with: screening alone never does.
    colours: OnceLock<Vec<Colour>>,
}

/// One colour's columns on those rows, and the factor of their products plus the prior's.
type Colour = (Matrix, Cholesky);

impl Nuisance {
    /// At this fit, whitened by `precision`.
    ///
    /// # Errors
    /// A bug of the tape.
    pub fn new(study: &Study<'_>, fit: &Fit, precision: &Precision) -> Result<Self, FitError> {
        Self::of(study, linearise::nuisance(study, fit, precision)?)
    }

    /// The same at another fit, in the same directions of light.
    ///
    /// # Errors
    /// A bug of the tape.
    pub fn renewed(
        &self,
        study: &Study<'_>,
        fit: &Fit,
        precision: &Precision,
    ) -> Result<Self, FitError> {
        let basis = self.basis.clone();
        Self::of(
            study,
            linearise::nuisance_along(study, fit, precision, basis)?,
        )
    }

    fn of(study: &Study<'_>, directions: Directions) -> Result<Self, FitError> {
        let Directions { basis, columns } = directions;
        let rows: Vec<usize> = (0..study.seen.len())
            .filter(|&i| study.develops(i))
            .collect();
        Ok(Self {
            basis,
            columns,
            rows,
            colours: OnceLock::new(),
        })
    }

    fn colours(&self) -> &[Colour] {
        let n = self.columns.len();
        let colour = |c: usize| {
            let matrix = Matrix::of_colour(&self.columns, &self.rows, c);
            let mut gram = matrix.products(0..self.rows.len(), 0..n, 0..n);
            (0..n).for_each(|i| gram[i * n + i] += 1.0);
            (matrix, Cholesky::new(&gram, n, n))
        };
        self.colours.get_or_init(|| (0..3).map(colour).collect())
    }

    /// The same together with whitened columns of other numbers, one coefficient for all colours, whose priors have a deviation of one.
    pub fn beside(&self, others: &[Vec<f32>]) -> Preconditioner<'_> {
        let m = others.len();
        let mut among = vec![0.0; m * m];
        (0..m).for_each(|i| among[i * m + i] = 1.0);
        let half = self
            .colours()
            .iter()
            .enumerate()
            .map(|(c, (own, factor))| {
                let other = Matrix::of_colour(others, &self.rows, c);
                let products = other.products(0..self.rows.len(), 0..m, 0..m);
                among.iter_mut().zip(products).for_each(|(a, p)| *a += p);
                let mut half = own.cross(&other);
                factor.forward_all(&mut half, m);
                for row in half.chunks_exact(m.max(1)) {
                    for i in 0..m {
                        for j in i..m {
                            among[i * m + j] -= row[i] * row[j];
                        }
                    }
                }
                half
            })
            .collect();
        let mut found = Preconditioner {
            nuisance: self,
            half,
            among,
            free: Vec::new(),
            factor: Cholesky::new(&[], 0, 0),
        };
        found.hold(&vec![false; m]);
        found
    }
}

/// About the inverse of the products of light, texture and other numbers, their priors included.
pub struct Preconditioner<'a> {
    nuisance: &'a Nuisance,
    /// By colour: L⁻¹ of the products of nuisance and other columns, `[nuisance][other]`.
    half: Vec<Vec<f64>>,
    /// Products of the other columns with the nuisance eliminated, `[other][other]`, the upper half.
    among: Vec<f64>,
    /// Other numbers that may move.
    free: Vec<usize>,
    /// Of the products among those.
    factor: Cholesky,
}

impl Preconditioner<'_> {
    /// How many other numbers there are.
    fn others(&self) -> usize {
        self.among.len().isqrt()
    }
}

impl Inverse for Preconditioner<'_> {
    /// Light and texture have no bounds; the last of `held` are the other numbers.
    fn hold(&mut self, held: &[bool]) {
        let m = self.others();
        let held = &held[held.len() - m..];
        self.free = (0..m).filter(|&i| !held[i]).collect();
        let n = self.free.len();
        let of_free = self
            .free
            .iter()
            .flat_map(|&i| self.free.iter().map(move |&j| (i, j)));
        let system: Vec<f64> = of_free.map(|(i, j)| self.among[i * m + j]).collect();
        self.factor = Cholesky::new(&system, n, n);
    }

    /// Of light `[number][colour]`, texture `[bump][colour]` and the other numbers.
    fn apply(&self, v: &[f32]) -> Vec<f32> {
        let (basis, colours) = (&self.nuisance.basis, self.nuisance.colours());
        let (all, directions) = (self.nuisance.columns.len(), basis.len());
        let bumps = all - directions;
        let m = self.others();
        let lights = v.len() - 3 * bumps - m;
        let (light, rest) = v.split_at(lights);
        let (texture, others) = rest.split_at(3 * bumps);
        // L⁻¹ of each colour's part, and what it leaves for the other numbers.
        let mut reduced: Vec<f64> = others.iter().map(|&x| f64::from(x)).collect();
        let parts: Vec<(Vec<f64>, Vec<f64>)> = (0..3)
            .map(|c| {
                let along = |row: &Vec<f32>| -> f64 {
                    let pairs = row.iter().zip(light[c..].iter().step_by(3));
                    pairs.map(|(b, x)| f64::from(*b) * f64::from(*x)).sum()
                };
                let within: Vec<f64> = basis.iter().map(along).collect();
                let mut part = within.clone();
                part.extend(texture[c..].iter().step_by(3).map(|&x| f64::from(x)));
                colours[c].1.forward(&mut part);
                for (row, x) in self.half[c].chunks_exact(m.max(1)).zip(&part) {
                    reduced.iter_mut().zip(row).for_each(|(r, h)| *r -= h * x);
                }
                (within, part)
            })
            .collect();
        let mut free: Vec<f64> = self.free.iter().map(|&i| reduced[i]).collect();
        self.factor.forward(&mut free);
        self.factor.backward(&mut free);
        let mut moved = vec![0.0; m];
        self.free
            .iter()
            .zip(&free)
            .for_each(|(&i, x)| moved[i] = *x);

        let mut out = v.to_vec();
        for (c, (within, mut part)) in parts.into_iter().enumerate() {
            for (row, x) in self.half[c].chunks_exact(m.max(1)).zip(&mut part) {
                *x -= row.iter().zip(&moved).map(|(h, b)| h * b).sum::<f64>();
            }
            colours[c].1.backward(&mut part);
            // Beyond the directions the prior alone holds light.
            for ((row, solved), was) in basis.iter().zip(&part).zip(&within) {
                let change = (solved - was) as f32;
                let numbers = out[..lights][c..].iter_mut().step_by(3);
                numbers.zip(row).for_each(|(o, b)| *o += change * b);
            }
            let numbers = out[lights..][..3 * bumps][c..].iter_mut().step_by(3);
            numbers
                .zip(&part[directions..])
                .for_each(|(o, x)| *o = *x as f32);
        }
        out[lights + 3 * bumps..]
            .iter_mut()
            .zip(&moved)
            .for_each(|(o, x)| *o = *x as f32);
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two directions of a light of three numbers, one bump, two other numbers; as many rows as `ROWS`.
    const ROWS: usize = 11;

    fn wave(seed: usize, size: usize) -> Vec<f32> {
        (0..size)
            .map(|k| (1.3 * k as f32 + 2.1 * seed as f32).sin())
            .collect()
    }

    fn nuisance() -> Nuisance {
        let third = 3.0f32.sqrt().recip();
        let basis = vec![vec![third; 3], vec![0.5f32.sqrt(), -(0.5f32.sqrt()), 0.0]];
        let columns: Vec<Vec<f32>> = (0..3).map(|k| wave(k, 3 * ROWS)).collect();
        Nuisance {
            basis,
            columns,
            rows: (0..ROWS).collect(),
            colours: OnceLock::new(),
        }
    }

    /// The system itself times `v`.
    fn product(nuisance: &Nuisance, others: &[Vec<f32>], v: &[f32]) -> Vec<f32> {
        let mut out = v.to_vec();
        for row in 0..3 * ROWS {
            let c = row % 3;
            let mut column = [0.0f32; 14];
            for (b, x) in nuisance.basis.iter().zip(&nuisance.columns) {
                (0..3).for_each(|l| column[3 * l + c] += b[l] * x[row]);
            }
            column[9 + c] = nuisance.columns[2][row];
            (0..2).for_each(|k| column[12 + k] = others[k][row]);
            let along: f32 = column.iter().zip(v).map(|(c, v)| c * v).sum();
            out.iter_mut()
                .zip(column)
                .for_each(|(o, c)| *o += along * c);
        }
        out
    }

    #[test]
    fn it_is_the_inverse_where_nothing_has_moved() {
        let nuisance = nuisance();
        let others = [wave(7, 3 * ROWS), wave(9, 3 * ROWS)];
        let mut preconditioner = nuisance.beside(&others);
        let v = wave(4, 14);
        let back = preconditioner.apply(&product(&nuisance, &others, &v));
        for (a, b) in back.iter().zip(&v) {
            assert!((a - b).abs() < 1e-4, "{back:?} {v:?}");
        }
        // With a number held it is the inverse of what is left.
        preconditioner.hold(&[true, false]);
        let mut v = v;
        v[12] = 0.0;
        let back = preconditioner.apply(&product(&nuisance, &others, &v));
        for (a, b) in back.iter().zip(&v) {
            assert!((a - b).abs() < 1e-4, "{back:?} {v:?}");
        }
    }
}
