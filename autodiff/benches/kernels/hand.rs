//! The shading kernel and its adjoint by hand, as fast as plain Rust lets it be: what the tape is held against.
//!
//! One pass over the samples of a pixel computes the image while they are in L1, another the adjoints: nothing is computed
//! twice, and each input is read from memory once. Tables are interleaved and padded to four channels, so that a lookup is
//! one vector load. One reciprocal serves all quotients of the adjoint. All else is loops over sixteen samples, which the
//! compiler turns into AVX-512 or AVX2, whichever the machine has.

use std::f32::consts::PI;

use pulp::{Arch, Simd, WithSimd};

use super::shading::{Data, PER_PIXEL, PIXELS, TEXELS};

/// Samples in a vector register.
const WIDTH: usize = 16;
const VECTORS: usize = PER_PIXEL / WIDTH;

type Wide = [f32; WIDTH];
type Row = [Wide; VECTORS];

/// Parameters in the order that suits the kernel, and their gradients.
#[derive(Clone)]
pub struct Hand {
    pub environment: Vec<[f32; 4]>,
    pub adjoint: Vec<[f32; 4]>,
    pub albedo: Vec<f32>,
    pub roughness: Vec<f32>,
}

/// What the samples of a pixel share.
#[derive(Clone, Copy)]
struct Pixel {
    a2: f32,
    m: f32,
    scale: f32,
    diffuse: [f32; 3],
}

/// What the adjoint needs of the samples of a pixel.
#[derive(Clone, Copy)]
struct Kept {
    specular: Row,
    /// `1 / (light d^2 root)`, whose products are all the quotients of the adjoint.
    inverse: Row,
    light: Row,
    root: Row,
    weight: Row,
    radiance: [Row; 3],
}

const ZERO: Row = [[0.0; WIDTH]; VECTORS];

impl Kept {
    const fn new() -> Self {
        Kept {
            specular: ZERO,
            inverse: ZERO,
            light: ZERO,
            root: ZERO,
            weight: ZERO,
            radiance: [ZERO; 3],
        }
    }
}

#[inline(always)]
fn row(values: &[f32], pixel: usize) -> &Row {
    let (rows, _) = values[pixel * PER_PIXEL..].as_chunks::<WIDTH>();
    rows[..VECTORS].try_into().expect("a pixel's samples")
}

/// Sum of all places, pairwise.
#[inline(always)]
fn total(mut x: Wide) -> f32 {
    let mut width = WIDTH / 2;
    while width > 0 {
        for i in 0..width {
            x[i] += x[i + width];
        }
        width /= 2;
    }
    x[0]
}

/// A pass, to be compiled for the instruction set that the machine has.
struct Run<'a, const GRADIENT: bool>(&'a mut Hand, &'a Data);

impl<const GRADIENT: bool> WithSimd for Run<'_, GRADIENT> {
    type Output = f32;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f32 {
        if GRADIENT {
            self.0.run_gradient(self.1)
        } else {
            self.0.run_primal(self.1)
        }
    }
}

impl Hand {
    pub fn new(data: &Data) -> Self {
        let texel = |t: usize| {
            let channel = |c: usize| data.environment[c * TEXELS + t];
            [channel(0), channel(1), channel(2), 0.0]
        };
        Hand {
            environment: (0..TEXELS).map(texel).collect(),
            adjoint: vec![[0.0; 4]; TEXELS],
            albedo: vec![0.0; 3 * PIXELS],
            roughness: vec![0.0; PIXELS],
        }
    }

    /// The values that a pixel's samples share; d scale / d a2; and d a2 / d roughness.
    #[inline(always)]
    fn pixel(data: &Data, p: usize) -> (Pixel, f32, f32) {
        let r = data.roughness[p];
        let a2 = r * r * r * r;
        let m = a2 - 1.0;
        let nv = data.nv[p];
        let root = (a2 - m * nv * nv).sqrt();
        let view = nv + root;
        let scale = a2 / (view * PI);
        let slope = 1.0 / (view * PI) - scale / view * (1.0 - nv * nv) / (2.0 * root);
        let diffuse = std::array::from_fn(|c| data.albedo[c * PIXELS + p] * (1.0 / PI));
        let pixel = Pixel {
            a2,
            m,
            scale,
            diffuse,
        };
        (pixel, slope, 4.0 * r * r * r)
    }

    /// The residual of a pixel; `kept` is filled for the adjoint if `GRADIENT`.
    #[inline(always)]
    fn image<const GRADIENT: bool>(
        &self,
        data: &Data,
        p: usize,
        pixel: Pixel,
        kept: &mut Kept,
    ) -> [f32; 3] {
        let (nls, nhs) = (row(&data.nl, p), row(&data.nh, p));
        let (vh5, weight) = (row(&data.vh5, p), row(&data.weight, p));
        let (texels, _) = data.texel[p * PER_PIXEL..].as_chunks::<WIDTH>();
        let mut sums = [[0.0f32; WIDTH]; 3];
        for v in 0..VECTORS {
            let mut looked_up = [[0.0f32; 4]; WIDTH];
            for i in 0..WIDTH {
                looked_up[i] = self.environment[texels[v][i] as usize % TEXELS];
            }
            for i in 0..WIDTH {
                let (nl, nh) = (nls[v][i], nhs[v][i]);
                let d = (nh * nh).mul_add(pixel.m, 1.0);
                let root = (-pixel.m * nl).mul_add(nl, pixel.a2).sqrt();
                let light = nl + root;
                let fresnel = vh5[v][i].mul_add(0.96, 0.04);
                let quotient = if GRADIENT {
                    let inverse = 1.0 / (light * d * d * root);
                    kept.inverse[v][i] = inverse;
                    kept.light[v][i] = light;
                    kept.root[v][i] = root;
                    inverse * root
                } else {
                    1.0 / (light * d * d)
                };
                kept.specular[v][i] = pixel.scale * quotient * fresnel;
                kept.weight[v][i] = nl * weight[v][i];
            }
            for c in 0..3 {
                for i in 0..WIDTH {
                    let radiance = looked_up[i][c] * kept.weight[v][i];
                    kept.radiance[c][v][i] = radiance;
                    let brdf = pixel.diffuse[c] + kept.specular[v][i];
                    sums[c][i] = brdf.mul_add(radiance, sums[c][i]);
                }
            }
        }
        std::array::from_fn(|c| {
            total(sums[c]) * (1.0 / PER_PIXEL as f32) - data.target[c * PIXELS + p]
        })
    }

    /// The loss.
    pub fn primal(&mut self, data: &Data) -> f32 {
        Arch::new().dispatch(Run::<false>(self, data))
    }

    /// The loss and the gradients.
    pub fn gradient(&mut self, data: &Data) -> f32 {
        Arch::new().dispatch(Run::<true>(self, data))
    }

    #[inline(always)]
    fn run_primal(&self, data: &Data) -> f32 {
        let mut kept = Kept::new();
        let mut loss = 0.0;
        for p in 0..PIXELS {
            let (pixel, _, _) = Self::pixel(data, p);
            let e = self.image::<false>(data, p, pixel, &mut kept);
            loss += e[0] * e[0] + e[1] * e[1] + e[2] * e[2];
        }
        loss
    }

    #[inline(always)]
    fn run_gradient(&mut self, data: &Data) -> f32 {
        self.adjoint.fill([0.0; 4]);
        let mut kept = Kept::new();
        let mut loss = 0.0;
        for p in 0..PIXELS {
            let (pixel, slope, to_roughness) = Self::pixel(data, p);
            let e = self.image::<true>(data, p, pixel, &mut kept);
            loss += e[0] * e[0] + e[1] * e[1] + e[2] * e[2];
            let g = e.map(|e| 2.0 * e / PER_PIXEL as f32);
            let (nls, nhs) = (row(&data.nl, p), row(&data.nh, p));
            let (texels, _) = data.texel[p * PER_PIXEL..].as_chunks::<WIDTH>();
            let (mut to_a2, mut to_scale) = ([0.0f32; WIDTH], [0.0f32; WIDTH]);
            let mut to_diffuse = [[0.0f32; WIDTH]; 3];
            for v in 0..VECTORS {
                let mut to_table = [[0.0f32; WIDTH]; 3];
                let mut to_specular = [0.0f32; WIDTH];
                for c in 0..3 {
                    for i in 0..WIDTH {
                        let share = g[c] * kept.radiance[c][v][i];
                        to_diffuse[c][i] += share;
                        to_specular[i] += share;
                        let brdf = pixel.diffuse[c] + kept.specular[v][i];
                        to_table[c][i] = g[c] * brdf * kept.weight[v][i];
                    }
                }
                for i in 0..WIDTH {
                    let (nl, nh) = (nls[v][i], nhs[v][i]);
                    let d = (nh * nh).mul_add(pixel.m, 1.0);
                    let (root, light) = (kept.root[v][i], kept.light[v][i]);
                    let both = to_specular[i] * kept.specular[v][i];
                    to_scale[i] += both;
                    // By d: -2 both / d; by light: -both / light; by root: half of that over root.
                    let share = both * kept.inverse[v][i];
                    let by_d = -2.0 * share * light * d * root * (nh * nh);
                    let by_light = -0.5 * share * d * d * (1.0 - nl * nl);
                    to_a2[i] += by_d + by_light;
                }
                for i in 0..WIDTH {
                    let adjoint = &mut self.adjoint[texels[v][i] as usize % TEXELS];
                    let share = [to_table[0][i], to_table[1][i], to_table[2][i], 0.0];
                    for c in 0..4 {
                        adjoint[c] += share[c];
                    }
                }
            }
            let to_scale = total(to_scale) / pixel.scale;
            self.roughness[p] = (total(to_a2) + to_scale * slope) * to_roughness;
            for c in 0..3 {
                self.albedo[c * PIXELS + p] = total(to_diffuse[c]) * (1.0 / PI);
            }
        }
        loss
    }
}
