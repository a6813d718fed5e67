//! Damped Gauss-Newton steps by conjugate gradients, with one group of variables eliminated.
//!
//! Minimises ½‖r(z, a)‖² + ½‖z‖² + ½τ‖a − ½‖², where every residual depends linearly on one entry of `a` (the diffuse albedo
//! of a patch and channel): `a` is eliminated in closed form (variable projection, Golub & Pereyra 1973, with Kaufman's
//! approximation of the derivative). Only products with the Jacobian are asked of the model; it is never formed.

/// A model linearised at a point: residuals and products with their Jacobian.
pub trait Linearisation {
    /// Residuals at the point, weighted so that their variance is one.
    fn residual(&self) -> &[f32];
    /// ∂residual/∂a: one entry a residual, for the entry of `a` that it depends on.
    fn by_albedo(&self) -> &[f32];
    /// Which entry of `a` each residual depends on.
    fn groups(&self) -> &[u32];
    /// J v with `a` held.
    fn jvp(&mut self, v: &[f32]) -> Vec<f32>;
    /// Jᵀ w with `a` held.
    fn vjp(&mut self, w: &[f32]) -> Vec<f32>;
}

/// How steps are taken.
#[derive(Clone, Copy, Debug)]
pub struct StepOptions {
    /// Products JᵀWJv a step.
    pub products: usize,
    /// A step ends early when the squared residual of the normal equations falls by this factor.
    pub tolerance: f64,
    /// Precision τ of the prior of `a` about one half.
    pub albedo_precision: f32,
}

/// Minimises ½Σ(aᵍ·bᵢ − yᵢ)² + ½τ(aᵍ − ½)² over a, where bᵢ = ∂rᵢ/∂a and −yᵢ = rᵢ − aᵍ·bᵢ.
pub fn best_albedo(
    residual: &[f32],
    by_albedo: &[f32],
    groups: &[u32],
    current: &[f32],
    tau: f32,
) -> Vec<f32> {
    let mut top = vec![0.5 * f64::from(tau); current.len()];
    let mut bottom = vec![f64::from(tau); current.len()];
    for ((&r, &b), &g) in residual.iter().zip(by_albedo).zip(groups) {
        let y = f64::from(current[g as usize] * b - r);
        top[g as usize] += f64::from(b) * y;
        bottom[g as usize] += f64::from(b) * f64::from(b);
    }
    top.iter()
        .zip(&bottom)
        .map(|(t, b)| (t / b) as f32)
        .collect()
}

/// ½‖r‖² + ½‖z‖² + ½τ‖a − ½‖².
pub fn cost(residual: &[f32], z: &[f32], albedo: &[f32], tau: f32) -> f64 {
    let square = |v: &[f32]| v.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>();
    let tie: f64 = albedo.iter().map(|&a| f64::from(a - 0.5).powi(2)).sum();
    0.5 * (square(residual) + square(z) + f64::from(tau) * tie)
}

/// A proposed step and what it promises.
#[derive(Clone, Debug)]
pub struct Step {
    /// The change of z.
    pub delta: Vec<f32>,
    /// Gradient along `delta`.
    pub slope: f64,
    /// Curvature of the linearised cost along `delta`.
    pub curvature: f64,
    /// Products spent.
    pub products: usize,
}

impl Step {
    /// By how much the linearised cost falls over the share `s` of the step.
    pub fn predicted(&self, s: f64) -> f64 {
        -(s * self.slope + 0.5 * s * s * self.curvature)
    }
}

/// One damped step from `z`, whose `a` is at its best.
///
/// Residuals of the normal equations are kept and each new one is made orthogonal to all before it: in single precision and
/// with eigenvalues over six decades, conjugate gradients would otherwise lose the directions they have found.
pub fn step<L: Linearisation>(
    at: &mut L,
    z: &[f32],
    groups: usize,
    damping: f32,
    options: &StepOptions,
) -> Step {
    let projector = Projector::new(at, groups, options.albedo_precision);
    let residual = at.residual().to_vec();
    let mut gradient = at.vjp(&residual);
    add(&mut gradient, 1.0, z);
    let mut product = |v: &[f32]| {
        let mut u = at.jvp(v);
        projector.project(at, &mut u);
        let mut h = at.vjp(&u);
        add(&mut h, 1.0 + damping, v);
        h
    };
    let mut x = vec![0.0; z.len()];
    let mut r: Vec<f32> = gradient.iter().map(|g| -g).collect();
    let mut p = r.clone();
    let mut rr = dot(&r, &r);
    let first = rr;
    let mut products = 0;
    let mut basis: Vec<Vec<f32>> = Vec::with_capacity(options.products);
    while products < options.products && rr > options.tolerance * first {
        let hp = product(&p);
        let alpha = (rr / dot(&p, &hp)) as f32;
        add(&mut x, alpha, &p);
        let length = rr.sqrt() as f32;
        basis.push(r.iter().map(|r| r / length).collect());
        add(&mut r, -alpha, &hp);
        orthogonalise(&mut r, &basis);
        let next = dot(&r, &r);
        let beta = (next / rr) as f32;
        rr = next;
        p.iter_mut().zip(&r).for_each(|(p, r)| *p = r + beta * *p);
        products += 1;
    }
    let mut hx = product(&x);
    add(&mut hx, -damping, &x);
    Step {
        slope: dot(&gradient, &x),
        curvature: dot(&x, &hx),
        delta: x,
        products,
    }
}

/// Takes from `r` its parts along a basis of unit vectors.
pub(super) fn orthogonalise(r: &mut [f32], basis: &[Vec<f32>]) {
    for unit in basis {
        let along = dot(unit, r) as f32;
        add(r, -along, unit);
    }
}

/// Removes from a residual-space vector what a change of `a` would take up.
pub struct Projector {
    inverse: Vec<f64>,
}

impl Projector {
    /// Of `groups` entries of `a`, whose prior has the precision `tau`.
    pub fn new<L: Linearisation>(at: &L, groups: usize, tau: f32) -> Self {
        let mut diagonal = vec![f64::from(tau); groups];
        for (&b, &g) in at.by_albedo().iter().zip(at.groups()) {
            diagonal[g as usize] += f64::from(b) * f64::from(b);
        }
        Self {
            inverse: diagonal.iter().map(|d| 1.0 / d).collect(),
        }
    }

    /// One over the precision of each entry of `a` by its own data and prior.
    pub fn variances(&self) -> &[f64] {
        &self.inverse
    }

    /// Removes from `u` what a change of `a` takes up; that change.
    pub fn project<L: Linearisation>(&self, at: &L, u: &mut [f32]) -> Vec<f32> {
        let (b, g) = (at.by_albedo(), at.groups());
        let mut along = vec![0.0; self.inverse.len()];
        for i in 0..u.len() {
            along[g[i] as usize] += f64::from(b[i]) * f64::from(u[i]);
        }
        along
            .iter_mut()
            .zip(&self.inverse)
            .for_each(|(a, inverse)| *a *= inverse);
        for i in 0..u.len() {
            u[i] -= b[i] * along[g[i] as usize] as f32;
        }
        along.iter().map(|a| -*a as f32).collect()
    }
}

/// The inner product, summed in double precision.
pub fn dot(a: &[f32], b: &[f32]) -> f64 {
    a.iter()
        .zip(b)
        .map(|(&x, &y)| f64::from(x) * f64::from(y))
        .sum()
}

/// y += s·x.
pub fn add(y: &mut [f32], s: f32, x: &[f32]) {
    y.iter_mut().zip(x).for_each(|(y, x)| *y += s * x);
}
