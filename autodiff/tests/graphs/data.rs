//! What random graphs run over.

use autodiff::{Program, Scalar, Sizes, Workspace};
use proptest::prelude::*;

use super::record::{MATRIX, PARAMS, TEXELS};

/// Lanes of every pixel, and numbers to fill arrays with.
#[derive(Clone, Debug)]
pub struct Data {
    counts: Vec<u32>,
    frames: usize,
    /// Rows of a table.
    places: usize,
    seed: u64,
}

/// A few segments, or now and then thousands of them, which make many chunks.
pub fn data() -> impl Strategy<Value = Data> {
    prop_oneof![15 => few(), 1 => many()]
}

/// Few rows, or now and then so many that a table is large for its lookups.
fn places() -> impl Strategy<Value = usize> {
    prop_oneof![8 => 5usize..9, 4 => 500usize..900, 1 => 30_000usize..40_000]
}

pub fn many() -> impl Strategy<Value = Data> {
    let sizes = (2000usize..2600, 3usize..16, places(), any::<u64>());
    sizes.prop_map(|(pixels, frames, places, seed)| {
        let mut data = Data {
            counts: Vec::new(),
            frames,
            places,
            seed,
        };
        let count = |i| match data.number(50, i) {
            x if x > 0.999 => 90,
            x => (x * 6.0) as u32,
        };
        data.counts = (0..pixels).map(count).collect();
        data
    })
}

pub fn few() -> impl Strategy<Value = Data> {
    let count = prop_oneof![4 => 0u32..6, 1 => 60u32..130];
    (
        prop::collection::vec(count, 0..12),
        1usize..20,
        places(),
        any::<u64>(),
    )
        .prop_map(|(counts, frames, places, seed)| Data {
            counts,
            frames,
            places,
            seed,
        })
}

impl Data {
    fn number(&self, array: u64, i: usize) -> f64 {
        let mut x = self.seed ^ (array << 40) ^ (i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        for _ in 0..2 {
            x ^= x >> 31;
            x = x.wrapping_mul(0xbf58_476d_1ce4_e5b9);
        }
        (x >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn array<S: Scalar>(&self, array: u64, n: usize, low: f64) -> Vec<S> {
        (0..n)
            .map(|i| S::from_f64(low + self.number(array, i)))
            .collect()
    }

    pub fn lens(&self) -> [usize; PARAMS.len()] {
        let pixels = self.counts.len();
        let table = 2 * self.places;
        [
            3 * pixels,
            pixels * self.frames,
            2 * TEXELS,
            1,
            MATRIX,
            table,
            TEXELS * self.frames,
        ]
    }

    pub fn params<S: Scalar>(&self) -> Vec<Vec<S>> {
        let lens = self.lens().into_iter().enumerate();
        lens.map(|(k, n)| self.array(k as u64, n, 0.5)).collect()
    }

    pub fn direction<S: Scalar>(&self) -> Vec<Vec<S>> {
        let lens = self.lens().into_iter().enumerate();
        lens.map(|(k, n)| self.array(10 + k as u64, n, -0.5))
            .collect()
    }

    /// Lanes of each sample.
    fn parts(&self) -> Vec<u32> {
        let n = self.counts.iter().sum::<u32>() as usize;
        (0..n).map(|i| (self.number(24, i) * 4.0) as u32).collect()
    }

    pub fn sizes(&self, block: usize) -> Sizes {
        let offsets = |counts: &[u32]| {
            let mut offsets = vec![0];
            for count in counts {
                offsets.push(offsets[offsets.len() - 1] + count);
            }
            offsets
        };
        Sizes::new()
            .lanes("pixels", self.counts.len())
            .lanes("texels", TEXELS)
            .lanes("places", self.places)
            .offsets("samples", offsets(&self.counts))
            .offsets("parts", offsets(&self.parts()))
            .axis("frames", self.frames)
            .block(block)
    }

    pub fn workspace<S: Scalar>(&self, program: &Program, block: usize) -> Workspace<S> {
        let mut ws = program.workspace::<S>(&self.sizes(block)).unwrap();
        self.bind(&mut ws);
        ws
    }

    /// Binds everything to a workspace of these sizes.
    pub fn bind<S: Scalar>(&self, ws: &mut Workspace<S>) {
        let n = self.counts.iter().sum::<u32>() as usize;
        let index_of = |array, rows: usize| -> Vec<u32> {
            (0..n)
                .map(|i| (self.number(array, i) * rows as f64) as u32)
                .collect()
        };
        let index = |array| index_of(array, TEXELS);
        // An index that always names the same row, on some seeds.
        let same = vec![3; n];
        let first = if self.seed.is_multiple_of(4) {
            same
        } else {
            index(20)
        };
        ws.set_index("first", &first).unwrap();
        ws.set_index("second", &index(21)).unwrap();
        ws.set_index("near", &index_of(26, self.places)).unwrap();
        ws.set_index("far", &index_of(27, self.places)).unwrap();
        ws.set("weight", &self.array::<S>(22, n, 0.0)).unwrap();
        let parts = self.parts().iter().sum::<u32>() as usize;
        ws.set("share", &self.array::<S>(25, parts, 0.0)).unwrap();
        let visible: Vec<bool> = (0..n).map(|i| self.number(23, i) < 0.6).collect();
        ws.set_mask("visible", &visible).unwrap();
        for (name, values) in PARAMS.iter().zip(self.params::<S>()) {
            ws.set(name, &values).unwrap();
        }
    }
}
