//! The pyramid that parameterises an environment (paper Eq. 7): Σ_k aᵏ L_k on the finest grid, before the exponential.

use crate::lat_long::LatLong;
use crate::math::Float;

/// The paper's ratio a between the weights of consecutive levels.
const RATIO: f64 = 2.0;

/// A coarse-to-fine stack of equirectangular grids and the linear map from it to the finest grid.
///
/// Level 0 is the coarsest; each finer level doubles it, the finest is H' × W', sizes halve rounding up. A value of
/// level k is interpolated bilinearly at the finest texels' centres and weighted by aᵏ; a is 2 unless said otherwise.
#[derive(Clone, Debug)]
pub struct Pyramid {
    levels: Vec<LatLong>,
    weights: Vec<f64>,
    offsets: Vec<usize>,
    /// For each finest texel, `4 × levels` pairs of (flat index, weight).
    index: Vec<u32>,
    weight: Vec<f64>,
}

impl Pyramid {
    /// A pyramid of at most `levels` levels (at least one) over the grid `finest`; it ends early at one texel.
    pub fn new(finest: LatLong, levels: usize) -> Self {
        Self::with_ratio(finest, levels, RATIO)
    }

    /// The same with another ratio a between the weights of consecutive levels, from coarse to fine.
    pub fn with_ratio(finest: LatLong, levels: usize, ratio: f64) -> Self {
        let mut grids = vec![finest];
        while grids.len() < levels.max(1) && grids[grids.len() - 1].len() > 1 {
            let last = grids[grids.len() - 1];
            grids.push(LatLong::new(
                last.rows.div_ceil(2),
                last.columns.div_ceil(2),
            ));
        }
        grids.reverse();
        let weights = (0..grids.len()).map(|k| ratio.powi(k as i32)).collect();
        Self::of(grids, weights)
    }

    /// The finest level alone, of the weight that it has here: a free value for every texel.
    pub fn finest_alone(&self) -> Self {
        let weight = self.weights[self.weights.len() - 1];
        Self::of(vec![self.finest()], vec![weight])
    }

    /// Of these grids, coarsest first, and their weights.
    fn of(grids: Vec<LatLong>, weights: Vec<f64>) -> Self {
        let finest = grids[grids.len() - 1];
        let mut offsets = vec![0];
        for grid in &grids {
            offsets.push(offsets[offsets.len() - 1] + grid.len());
        }
        let mut index = Vec::with_capacity(finest.len() * grids.len() * 4);
        let mut weight = Vec::with_capacity(index.capacity());
        for row in 0..finest.rows {
            for column in 0..finest.columns {
                let u = (column as f32 + 0.5) / finest.columns as f32;
                let v = (row as f32 + 0.5) / finest.rows as f32;
                for (k, grid) in grids.iter().enumerate() {
                    let exact = k + 1 == grids.len();
                    let lookup = grid.bilinear_at(u, v);
                    for corner in 0..4 {
                        // Interpolation at its own centres is the identity but for rounding.
                        let (i, w) = match (exact, corner) {
                            (true, 0) => ((row * finest.columns + column) as u32, 1.0),
                            (true, _) => ((row * finest.columns + column) as u32, 0.0),
                            _ => (lookup.index[corner], f64::from(lookup.weight[corner])),
                        };
                        index.push(i + offsets[k] as u32);
                        weight.push(w * weights[k]);
                    }
                }
            }
        }
        Self {
            levels: grids,
            weights,
            offsets,
            index,
            weight,
        }
    }

    /// The grids, coarsest first.
    pub fn levels(&self) -> &[LatLong] {
        &self.levels
    }

    /// The weight aᵏ of level `k` (0 = coarsest).
    pub fn level_weight(&self, k: usize) -> f64 {
        self.weights[k]
    }

    /// The finest grid.
    pub fn finest(&self) -> LatLong {
        self.levels[self.levels.len() - 1]
    }

    /// The number of values of all levels together: the length of `levels_flat`.
    pub fn len(&self) -> usize {
        self.offsets[self.levels.len()]
    }

    /// Whether there are no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Where the values of level `k` (0 = coarsest) lie in `levels_flat`.
    pub fn range(&self, k: usize) -> std::ops::Range<usize> {
        self.offsets[k]..self.offsets[k + 1]
    }

    /// The values that a finest texel is made of and their weights, aᵏ included; a value may come more than once.
    pub fn parts(&self, texel: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let entries = 4 * self.levels.len();
        (texel * entries..(texel + 1) * entries).map(|e| (self.index[e] as usize, self.weight[e]))
    }

    /// What every finest texel is made of, texel after texel: values and their weights.
    fn texels(&self) -> impl Iterator<Item = (&[u32], &[f64])> {
        let entries = 4 * self.levels.len();
        let index = self.index.chunks_exact(entries);
        index.zip(self.weight.chunks_exact(entries))
    }

    /// finest = Σ_k aᵏ · upsample(level k), for `width` columns at once.
    ///
    /// `levels_flat` is `[value][column]`, `len() × width`; `finest` is `[texel][column]` and is overwritten.
    pub fn apply<T: Float>(&self, levels_flat: &[T], finest: &mut [T], width: usize) {
        assert_eq!(levels_flat.len(), self.len() * width, "pyramid values");
        assert_eq!(finest.len(), self.finest().len() * width, "pyramid texels");
        if width == 1 {
            // The same sums, in a register.
            for (out, (index, weight)) in finest.iter_mut().zip(self.texels()) {
                let mut sum = T::ZERO;
                for (i, w) in index.iter().zip(weight) {
                    sum += T::from_f64(*w) * levels_flat[*i as usize];
                }
                *out = sum;
            }
            return;
        }
        for (out, (index, weight)) in finest.chunks_exact_mut(width).zip(self.texels()) {
            out.fill(T::ZERO);
            for (i, w) in index.iter().zip(weight) {
                let w = T::from_f64(*w);
                let source = &levels_flat[*i as usize * width..][..width];
                for (o, s) in out.iter_mut().zip(source) {
                    *o += w * *s;
                }
            }
        }
    }

    /// The transpose of [`apply`](Self::apply): `levels_flat` is overwritten.
    pub fn apply_transpose<T: Float>(&self, finest: &[T], levels_flat: &mut [T], width: usize) {
        assert_eq!(levels_flat.len(), self.len() * width, "pyramid values");
        assert_eq!(finest.len(), self.finest().len() * width, "pyramid texels");
        levels_flat.fill(T::ZERO);
        for (source, (index, weight)) in finest.chunks_exact(width).zip(self.texels()) {
            for (i, w) in index.iter().zip(weight) {
                let w = T::from_f64(*w);
                let out = &mut levels_flat[*i as usize * width..][..width];
                for (o, s) in out.iter_mut().zip(source) {
                    *o += w * *s;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_halve_rounding_up() {
        let pyramid = Pyramid::new(LatLong::new(50, 100), 6);
        let sizes: Vec<_> = pyramid
            .levels()
            .iter()
            .map(|g| (g.rows, g.columns))
            .collect();
        assert_eq!(
            sizes,
            [(2, 4), (4, 7), (7, 13), (13, 25), (25, 50), (50, 100)]
        );
        assert_eq!(pyramid.len(), 8 + 28 + 91 + 325 + 1250 + 5000);
        assert_eq!(Pyramid::new(LatLong::new(4, 8), 99).levels().len(), 4);
    }

    #[test]
    fn constants_are_weighted_by_powers_of_two() {
        let pyramid = Pyramid::new(LatLong::new(50, 100), 3);
        for k in 0..3 {
            let mut levels = vec![0.0_f64; pyramid.len()];
            levels[pyramid.range(k)].fill(0.5);
            let mut finest = vec![0.0; 5000];
            pyramid.apply(&levels, &mut finest, 1);
            let expected = 0.5 * f64::from(1 << k);
            assert!(finest.iter().all(|v| (v - expected).abs() < 1e-6));
        }
    }

    #[test]
    fn a_ratio_below_one_favours_the_coarse_levels() {
        let grid = LatLong::new(8, 16);
        let halving = Pyramid::with_ratio(grid, 3, 0.5);
        let weights: Vec<f64> = (0..3).map(|k| halving.level_weight(k)).collect();
        assert_eq!(weights, [1.0, 0.5, 0.25]);
        let mut levels = vec![0.0_f64; halving.len()];
        levels[halving.range(1)].fill(2.0);
        let mut finest = vec![0.0; grid.len()];
        halving.apply(&levels, &mut finest, 1);
        assert!(finest.iter().all(|v| (v - 1.0).abs() < 1e-6));
    }

    #[test]
    fn the_finest_level_alone_is_a_value_for_every_texel() {
        let grid = LatLong::new(5, 7);
        let alone = Pyramid::new(grid, 3).finest_alone();
        assert_eq!((alone.len(), alone.levels().len()), (35, 1));
        let levels: Vec<f64> = (0..35).map(f64::from).collect();
        let mut finest = vec![0.0; 35];
        alone.apply(&levels, &mut finest, 1);
        let expected: Vec<f64> = levels.iter().map(|v| 4.0 * v).collect();
        assert_eq!(finest, expected);
    }

    #[test]
    fn the_transpose_is_the_adjoint() {
        let pyramid = Pyramid::new(LatLong::new(9, 14), 4);
        let width = 3;
        let wave = |n: usize, f: f64| (0..n).map(|i| (f * i as f64).sin()).collect::<Vec<_>>();
        let x = wave(pyramid.len() * width, 1.3);
        let y = wave(9 * 14 * width, 0.7);
        let mut ax = vec![0.0; y.len()];
        let mut aty = vec![0.0; x.len()];
        pyramid.apply(&x, &mut ax, width);
        pyramid.apply_transpose(&y, &mut aty, width);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(p, q)| p * q).sum::<f64>();
        assert!((dot(&ax, &y) - dot(&x, &aty)).abs() < 1e-9);
    }
}
