//! The paper's flatland (supplement S4, Eq. S16–S19): a Lambertian disc of radius 1 under light from all around, and occluders
//! of a width Δθ at a distance r.
//!
//! The printed S17 is 1 inside the occluder, a window; the text asks for a blocker. Both are here. S18 prints an arctan, read
//! as atan2, and angles are compared around the circle.

use std::f64::consts::{PI, TAU};

use nalgebra::DMatrix;

/// What of the light an occluder leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Occluder {
    /// It takes away what is inside.
    Blocker,
    /// It takes away what is outside: S17 as printed.
    Window,
}

/// The disc and its occluders' size.
#[derive(Clone, Copy, Debug)]
pub struct Flatland {
    /// Places on the disc, and directions of light.
    pub samples: usize,
    /// Distance r of the occluders.
    pub distance: f64,
    /// Their width Δθ (rad).
    pub width: f64,
    /// What they are.
    pub occluder: Occluder,
}

impl Flatland {
    /// The numbers of Fig. 3 with a blocker.
    pub const PAPER: Self = Self {
        samples: 512,
        distance: 10.0,
        width: 0.7,
        occluder: Occluder::Blocker,
    };

    /// The angle of a sample, of the disc (λ) as of the light (φ).
    pub fn angle(&self, index: usize) -> f64 {
        TAU * index as f64 / self.samples as f64
    }

    /// (cos(λ − φ))₊ for a difference of whole samples. Exactly zero at right angles, where rounding would leave dust.
    pub fn cosine(&self, difference: usize) -> f64 {
        let quarter = (4 * difference) % (4 * self.samples);
        if quarter == self.samples || quarter == 3 * self.samples {
            return 0.0;
        }
        self.angle(difference).cos().max(0.0)
    }

    /// The occluder M_t (S17) at the central angle θ.
    fn passes(&self, lambda: f64, phi: f64, theta: f64) -> bool {
        let off = (self.place(lambda, phi) - theta + PI).rem_euclid(TAU) - PI;
        let inside = off.abs() < 0.5 * self.width;
        inside == (self.occluder == Occluder::Window)
    }

    /// ψ (S18): where on the occluders' circle a ray from λ towards φ arrives.
    pub fn place(&self, lambda: f64, phi: f64) -> f64 {
        let cos = (lambda - phi).cos();
        let t = (cos * cos + self.distance * self.distance - 1.0).sqrt() - cos;
        let (x, y) = (lambda.cos() + t * phi.cos(), lambda.sin() + t * phi.sin());
        y.atan2(x)
    }

    /// A of S19: the cosine, and one block of rows for each occluder's angle; with none, a single block without occluder.
    pub fn operator(&self, angles: &[f64]) -> DMatrix<f64> {
        let n = self.samples;
        DMatrix::from_fn(n * angles.len().max(1), n, |row, column| {
            let (block, place) = (row / n, row % n);
            let cosine = self.cosine((n + place - column) % n);
            let passes = angles.get(block).is_none_or(|&theta| {
                cosine > 0.0 && self.passes(self.angle(place), self.angle(column), theta)
            });
            if passes { cosine } else { 0.0 }
        })
    }
}

/// `count` angles uniformly spread over the circle, the first at 0.
pub fn spread(count: usize) -> Vec<f64> {
    (0..count).map(|t| TAU * t as f64 / count as f64).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_arrive_where_they_leave_the_circle() {
        let flatland = Flatland::PAPER;
        for (lambda, phi) in [(0.0, 0.0), (1.0, 1.5), (3.0, 2.2), (-2.0, -1.2)] {
            let psi = flatland.place(lambda, phi);
            let place = [10.0 * psi.cos(), 10.0 * psi.sin()];
            // The place minus the start is parallel to the direction, and ahead.
            let way = [place[0] - lambda.cos(), place[1] - lambda.sin()];
            let cross = way[0] * phi.sin() - way[1] * phi.cos();
            assert!(cross.abs() < 1e-12, "{cross}");
            assert!(way[0] * phi.cos() + way[1] * phi.sin() > 0.0);
        }
    }

    #[test]
    fn blocker_and_window_share_the_light() {
        let blocker = Flatland {
            samples: 64,
            ..Flatland::PAPER
        };
        let window = Flatland {
            occluder: Occluder::Window,
            ..blocker
        };
        // Close to ±π, where angles wrap.
        let angles = [3.1];
        let (a, b, all) = (
            blocker.operator(&angles),
            window.operator(&angles),
            blocker.operator(&[]),
        );
        let taken = b.sum();
        assert!(taken > 0.0 && a + b == all);
        // Of 2π, the window lets through about Δθ: light from behind the occluder, seen by half the disc.
        let share = taken / all.sum();
        assert!((share - 0.7 / TAU).abs() < 0.02, "{share}");
    }
}
