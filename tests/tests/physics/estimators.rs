//! Every Monte Carlo estimator against quadrature, with self-shadows and an occluder.

use eclipse_tests::scenes;
use eclipse_tests::statistics::mean_and_error;
use glam::Vec3;
use render::bsdf::{Material, Model};
use render::bvh::{Bvh, SurfacePoint};
use render::environment::EnvironmentMap;
use render::image::Image;
use render::lat_long::LatLong;
use render::occluder::mask_lookup;
use render::path::{Lookup, PathBatch, PathScene, PathSettings, ShadingPoint};
use render::visibility::Visibility;

const MATERIAL: Material = Material {
    albedo: [0.8, 0.5, 0.2],
    alpha: 0.35,
    kappa: 0.08,
};
const RADIUS: f32 = 3.0;

/// The rendering integral on a grid much finer than the environment's, in plain double precision.
fn quadrature(
    bvh: &Bvh,
    environment: &EnvironmentMap,
    mask: &Image,
    model: Model,
    point: &SurfacePoint,
    outgoing: Vec3,
) -> [f64; 3] {
    let fine = LatLong::new(600, 1200);
    let mask_grid = LatLong::new(mask.height, mask.width);
    let mut sum = [0.0; 3];
    for r in 0..fine.rows {
        for c in 0..fine.columns {
            let d = fine.texel_direction(r, c);
            let cosine = point.normal.dot(d);
            if cosine <= 0.0 || bvh.occluded(point, d) {
                continue;
            }
            let passed = mask_lookup(mask_grid, point.position, d, RADIUS).gather(&mask.data);
            let f = model.evaluate(&MATERIAL, point.normal, d, outgoing);
            let light = environment.radiance(d);
            for k in 0..3 {
                sum[k] += f64::from(light[k] * passed * f[k] * cosine * fine.solid_angle(r));
            }
        }
    }
    sum
}

#[test]
fn light_material_and_combined_samples_agree_with_quadrature() {
    let bvh = scenes::pair();
    let grid = LatLong::new(20, 40);
    let environment = scenes::interior(grid);
    let mask = scenes::disc_mask(grid, Vec3::new(0.3, -0.9, 0.3).normalize());
    let camera = scenes::camera(32);
    let pixels: Vec<[f32; 2]> = vec![[17.0, 15.5], [13.0, 17.0], [20.0, 13.0]];
    for [x, y] in pixels {
        let (surface, outgoing) = bvh.seen(&camera, x, y).expect("the pixel shows the object");
        for model in [Model::Lambertian, Model::Microfacet] {
            let expected = quadrature(&bvh, &environment, &mask, model, &surface, outgoing);
            let scene = PathScene {
                bvh: &bvh,
                visibility: Visibility::Rays,
                model,
                lights: environment.distribution(),
                environment_grid: grid,
                mask_grid: grid,
                radii: &[RADIUS],
            };
            let counts = [(64, 0), (0, 64), (32, 32), (48, 12)];
            let readings = [Lookup::Bilinear, Lookup::Stochastic];
            for ((light_samples, material_samples), lookup) in
                counts.into_iter().flat_map(|n| readings.map(|l| (n, l)))
            {
                let points: Vec<ShadingPoint> = (0..400)
                    .map(|pixel| ShadingPoint {
                        surface,
                        outgoing,
                        frame: 0,
                        pixel,
                        cached: 0,
                        alpha: MATERIAL.alpha,
                    })
                    .collect();
                let settings = PathSettings {
                    lookup,
                    light_samples,
                    material_samples,
                    seed: 3,
                    iteration: 0,
                    render: 0,
                };
                let batch = PathBatch::sample(&scene, &points, &settings);
                let values: Vec<[f64; 3]> = (0..points.len())
                    .map(|p| {
                        batch.radiance(p, model, &MATERIAL, &environment.image().data, &mask.data)
                    })
                    .collect();
                for c in 0..3 {
                    let channel: Vec<f64> = values.iter().map(|v| v[c]).collect();
                    let (mean, error) = mean_and_error(&channel);
                    // Quadrature itself is good to about a thousandth (shadow edges, one ray a cell).
                    let slack = 4.0 * error + 2e-3 * expected[c];
                    assert!(
                        (mean - expected[c]).abs() < slack,
                        "{model:?} {lookup:?} {light_samples}+{material_samples} at {x},{y}: {mean} ± {error}, {}",
                        expected[c]
                    );
                }
            }
        }
    }
}

#[test]
fn paths_are_the_same_for_any_number_of_threads_and_differ_between_renders() {
    let bvh = scenes::pair();
    let grid = LatLong::new(20, 40);
    let environment = scenes::interior(grid);
    let camera = scenes::camera(48);
    let points: Vec<ShadingPoint> = (0..48 * 48_u32)
        .filter_map(|pixel| {
            let (surface, outgoing) = bvh.seen(
                &camera,
                (pixel % 48) as f32 + 0.5,
                (pixel / 48) as f32 + 0.5,
            )?;
            Some(ShadingPoint {
                surface,
                outgoing,
                frame: 1,
                pixel,
                cached: 0,
                alpha: 0.5,
            })
        })
        .collect();
    assert!(points.len() > 300);
    let scene = PathScene {
        bvh: &bvh,
        visibility: Visibility::Rays,
        model: Model::Microfacet,
        lights: environment.distribution(),
        environment_grid: grid,
        mask_grid: grid,
        radii: &[RADIUS, RADIUS],
    };
    let settings = PathSettings {
        lookup: Lookup::Stochastic,
        light_samples: 6,
        material_samples: 4,
        seed: 1,
        iteration: 5,
        render: 0,
    };
    let draw = |threads: usize, settings: PathSettings| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads can be started");
        pool.install(|| PathBatch::sample(&scene, &points, &settings))
    };
    let one = draw(1, settings);
    assert_eq!(one, draw(3, settings));
    assert_ne!(
        one.incident,
        draw(
            1,
            PathSettings {
                render: 1,
                ..settings
            }
        )
        .incident
    );
    assert_ne!(
        one.incident,
        draw(
            1,
            PathSettings {
                iteration: 6,
                ..settings
            }
        )
        .incident
    );
}
