//! Where simulation and recording differ, whatever the reason.

use serde::Serialize;

use super::{
    fit::Fit,
    neighbours::{self, shared},
    split::Role,
    statistics::{discoveries, normal_tail},
    study::Study,
};

/// Light in the background that is told, of the middle value: the least size of an effect. Less may be what cutting values off at
/// zero has left, however sure it is.
const GLOW: f64 = 0.003;
/// Blocks of the background that are this many pixels apart at most are neighbours.
const NEIGHBOURS: f32 = 100.0;

/// A part of a frame whose residuals have a mean that noise does not explain.
#[derive(Clone, Debug, Serialize)]
pub struct HotSpot {
    /// The frame, counted from zero.
    pub frame: usize,
    /// Its name.
    pub name: String,
    /// Its box in the image: left, top, right, bottom, pixels.
    pub pixels: [f32; 4],
    /// The middle of the part of surface, in the capture's own frame.
    pub surface_point: [f32; 3],
    /// Mean residual over its standard error, signed: positive where the photograph is brighter.
    pub sigma: f64,
    /// Mean residual relative to the value.
    pub relative: f64,
    /// What neighbouring places of it share, in units of the noise's variance: noise shares nothing. Absent where it has no
    /// neighbours.
    pub shared: Option<f64>,
}

impl HotSpot {
    /// The middle of its box, pixels.
    pub fn middle(&self) -> [f32; 2] {
        let [left, top, right, bottom] = self.pixels;
        [0.5 * (left + right), 0.5 * (top + bottom)]
    }

    /// Standard error of the relative residual.
    pub fn relative_error(&self) -> f64 {
        (self.relative / self.sigma).abs()
    }
}

/// Parts of frames with significant mean residual (Benjamini and Hochberg at 1 %), largest first; of frames that were sealed only where
/// no effect in `fit` has numbers of single frames, since theirs are not known.
///
/// What counts as significant is told by `quiet`, the best model there is: a mismatch that is everywhere would hide itself.
pub fn hot_spots(study: &Study<'_>, fit: &Fit, quiet: &Fit, most: usize) -> Vec<HotSpot> {
    let patches = study.seen.patches;
    let scale = fit.inflation.min(quiet.inflation);
    let residual = fit.residual(study);
    let cells = cells(study, fit, &residual);
    let z: Vec<f64> = cells.iter().map(|cell| cell.z(scale)).collect();
    let quiet: Vec<f64> = self::cells(study, quiet, &quiet.residual(study))
        .iter()
        .map(|cell| cell.z(scale))
        .collect();
    // The model's own error scatters the means of nulls too: their middle tells how much.
    let spread = middle(&z).min(middle(&quiet)).max(1.0);
    let seen: Vec<usize> = (0..cells.len())
        .filter(|&k| cells[k].weight > 0.0)
        .collect();
    let p: Vec<f64> = seen
        .iter()
        .map(|&k| 2.0 * normal_tail(z[k].abs() / spread))
        .collect();
    let found = discoveries(&p, 0.01);
    let mut order: Vec<usize> = seen
        .iter()
        .zip(found)
        .filter_map(|(&k, found)| found.then_some(k))
        .collect();
    order.sort_by(|&a, &b| z[b].abs().total_cmp(&z[a].abs()).then(a.cmp(&b)));
    order.truncate(most);
    let shares = shared_in_cells(study, &residual);
    order
        .into_iter()
        .map(|k| {
            let cell = &cells[k];
            let places = cell.views.iter().map(|&v| study.seen.views[v].at);
            let mut pixels = [f32::INFINITY, f32::INFINITY, 0.0, 0.0];
            for [x, y] in places {
                pixels = [
                    pixels[0].min(x),
                    pixels[1].min(y),
                    pixels[2].max(x),
                    pixels[3].max(y),
                ];
            }
            let sum: glam::Vec3 = cell
                .views
                .iter()
                .map(|&v| {
                    study.seen.sites[study.seen.views[v].site as usize]
                        .point
                        .position
                })
                .sum();
            let middle = sum / cell.views.len().max(1) as f32 + study.capture.centre;
            HotSpot {
                frame: k / patches,
                name: study.capture.frames[k / patches].name.clone(),
                pixels,
                surface_point: middle.to_array(),
                sigma: z[k] / spread,
                relative: cell.residual / cell.value.max(1e-12),
                shared: shares[k],
            }
        })
        .collect()
}

/// A patch in a frame: weighted sums over the colours and the views of it.
#[derive(Clone, Default)]
struct Cell {
    residual: f64,
    weight: f64,
    value: f64,
    views: Vec<usize>,
}

impl Cell {
    /// Its mean residual in standard errors, variances being larger by `scale`.
    fn z(&self, scale: f64) -> f64 {
        match self.weight > 0.0 {
            true => self.residual / (self.weight * scale).sqrt(),
            false => 0.0,
        }
    }
}

/// `[frame][patch]`.
fn cells(study: &Study<'_>, fit: &Fit, residual: &[f32]) -> Vec<Cell> {
    let patches = study.seen.patches;
    let all_known = fit.is_shared();
    let known = |frame: u32| all_known || !study.frame_is_sealed(frame);
    let mut cells = vec![Cell::default(); patches * study.seen.frames];
    for (v, view) in study.seen.views.iter().enumerate() {
        if !study.has_known_albedo(v) || !known(view.frame) {
            continue;
        }
        let patch = usize::from(study.seen.sites[view.site as usize].place.patch);
        let cell = &mut cells[view.frame as usize * patches + patch];
        for c in 0..3 {
            let i = 3 * v + c;
            let weight = 1.0 / f64::from(study.variance[i]);
            cell.residual += weight * f64::from(residual[i]);
            cell.weight += weight;
            cell.value += weight * f64::from(fit.value[i]);
        }
        cell.views.push(v);
    }
    cells
}

/// The spread that the middle of these sizes tells of, were they normal; none of those that are nothing.
fn middle(z: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = z.iter().map(|z| z.abs()).filter(|z| *z > 0.0).collect();
    super::statistics::median(&mut sizes) / 0.6745
}

/// What neighbours of one patch share in each frame, `[frame][patch]`.
fn shared_in_cells(study: &Study<'_>, residual: &[f32]) -> Vec<Option<f64>> {
    let seen = &study.seen;
    let standard = |k: usize| f64::from(residual[k] / study.variance[k].sqrt());
    let patch = |v: u32| {
        let site = seen.views[v as usize].site as usize;
        usize::from(seen.sites[site].place.patch)
    };
    let mut sums = vec![(0.0, 0u32); seen.patches * seen.frames];
    let sites = neighbours::sites(study);
    for pair in neighbours::views(study, &sites, |v| study.has_known_albedo(v)) {
        let [a, b] = pair.map(patch);
        if a == b {
            let frame = seen.views[pair[0] as usize].frame as usize;
            let cell = &mut sums[frame * seen.patches + a];
            cell.0 += shared(pair, &standard);
            cell.1 += 1;
        }
    }
    let mean = |(sum, count): (f64, u32)| (count > 0).then(|| sum / f64::from(count));
    sums.into_iter().map(mean).collect()
}

/// The part of residuals that neighbouring places of a frame share: noise does not correlate, missing physics does.
///
/// A mean product of standardised residuals of neighbours, that is, an energy per value in units of the noise's variance.
#[derive(Clone, Copy, Debug, Default)]
pub struct Structured {
    /// Of the surface.
    pub surface: f64,
    /// Of the background, where that should be dark and glows visibly.
    pub background: f64,
}

impl Structured {
    /// Of a fit.
    pub fn of(study: &Study<'_>, fit: &Fit) -> Self {
        let residual = fit.residual(study);
        let standard = |k: usize| f64::from(residual[k] / study.variance[k].sqrt());
        let plain = |k: usize| f64::from(residual[k]);
        let glow = of_background(study, &plain).max(0.0).sqrt();
        let background = if glow > GLOW * f64::from(fit.scene(study).typical()) {
            of_background(study, &standard).max(0.0)
        } else {
            0.0
        };
        Self {
            surface: of_surface(study, &standard).max(0.0),
            background,
        }
    }

    /// That of the surface in frames that no fit has seen; absent where none is sealed.
    pub fn in_sealed_frames(study: &Study<'_>, fit: &Fit) -> Option<f64> {
        let residual = fit.residual(study);
        let standard = |k: usize| f64::from(residual[k] / study.variance[k].sqrt());
        let sealed = |v: usize| study.role[v] == Role::SealedFrame;
        shared_on_surface(study, &standard, sealed).map(|shared| shared.max(0.0))
    }

    /// Both.
    pub fn all(self) -> f64 {
        self.surface + self.background
    }
}

fn of_surface(study: &Study<'_>, standard: &dyn Fn(usize) -> f64) -> f64 {
    shared_on_surface(study, standard, |v| study.develops(v)).unwrap_or(0.0)
}

/// Of the views that `counted` names; nothing where none of them are neighbours.
fn shared_on_surface(
    study: &Study<'_>,
    standard: &dyn Fn(usize) -> f64,
    counted: impl Fn(usize) -> bool,
) -> Option<f64> {
    let sites = neighbours::sites(study);
    let pairs = neighbours::views(study, &sites, counted);
    let products = pairs.iter().map(|&pair| shared(pair, standard));
    let sum = products.sum::<f64>();
    (!pairs.is_empty()).then(|| sum / pairs.len() as f64)
}

fn of_background(study: &Study<'_>, standard: &dyn Fn(usize) -> f64) -> f64 {
    let dark = &study.seen.dark;
    let first = study.seen.views.len();
    let apart = |a: usize, b: usize| {
        let [[ax, ay], [bx, by]] = [dark[a].at, dark[b].at];
        (ax - bx).hypot(ay - by)
    };
    let (mut sum, mut count) = (0.0, 0u64);
    // Blocks of a frame stand together, row by row: the next one is a neighbour but at a row's end.
    for b in 1..dark.len() {
        let a = b - 1;
        let together = dark[a].frame == dark[b].frame && apart(a, b) < NEIGHBOURS;
        if together && study.develops(first + a) && study.develops(first + b) {
            for c in 0..3 {
                sum += standard(3 * (first + a) + c) * standard(3 * (first + b) + c);
                count += 1;
            }
        }
    }
    sum / count.max(1) as f64
}
