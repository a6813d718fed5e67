//! Where simulation and recording differ, along axes that physics acts by: mean residuals and what neighbouring residuals share.

use serde::Serialize;

use super::{
    fit::Fit,
    light::Light,
    neighbours, shadow_edges,
    statistics::{discoveries, normal_tail},
    study::Study,
};

/// Views that a bin needs.
const LEAST_VIEWS: usize = 5;
/// Blocks that a bin needs before anything in it can stand out: the scatter of fewer says little.
const LEAST_BLOCKS: usize = 8;
/// The share of false discoveries among what stands out.
const LEVEL: f64 = 0.01;

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
    /// What neighbouring residuals share before and after, in units of the noise's variance: noise shares nothing. Zero where a bin
    /// has no neighbours.
    pub shared_before: Vec<f64>,
    /// See `shared_before`.
    pub shared_after: Vec<f64>,
    /// Standard error of either, as a null would scatter.
    pub shared_error: Vec<f64>,
    /// Whether a bin's mean or what its neighbours share stands out before and after, all bins of all axes considered.
    pub found_before: Vec<bool>,
    /// See `found_before`.
    pub found_after: Vec<bool>,
}

/// An axis before anything is measured along it.
struct Ruler {
    name: &'static str,
    bins: usize,
    range: [f64; 2],
    /// Where each view lies; not a number where the axis says nothing of it.
    at: Vec<f64>,
}

impl Ruler {
    fn bin(&self, at: f64) -> Option<usize> {
        let [low, high] = self.range;
        let bin = (at - low) / (high - low) * self.bins as f64;
        (0.0..=self.bins as f64)
            .contains(&bin)
            .then(|| (bin as usize).min(self.bins - 1))
    }

    fn middle(&self, bin: usize) -> f64 {
        let [low, high] = self.range;
        low + (bin as f64 + 0.5) / self.bins as f64 * (high - low)
    }
}

/// Residuals before and after over frames, image radius, image position, level, facing, half-vector, openness and distance from
/// edges of shadows; where an axis has no values, it is left out.
pub fn axes(study: &Study<'_>, before: &Fit, after: &Fit) -> Vec<Axis> {
    let sites = neighbours::sites(study);
    let pairs = neighbours::views(study, &sites, |v| study.has_known_albedo(v));
    let rulers = rulers(study, before, &sites);
    // One noise for both models: what a bin gains must not be what the model's own scatter is taken for.
    let [first, last] = [before, after].map(|fit| {
        let residual = fit.residual(study);
        let of = |ruler| measured(study, before, &residual, &pairs, ruler);
        rulers.iter().map(of).collect::<Vec<_>>()
    });
    let found = [stands_out(&first), stands_out(&last)];
    let mut next = 0;
    let mut all = Vec::new();
    for ((ruler, first), last) in rulers.iter().zip(&first).zip(&last) {
        let own = next..next + first.len();
        next = own.end;
        if first.is_empty() {
            continue;
        }
        let of = |bins: &[Bin], value: fn(&Bin) -> f64| bins.iter().map(value).collect();
        all.push(Axis {
            name: ruler.name,
            at: first.iter().map(|bin| ruler.middle(bin.index)).collect(),
            before: of(first, |bin| bin.mean),
            after: of(last, |bin| bin.mean),
            error: of(first, |bin| bin.error),
            shared_before: of(first, |bin| bin.shared),
            shared_after: of(last, |bin| bin.shared),
            shared_error: of(first, |bin| bin.shared_error),
            found_before: found[0][own.clone()].to_vec(),
            found_after: found[1][own].to_vec(),
        });
    }
    all
}

/// Which bins stand out (Benjamini and Hochberg over both tests of all bins of all axes), axis after axis.
fn stands_out(axes: &[Vec<Bin>]) -> Vec<bool> {
    let p: Vec<f64> = axes.iter().flatten().flat_map(|bin| bin.p).collect();
    let found = discoveries(&p, LEVEL);
    found
        .chunks_exact(2)
        .map(|pair| pair[0] || pair[1])
        .collect()
}

fn rulers(study: &Study<'_>, fit: &Fit, sites: &[[u32; 2]]) -> Vec<Ruler> {
    let views = &study.seen.views;
    let typical = f64::from(fit.scene(study).typical());
    let camera = |v: usize| &study.capture.frames[views[v].frame as usize].camera;
    let radius = |v: usize| {
        let camera = camera(v);
        let [x, y] = views[v].at;
        let (dx, dy) = (x - camera.principal[0], y - camera.principal[1]);
        let half = 0.5 * (camera.width as f32).hypot(camera.height as f32);
        f64::from(dx.hypot(dy) / half)
    };
    let level = |v: usize| {
        let sum: f64 = (0..3).map(|c| f64::from(fit.value[3 * v + c])).sum();
        sum / (3.0 * typical)
    };
    let facing = |v: usize| {
        let normal = study.seen.sites[views[v].site as usize].point.normal;
        f64::from(normal.dot(study.seen.outgoing(&views[v])))
    };
    let open = |v: usize| {
        let row = study.horizon.row(&study.seen, &views[v]);
        row.map(|(_, weight, _)| f64::from(weight)).sum::<f64>() / std::f64::consts::PI
    };
    let (open_name, least_open) = match study.horizon.light() {
        Light::Environment => ("openness (1 on a convex shape)", 0.2),
        Light::Lamps => ("facing the lamp (n·l, 0 in its shadow)", 0.0),
    };
    let edges = shadow_edges::distances(study, fit, sites);
    let frames = study.seen.frames;
    let ruler = |name, bins, range, of: &dyn Fn(usize) -> f64| Ruler {
        name,
        bins,
        range,
        at: (0..views.len()).map(of).collect(),
    };
    vec![
        ruler("frame", frames, [-0.5, frames as f64 - 0.5], &|v| {
            f64::from(views[v].frame)
        }),
        ruler(
            "distance from the image's middle (1 in the corners)",
            10,
            [0.0, 0.8],
            &radius,
        ),
        ruler("across the image (0 left, 1 right)", 12, [0.0, 1.0], &|v| {
            f64::from(views[v].at[0]) / camera(v).width as f64
        }),
        ruler("down the image (0 top, 1 bottom)", 12, [0.0, 1.0], &|v| {
            f64::from(views[v].at[1]) / camera(v).height as f64
        }),
        ruler("level (of the middle one)", 12, [0.0, 3.0], &level),
        ruler("facing the camera (n·v)", 8, [0.3, 1.0], &facing),
        ruler(
            "facing half-way between camera and strongest light (n·h)",
            12,
            [0.4, 1.0],
            &|v| half_way(study, fit, v),
        ),
        ruler(open_name, 8, [least_open, 1.0], &open),
        ruler(
            "distance along the surface from edges of its own shadows (of its radius)",
            10,
            [0.0, 1.0],
            &|v| edges[v],
        ),
    ]
}

/// n·h, h half-way between the camera and the source that sends most light to a view's site past the object itself, its cosine
/// included; occluders of the model are not asked. The mean of many half vectors would face along the normal nearly everywhere,
/// wherever the light is. Not a number where no light arrives.
fn half_way(study: &Study<'_>, fit: &Fit, v: usize) -> f64 {
    let view = &study.seen.views[v];
    let light = |source: usize| fit.radiance[3 * source..3 * source + 3].iter().sum::<f32>();
    let sent = fit
        .horizon
        .row(&study.seen, view)
        .map(|(source, weight, incident)| (weight * light(source), incident));
    let strongest = sent.max_by(|a, b| a.0.total_cmp(&b.0));
    let normal = study.seen.sites[view.site as usize].point.normal;
    strongest.map_or(f64::NAN, |(_, incident)| {
        let half = (incident + study.seen.outgoing(view)).normalize_or_zero();
        f64::from(normal.dot(half))
    })
}

/// What is measured in a bin.
struct Bin {
    index: usize,
    mean: f64,
    error: f64,
    shared: f64,
    shared_error: f64,
    /// Probability of such a mean, and of so much shared, by chance.
    p: [f64; 2],
}

/// The bins of an axis that have enough views.
fn measured(
    study: &Study<'_>,
    null: &Fit,
    residual: &[f32],
    pairs: &[[u32; 2]],
    ruler: &Ruler,
) -> Vec<Bin> {
    // Σ w·v·r and Σ w·v² make a mean of relative residuals, values counting as they are known.
    let mut means = vec![Mean::new(study.blocks()); ruler.bins];
    let mut views = vec![0; ruler.bins];
    for v in (0..ruler.at.len()).filter(|&v| study.has_known_albedo(v)) {
        let Some(bin) = ruler.bin(ruler.at[v]) else {
            continue;
        };
        views[bin] += 1;
        for i in 3 * v..3 * v + 3 {
            let variance = f64::from(study.variance[i]) * null.inflation;
            let value = f64::from(null.value[i]);
            let (sum, weight) = (f64::from(residual[i]) * value, value * value);
            means[bin].add(study.block(v), sum / variance, weight / variance);
        }
    }
    let mut products = vec![Mean::new(study.blocks()); ruler.bins];
    let standard = |k: usize| f64::from(residual[k] / study.variance[k].sqrt());
    for pair in pairs {
        let [i, j] = pair.map(|v| v as usize);
        if let Some(bin) = ruler.bin(0.5 * (ruler.at[i] + ruler.at[j])) {
            // The mean over three colours: a third of a product's variance.
            products[bin].add(
                study.block(i),
                3.0 * neighbours::shared(*pair, &standard),
                3.0,
            );
        }
    }
    let kept = (0..ruler.bins).filter(|&bin| views[bin] >= LEAST_VIEWS);
    kept.map(|index| {
        let (mean, product) = (&means[index], &products[index]);
        Bin {
            index,
            mean: mean.value(),
            error: mean.by_noise(),
            shared: product.value(),
            shared_error: product.by_noise(),
            p: [
                mean.z().map_or(1.0, |z| 2.0 * normal_tail(z.abs())),
                product.z().map_or(1.0, normal_tail),
            ],
        }
    })
    .collect()
}

/// A weighted mean over blocks, within which errors are not independent.
#[derive(Clone)]
struct Mean {
    /// Sum and weight of each block.
    blocks: Vec<[f64; 2]>,
}

impl Mean {
    fn new(blocks: usize) -> Self {
        Self {
            blocks: vec![[0.0; 2]; blocks],
        }
    }

    fn add(&mut self, block: usize, sum: f64, weight: f64) {
        self.blocks[block][0] += sum;
        self.blocks[block][1] += weight;
    }

    fn weight(&self) -> f64 {
        self.blocks.iter().map(|block| block[1]).sum()
    }

    fn value(&self) -> f64 {
        let weight = self.weight();
        if weight > 0.0 {
            self.blocks.iter().map(|block| block[0]).sum::<f64>() / weight
        } else {
            0.0
        }
    }

    /// Its standard error where one unit of weight has a variance of one and all is independent; zero without any.
    fn by_noise(&self) -> f64 {
        let weight = self.weight();
        if weight > 0.0 {
            weight.sqrt().recip()
        } else {
            0.0
        }
    }

    /// The mean over its standard error: that of the noise, or from the scatter of blocks where this is larger. `None` where too few
    /// blocks say how they scatter.
    fn z(&self) -> Option<f64> {
        let (mean, weight) = (self.value(), self.weight());
        let used: Vec<&[f64; 2]> = self.blocks.iter().filter(|block| block[1] > 0.0).collect();
        let count = used.len() as f64;
        if used.len() < LEAST_BLOCKS || weight <= 0.0 {
            return None;
        }
        let squares: f64 = used.iter().map(|b| (b[0] - mean * b[1]).powi(2)).sum();
        let by_blocks = (squares * count / (count - 1.0)).sqrt() / weight;
        Some(mean / self.by_noise().max(by_blocks))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blocks of `each` values around `middle`, whole blocks off by ± `own` in turn.
    fn blocks(count: usize, each: usize, middle: f64, own: f64) -> Mean {
        let mut mean = Mean::new(count + 3);
        for block in 0..count {
            let sign = if block % 2 == 0 { 1.0 } else { -1.0 };
            for _ in 0..each {
                mean.add(block, 2.0 * (middle + sign * own), 2.0);
            }
        }
        mean
    }

    #[test]
    fn what_blocks_have_in_common_is_no_evidence() {
        let noise = blocks(10, 20, 0.3, 0.0);
        assert!((noise.value() - 0.3).abs() < 1e-12);
        assert!((noise.by_noise() - 0.05).abs() < 1e-12);
        assert!((noise.z().unwrap() - 6.0).abs() < 1e-9);
        // Ten blocks that differ by ± 1.5 have a mean known to half of one, however many values each holds.
        let scattered = blocks(10, 2000, 0.3, 1.5).z().unwrap();
        assert!((scattered - 0.3 / 0.5).abs() < 1e-6, "{scattered}");
        assert!(blocks(LEAST_BLOCKS - 1, 20, 0.3, 0.0).z().is_none());
        assert_eq!(Mean::new(4).value(), 0.0);
    }

    #[test]
    fn bins_hold_both_ends_and_nothing_beyond() {
        let ruler = Ruler {
            name: "",
            bins: 4,
            range: [-1.0, 1.0],
            at: Vec::new(),
        };
        let bins = [-1.0, -0.51, 0.0, 0.99, 1.0].map(|at| ruler.bin(at));
        assert_eq!(bins, [Some(0), Some(0), Some(2), Some(3), Some(3)]);
        for outside in [-1.01, 1.01, f64::NAN, f64::INFINITY] {
            assert_eq!(ruler.bin(outside), None);
        }
        assert_eq!(ruler.middle(3), 0.75);
    }

    #[test]
    fn one_axis_stands_out_among_many() {
        let bin = |p| Bin {
            index: 0,
            mean: 0.0,
            error: 1.0,
            shared: 0.0,
            shared_error: 1.0,
            p,
        };
        let quiet = || (0..9).map(|_| bin([0.5, 0.7])).collect::<Vec<_>>();
        let loud = vec![bin([1e-9, 0.5]), bin([0.004, 0.4]), bin([0.3, 1e-9])];
        let found = stands_out(&[quiet(), loud, quiet()]);
        assert_eq!(found.len(), 21);
        let names: Vec<usize> = (0..21).filter(|&k| found[k]).collect();
        assert_eq!(names, [9, 11]);
    }
}
