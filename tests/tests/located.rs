//! What a diagnosis shows of where models are off, of the occluders it found, and how sure it is of numbers.

use std::{fs, path::Path};

use eclipse::{
    capture::Capture,
    criticism::{
        Simulation,
        axes::{Axis, axes},
        certainty::standard_errors,
        chain::{Chain, Link},
        effects,
        fit::Fit,
        locate, neighbours, shadow_edges,
        silhouette::{self, Silhouettes},
        study::Study,
    },
    image_io::write_exr,
};
use eclipse_tests::painted;
use glam::Vec3;
use render::{camera::Camera, image::Image, lat_long::LatLong, mesh::Mesh, sampler::SampleKey};

const SIZE: usize = 48;
const FRAMES: usize = 10;
const ROWS: usize = 20;
const NOISE: f32 = 0.01;

/// Two balls, one of which stands between the other and the sun of [`sun_and_sky`].
fn pair() -> Mesh {
    let mut mesh = Mesh::sphere(Vec3::new(-0.4, 0.0, -0.1), 0.55, 24);
    mesh.append(&Mesh::sphere(Vec3::new(0.55, 0.0, 0.4), 0.4, 24));
    mesh
}

/// Most of the light comes from one direction, 40° up over +x.
fn sun_and_sky() -> Image {
    let grid = LatLong::new(ROWS, 2 * ROWS);
    let sun = Vec3::new(0.77, 0.0, 0.64).normalize();
    let mut map = Image::filled(grid.columns, grid.rows, 3, 0.0);
    for (texel, rgb) in map.data.chunks_exact_mut(3).enumerate() {
        let direction = grid.texel_direction(texel / grid.columns, texel % grid.columns);
        rgb.fill(if direction.dot(sun) > 0.98 { 40.0 } else { 0.3 });
    }
    map
}

/// A capture of `mesh`, from all around.
fn capture(mesh: Mesh, path: &Path) -> Capture {
    let cameras = (0..FRAMES).map(|t| {
        let azimuth = t as f32 / FRAMES as f32 * std::f32::consts::TAU;
        let height = 0.2 + 0.5 * ((t * 3) % FRAMES) as f32 / FRAMES as f32;
        let eye = 5.0 * Vec3::new(azimuth.cos(), azimuth.sin(), height).normalize();
        Camera::look_at(SIZE, SIZE, 0.5, eye, Vec3::ZERO)
    });
    painted::capture(mesh, path, cameras, |point| {
        [0.35 + 0.2 * point.normal.x; 3]
    })
}

fn study(capture: &Capture) -> Study<'_> {
    let simulation = Simulation {
        environment: sun_and_sky(),
        lobe: None,
        renders: capture.frames.iter().map(|f| f.image.clone()).collect(),
        occluders: Vec::new(),
    };
    Study::new(capture, &simulation, 500, ROWS, 3).unwrap()
}

/// Numbers between −½ and ½.
fn uniform(seed: u64) -> impl FnMut() -> f32 {
    let mut stream = SampleKey {
        seed,
        ..SampleKey::default()
    }
    .stream();
    move || stream.uniform() - 0.5
}

/// Puts `of(observation) ×` the model's values with noise in the photographs' place.
fn plant(study: &mut Study<'_>, values: &[f32], of: impl Fn(usize) -> f32) {
    let mut next = uniform(9);
    let mut normal = || (0..12).map(|_| next()).sum::<f32>();
    let (mut planted, mut variances) = (Vec::new(), Vec::new());
    for (i, value) in values.iter().enumerate() {
        let value = of(i / 3) * value;
        let variance = (NOISE * value).powi(2) + 0.001f32.powi(2);
        planted.push(value + variance.sqrt() * normal());
        variances.push(variance);
    }
    study.replace(planted, variances);
}

/// The axis whose name contains `part`.
fn along<'a>(axes: &'a [Axis], part: &str) -> &'a Axis {
    let names: Vec<&str> = axes.iter().map(|axis| axis.name).collect();
    let found = axes.iter().find(|axis| axis.name.contains(part));
    found.unwrap_or_else(|| panic!("no axis {part} among {names:?}"))
}

fn count(found: &[bool]) -> usize {
    found.iter().filter(|found| **found).count()
}

#[test]
fn a_null_has_nothing_along_any_axis_and_a_falloff_has_it_along_the_radius() {
    let capture = capture(pair(), Path::new("pair"));
    let mut study = study(&capture);
    let fit = Fit::start(&study).unwrap();
    plant(&mut study, &fit.value, |_| 1.0);
    let null = axes(&study, &fit, &fit);
    for part in [
        "frame", "middle", "across", "down", "level", "n·v", "n·h", "openness", "shadows",
    ] {
        let axis = along(&null, part);
        assert!(axis.at.len() >= 2, "{part}: {:?}", axis.at);
        let lengths = [
            axis.before.len(),
            axis.shared_after.len(),
            axis.found_after.len(),
        ];
        assert_eq!(lengths, [axis.at.len(); 3]);
    }
    // One chance in a hundred that any does.
    let chance: usize = null.iter().map(|axis| count(&axis.found_before)).sum();
    assert!(chance <= 1, "{chance} bins stand out of a null");
    assert!(locate::Structured::of(&study, &fit).all() < 0.05);

    let seen: Vec<[f32; 2]> = (0..study.seen.len()).map(|i| study.seen.at(i)).collect();
    let middle = SIZE as f32 / 2.0;
    let squared = |i: usize| {
        let [x, y] = seen[i].map(|at| (at - middle) / middle);
        0.5 * (x * x + y * y)
    };
    plant(&mut study, &fit.value, |i| 1.0 - 0.4 * squared(i));
    let falloff = axes(&study, &fit, &fit);
    let radius = along(&falloff, "middle");
    assert!(count(&radius.found_before) >= 3, "{radius:?}");
    let outermost = radius.found_before.iter().rposition(|found| *found);
    let outermost = outermost.unwrap();
    assert!(radius.before[outermost] < -0.03, "{radius:?}");
    assert!(radius.shared_before[outermost] > 1.0, "{radius:?}");
    assert!(radius.before[0].abs() < 0.01, "{radius:?}");
    // Lost in all directions alike, it makes no difference between the image's halves.
    let across = along(&falloff, "across");
    assert!(across.before[0] < -0.02 && across.before[across.before.len() - 1] < -0.02);
}

#[test]
fn a_patch_that_is_too_bright_is_a_hot_spot_whose_neighbours_agree() {
    let capture = capture(pair(), Path::new("pair"));
    let mut study = study(&capture);
    let fit = Fit::start(&study).unwrap();
    let cell = |study: &Study<'_>, v: usize| {
        let view = &study.seen.views[v];
        let patch = study.seen.sites[view.site as usize].place.patch;
        (view.frame, patch)
    };
    // The part of a frame with most views.
    let views: Vec<usize> = (0..study.seen.views.len())
        .filter(|&v| study.develops(v))
        .collect();
    let cells: Vec<(u32, u16)> = views.iter().map(|&v| cell(&study, v)).collect();
    let size = |own: &(u32, u16)| cells.iter().filter(|other| *other == own).count();
    let bright = *cells.iter().max_by_key(|own| size(own)).unwrap();
    let of_bright: Vec<bool> = (0..study.seen.len())
        .map(|i| i < study.seen.views.len() && cell(&study, i) == bright)
        .collect();
    plant(
        &mut study,
        &fit.value,
        |i| if of_bright[i] { 1.2 } else { 1.0 },
    );
    let spots = locate::hot_spots(&study, &fit, &fit, 12);
    assert_eq!(spots[0].frame as u32, bright.0);
    assert!((spots[0].relative - 0.2).abs() < 0.02, "{:?}", spots[0]);
    let shared = spots[0].shared.unwrap();
    assert!(shared > 10.0, "{shared}");
}

#[test]
fn shadows_have_edges_on_what_stands_in_one_and_none_on_a_ball() {
    let capture_of = |mesh: Mesh| capture(mesh, Path::new("shadows"));
    let shaded = capture_of(pair());
    let study_of_pair = study(&shaded);
    let fit = Fit::start(&study_of_pair).unwrap();
    let pairs = neighbours::sites(&study_of_pair);
    let distances = shadow_edges::distances(&study_of_pair, &fit, &pairs);
    let near = distances.iter().filter(|d| **d < 0.1).count();
    assert!(near > 20 && near < distances.len() / 2, "{near}");
    // On the far ball the near one casts a shadow of the sun; on the near one only sky is hidden, where it faces the far one.
    let [far, near_one] = [Vec3::new(-0.4, 0.0, -0.1), Vec3::new(0.55, 0.0, 0.4)];
    let edges = distances.iter().zip(&study_of_pair.seen.views);
    let at_edges: Vec<Vec3> = edges
        .filter(|(distance, _)| **distance < 0.1)
        .map(|(_, view)| study_of_pair.seen.sites[view.site as usize].point.position)
        .collect();
    let (on_far, on_near): (Vec<Vec3>, Vec<Vec3>) =
        at_edges.iter().partition(|p| p.distance(far) < 0.56);
    assert!(3 * on_far.len() > near, "{} of {near}", on_far.len());
    let facing = |p: &Vec3| {
        (*p - near_one)
            .normalize()
            .dot((far - near_one).normalize())
    };
    assert!(on_near.iter().all(|p| facing(p) > 0.0), "{on_near:?}");

    let ball = capture_of(Mesh::sphere(Vec3::ZERO, 0.9, 32));
    let study_of_ball = study(&ball);
    let fit = Fit::start(&study_of_ball).unwrap();
    let pairs = neighbours::sites(&study_of_ball);
    let distances = shadow_edges::distances(&study_of_ball, &fit, &pairs);
    assert!(distances.iter().all(|distance| distance.is_infinite()));
}

/// The model with somebody behind the camera.
fn behind_the_camera(study: &Study<'_>) -> Fit {
    let mut fit = Fit::start(study).unwrap();
    let occluder = effects::by_id("moving_occluder").unwrap();
    let opacity = occluder.terms(&fit.scene(study)).into_iter().map(|term| {
        let there = term.frame.is_none()
            && term.name.contains(" -8° to 8° from")
            && term.name.contains("6° to 24°");
        if there { 0.8 } else { 0.0 }
    });
    let opacity: Vec<f64> = opacity.collect();
    assert_eq!(opacity.iter().filter(|o| **o > 0.0).count(), 1);
    fit.add(occluder, opacity);
    fit.relink(study).unwrap();
    fit
}

#[test]
fn silhouettes_are_where_the_occluder_is_and_are_compared_with_a_truth() {
    let folder = tempfile::tempdir().unwrap();
    let capture = capture(pair(), folder.path());
    let study = study(&capture);
    let plain = Fit::start(&study).unwrap();
    assert!(Silhouettes::of(&study, &[], &plain).is_none());
    let fit = behind_the_camera(&study);
    let found = Silhouettes::of(&study, &[], &fit).unwrap();
    assert_eq!(found.masks.len(), FRAMES);
    let grid = LatLong::new(ROWS, 2 * ROWS);
    for (mask, eye) in found.masks.iter().zip(&study.seen.eyes) {
        assert_eq!([mask.width, mask.height], [grid.columns, grid.rows]);
        let level = Vec3::new(eye.x, eye.y, 0.0).normalize();
        let behind = (level + Vec3::new(0.0, 0.0, 0.27)).normalize();
        assert!(mask.data[grid.nearest(behind)] < 0.5);
        let across = Vec3::new(-behind.x, -behind.y, behind.z);
        assert_eq!(mask.data[grid.nearest(across)], 1.0);
    }
    assert!(
        found
            .told
            .blocked
            .iter()
            .all(|share| (0.0..0.5).contains(share))
    );
    assert_eq!(found.told.score.energy_weighted_error, None);
    assert_eq!(found.told.problem, None);

    // Occluders that the simulation has are in the model too.
    let mut given = vec![Image::filled(8, 4, 1, 1.0); FRAMES];
    given[2].data.fill(0.0);
    let both = Silhouettes::of(&study, &given, &fit).unwrap();
    assert_eq!(both.masks[2].data, vec![0.0; grid.len()]);
    assert!((both.told.blocked[2] - 1.0).abs() < 1e-6);
    let apart = both.masks[0].data.iter().zip(&found.masks[0].data);
    assert!(apart.into_iter().all(|(a, b)| (a - b).abs() < 1e-5));

    let truth = folder.path().join("truth");
    fs::create_dir(&truth).unwrap();
    found.write(&truth).unwrap();
    let score = |given: &[Image]| Silhouettes::of(&study, given, &fit).unwrap();
    // Without the light that is blocked, no error can be weighed by it.
    let weightless = score(&[]).told;
    assert_eq!(
        (weightless.score.energy_weighted_error, weightless.problem),
        (None, None)
    );
    let light = truth.join("environment.exr");
    write_exr(&light, &sun_and_sky(), &["R", "G", "B"]).unwrap();
    let same = score(&[]);
    assert_eq!(same.told.score.energy_weighted_error, Some(0.0));
    assert_eq!(same.truth, found.masks);
    let worse = score(&given).told.score.energy_weighted_error.unwrap();
    assert!(worse > 1.0, "{worse}");

    // A truth of other photographs gives no number, but the reason.
    let fewer = Silhouettes {
        masks: found.masks[1..].to_vec(),
        truth: Vec::new(),
        told: found.told.clone(),
    };
    fewer.write(&truth).unwrap();
    let told = score(&[]).told;
    assert_eq!(told.score.energy_weighted_error, None);
    assert!(told.problem.unwrap().contains("masks"));
    assert!(truth.join(silhouette::FILE).is_file());
}

#[test]
#[ignore = "a minute; run with --ignored"]
fn numbers_lie_within_a_few_of_their_errors() {
    let capture = capture(pair(), Path::new("pair"));
    let mut study = study(&capture);
    let truth = {
        let mut fit = Fit::start(&study).unwrap();
        let mut next = uniform(5);
        fit.parameters.texture.fill_with(|| 0.6 * next());
        fit.evaluate(&study).unwrap();
        fit
    };
    let effect = effects::by_id("exposure_drift").unwrap();
    let terms = std::sync::Arc::new(effect.terms(&truth.scene(&study)));
    let planted: Vec<f64> = (0..terms.len())
        .map(|k| {
            if k % 3 == 0 {
                0.04 * (k as f64).sin()
            } else {
                0.0
            }
        })
        .collect();
    let link = Link { effect, terms };
    let mut chain = Chain::new(&[link], study.seen.len()).unwrap();
    chain
        .bind(&truth.ideal, std::slice::from_ref(&planted))
        .unwrap();
    let values = chain.values().unwrap();
    plant(&mut study, &values, |_| 1.0);
    let mut fit = Fit::start(&study).unwrap();
    fit.add(effect, Vec::new());
    fit.refine(&study, 12).unwrap();
    let errors = &standard_errors(&study, &fit).unwrap()["exposure_drift"];
    assert_eq!(errors.len(), planted.len());
    // Light takes up part of the gain that all frames share: errors hold that too.
    let found = &fit.active[0].beta;
    let gains: Vec<usize> = (0..planted.len()).step_by(3).collect();
    let squares = gains
        .iter()
        .map(|&k| ((found[k] - planted[k]) / errors[k]).powi(2));
    let squared = squares.sum::<f64>() / gains.len() as f64;
    assert!(squared < 6.0, "{squared}: {found:?} ± {errors:?}");
    let size = |k: &usize| (1e-4..0.06).contains(&errors[*k]);
    assert!(gains.iter().all(size), "{errors:?}");
}
