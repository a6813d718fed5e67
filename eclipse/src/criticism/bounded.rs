//! Quadratic problems with bounds, by active sets.

use super::linear::{Cholesky, inner};

/// Errors, in units of a number's own curvature, that count as none.
const TOLERANCE: f64 = 1e-9;
/// Exchanges of whole sets that may fail to help before single numbers are exchanged, which cannot go round in circles.
const PATIENCE: usize = 3;

/// Where a number is.
#[derive(Clone, Copy, PartialEq)]
enum Place {
    Free,
    Least,
    Most,
}

/// Minimises ½ βᵀAβ − bᵀβ with every β within its bounds; A is symmetric and positive definite.
///
/// Block principal pivoting: solve for the numbers that are free, then exchange all that left their bounds or would leave
/// them for something better. A few small factorisations replace thousands of sweeps where columns are nearly alike.
pub fn bounded(a: &[f64], b: &[f64], bounds: &[[f64; 2]]) -> Vec<f64> {
    let n = b.len();
    let mut place: Vec<Place> = bounds
        .iter()
        .map(|[least, most]| match () {
            () if *least >= 0.0 => Place::Least,
            () if *most <= 0.0 => Place::Most,
            () => Place::Free,
        })
        .collect();
    let (mut fewest, mut patience) = (usize::MAX, PATIENCE);
    for _ in 0..20 + 4 * n {
        let x = solve(a, b, bounds, &place);
        let wrong: Vec<(usize, Place)> = (0..n)
            .filter_map(|i| Some((i, better(a, b, bounds, &x, &place, i)?)))
            .collect();
        if wrong.is_empty() {
            return clamped(x, bounds);
        }
        if wrong.len() < fewest {
            (fewest, patience) = (wrong.len(), PATIENCE);
        } else {
            patience = patience.saturating_sub(1);
        }
        // Murty's rule, the last one alone, ends for certain.
        let from = if patience > 0 { 0 } else { wrong.len() - 1 };
        for &(i, to) in &wrong[from..] {
            place[i] = to;
        }
    }
    let x = clamped(solve(a, b, bounds, &place), bounds);
    descend(a, b, bounds, x)
}

/// All numbers, those at bounds as they are and the free ones at their best.
fn solve(a: &[f64], b: &[f64], bounds: &[[f64; 2]], place: &[Place]) -> Vec<f64> {
    let n = b.len();
    let mut x: Vec<f64> = (0..n)
        .map(|i| match place[i] {
            Place::Free => 0.0,
            Place::Least => bounds[i][0],
            Place::Most => bounds[i][1],
        })
        .collect();
    let free: Vec<usize> = (0..n).filter(|&i| place[i] == Place::Free).collect();
    let size = free.len();
    let mut system = vec![0.0; size * size];
    let mut right = vec![0.0; size];
    for (k, &i) in free.iter().enumerate() {
        let row = &a[i * n..(i + 1) * n];
        right[k] = b[i] - inner(row, &x);
        for (s, &j) in system[k * size..(k + 1) * size].iter_mut().zip(&free) {
            *s = row[j];
        }
    }
    let factor = Cholesky::new(&system, size, size);
    factor.forward(&mut right);
    factor.backward(&mut right);
    for (&i, value) in free.iter().zip(right) {
        x[i] = value;
    }
    x
}

/// Where number `i` should be instead, if it should.
fn better(
    a: &[f64],
    b: &[f64],
    bounds: &[[f64; 2]],
    x: &[f64],
    place: &[Place],
    i: usize,
) -> Option<Place> {
    let n = b.len();
    let unit = a[i * n + i].max(1e-300).sqrt();
    let [least, most] = bounds[i];
    match place[i] {
        Place::Free if (least - x[i]) * unit > TOLERANCE => Some(Place::Least),
        Place::Free if (x[i] - most) * unit > TOLERANCE => Some(Place::Most),
        Place::Free => None,
        _ if least >= most => None,
        at => {
            let slope = (inner(&a[i * n..(i + 1) * n], x) - b[i]) / unit;
            let inward = if at == Place::Least { -slope } else { slope };
            (inward > TOLERANCE * (1.0 + b[i].abs() / unit)).then_some(Place::Free)
        }
    }
}

fn clamped(mut x: Vec<f64>, bounds: &[[f64; 2]]) -> Vec<f64> {
    for (x, [least, most]) in x.iter_mut().zip(bounds) {
        *x = x.max(*least).min(*most);
    }
    x
}

/// Coordinate descent from `x`, for systems too near to singular for exchanges to end.
fn descend(a: &[f64], b: &[f64], bounds: &[[f64; 2]], mut x: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    let mut gradient: Vec<f64> = (0..n)
        .map(|i| inner(&a[i * n..(i + 1) * n], &x) - b[i])
        .collect();
    for _ in 0..2000 {
        let mut moved = 0.0f64;
        for i in 0..n {
            let pivot = a[i * n + i];
            if pivot <= 0.0 {
                continue;
            }
            let next = (x[i] - gradient[i] / pivot)
                .max(bounds[i][0])
                .min(bounds[i][1]);
            let step = next - x[i];
            if step != 0.0 {
                x[i] = next;
                for (g, a) in gradient.iter_mut().zip(&a[i * n..(i + 1) * n]) {
                    *g += step * a;
                }
                moved = moved.max(step.abs() * pivot.sqrt());
            }
        }
        if moved < 1e-6 {
            break;
        }
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    const OPEN: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

    #[test]
    fn small_systems_are_solved_within_bounds() {
        let a = [4.0, 1.0, 1.0, 3.0];
        let b = [1.0, 2.0];
        let free = bounded(&a, &b, &[OPEN; 2]);
        assert!((free[0] - 1.0 / 11.0).abs() < 1e-12 && (free[1] - 7.0 / 11.0).abs() < 1e-12);
        let held = bounded(&a, &[-1.0, 2.0], &[[0.0, f64::INFINITY]; 2]);
        assert_eq!(held[0], 0.0);
        assert!((held[1] - 2.0 / 3.0).abs() < 1e-9);
        let capped = bounded(&a, &b, &[[0.0, 1.0], [0.0, 0.5]]);
        assert!((capped[0] - 0.125).abs() < 1e-9 && capped[1] == 0.5);
        let fixed = bounded(&a, &b, &[[0.0, 0.0], OPEN]);
        assert!(fixed[0] == 0.0 && (fixed[1] - 2.0 / 3.0).abs() < 1e-12);
        assert!(bounded(&[], &[], &[]).is_empty());
    }

    /// Columns that are sums of a few patterns and a little of their own, as those of neighbouring cells of light are.
    fn alike(n: usize, patterns: usize, seed: u64) -> (Vec<f64>, Vec<f64>) {
        let rows = 2 * n;
        let mut state = seed;
        let mut random = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / f64::from(1u32 << 30) - 1.0
        };
        let basis: Vec<Vec<f64>> = (0..patterns)
            .map(|_| (0..rows).map(|_| 30.0 * random()).collect())
            .collect();
        let columns: Vec<Vec<f64>> = (0..n)
            .map(|_| {
                let weights: Vec<f64> = (0..patterns).map(|_| random()).collect();
                (0..rows)
                    .map(|r| {
                        random()
                            + weights
                                .iter()
                                .zip(&basis)
                                .map(|(w, p)| w * p[r])
                                .sum::<f64>()
                    })
                    .collect()
            })
            .collect();
        let y: Vec<f64> = (0..rows).map(|_| 20.0 * random()).collect();
        let mut a = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..n {
                a[i * n + j] = inner(&columns[i], &columns[j]) + f64::from(u8::from(i == j));
            }
        }
        (a, columns.iter().map(|c| inner(c, &y)).collect())
    }

    #[test]
    fn nothing_can_be_improved_where_it_ends() {
        for (seed, patterns) in [(1, 3), (2, 10), (3, 60)] {
            let n = 60;
            let (a, b) = alike(n, patterns, seed);
            let bounds: Vec<[f64; 2]> = (0..n)
                .map(|i| [[0.0, 1.0], OPEN, [0.0, f64::INFINITY], [-0.1, 0.2]][i % 4])
                .collect();
            let x = bounded(&a, &b, &bounds);
            let mut held = 0;
            for i in 0..n {
                let unit = a[i * n + i].sqrt();
                let slope = (inner(&a[i * n..(i + 1) * n], &x) - b[i]) / unit;
                let [least, most] = bounds[i];
                assert!((least..=most).contains(&x[i]));
                held += usize::from(x[i] == least || x[i] == most);
                if x[i] > least {
                    assert!(slope < 1e-5, "{patterns}: {i} wants less, {slope}");
                }
                if x[i] < most {
                    assert!(slope > -1e-5, "{patterns}: {i} wants more, {slope}");
                }
            }
            assert!((5..n - 5).contains(&held), "{held}");
        }
    }

    #[test]
    fn descent_comes_to_the_same_place() {
        let (a, b) = alike(20, 20, 7);
        let bounds = [[0.0, 1.0]; 20];
        let x = bounded(&a, &b, &bounds);
        let y = descend(&a, &b, &bounds, vec![0.0; 20]);
        for (x, y) in x.iter().zip(y) {
            assert!((x - y).abs() < 1e-5, "{x} {y}");
        }
    }
}
