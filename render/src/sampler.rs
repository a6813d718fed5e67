//! Random numbers as a pure function of what they are for, and stratified points.
//!
//! Every generator is keyed by (seed, frame, pixel, sample, dimension): no state is shared, so any thread may draw any
//! pixel's numbers in any order and the picture is the same.

use rand_pcg::Pcg32;
use rand_pcg::rand_core::Rng;

/// What a stream of random numbers is for. Two different keys give independent streams.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SampleKey {
    /// The run's seed.
    pub seed: u64,
    /// Frame (photograph) index.
    pub frame: u32,
    /// Pixel or surface point index within the frame.
    pub pixel: u32,
    /// Sample or iteration index.
    pub sample: u32,
    /// Which decision of the sample: camera ray, light, material, ...
    pub dimension: u32,
}

impl SampleKey {
    /// The stream of numbers of this key.
    pub fn stream(self) -> Stream {
        let low = mix(self.seed ^ mix(u64::from(self.frame) << 32 | u64::from(self.pixel)));
        let high = mix(low ^ (u64::from(self.sample) << 32 | u64::from(self.dimension)));
        Stream(Pcg32::new(high, mix(high ^ low)))
    }
}

impl SampleKey {
    /// The numbers of this key by index, without a stream's state.
    pub fn counter(self) -> Counter {
        let low = mix(self.seed ^ mix(u64::from(self.frame) << 32 | u64::from(self.pixel)));
        let high = mix(low ^ (u64::from(self.sample) << 32 | u64::from(self.dimension)));
        Counter([high as u32, (high >> 32) as u32])
    }
}

/// Random words by index: samples evaluated together need no order among each other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counter(pub [u32; 2]);

impl Counter {
    /// The four words at an index of one of several sequences.
    ///
    /// `pcg4d` of Jarzynski & Olano, "Hash Functions for GPU Rendering", JCGT 9(3), 2020, with a last shift that lets the
    /// low bits know of the high ones.
    #[inline(always)]
    pub fn words(self, sequence: u32, index: u32) -> [u32; 4] {
        let start = |x: u32| x.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let [mut x, mut y] = self.0.map(start);
        let (mut z, mut w) = (start(index), start(sequence));
        for _ in 0..2 {
            x = x.wrapping_add(y.wrapping_mul(w));
            y = y.wrapping_add(z.wrapping_mul(x));
            z = z.wrapping_add(x.wrapping_mul(y));
            w = w.wrapping_add(y.wrapping_mul(z));
            [x, y, z, w] = [x, y, z, w].map(|v| v ^ (v >> 16));
        }
        [x, y, z, w]
    }
}

/// A word as a uniform number of [0, 1), a multiple of 2⁻²⁴.
#[inline(always)]
pub fn unit(word: u32) -> f32 {
    (word >> 8) as i32 as f32 * (1.0 / 16_777_216.0)
}

/// A word as two uniform numbers of (0, 1), each in the middle of one of 65,536 steps.
#[inline(always)]
pub fn unit_pair(word: u32) -> [f32; 2] {
    [word >> 16, word & 0xffff].map(|half| (half as i32 as f32 + 0.5) * (1.0 / 65_536.0))
}

/// A stream of uniform numbers.
#[derive(Clone, Debug)]
pub struct Stream(Pcg32);

impl Stream {
    /// A uniform number of [0, 1), a multiple of 2⁻²⁴.
    #[inline]
    pub fn uniform(&mut self) -> f32 {
        (self.0.next_u32() >> 8) as f32 * (1.0 / 16_777_216.0)
    }

    /// Two uniform numbers of [0, 1).
    #[inline]
    pub fn uniform_2d(&mut self) -> [f32; 2] {
        [self.uniform(), self.uniform()]
    }

    /// A number from the unit normal distribution (Box and Muller 1958, one of the pair).
    #[inline]
    pub fn normal(&mut self) -> f32 {
        let [u, v] = self.uniform_2d();
        (-2.0 * (1.0 - u).ln()).sqrt() * (std::f32::consts::TAU * v).cos()
    }
}

/// The finaliser of SplitMix64 (Steele et al. 2014): a bijection of 64 bits that scatters neighbouring keys.
fn mix(x: u64) -> u64 {
    let mut z = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// `n = rows × columns` jittered points, one in each cell of a grid that tiles the unit square.
///
/// The paper's S13–S15 only tile the square when n is an odd power of two; factoring n exactly always does, at the
/// price of thin cells when n is prime.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stratified {
    /// Cells down.
    pub rows: usize,
    /// Cells across, at least as many as down.
    pub columns: usize,
}

impl Stratified {
    /// The squarest grid of exactly `n` cells (none when `n` is 0).
    pub fn new(n: usize) -> Self {
        let mut rows = n.isqrt().max(1);
        while !n.is_multiple_of(rows) {
            rows -= 1;
        }
        Self {
            rows,
            columns: n / rows,
        }
    }

    /// Point `i` of the set: a place in its cell given by `jitter` of [0, 1)².
    pub fn point(&self, i: usize, jitter: [f32; 2]) -> [f32; 2] {
        self.point_in(self.cell(i), jitter)
    }

    /// Column and row of cell `i`, row by row.
    pub fn cell(&self, i: usize) -> [f32; 2] {
        [(i % self.columns) as f32, (i / self.columns) as f32]
    }

    /// The point at `jitter` of [0, 1)² of the cell in a column and row.
    #[inline(always)]
    pub fn point_in(&self, [column, row]: [f32; 2], jitter: [f32; 2]) -> [f32; 2] {
        let below_one = 1.0 - f32::EPSILON / 2.0;
        [
            ((column + jitter[0]) / self.columns as f32).min(below_one),
            ((row + jitter[1]) / self.rows as f32).min(below_one),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stratified_points_tile_the_square() {
        for n in [1, 2, 7, 12, 64, 128, 256, 1024] {
            let set = Stratified::new(n);
            assert_eq!(set.rows * set.columns, n);
            let mut seen = vec![false; n];
            for i in 0..n {
                let [u, v] = set.point(i, [0.999, 0.001]);
                assert!((0.0..1.0).contains(&u) && (0.0..1.0).contains(&v));
                let cell = (v * set.rows as f32) as usize * set.columns
                    + (u * set.columns as f32) as usize;
                assert!(!std::mem::replace(&mut seen[cell], true));
            }
        }
    }

    #[test]
    fn each_part_of_the_key_changes_the_stream() {
        let key = SampleKey {
            seed: 1,
            frame: 2,
            pixel: 3,
            sample: 4,
            dimension: 5,
        };
        let first = |k: SampleKey| k.stream().uniform_2d();
        let others = [
            SampleKey { seed: 2, ..key },
            SampleKey { frame: 3, ..key },
            SampleKey { pixel: 4, ..key },
            SampleKey { sample: 5, ..key },
            SampleKey {
                dimension: 6,
                ..key
            },
        ];
        assert_eq!(first(key), first(key));
        for other in others {
            assert_ne!(first(key), first(other));
        }
    }

    #[test]
    fn counted_words_are_uniform_and_uncorrelated() {
        let words = |pixel: u32, i: u32| {
            let key = SampleKey {
                pixel,
                ..SampleKey::default()
            };
            key.counter().words(1, i)
        };
        let mut counts = vec![0.0_f64; 256];
        let (mut lags, n) = ([0.0_f64; 5], 1 << 16);
        for k in 0..n {
            let (pixel, i) = (k / 64, k % 64);
            let [a, b, c, d] = words(pixel, i).map(|w| f64::from(unit(w)) - 0.5);
            let next = f64::from(unit(words(pixel, i + 1)[0])) - 0.5;
            let beside = f64::from(unit(words(pixel + 1, i)[0])) - 0.5;
            for (lag, product) in lags
                .iter_mut()
                .zip([a * b, b * c, c * d, a * next, a * beside])
            {
                *lag += product / f64::from(n);
            }
            let [high, low] = unit_pair(words(pixel, i)[3]);
            counts[(16.0 * high) as usize * 16 + (16.0 * low) as usize] += 1.0;
        }
        for lag in lags {
            assert!(lag.abs() < 4.0 / 12.0 / f64::from(n).sqrt(), "{lags:?}");
        }
        let expected = f64::from(n) / 256.0;
        let chi_square: f64 = counts
            .iter()
            .map(|c| (c - expected).powi(2) / expected)
            .sum();
        assert!(
            (chi_square - 255.0).abs() < 4.0 * (2.0_f64 * 255.0).sqrt(),
            "{chi_square}"
        );
    }

    #[test]
    fn neighbouring_pixels_are_uncorrelated() {
        let n = 20_000;
        let draw = |pixel| {
            SampleKey {
                pixel,
                ..SampleKey::default()
            }
            .stream()
            .uniform()
                - 0.5
        };
        let lag: f32 = (0..n).map(|p| draw(p) * draw(p + 1)).sum::<f32>() / n as f32;
        // The products have standard deviation 1/12.
        assert!(lag.abs() < 4.0 / 12.0 / (n as f32).sqrt());
    }
}
