//! Sampling densities against histograms.

use eclipse_tests::scenes;
use eclipse_tests::statistics::chi_square_z;
use glam::Vec3;
use render::bsdf::{Lobe, MaterialSampler};
use render::lat_long::LatLong;
use render::sampler::{SampleKey, Stream};
use render::warp;

const SAMPLES: usize = 200_000;

/// Compares directions drawn by `draw` with the density they claim, on a grid of bins over the whole sphere.
fn check(name: &str, draw: impl FnMut(&mut Stream) -> Vec3, density: impl Fn(Vec3) -> f32) {
    check_rows(name, draw, density, 16);
}

/// The same above the horizon only: half vectors also send directions below it, where the reflectance is zero and nobody
/// asks for a density.
fn check_above(name: &str, draw: impl FnMut(&mut Stream) -> Vec3, density: impl Fn(Vec3) -> f32) {
    check_rows(name, draw, density, 8);
}

fn check_rows(
    name: &str,
    mut draw: impl FnMut(&mut Stream) -> Vec3,
    density: impl Fn(Vec3) -> f32,
    rows: usize,
) {
    let bins = LatLong::new(16, 32);
    let mut stream = SampleKey {
        seed: 7,
        ..SampleKey::default()
    }
    .stream();
    let mut counts = vec![0.0; bins.len()];
    for _ in 0..SAMPLES {
        counts[bins.nearest(draw(&mut stream))] += 1.0;
    }
    let parts = 24;
    let expected: Vec<f64> = (0..bins.len())
        .map(|bin| {
            let (row, column) = (bin / bins.columns, bin % bins.columns);
            let mut mass = 0.0;
            for s in 0..parts * parts {
                let place =
                    [(s % parts) as f32 + 0.5, (s / parts) as f32 + 0.5].map(|x| x / parts as f32);
                let band = row as f32 + (s / parts) as f32 / parts as f32;
                let solid_angle =
                    bins.band_solid_angle(band, band + 1.0 / parts as f32) / parts as f32;
                mass += f64::from(density(bins.direction_within(row, column, place)) * solid_angle);
            }
            mass * SAMPLES as f64
        })
        .collect();
    let counted = rows * bins.columns;
    let z = chi_square_z(&counts[..counted], &expected[..counted]);
    assert!(z.abs() < 4.5, "{name}: {z} standard deviations");
}

#[test]
fn the_cosine_lobe_has_its_density() {
    check(
        "cosine",
        |s| warp::cosine(s.uniform_2d()),
        warp::cosine_density,
    );
}

#[test]
fn half_vectors_have_the_density_of_s9() {
    for alpha in [0.15, 0.6, 1.0] {
        check(
            "half vector",
            |s| warp::ggx_half_vector(s.uniform_2d(), alpha),
            |h| {
                if h.z > 0.0 {
                    warp::ggx(h.z, alpha) * h.z
                } else {
                    0.0
                }
            },
        );
        let outgoing = Vec3::new(0.6, 0.2, 0.5).normalize();
        check_above(
            "reflection",
            |s| warp::reflect(outgoing, warp::ggx_half_vector(s.uniform_2d(), alpha)),
            |d| warp::ggx_half_vector_density(d, outgoing, alpha),
        );
    }
}

#[test]
fn visible_normals_have_their_density() {
    for alpha in [0.15, 0.6, 1.0] {
        for outgoing in [Vec3::Z, Vec3::new(0.9, -0.3, 0.2).normalize()] {
            check_above(
                "visible normals",
                |s| {
                    warp::reflect(
                        outgoing,
                        warp::ggx_visible_normal(s.uniform_2d(), outgoing, alpha),
                    )
                },
                |d| warp::ggx_visible_normal_density(d, outgoing, alpha),
            );
        }
    }
}

#[test]
fn the_material_mixture_has_its_density() {
    let normal = Vec3::new(0.3, -0.5, 0.7).normalize();
    let outgoing = Vec3::new(0.8, 0.1, 0.4).normalize();
    for share in [1.0, 0.5, 0.2] {
        let sampler = MaterialSampler::new(share, 0.3, normal, outgoing);
        check(
            "mixture",
            |s| {
                let lobe = if s.uniform() < share {
                    Lobe::Cosine
                } else {
                    Lobe::VisibleNormal
                };
                sampler.sample(lobe, s.uniform_2d())
            },
            |d| sampler.density(d),
        );
    }
}

#[test]
fn light_has_its_density() {
    let environment = scenes::interior(LatLong::new(16, 32));
    let lights = environment.distribution();
    check(
        "light",
        |s| lights.sample(s.uniform_2d()).0,
        |d| lights.density(d),
    );
}
