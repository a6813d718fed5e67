//! Where simulation and recording differ, whatever the reason.

use serde::Serialize;

use super::{
    fit::Fit,
    light::Light,
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
    /// The frame.
    pub frame: usize,
    /// Its box in the image: left, top, right, bottom, pixels.
    pub pixels: [f32; 4],
    /// The middle of the part of surface, in the capture's own frame.
    pub surface_point: [f32; 3],
    /// Mean residual over its standard error, signed: positive where the photograph is brighter.
    pub sigma: f64,
    /// Mean residual relative to the value.
    pub relative: f64,
}

/// Residuals by one axis, such as the distance from the image's middle.
#[derive(Clone, Debug, Serialize)]
pub struct Axis {
    /// What the axis is.
    pub name: &'static str,
    /// Middle of each bin.
    pub at: Vec<f64>,
    /// Mean relative residual before and after.
    pub before: Vec<f64>,
    /// See `before`.
    pub after: Vec<f64>,
    /// Standard error of either, as a null would scatter.
    pub error: Vec<f64>,
}

/// Parts of frames with significant mean residual (Benjamini and Hochberg at 1 %), largest first.
pub fn hot_spots(study: &Study<'_>, fit: &Fit, most: usize) -> Vec<HotSpot> {
    let residual = fit.residual(study);
    let patches = study.seen.patches;
    let scale = fit.inflation;
    // Mean over the colours and the views of each (frame, patch).
    let mut cells: Vec<(f64, f64, f64, Vec<usize>)> =
        vec![(0.0, 0.0, 0.0, Vec::new()); patches * study.seen.frames];
    for (v, view) in study.seen.views.iter().enumerate() {
        if !study.has_known_albedo(v) {
            continue;
        }
        let patch = usize::from(study.seen.sites[view.site as usize].place.patch);
        let cell = &mut cells[view.frame as usize * patches + patch];
        for c in 0..3 {
            let i = 3 * v + c;
            let weight = 1.0 / (f64::from(study.variance[i]) * scale);
            cell.0 += weight * f64::from(residual[i]);
            cell.1 += weight;
            cell.2 += weight * f64::from(fit.value[i]);
        }
        cell.3.push(v);
    }
    let z: Vec<f64> = cells
        .iter()
        .map(|cell| {
            if cell.1 > 0.0 {
                cell.0 / cell.1.sqrt()
            } else {
                0.0
            }
        })
        .collect();
    // The model's own error scatters the means of nulls too: their middle tells how much.
    let mut sizes: Vec<f64> = z.iter().map(|z| z.abs()).filter(|z| *z > 0.0).collect();
    let spread = (super::statistics::median(&mut sizes) / 0.6745).max(1.0);
    let p: Vec<f64> = z
        .iter()
        .map(|z| 2.0 * normal_tail(z.abs() / spread))
        .collect();
    let found = discoveries(&p, 0.01);
    let mut order: Vec<usize> = (0..z.len()).filter(|&k| found[k]).collect();
    order.sort_by(|&a, &b| z[b].abs().total_cmp(&z[a].abs()).then(a.cmp(&b)));
    order.truncate(most);
    order
        .into_iter()
        .map(|k| {
            let cell = &cells[k];
            let places = cell.3.iter().map(|&v| study.seen.views[v].at);
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
                .3
                .iter()
                .map(|&v| {
                    study.seen.sites[study.seen.views[v].site as usize]
                        .point
                        .position
                })
                .sum();
            let middle = sum / cell.3.len().max(1) as f32 + study.capture.centre;
            HotSpot {
                frame: k / patches,
                pixels,
                surface_point: middle.to_array(),
                sigma: z[k] / spread,
                relative: cell.0 / cell.2.max(1e-12),
            }
        })
        .collect()
}

/// The part of residuals that neighbouring places of a frame share: noise does not correlate, missing physics does.
///
/// A mean product of standardised residuals of neighbours, that is, an energy per value in units of the noise's variance: of the
/// surface, and of the background where that should be dark and glows visibly.
pub fn structured_energy(study: &Study<'_>, fit: &Fit) -> f64 {
    let residual = fit.residual(study);
    let standard = |k: usize| f64::from(residual[k] / study.variance[k].sqrt());
    let plain = |k: usize| f64::from(residual[k]);
    let glow = of_background(study, &plain).max(0.0).sqrt();
    let certain = if glow > GLOW * f64::from(fit.scene(study).typical()) {
        of_background(study, &standard).max(0.0)
    } else {
        0.0
    };
    of_surface(study, &standard).max(0.0) + certain
}

fn of_surface(study: &Study<'_>, standard: &dyn Fn(usize) -> f64) -> f64 {
    let reach = 2.2 * study.seen.spacing;
    // Neighbours of each site, each pair once.
    let sites = &study.seen.sites;
    let (mut sum, mut count) = (0.0, 0u64);
    for a in 0..sites.len() {
        for b in a + 1..sites.len() {
            let close = sites[a].point.position.distance(sites[b].point.position) < reach
                && sites[a].point.normal.dot(sites[b].point.normal) > 0.7;
            if !close {
                continue;
            }
            let (mut i, mut j) = (study.seen.offsets[a], study.seen.offsets[b]);
            while i < study.seen.offsets[a + 1] && j < study.seen.offsets[b + 1] {
                let (fi, fj) = (study.seen.views[i].frame, study.seen.views[j].frame);
                if fi == fj {
                    if study.develops(i) && study.develops(j) {
                        for c in 0..3 {
                            sum += standard(3 * i + c) * standard(3 * j + c);
                            count += 1;
                        }
                    }
                    (i, j) = (i + 1, j + 1);
                } else if fi < fj {
                    i += 1;
                } else {
                    j += 1;
                }
            }
        }
    }
    sum / count.max(1) as f64
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

/// Mean residuals over frames, image radius, level, facing and openness, before and after.
pub fn axes(study: &Study<'_>, before: &Fit, after: &Fit) -> Vec<Axis> {
    let views = &study.seen.views;
    let typical = f64::from(before.scene(study).typical());
    let facing = |v: usize| {
        let view = &views[v];
        let normal = study.seen.sites[view.site as usize].point.normal;
        f64::from(normal.dot(study.seen.outgoing(view)))
    };
    let radius = |v: usize| {
        let camera = &study.capture.frames[views[v].frame as usize].camera;
        let [x, y] = views[v].at;
        let (dx, dy) = (x - camera.principal[0], y - camera.principal[1]);
        let half = 0.5 * (camera.width as f32).hypot(camera.height as f32);
        f64::from(dx.hypot(dy) / half)
    };
    let level = |v: usize| {
        let sum: f64 = (0..3).map(|c| f64::from(before.value[3 * v + c])).sum();
        sum / (3.0 * typical)
    };
    let open = |v: usize| {
        let row = study.horizon.row(&study.seen, &views[v]);
        row.map(|(_, weight, _)| f64::from(weight)).sum::<f64>() / std::f64::consts::PI
    };
    let (open_name, least_open) = match study.horizon.light() {
        Light::Environment => ("openness (1 on a convex shape)", 0.2),
        Light::Lamps => ("facing the lamp (n·l, 0 in its shadow)", 0.0),
    };
    let frame = |v: usize| f64::from(views[v].frame);
    let frames = study.seen.frames as f64 - 0.5;
    vec![
        axis(
            study,
            before,
            after,
            "frame",
            study.seen.frames,
            [-0.5, frames],
            &frame,
        ),
        axis(
            study,
            before,
            after,
            "distance from the image's middle (1 in the corners)",
            10,
            [0.0, 0.8],
            &radius,
        ),
        axis(
            study,
            before,
            after,
            "level (of the middle one)",
            12,
            [0.0, 3.0],
            &level,
        ),
        axis(
            study,
            before,
            after,
            "facing the camera (n·v)",
            8,
            [0.3, 1.0],
            &facing,
        ),
        axis(study, before, after, open_name, 8, [least_open, 1.0], &open),
    ]
}

fn axis(
    study: &Study<'_>,
    before: &Fit,
    after: &Fit,
    name: &'static str,
    bins: usize,
    [low, high]: [f64; 2],
    of: &dyn Fn(usize) -> f64,
) -> Axis {
    let (first, last) = (before.residual(study), after.residual(study));
    let mut sums = vec![[0.0f64; 4]; bins];
    for v in (0..study.seen.views.len()).filter(|&v| study.has_known_albedo(v)) {
        let at = (of(v) - low) / (high - low) * bins as f64;
        if !(0.0..bins as f64).contains(&at) {
            continue;
        }
        let sum = &mut sums[at as usize];
        for i in 3 * v..3 * v + 3 {
            let variance = f64::from(study.variance[i]) * before.inflation;
            let value = f64::from(before.value[i]);
            sum[0] += f64::from(first[i]) * value / variance;
            sum[1] += f64::from(last[i]) * value / variance;
            sum[2] += value * value / variance;
        }
        sum[3] += 1.0;
    }
    let kept: Vec<usize> = (0..bins).filter(|&b| sums[b][3] >= 5.0).collect();
    Axis {
        name,
        at: kept
            .iter()
            .map(|&b| low + (b as f64 + 0.5) / bins as f64 * (high - low))
            .collect(),
        before: kept.iter().map(|&b| sums[b][0] / sums[b][2]).collect(),
        after: kept.iter().map(|&b| sums[b][1] / sums[b][2]).collect(),
        error: kept.iter().map(|&b| 1.0 / sums[b][2].sqrt()).collect(),
    }
}
