//! Conjugate gradients within bounds: numbers that would leave theirs are put there, and the others solved again.

use super::linear::preconditioned;

/// How often numbers that left their bounds are put there; what leaves after that is cut off.
const ROUNDS: usize = 4;
/// Products of the first solution and of each that follows, which begins near its end.
const PRODUCTS: [usize; 2] = [48, 12];
/// By how much the residual falls.
const TOLERANCE: f64 = 1e-3;

/// About the inverse of the system, symmetric and positive definite.
pub trait Inverse {
    /// Of the numbers that are not held from here on; there is none at first.
    fn hold(&mut self, held: &[bool]);

    /// Its product with a vector, zero where numbers are held.
    fn apply(&self, v: &[f32]) -> Vec<f32>;
}

/// The step δ that about minimises ½ δᵀAδ − bᵀδ with every number within its `room`, least and most; zero must be.
///
/// A is symmetric, positive definite and known by its products. A number at its bound that wants to go beyond stays. To cut the
/// unbounded step off instead would not do: where columns are alike it may lead upwards. Comes with whether it got to its end.
pub fn step(
    b: &[f32],
    room: &[[f32; 2]],
    mut product: impl FnMut(&[f32]) -> Vec<f32>,
    inverse: &mut dyn Inverse,
) -> (Vec<f32>, bool) {
    let mut held: Vec<bool> = b
        .iter()
        .zip(room)
        .map(|(b, [least, most])| *least >= 0.0 && *b < 0.0 || *most <= 0.0 && *b > 0.0)
        .collect();
    let mut delta = vec![0.0; b.len()];
    let mut ended = true;
    for round in 0..ROUNDS {
        inverse.hold(&held);
        let free = |v: &mut [f32]| {
            let of_held = v.iter_mut().zip(&held).filter(|(_, held)| **held);
            of_held.for_each(|(v, _)| *v = 0.0);
        };
        let mut right = b.to_vec();
        free(&mut right);
        let products = PRODUCTS[usize::from(round > 0)];
        let among_free = |v: &[f32]| {
            let mut moved = product(v);
            free(&mut moved);
            moved
        };
        let along = |v: &[f32]| inverse.apply(v);
        ended = preconditioned(&mut delta, &right, products, TOLERANCE, among_free, along);
        let mut left = false;
        for ((delta, held), [least, most]) in delta.iter_mut().zip(&mut held).zip(room) {
            if *delta < *least || *delta > *most {
                *delta = delta.clamp(*least, *most);
                *held = true;
                left = true;
            }
        }
        if !left {
            break;
        }
        ended = false;
    }
    (delta, ended)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A well-conditioned system of `n` numbers whose columns are alike in pairs.
    fn product(v: &[f32]) -> Vec<f32> {
        let sum: f32 = v.iter().sum();
        (0..v.len())
            .map(|i| (1.0 + 0.1 * i as f32) * v[i] + 0.9 * v[i ^ 1] + 0.05 * sum)
            .collect()
    }

    /// Of the diagonal.
    struct Scaled(Vec<bool>);

    impl Inverse for Scaled {
        fn hold(&mut self, held: &[bool]) {
            self.0 = held.to_vec();
        }
        fn apply(&self, v: &[f32]) -> Vec<f32> {
            let scaled = |i: usize| v[i] / (1.05 + 0.1 * i as f32);
            let numbers = (0..v.len()).map(|i| if self.0[i] { 0.0 } else { scaled(i) });
            numbers.collect()
        }
    }

    #[test]
    fn without_bounds_it_solves_the_system() {
        let b: Vec<f32> = (0..6).map(|i| (i as f32 * 1.7).sin()).collect();
        let open = [[f32::NEG_INFINITY, f32::INFINITY]; 6];
        let (delta, ended) = step(&b, &open, product, &mut Scaled(Vec::new()));
        assert!(ended);
        for (a, b) in product(&delta).iter().zip(&b) {
            assert!((a - b).abs() < 5e-3, "{a} {b}");
        }
    }

    #[test]
    fn within_bounds_nothing_free_could_be_better_and_the_step_leads_downwards() {
        let b: Vec<f32> = (0..6).map(|i| (i as f32 * 1.7).sin()).collect();
        let mut room = [[0.0, 0.3]; 6];
        room[5] = [-0.1, f32::INFINITY];
        let (delta, _) = step(&b, &room, product, &mut Scaled(Vec::new()));
        let slope: Vec<f32> = product(&delta).iter().zip(&b).map(|(a, b)| a - b).collect();
        let mut bound = 0;
        for ((delta, slope), [least, most]) in delta.iter().zip(&slope).zip(&room) {
            assert!((*least..=*most).contains(delta));
            let inside = delta > least && delta < most;
            assert!(!inside || slope.abs() < 5e-3, "{delta} {slope}");
            bound += usize::from(!inside);
        }
        assert!((2..6).contains(&bound), "{bound}");
        let value: f32 = delta
            .iter()
            .zip(&slope)
            .zip(&b)
            .map(|((d, s), b)| 0.5 * d * (s - b))
            .sum();
        assert!(value < 0.0, "{value}");
    }
}
