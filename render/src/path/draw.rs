//! Draws the samples of a run of points: block by block, strategy by strategy, then in the order of the points.

use super::block::{Block, Plan, STRATEGIES, WIDTH};
use super::quadrature::of_frame;
use super::run::Run;
use super::{Lookup, PathScene, PathSettings, ShadingPoint};
use crate::bsdf::{Model, lobe_samples};
use crate::sampler::{Counter, SampleKey, Stratified};

/// Samples of a group of points: enough to fill blocks, few enough to stay in the first cache levels.
const GROUP: usize = 512;

/// A batch in the making.
pub(super) struct Draw<'a> {
    plan: Plan<'a>,
    settings: PathSettings,
    /// Points of a group.
    group: usize,
    block: Box<Block>,
    /// Results of each strategy for a group, by point.
    drawn: [Drawn; 3],
    batch: Run,
}

/// Results of many samples, those that carry no light included.
#[derive(Default)]
struct Drawn {
    incident: Vec<f32>,
    half: Vec<f32>,
    difference: Vec<f32>,
    weight: Vec<f32>,
    light: Vec<u32>,
    mask: Vec<u32>,
    light_at: [Vec<f32>; 2],
    mask_at: [Vec<f32>; 2],
}

impl<'a> Draw<'a> {
    pub(super) fn new(scene: &'a PathScene<'a>, settings: &PathSettings) -> Self {
        let [cosine, normal] = lobe_samples(scene.model, settings.material_samples);
        let counts = [settings.light_samples, cosine, normal];
        let total: usize = counts.iter().sum();
        Self {
            plan: Plan {
                scene,
                lookup: settings.lookup,
                counts,
            },
            settings: *settings,
            group: GROUP.div_ceil(total.max(1)),
            block: Block::new(),
            drawn: Default::default(),
            batch: Run::empty(settings.lookup),
        }
    }

    /// Draws the samples of a run of points.
    pub(super) fn run(mut self, points: &[ShadingPoint]) -> Run {
        for group in points.chunks(self.group) {
            for strategy in 0..STRATEGIES.len() {
                self.draw(group, strategy);
            }
            self.merge(group);
        }
        self.batch
    }

    /// Draws a strategy's samples of a group of points.
    #[inline(always)]
    fn draw(&mut self, points: &[ShadingPoint], strategy: usize) {
        let each = self.plan.counts[strategy];
        let set = Stratified::new(each);
        self.drawn[strategy].clear();
        let mut filled = 0;
        for (owner, point) in points.iter().enumerate() {
            let key = key(point, &self.settings);
            let radius = self.plan.scene.radii[point.frame as usize];
            let mut first = 0;
            while first < each {
                let count = (each - first).min(WIDTH - filled);
                let lanes = filled..filled + count;
                self.block
                    .fill(lanes, owner, point, key, radius, &set, first);
                (first, filled) = (first + count, filled + count);
                if filled == WIDTH {
                    self.evaluate(points, strategy, filled);
                    filled = 0;
                }
            }
        }
        if filled > 0 {
            self.evaluate(points, strategy, filled);
        }
    }

    #[inline(always)]
    fn evaluate(&mut self, points: &[ShadingPoint], strategy: usize, filled: usize) {
        self.block.evaluate(&self.plan, points, strategy, filled);
        self.drawn[strategy].append(&self.block, filled, self.plan.lookup);
    }

    /// Appends the samples that carry light, a point after the other.
    #[inline(always)]
    fn merge(&mut self, points: &[ShadingPoint]) {
        let microfacet = self.plan.scene.model == Model::Microfacet;
        for (p, point) in points.iter().enumerate() {
            for (drawn, each) in self.drawn.iter().zip(self.plan.counts) {
                let lanes = p * each..(p + 1) * each;
                drawn.emit(lanes, &self.plan, point.frame, microfacet, &mut self.batch);
            }
            let outgoing = point.surface.normal.dot(point.outgoing);
            self.batch.outgoing.push(outgoing);
            self.batch.offsets.push(self.batch.weight.len() as u32);
        }
    }
}

impl Drawn {
    fn clear(&mut self) {
        let [u, v] = &mut self.light_at;
        let [s, t] = &mut self.mask_at;
        let reals = [
            &mut self.incident,
            &mut self.half,
            &mut self.difference,
            &mut self.weight,
        ];
        reals.into_iter().chain([u, v, s, t]).for_each(Vec::clear);
        self.light.clear();
        self.mask.clear();
    }

    fn append(&mut self, block: &Block, filled: usize, lookup: Lookup) {
        self.incident.extend_from_slice(&block.incident[..filled]);
        self.half.extend_from_slice(&block.half[..filled]);
        self.difference
            .extend_from_slice(&block.difference[..filled]);
        self.weight.extend_from_slice(&block.weight[..filled]);
        match lookup {
            Lookup::Stochastic => {
                self.light.extend_from_slice(&block.light[..filled]);
                self.mask.extend_from_slice(&block.mask[..filled]);
            }
            Lookup::Bilinear => {
                for k in 0..2 {
                    self.light_at[k].extend_from_slice(&block.light_at[k][..filled]);
                    self.mask_at[k].extend_from_slice(&block.mask_at[k][..filled]);
                }
            }
        }
    }

    /// Appends those of the samples `lanes` that carry light.
    #[inline(always)]
    fn emit(
        &self,
        lanes: std::ops::Range<usize>,
        plan: &Plan,
        frame: u32,
        microfacet: bool,
        batch: &mut Run,
    ) {
        let weight = &self.weight[lanes.clone()];
        let keep =
            |values: &[f32], into: &mut Vec<f32>| compact(weight, &values[lanes.clone()], into);
        keep(&self.incident, &mut batch.incident);
        if microfacet {
            keep(&self.half, &mut batch.half);
            keep(&self.difference, &mut batch.difference);
        }
        match plan.lookup {
            Lookup::Stochastic => {
                compact(
                    weight,
                    &self.light[lanes.clone()],
                    &mut batch.light.index[0],
                );
                compact(weight, &self.mask[lanes.clone()], &mut batch.mask.index[0]);
            }
            Lookup::Bilinear => {
                let at = |grid: crate::lat_long::LatLong, [u, v]: &[Vec<f32>; 2], i: usize| {
                    grid.bilinear_at(u[i], v[i])
                };
                for i in lanes.clone().filter(|&i| self.weight[i] > 0.0) {
                    let light = at(plan.scene.environment_grid, &self.light_at, i);
                    let mask = at(plan.scene.mask_grid, &self.mask_at, i);
                    batch.light.push(&light);
                    batch.mask.push(&of_frame(&mask, plan.scene, frame));
                }
            }
        }
        keep(&self.weight, &mut batch.weight);
    }
}

/// Appends the values of nonzero weight, without a branch.
#[inline(always)]
fn compact<T: Copy + Default>(weight: &[f32], values: &[T], into: &mut Vec<T>) {
    let mut kept = [T::default(); WIDTH];
    for (values, weight) in values.chunks(WIDTH).zip(weight.chunks(WIDTH)) {
        let mut count = 0;
        for (value, weight) in values.iter().zip(weight) {
            kept[count % WIDTH] = *value;
            count += usize::from(*weight > 0.0);
        }
        into.extend_from_slice(&kept[..count]);
    }
}

/// The random numbers of a point.
fn key(point: &ShadingPoint, settings: &PathSettings) -> Counter {
    SampleKey {
        seed: settings.seed,
        frame: point.frame,
        pixel: point.pixel,
        sample: settings.iteration,
        dimension: settings.render,
    }
    .counter()
}
