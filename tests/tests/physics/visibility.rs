//! Cached visibility against ray casts.

use eclipse_tests::scenes;
use render::bsdf::Model;
use render::bvh::SurfacePoint;
use render::lat_long::LatLong;
use render::path::{Lookup, PathBatch, PathScene, PathSettings, ShadingPoint};
use render::transport::Quadrature;
use render::visibility::{Visibility, VisibilityCache};

fn points() -> (render::bvh::Bvh, Vec<SurfacePoint>) {
    let bvh = scenes::pair();
    let camera = scenes::camera(24);
    let points = (0..24 * 24)
        .filter_map(|p| bvh.seen(&camera, (p % 24) as f32 + 0.5, (p / 24) as f32 + 0.5))
        .map(|(point, _)| point)
        .collect();
    (bvh, points)
}

#[test]
fn bits_agree_with_rays_away_from_shadow_edges() {
    let (bvh, points) = points();
    let grid = LatLong::new(25, 50);
    let cache = VisibilityCache::build(&bvh, grid, 2, &points);
    assert_eq!(cache.points(), points.len());
    let (mut disagreements, mut queries) = (0, 0);
    for (i, point) in points.iter().enumerate() {
        for t in (0..grid.len()).step_by(3) {
            let direction = grid.texel_direction(t / 50, t % 50);
            let rays = !bvh.occluded(point, direction) && point.normal.dot(direction) > 0.0;
            // A direction off the corner that four parts share.
            let uv = LatLong::coordinates(direction).map(|x| x + 1e-3);
            disagreements += usize::from(rays != cache.visible(i, uv));
            queries += 1;
        }
    }
    let share = disagreements as f64 / f64::from(queries);
    assert!(share < 0.03, "{share}");
}

#[test]
fn coverage_reproduces_the_transport_of_ray_casts() {
    let (bvh, points) = points();
    let grid = LatLong::new(50, 100);
    let quadrature = Quadrature::new(grid, 2);
    let (mut bias, mut scatter) = (0.0, 0.0);
    for side in [1, 2] {
        let cache = VisibilityCache::build(&bvh, grid, side, &points);
        (bias, scatter) = (0.0, 0.0);
        for (i, (point, row)) in points
            .iter()
            .zip(quadrature.rows(&bvh, &points))
            .enumerate()
        {
            let exact: f32 = row.weight.iter().sum();
            let mut cached = 0.0;
            for t in 0..grid.len() {
                let cosine = point
                    .normal
                    .dot(grid.texel_direction(t / 100, t % 100))
                    .max(0.0);
                cached += cosine * grid.solid_angle(t / 100) * cache.coverage(i, t);
            }
            let relative = f64::from(cached / exact - 1.0);
            bias += relative / points.len() as f64;
            scatter += relative * relative / points.len() as f64;
        }
        assert!(bias.abs() < 3e-3, "side {side}: {bias}");
    }
    assert!(
        scatter.sqrt() < 5e-3 && bias.abs() < 2e-3,
        "{scatter} {bias}"
    );
}

#[test]
fn estimates_from_the_cache_and_from_rays_agree() {
    let (bvh, surfaces) = points();
    let grid = LatLong::new(50, 100);
    let environment = scenes::interior(grid);
    let cache = VisibilityCache::build(&bvh, grid, 2, &surfaces);
    let points: Vec<ShadingPoint> = surfaces
        .iter()
        .enumerate()
        .map(|(i, surface)| ShadingPoint {
            surface: *surface,
            outgoing: surface.normal,
            frame: 0,
            pixel: i as u32,
            cached: i as u32,
            alpha: 0.5,
        })
        .collect();
    let estimate = |visibility| {
        let scene = PathScene {
            bvh: &bvh,
            visibility,
            model: Model::Lambertian,
            lights: environment.distribution(),
            environment_grid: grid,
            mask_grid: grid,
            radii: &[3.0],
        };
        let settings = PathSettings {
            lookup: Lookup::Stochastic,
            light_samples: 256,
            material_samples: 256,
            seed: 2,
            iteration: 0,
            render: 0,
        };
        let batch = PathBatch::sample(&scene, &points, &settings);
        let material = render::bsdf::Material {
            albedo: [1.0; 3],
            alpha: 0.5,
            kappa: 0.0,
        };
        let open = vec![1.0; grid.len()];
        let value = |p| {
            batch.radiance(
                p,
                Model::Lambertian,
                &material,
                &environment.image().data,
                &open,
            )[0]
        };
        (0..points.len()).map(value).sum::<f64>()
    };
    // The same directions on both sides: only visibility differs.
    let (rays, cached) = (
        estimate(Visibility::Rays),
        estimate(Visibility::Cached(&cache)),
    );
    assert!((cached / rays - 1.0).abs() < 3e-3, "{rays} {cached}");
}
