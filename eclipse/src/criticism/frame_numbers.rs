//! Numbers that belong to one frame, in frames that no fit has seen: unknown there, so that what they can imitate does not count.

use super::{
    chain::Chain,
    fit::{Fit, FitError},
    linear::{Cholesky, inner},
    split::Role,
    study::Study,
};

/// What the numbers of sealed frames in a model change.
pub struct FrameNumbers {
    columns: Vec<Column>,
}

/// One number: its frame, and the change of every value of it by one of the number's scales, `[observation][colour]`.
struct Column {
    frame: u32,
    change: Vec<f32>,
}

impl FrameNumbers {
    /// Of a model without any.
    pub fn none() -> Self {
        Self {
            columns: Vec::new(),
        }
    }

    /// Of the effects in `fit`.
    ///
    /// # Errors
    /// A bug of the tape.
    pub fn of(study: &Study<'_>, fit: &Fit) -> Result<Self, FitError> {
        let mut columns = Vec::new();
        if fit.active.is_empty() {
            return Ok(Self { columns });
        }
        let mut chain = Chain::new(&fit.links, study.seen.len())?;
        let betas = fit.betas(study, &chain);
        chain.bind(&fit.ideal, &betas)?;
        for (l, link) in chain.links().to_vec().iter().enumerate() {
            for (k, term) in link.terms.iter().enumerate() {
                let sealed = |frame: &u32| study.frame_is_sealed(*frame);
                if let Some(frame) = term.frame.filter(sealed) {
                    let scale = term.scale as f32;
                    let change = chain.column(l, k)?.iter().map(|x| scale * x).collect();
                    columns.push(Column { frame, change });
                }
            }
        }
        Ok(Self { columns })
    }

    /// Takes out of `residual` in sealed frames what they explain best; `weight` is one over the noise's variance.
    pub fn take_out(&self, study: &Study<'_>, weight: &[f32], residual: &mut [f32]) {
        for frame in 0..study.seen.frames as u32 {
            let own = self.columns.iter().filter(|c| c.frame == frame);
            let own: Vec<&[f32]> = own.map(|c| c.change.as_slice()).collect();
            if own.is_empty() {
                continue;
            }
            let rows: Vec<usize> = (0..study.seen.len())
                .filter(|&i| study.role[i] == Role::SealedFrame && study.seen.frame(i) == frame)
                .flat_map(|i| 3 * i..3 * i + 3)
                .collect();
            let weight: Vec<f64> = rows.iter().map(|&k| f64::from(weight[k])).collect();
            let own: Vec<Vec<f64>> = own
                .iter()
                .map(|change| rows.iter().map(|&k| f64::from(change[k])).collect())
                .collect();
            let mut left: Vec<f64> = rows.iter().map(|&k| f64::from(residual[k])).collect();
            ridge(&own, &weight, &mut left);
            for (&k, left) in rows.iter().zip(left) {
                residual[k] = left as f32;
            }
        }
    }
}

/// Leaves of `residual` what weighted regression on `columns`, each with a unit prior, does not explain.
fn ridge(columns: &[Vec<f64>], weight: &[f64], residual: &mut [f64]) {
    let n = columns.len();
    let weighted: Vec<Vec<f64>> = columns
        .iter()
        .map(|column| column.iter().zip(weight).map(|(x, w)| x * w).collect())
        .collect();
    let mut matrix = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..n {
            matrix[i * n + j] = inner(&weighted[i], &columns[j]);
        }
        matrix[i * n + i] += 1.0;
    }
    let mut numbers: Vec<f64> = weighted.iter().map(|x| inner(x, residual)).collect();
    let factor = Cholesky::new(&matrix, n, n);
    factor.forward(&mut numbers);
    factor.backward(&mut numbers);
    for (column, number) in columns.iter().zip(numbers) {
        let pairs = residual.iter_mut().zip(column);
        pairs.for_each(|(r, x)| *r -= number * x);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_columns_explain_is_taken_out_and_the_rest_stays() {
        let columns = [vec![1.0, 1.0, 1.0, 1.0], vec![0.0, 1.0, 2.0, 3.0]];
        // Orthogonal to both under these weights.
        let rest = [1.0, -2.0, 1.0, 0.0];
        let weight = [1e9; 4];
        let mut residual: Vec<f64> = (0..4)
            .map(|k| 3.0 * columns[0][k] - 0.5 * columns[1][k] + rest[k])
            .collect();
        ridge(&columns, &weight, &mut residual);
        for (left, rest) in residual.iter().zip(rest) {
            assert!((left - rest).abs() < 1e-6, "{residual:?}");
        }
        // A prior of one against data that weigh as much halves what is taken out.
        let mut residual = [2.0];
        ridge(&[vec![1.0]], &[1.0], &mut residual);
        assert!((residual[0] - 1.0).abs() < 1e-12);
    }
}
