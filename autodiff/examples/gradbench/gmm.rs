//! Fitting a mixture of Gaussians: the objective of the GMM evaluation, on the tape.
//!
//! Of n points x in d dimensions and k components with log weights alpha, means mu, and inverse covariance factors whose
//! diagonal is exp(q) and whose strict lower triangle is l, column by column:
//!
//! `sum_x logsumexp_k(alpha + sum q - |Q (x - mu)|^2 / 2) - n logsumexp(alpha) - n d ln(2 pi) / 2 + prior`, with the Wishart
//! prior `k C - sum_k (gamma^2 (|exp q|^2 + |l|^2) / 2 - m sum q)`.

use std::f64::consts::PI;

use autodiff::{GraphError, Program, RunError, Sizes, Var, Workspace};

/// What is given: matrices by rows.
#[derive(Clone, Debug, Default)]
pub struct Input {
    pub alpha: Vec<f64>,
    pub mu: Vec<Vec<f64>>,
    pub q: Vec<Vec<f64>>,
    pub l: Vec<Vec<f64>>,
    pub x: Vec<Vec<f64>>,
    pub gamma: f64,
    pub m: usize,
}

/// Gradients, in the shapes of the input.
#[derive(Clone, Debug, Default)]
pub struct Gradient {
    pub alpha: Vec<f64>,
    pub mu: Vec<Vec<f64>>,
    pub q: Vec<Vec<f64>>,
    pub l: Vec<Vec<f64>>,
}

/// The recorded objective with the input bound.
pub struct Gmm {
    program: Program,
    ws: Workspace<f64>,
    input: Input,
}

impl Input {
    pub fn dimensions(&self) -> usize {
        self.mu.first().map_or(0, Vec::len)
    }
}

impl Gmm {
    pub fn new(input: Input) -> Result<Self, Box<dyn std::error::Error>> {
        let program = record(&input)?;
        let sizes = Sizes::new()
            .lanes("point", input.x.len())
            .axis("component", input.alpha.len());
        let mut ws = program.workspace::<f64>(&sizes)?;
        ws.set("x", &columns(&input.x))?;
        bind(&mut ws, &input)?;
        Ok(Gmm { program, ws, input })
    }

    pub fn objective(&mut self) -> Result<f64, RunError> {
        // Bound anew, so that nothing is kept from an earlier call.
        bind(&mut self.ws, &self.input)?;
        self.program.forward(&mut self.ws)?;
        Ok(self.ws.output("objective")?[0])
    }

    pub fn gradient(&mut self) -> Result<Gradient, RunError> {
        bind(&mut self.ws, &self.input)?;
        self.program.vjp(&mut self.ws, "objective")?;
        let k = self.input.alpha.len();
        Ok(Gradient {
            alpha: self.ws.gradient("alpha")?.to_vec(),
            mu: rows(self.ws.gradient("mu")?, k),
            q: rows(self.ws.gradient("q")?, k),
            l: match self.input.dimensions() {
                0 | 1 => vec![Vec::new(); k],
                _ => rows(self.ws.gradient("l")?, k),
            },
        })
    }
}

fn bind(ws: &mut Workspace<f64>, input: &Input) -> Result<(), RunError> {
    ws.set("alpha", &input.alpha)?;
    ws.set("mu", &columns(&input.mu))?;
    ws.set("q", &columns(&input.q))?;
    if input.dimensions() > 1 {
        ws.set("l", &columns(&input.l))?;
    }
    Ok(())
}

fn record(input: &Input) -> Result<Program, GraphError> {
    let (n, k, d) = (input.x.len(), input.alpha.len(), input.dimensions());
    let (gamma, m) = (input.gamma, input.m as f64);
    let g = autodiff::Graph::new();
    let (point, component) = (g.domain("point"), g.axis("component"));
    let one = g.uniform();
    let alpha = g.param_along("alpha", &one, 1, &component);
    let mu = g.param_along("mu", &one, d, &component);
    let q = g.param_along("q", &one, d, &component);
    let l = (d > 1).then(|| g.param_along("l", &one, d * (d - 1) / 2, &component));
    let x = g.input("x", &point, d);

    let (diagonal, sum_q) = (q.exp(), q.sum_channels());
    let centered = x - mu;
    let scaled = &centered * &diagonal;
    let row = |j: usize| {
        let below = (0..j).map(|i| {
            // Entry (j, i) of a triangle that is stored column by column.
            let at = i * d - i * (i + 1) / 2 + (j - i - 1);
            (at, i)
        });
        below.fold(scaled.channel(j), |sum: Var, (at, i)| match &l {
            Some(l) => sum + l.channel(at) * centered.channel(i),
            None => sum,
        })
    };
    let square = (1..d).fold(row(0).square(), |sum, j| sum + row(j).square());
    let terms = (&alpha + &sum_q) - square * 0.5;
    let likelihood = terms.log_sum_exp().sum() - alpha.log_sum_exp() * n as f64;

    let norm = diagonal.square().sum();
    let norm = match &l {
        Some(l) => norm + l.square().sum(),
        None => norm,
    };
    let prior = norm * (0.5 * gamma * gamma) - sum_q.sum() * m;
    let constant =
        k as f64 * wishart_constant(d, input.m, gamma) - (n * d) as f64 * 0.5 * (2.0 * PI).ln();
    let objective = likelihood - prior + constant;
    g.compile(&[("objective", &objective)])
}

/// `n d (ln gamma - ln(2) / 2) - ln Gamma_d(n / 2)` with `n = d + m + 1`.
pub fn wishart_constant(d: usize, m: usize, gamma: f64) -> f64 {
    let n = d + m + 1;
    // The multivariate gamma function takes halves of whole numbers only.
    let mut log_gamma = 0.25 * (d * d.saturating_sub(1)) as f64 * PI.ln();
    for j in 0..d {
        log_gamma += log_gamma_of_half(n - j);
    }
    (n * d) as f64 * (gamma.ln() - 0.5 * 2f64.ln()) - log_gamma
}

/// `ln Gamma(twice / 2)`.
fn log_gamma_of_half(twice: usize) -> f64 {
    let (first, mut sum) = match twice % 2 {
        0 => (2, 0.0),
        _ => (1, 0.5 * PI.ln()),
    };
    for at in (first..twice).step_by(2) {
        sum += (0.5 * at as f64).ln();
    }
    sum
}

/// Columns of a matrix given by rows, one after another.
fn columns(rows: &[Vec<f64>]) -> Vec<f64> {
    let width = rows.first().map_or(0, Vec::len);
    (0..width)
        .flat_map(|c| rows.iter().map(move |row| row[c]))
        .collect()
}

/// The inverse of [`columns`] for `height` rows.
fn rows(columns: &[f64], height: usize) -> Vec<Vec<f64>> {
    (0..height)
        .map(|r| columns.iter().skip(r).step_by(height).copied().collect())
        .collect()
}
