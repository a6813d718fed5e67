//! Measured speeds of what a reconstruction spends its time on, per second of one core.
//!
//! `cargo run --release -p render --example rates`

mod quadrature;

use cpu_time::ProcessTime;
use glam::{Vec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use obvhs::ray::Ray as ObvhsRay;
use obvhs::triangle::Triangle;
use render::bsdf::Model;
use render::bvh::{Bvh, Rays, SurfacePoint};
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

const DEGREE: usize = 24;

type Report = Result<(), Box<dyn std::error::Error + Send + Sync>>;

/// `rates [PART]` with one of `harmonics`, `rays`, `transport`, `monte-carlo`, `quadrature`; all without it.
fn main() -> Report {
    let only = std::env::args().nth(1);
    let wanted = |part: &str| only.as_ref().is_none_or(|only| only == part);
    let mesh = bumpy(200);
    let bvh = Bvh::new(&mesh)?;
    println!(
        "{} triangles, grid {} x {}",
        mesh.faces.len(),
        GRID.rows,
        GRID.columns
    );
    let points = shading_points(&bvh);
    let cached: Vec<SurfacePoint> = points[..2048].iter().map(|p| p.surface).collect();
    let cache = VisibilityCache::build(&bvh, GRID, 1, &cached);
    let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool(1)?.install(|| {
        if wanted("harmonics") {
            harmonics();
        }
        if wanted("rays") {
            rays(&mesh, &bvh, &points);
        }
        if wanted("transport") {
            transport(&bvh, &points);
        }
    });
    for threads in [1, 2] {
        pool(threads)?.install(|| -> Report {
            if wanted("monte-carlo") {
                monte_carlo(&bvh, &points, &cache, threads)?;
            }
            if wanted("quadrature") {
                quadrature::quadrature(&bvh, &points[..512], threads)?;
            }
            Ok(())
        })?;
    }
    Ok(())
}

/// The least processor time of a run, in seconds over all threads, among the runs of a second and a half: what other work on
/// the machine takes away is not counted.
fn seconds(mut run: impl FnMut()) -> f64 {
    let (start, mut best) = (ProcessTime::now(), f64::INFINITY);
    while start.elapsed().as_secs_f64() < 1.5 {
        let before = ProcessTime::now();
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
    let mut packets = Vec::new();
    for (origin, queries) in by_origin(&queries) {
        let along =
            [0, 1, 2].map(|axis| queries.iter().map(|(_, d)| d[axis]).collect::<Vec<f32>>());
        packets.push((origin, along));
    }
    let mut open = 0;
    let together = seconds(|| {
        open = 0;
        for (origin, [x, y, z]) in &packets {
            let mut free = vec![true; x.len()];
            let direction = [x, y, z].map(Vec::as_slice);
            let open_of_it = &mut free;
            bvh.close_blocked(
                *origin,
                Rays {
                    direction,
                    open: open_of_it,
                },
            );
            open += free.iter().filter(|open| **open).count();
        }
    });
    let share = |count: usize| 100.0 * count as f64 / queries.len() as f64;
    println!(
        "shadow rays: one by one {:.2} M/s, compressed wide {:.2} M/s, those of a point together {:.2} M/s \
         ({:.1}, {:.1} and {:.1} % blocked)",
        rate(binary),
        rate(compressed),
        rate(together),
        share(blocked[0]),
        share(blocked[1]),
        share(queries.len() - open),
    );
}

/// Runs of queries from one place.
fn by_origin(queries: &[(Vec3, Vec3)]) -> impl Iterator<Item = (Vec3, &[(Vec3, Vec3)])> {
    let runs = queries.chunk_by(|a, b| a.0 == b.0);
    runs.map(|run| (run[0].0, run))
}

/// Rows of the transport operator.
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

/// Path sampling, then loss and gradient on the tape, for batches of light and material samples.
fn monte_carlo(
    bvh: &Bvh,
    points: &[ShadingPoint],
    cache: &VisibilityCache,
    threads: usize,
) -> Report {
    for model in [Model::Lambertian, Model::Microfacet] {
        // The paper takes 1024 rays a render of a pixel: the network's work is shared by them.
        for rays in [256, 1024] {
            let points = &points[..(1 << 19) / rays];
            for visibility in [Visibility::Rays, Visibility::Cached(cache)] {
                monte_carlo_batch(bvh, points, visibility, model, rays, threads)?;
            }
        }
    }
    Ok(())
}

fn monte_carlo_batch(
    bvh: &Bvh,
    points: &[ShadingPoint],
    visibility: Visibility,
    model: Model,
    rays: usize,
    threads: usize,
) -> Report {
    let positions: Vec<Vec3> = points.iter().map(|p| p.surface.position).collect();
    let environment = EnvironmentMap::new(Image::filled(100, 50, 3, 0.5))?;
    let radii = [5.0; FRAMES];
    let scene = PathScene {
        bvh,
        visibility,
        model,
        lights: environment.distribution(),
        environment_grid: GRID,
        mask_grid: GRID,
        radii: &radii,
    };
    let settings = PathSettings {
        light_samples: rays / 2,
        material_samples: rays / 2,
        seed: 1,
        iteration: 0,
        lookup: Lookup::Stochastic,
        render: 0,
    };
    let draw = |render| PathBatch::sample(&scene, points, &PathSettings { render, ..settings });
    let drawn = (2 * rays * points.len()) as f64;
    let photographs = vec![0.4; 3 * points.len()];
    let options = EstimatorOptions {
        model,
        pyramid: Pyramid::new(GRID, 6),
        mask_grid: GRID,
        degree: DEGREE,
        frames: FRAMES,
        lookup: settings.lookup,
        form: LossForm::HalfBackward,
    };
    let unknowns = options.start(5.0, 1, 1.5);
    let estimator = Estimator::new(options)?;
    let (mut failed, mut carried) = (None, 0);
    // Sampling alone, and all that an iteration does with its samples.
    let sampling = seconds(|| drop([draw(0), draw(1)]));
    let whole = seconds(|| {
        let batches = [draw(0), draw(1)];
        carried = batches.iter().map(PathBatch::samples).sum();
        let renders = [0, 1].map(|i| RenderSample {
            positions: &positions,
            batch: &batches[i],
        });
        failed = estimator.gradients(&unknowns, renders, &photographs).err();
    });
    if let Some(error) = failed {
        return Err(error.into());
    }
    let shadows = match visibility {
        Visibility::Rays => "cast",
        Visibility::Cached(_) => "cached",
    };
    println!(
        "Monte Carlo, {model:?}, {rays} rays, shadows {shadows}, {threads} thread(s): sampling, loss and gradient {:.1} M drawn/s, \
         {:.1} M carry light/s; sampling alone {:.1} M drawn/s",
        drawn / whole / 1e6,
        carried as f64 / whole / 1e6,
        drawn / sampling / 1e6
    );
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
