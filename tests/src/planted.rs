//! Studies whose photographs are the model's own values, with an effect planted in them.

use std::{
    path::Path,
    sync::{Arc, LazyLock},
};

use eclipse::{
    capture::Capture,
    criticism::{
        Simulation,
        chain::{Chain, Link},
        diagnose::screen_at,
        effects::{self, Effect, Term},
        fit::Fit,
        score::Screen,
        study::Study,
        transport::Lobe,
    },
};
use glam::Vec3;
use render::{camera::Camera, lat_long::LatLong, mesh::Mesh, sampler::SampleKey};

use crate::{
    painted,
    scenes::{add_sphere, interior},
};

/// How large a capture is, and how much of it is looked at.
pub struct Scale {
    /// Pixels across and down.
    pub size: usize,
    /// Photographs.
    pub frames: usize,
    /// Places looked at.
    pub sites: usize,
}

/// Enough for what every day asks.
pub const SMALL: Scale = Scale {
    size: 48,
    frames: 14,
    sites: 700,
};
/// Enough for effects that light and albedo imitate nearly: fewer places leave their gains within three standard errors.
pub const LARGE: Scale = Scale {
    size: 72,
    frames: 24,
    sites: 2000,
};
const NOISE: f32 = 0.01;

/// Three balls in a heap: concavities, cast shadows and normals of all directions.
fn heap() -> Mesh {
    let mut mesh = Mesh::default();
    for (centre, radius) in [
        (Vec3::new(-0.45, -0.1, -0.2), 0.5),
        (Vec3::new(0.45, 0.05, -0.25), 0.45),
        (Vec3::new(0.0, 0.1, 0.4), 0.38),
    ] {
        add_sphere(&mut mesh, centre, radius, 24);
    }
    mesh
}

/// A capture whose photographs the tests replace by the model's own values.
pub fn capture(ceiling: f32, scale: &Scale) -> Capture {
    let Scale { size, frames, .. } = *scale;
    let cameras = (0..frames).map(move |t| {
        let azimuth = t as f32 / frames as f32 * std::f32::consts::TAU;
        let height = 0.25 + 0.5 * ((t * 5) % frames) as f32 / frames as f32;
        let eye = 5.0 * Vec3::new(azimuth.cos(), azimuth.sin(), height).normalize();
        Camera::look_at(size, size, 0.5, eye, Vec3::ZERO)
    });
    let mut capture = painted::capture(heap(), Path::new("heap"), cameras, |point| {
        let light = 0.35 + 0.25 * point.normal.dot(Vec3::new(0.3, -0.8, 0.5));
        [0, 1, 2].map(|c| {
            let wave = (4.0 * point.position[c] + c as f32).sin();
            (light * (0.5 + 0.25 * wave)).min(ceiling)
        })
    });
    for frame in &mut capture.frames {
        let pixels = frame.image.data.chunks_exact_mut(3).zip(&frame.mask.data);
        // A background that is zero throughout would pass for one that a program cut out.
        for (p, (rgb, _)) in pixels.enumerate().filter(|(_, (_, mask))| **mask == 0.0) {
            rgb.fill(0.002 * pattern(p) as f32);
        }
    }
    capture
}

/// The gloss of the simulation.
pub const LOBE: Option<Lobe> = Some(Lobe {
    alpha: 0.4,
    kappa: 0.05,
});

/// A study of `capture` by a simulation under a plain interior.
pub fn study<'a>(capture: &'a Capture, lobe: Option<Lobe>, scale: &Scale) -> Study<'a> {
    let simulation = Simulation {
        environment: interior(LatLong::new(20, 40)).image().clone(),
        lobe,
        renders: capture.frames.iter().map(|f| f.image.clone()).collect(),
        occluders: Vec::new(),
    };
    Study::new(capture, &simulation, scale.sites, 20, 3).unwrap()
}

/// The true model: the simulation's light on a smooth texture.
pub fn truth(study: &Study<'_>) -> Fit {
    let mut fit = Fit::start(study).unwrap();
    let mut stream = SampleKey {
        seed: 5,
        ..SampleKey::default()
    }
    .stream();
    for w in &mut fit.parameters.texture {
        *w = 0.8 * (stream.uniform() - 0.5);
    }
    fit.evaluate(study).unwrap();
    fit
}

/// The terms of `effect` where `fit` stands.
pub fn terms(study: &Study<'_>, fit: &Fit, effect: &'static dyn Effect) -> Arc<Vec<Term>> {
    Arc::new(effect.terms(&fit.scene(study)))
}

/// A study and its true model, made once for all tests that plant nothing.
pub fn true_model() -> &'static (Study<'static>, Fit) {
    static CAPTURE: LazyLock<Capture> = LazyLock::new(|| capture(1.0, &SMALL));
    static MODEL: LazyLock<(Study<'static>, Fit)> = LazyLock::new(|| {
        let study = study(&CAPTURE, LOBE, &SMALL);
        let fit = truth(&study);
        (study, fit)
    });
    &MODEL
}

/// An effect and how much of each of its columns a term has.
pub type Planted<'a> = (&'static dyn Effect, &'a dyn Fn(usize, &Term) -> f64);

/// Puts the true model's values with `beta` of an effect and noise into the study.
pub fn plant(study: &mut Study<'_>, effect: Option<Planted<'_>>) {
    let fit = truth(study);
    plant_on(study, &fit, effect);
}

/// The same for the values of `fit`.
pub fn plant_on(study: &mut Study<'_>, fit: &Fit, effect: Option<Planted<'_>>) {
    plant_all(study, fit, effect.as_slice());
}

/// The same with several effects, in the order light meets them.
pub fn plant_all(study: &mut Study<'_>, fit: &Fit, effects: &[Planted<'_>]) {
    let mut values = fit.ideal.clone();
    if !effects.is_empty() {
        let planted = effects.iter().map(|&(effect, beta)| {
            let terms = terms(study, fit, effect);
            let betas: Vec<f64> = terms.iter().enumerate().map(|(k, t)| beta(k, t)).collect();
            (Link { effect, terms }, betas)
        });
        let (links, betas): (Vec<Link>, Vec<Vec<f64>>) = planted.unzip();
        let mut chain = Chain::new(&links, study.seen.len()).unwrap();
        chain.bind(&fit.ideal, &betas).unwrap();
        values = chain.values().unwrap();
    }
    let mut stream = SampleKey {
        seed: 9,
        ..SampleKey::default()
    }
    .stream();
    let mut normal = || (0..12).map(|_| stream.uniform()).sum::<f32>() - 6.0;
    let variance: Vec<f32> = values
        .iter()
        .map(|v| (NOISE * v).powi(2) + 0.002f32.powi(2))
        .collect();
    for (value, variance) in values.iter_mut().zip(&variance) {
        *value += variance.sqrt() * normal();
    }
    study.replace(values, variance);
}

/// The first screening, of all effects.
pub fn screened(study: &Study<'_>) -> Screen {
    let mut fit = Fit::start(study).unwrap();
    fit.refine(study, 6).unwrap();
    screen_at(study, &fit, effects::all().into_iter()).unwrap()
}

/// Asserts that an effect leads the physics of a screening, among the first `among`.
pub fn leads(screen: &Screen, id: &str, among: usize) {
    let physics: Vec<_> = screen
        .scores
        .iter()
        .filter(|s| effects::by_id(s.id).is_some_and(|e| !e.is_capacity()))
        .collect();
    let at = physics.iter().position(|s| s.id == id).unwrap();
    let list: Vec<_> = physics
        .iter()
        .take(6)
        .map(|s| (s.id, s.gain, s.gain_se))
        .collect();
    assert!(at < among, "{id} comes {at}: {list:?}");
    assert!(
        physics[at].gain > 3.0 * physics[at].gain_se,
        "{id}: {list:?}"
    );
}

/// Deviations of a pattern without regularity.
pub fn pattern(k: usize) -> f64 {
    ((k * 37 + 11) % 17) as f64 / 8.0 - 1.0
}
