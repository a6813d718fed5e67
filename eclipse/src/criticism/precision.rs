//! The inverse covariance of observations: independent noise, and an albedo of each site's own that all its views share.
//!
//! V = W⁻¹ + τ² D Dᵀ by site and colour, with D the light on the site in each view. Products with V⁻¹ and its symmetric
//! square root are closed forms (Sherman & Morrison), so that a site's albedo never has to be solved for.

/// See the module.
pub struct Precision {
    offsets: Vec<usize>,
    weight: Vec<f32>,
    shading: Vec<f32>,
    tau: [f64; 3],
}

impl Precision {
    /// Of `weight` (`[observation][colour]`, one over the noise's variance) and `shading` (`[view][colour]`).
    pub fn new(offsets: &[usize], weight: Vec<f32>, shading: Vec<f32>, tau: [f64; 3]) -> Self {
        Self {
            offsets: offsets.to_vec(),
            weight,
            shading,
            tau,
        }
    }

    /// The weight of each value.
    pub fn weight(&self) -> &[f32] {
        &self.weight
    }

    fn sites(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Sum over a site's views, in one colour.
    fn sum(&self, site: usize, c: usize, of: impl Fn(usize) -> f32) -> f64 {
        (self.offsets[site]..self.offsets[site + 1])
            .map(|v| f64::from(of(3 * v + c)))
            .sum()
    }

    /// V⁻¹ v.
    pub fn apply(&self, v: &[f32]) -> Vec<f32> {
        let mut out: Vec<f32> = v.iter().zip(&self.weight).map(|(v, w)| v * w).collect();
        for site in 0..self.sites() {
            for c in 0..3 {
                let along = self.sum(site, c, |i| self.weight[i] * self.shading[i] * v[i]);
                let power = self.sum(site, c, |i| self.weight[i] * self.shading[i].powi(2));
                let tau2 = self.tau[c] * self.tau[c];
                let factor = (tau2 * along / (1.0 + tau2 * power)) as f32;
                for view in self.offsets[site]..self.offsets[site + 1] {
                    let i = 3 * view + c;
                    out[i] -= self.weight[i] * self.shading[i] * factor;
                }
            }
        }
        out
    }

    /// What the sites' own albedos add to the logarithm of V's determinant.
    pub fn log_determinant(&self) -> f64 {
        let part = |site: usize, c: usize| {
            let power = self.sum(site, c, |i| self.weight[i] * self.shading[i].powi(2));
            (self.tau[c] * self.tau[c] * power).ln_1p()
        };
        (0..self.sites())
            .map(|site| (0..3).map(|c| part(site, c)).sum::<f64>())
            .sum()
    }

    /// V^(−½) v, in place: afterwards unit noise, independent.
    pub fn whiten(&self, v: &mut [f32]) {
        v.iter_mut()
            .zip(&self.weight)
            .for_each(|(v, w)| *v *= w.sqrt());
        for site in 0..self.sites() {
            for c in 0..3 {
                let root = |i: usize| self.weight[i].sqrt() * self.shading[i];
                let power = self.sum(site, c, |i| root(i).powi(2));
                if power <= 0.0 {
                    continue;
                }
                let along = self.sum(site, c, |i| root(i) * v[i]);
                let shrink = 1.0 - 1.0 / (1.0 + self.tau[c].powi(2) * power).sqrt();
                let factor = (shrink * along / power) as f32;
                for view in self.offsets[site]..self.offsets[site + 1] {
                    let i = 3 * view + c;
                    v[i] -= root(i) * factor;
                }
            }
        }
    }

    /// The square sum of what [`whiten`](Self::whiten) made `white` of, in units of the noise alone: with the part that the sites' own
    /// albedos would have taken.
    pub fn square_of_noise(&self, white: &[f32]) -> f64 {
        let kept: f64 = white.iter().map(|w| f64::from(*w).powi(2)).sum();
        let pairs = (0..self.sites()).flat_map(|site| [0, 1, 2].map(|c| (site, c)));
        let taken = pairs.map(|(site, c)| {
            let along = self.sum(site, c, |i| {
                self.weight[i].sqrt() * self.shading[i] * white[i]
            });
            (self.tau[c] * along).powi(2)
        });
        kept + taken.sum::<f64>()
    }

    /// Best own albedo of each site for residuals `r`, and its standard error, `[site][colour]`.
    pub fn own(&self, r: &[f32]) -> Vec<(f32, f32)> {
        (0..self.sites())
            .flat_map(|site| {
                [0, 1, 2].map(|c| {
                    let along = self.sum(site, c, |i| self.weight[i] * self.shading[i] * r[i]);
                    let power = self.sum(site, c, |i| self.weight[i] * self.shading[i].powi(2))
                        + 1.0 / self.tau[c].powi(2);
                    ((along / power) as f32, (1.0 / power.sqrt()) as f32)
                })
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_square_root_squares_to_the_inverse_covariance() {
        let weight = vec![2.0, 1.0, 1.0, 4.0, 1.0, 0.0, 9.0, 1.0, 1.0];
        let shading = vec![0.5, 1.0, 1.0, 0.8, 2.0, 1.0];
        let p = Precision::new(&[0, 2], weight, shading, [0.7, 0.3, 0.1]);
        let v = vec![1.0, -2.0, 0.5, 0.3, 1.0, 2.0, 1.0, 1.0, -1.0];
        let mut white = v.clone();
        p.whiten(&mut white);
        let square: f32 = white.iter().map(|w| w * w).sum();
        let direct: f32 = v.iter().zip(p.apply(&v)).map(|(a, b)| a * b).sum();
        assert!((square / direct - 1.0).abs() < 1e-5, "{square} {direct}");
        let noise: f32 = v.iter().zip(&p.weight).map(|(v, w)| w * v * v).sum();
        assert!((p.square_of_noise(&white) - f64::from(noise)).abs() < 1e-4);
        // Two views of one site in the first colour, by hand: V = W⁻¹ + τ² D Dᵀ.
        let (a, d) = (0.5 + 0.49 * 0.25, 0.25 + 0.49 * 0.64);
        let b = 0.49 * 0.5 * 0.8;
        let det = a * d - b * b;
        let hand = (d * v[0] - b * v[3]) / det;
        assert!((p.apply(&v)[0] - hand).abs() < 1e-5);
        // The noise alone has a determinant of ½ · ¼ there.
        let first = Precision {
            tau: [0.7, 0.0, 0.0],
            ..p
        };
        assert!((first.log_determinant() - f64::from(8.0 * det).ln()).abs() < 1e-5);
    }
}
