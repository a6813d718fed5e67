//! Measured speeds of what a reconstruction spends its time on, a core at a time.
//!
//! `cargo run --release -p render --example rates`

use std::time::Instant;

use glam::{Vec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use obvhs::ray::Ray as ObvhsRay;
use obvhs::triangle::Triangle;
use render::bsdf::Model;
use render::bvh::{Bvh, SurfacePoint};
use render::camera::Camera;
use render::environment::EnvironmentMap;
use render::estimator::{Estimator, EstimatorOptions, RenderSample};
use render::harmonics::Harmonics;
use render::image::Image;
use render::lat_long::LatLong;
use render::loss::LossForm;
use render::mesh::Mesh;
use render::path::{Lookup, PathBatch, PathScene, PathSettings, ShadingPoint};
use render::pyramid::Pyramid;
use render::transport::Quadrature;
use render::visibility::{Visibility, VisibilityCache};

const GRID: LatLong = LatLong::new(50, 100);
const FRAMES: usize = 64;

fn main() -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    one.install(|| {
        let mesh = bumpy(200);
        let bvh = Bvh::new(&mesh)?;
        println!(
            "{} triangles, grid {} x {}, one thread",
            mesh.faces.len(),
            GRID.rows,
            GRID.columns
        );
        let points = shading_points(&bvh);
        harmonics();
        rays(&mesh, &bvh, &points);
        transport(&bvh, &points);
        monte_carlo(&bvh, &points)
    })
}

/// The best time of the runs that fit into a second and a half: the least disturbed by other work on the machine.
fn seconds(mut run: impl FnMut()) -> f64 {
    let (start, mut best) = (Instant::now(), f64::INFINITY);
    while start.elapsed().as_secs_f64() < 1.5 {
        let before = Instant::now();
        run();
        best = best.min(before.elapsed().as_secs_f64());
    }
    best
}

fn harmonics() {
    let harmonics = Harmonics::<f32>::new(24, GRID);
    let coefficients: Vec<f32> = (0..625 * FRAMES).map(|i| (0.37 * i as f32).sin()).collect();
    let mut values = vec![0.0; GRID.len() * FRAMES];
    let mut back = coefficients.clone();
    let forward = seconds(|| harmonics.synthesize(&coefficients, &mut values, FRAMES));
    let transpose = seconds(|| harmonics.transpose(&values, &mut back, FRAMES));
    println!(
        "harmonics, degree 24, {FRAMES} frames: synthesis {:.2} ms, transpose {:.2} ms",
        forward * 1e3,
        transpose * 1e3
    );
}

fn rays(mesh: &Mesh, bvh: &Bvh, points: &[ShadingPoint]) {
    let triangles: Vec<Triangle> = (0..mesh.faces.len())
        .map(|f| {
            let [v0, v1, v2] = mesh.triangle(f).map(Vec3A::from);
            Triangle { v0, v1, v2 }
        })
        .collect();
    let wide = build_cwbvh_from_tris(
        &triangles,
        BvhBuildParams::medium_build(),
        &mut Default::default(),
    );
    let ordered: Vec<Triangle> = wide
        .primitive_indices
        .iter()
        .map(|&i| triangles[i as usize])
        .collect();
    let queries: Vec<(Vec3, Vec3)> = points
        .iter()
        .step_by(8)
        .flat_map(|p| {
            (0..GRID.len())
                .step_by(7)
                .map(move |t| (p.surface, GRID.texel_direction(t / 100, t % 100)))
        })
        .filter(|(s, d): &(SurfacePoint, Vec3)| s.geometric_normal.dot(*d) > 0.0)
        .map(|(s, d)| (render::bvh::offset_origin(&s), d))
        .collect();
    let mut blocked = [0; 2];
    let binary =
        seconds(|| blocked[0] = queries.iter().filter(|(o, d)| bvh.blocked(*o, *d)).count());
    let compressed = seconds(|| {
        let hit = |(o, d): &&(Vec3, Vec3)| {
            let ray = ObvhsRay::new_inf((*o).into(), (*d).into());
            !wide.ray_traverse_miss(ray, |ray, i| ordered[i].intersect(ray))
        };
        blocked[1] = queries.iter().filter(hit).count();
    });
    let rate = |seconds: f64| queries.len() as f64 / seconds / 1e6;
    println!(
        "shadow rays: binary {:.2} M/s, compressed wide {:.2} M/s ({:.0} % and {:.0} % blocked)",
        rate(binary),
        rate(compressed),
        100.0 * blocked[0] as f64 / queries.len() as f64,
        100.0 * blocked[1] as f64 / queries.len() as f64
    );
}

fn transport(bvh: &Bvh, points: &[ShadingPoint]) {
    let quadrature = Quadrature::new(GRID, 2);
    let some: Vec<SurfacePoint> = points.iter().step_by(16).map(|p| p.surface).collect();
    let mut entries = 0;
    let time = seconds(|| {
        entries = quadrature
            .rows(bvh, &some)
            .iter()
            .map(|r| r.texel.len())
            .sum()
    });
    println!(
        "transport rows of 4 rays a texel: {:.0} points/s, {:.0} entries a point",
        some.len() as f64 / time,
        entries as f64 / some.len() as f64
    );
}

fn monte_carlo(
    bvh: &Bvh,
    points: &[ShadingPoint],
) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
    let points = &points[..points.len().min(2048)];
    let surfaces: Vec<SurfacePoint> = points.iter().map(|p| p.surface).collect();
    let positions: Vec<Vec3> = surfaces.iter().map(|s| s.position).collect();
    let cache = VisibilityCache::build(bvh, GRID, 1, &surfaces);
    let environment = EnvironmentMap::new(Image::filled(100, 50, 3, 0.5))?;
    let radii = [5.0; FRAMES];
    for model in [Model::Lambertian, Model::Microfacet] {
        let scene = PathScene {
            bvh,
            visibility: Visibility::Cached(&cache),
            model,
            lights: environment.distribution(),
            environment_grid: GRID,
            mask_grid: GRID,
            radii: &radii,
        };
        let settings = PathSettings {
            light_samples: 128,
            material_samples: 128,
            seed: 1,
            iteration: 0,
            lookup: Lookup::Stochastic,
            render: 0,
        };
        let draw = |render| PathBatch::sample(&scene, points, &PathSettings { render, ..settings });
        let drawn = (2 * 256 * points.len()) as f64;
        let few = &points[..64];
        let sampling = seconds(|| drop(PathBatch::sample(&scene, few, &settings))) * drawn
            / (256 * few.len()) as f64;
        let (first, second) = (draw(0), draw(1));
        let carried = (first.samples() + second.samples()) as f64;
        println!(
            "{model:?}: sampling {:.1} M drawn/s; {:.0} % of them carry light",
            drawn / sampling / 1e6,
            100.0 * carried / drawn
        );
        let renders = [&first, &second].map(|batch| RenderSample {
            positions: &positions,
            batch,
        });
        let photographs = vec![0.4; 3 * points.len()];
        for form in [LossForm::Product, LossForm::HalfBackward] {
            let options = EstimatorOptions {
                model,
                pyramid: Pyramid::new(GRID, 6),
                mask_grid: GRID,
                degree: 24,
                frames: FRAMES,
                lookup: settings.lookup,
                form,
            };
            let unknowns = options.start(5.0, 1, 1.5);
            let estimator = Estimator::new(options)?;
            let mut failed = None;
            let tape =
                seconds(|| failed = estimator.gradients(&unknowns, renders, &photographs).err());
            if let Some(error) = failed {
                return Err(error.into());
            }
            println!(
                "  {form:?}: loss and gradient {:.1} M drawn/s ({:.1} M carried/s); with sampling {:.1} M drawn/s",
                drawn / tape / 1e6,
                carried / tape / 1e6,
                drawn / (tape + sampling) / 1e6
            );
        }
    }
    Ok(())
}

/// A sphere with dents and bumps that shade each other.
fn bumpy(rows: u32) -> Mesh {
    let mut mesh = Mesh::default();
    let columns = 2 * rows;
    for r in 0..=rows {
        for c in 0..columns {
            let d = LatLong::direction(c as f32 / columns as f32, r as f32 / rows as f32);
            let bump = (7.0 * d.x).sin() * (6.0 * d.y + 1.0).sin() * (5.0 * d.z).cos();
            mesh.positions.push(d * (1.0 + 0.25 * bump));
        }
    }
    let at = |r: u32, c: u32| r * columns + c % columns;
    for r in 0..rows {
        for c in 0..columns {
            mesh.faces.push([at(r, c), at(r + 1, c), at(r + 1, c + 1)]);
            mesh.faces.push([at(r, c), at(r + 1, c + 1), at(r, c + 1)]);
        }
    }
    mesh
}

/// The pixels of a frame that show the object, as if they came from many frames.
fn shading_points(bvh: &Bvh) -> Vec<ShadingPoint> {
    let camera = Camera::look_at(128, 128, 0.4, Vec3::new(4.0, 2.5, 1.5), Vec3::ZERO);
    let at = |pixel: u32| {
        let (surface, outgoing) = bvh.seen(
            &camera,
            (pixel % 128) as f32 + 0.5,
            (pixel / 128) as f32 + 0.5,
        )?;
        Some((surface, outgoing, pixel))
    };
    let seen = (0..128 * 128).filter_map(at).enumerate();
    seen.map(|(i, (surface, outgoing, pixel))| ShadingPoint {
        surface,
        outgoing,
        frame: pixel % FRAMES as u32,
        pixel,
        cached: i as u32,
        alpha: 0.5,
    })
    .collect()
}
