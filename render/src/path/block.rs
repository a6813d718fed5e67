//! Samples of one strategy, evaluated together: a value an array, so that every step but table lookups becomes SIMD.

use glam::Vec3;
use pulp::{Arch, Simd, WithSimd};

use super::{Lookup, PathScene, ShadingPoint};
use crate::bsdf::{Lobe, MaterialSampler, Model};
use crate::bvh::{Rays, offset_origin};
use crate::environment::Cell;
use crate::lat_long::LatLong;
use crate::occluder::shell_place;
use crate::sampler::{Counter, Stratified, unit, unit_pair};
use crate::visibility::Visibility;
use crate::warp;

/// Samples of a block: all arrays together stay in the first-level cache.
pub(super) const WIDTH: usize = 128;

type Lanes = [f32; WIDTH];
type Words = [u32; WIDTH];

/// How directions are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Strategy {
    /// In proportion to the light.
    Light,
    /// From a lobe of the material.
    Material(Lobe),
}

/// All strategies, in the order of a point's samples.
pub(super) const STRATEGIES: [Strategy; 3] = [
    Strategy::Light,
    Strategy::Material(Lobe::Cosine),
    Strategy::Material(Lobe::VisibleNormal),
];

/// What all samples of a batch have in common.
#[derive(Clone, Copy)]
pub(super) struct Plan<'a> {
    pub(super) scene: &'a PathScene<'a>,
    pub(super) lookup: Lookup,
    /// Samples a point of each of [`STRATEGIES`].
    pub(super) counts: [usize; 3],
}

/// Inputs, intermediate values and results of up to [`WIDTH`] samples.
pub(super) struct Block {
    normal: [Lanes; 3],
    outgoing: [Lanes; 3],
    position: [Lanes; 3],
    /// Squared radius of the shell, less the squared distance of the point from its centre.
    reach: Lanes,
    alpha: Lanes,
    key: [Words; 2],
    frame: Words,
    cached: Words,
    /// The point's number in its group.
    owner: Words,
    /// The sample's number among its point's.
    index: Words,
    /// Column and row of the stratum.
    stratum: [Lanes; 2],

    place: [Lanes; 2],
    choice: [Words; 2],
    row: Words,
    column: Words,
    direction: [Lanes; 3],
    part: Words,
    mass: Lanes,

    /// Grid coordinates of the direction, and of the place where it leaves the shell.
    pub(super) light_at: [Lanes; 2],
    pub(super) mask_at: [Lanes; 2],
    /// The texels chosen for a stochastic lookup; the mask's with its frame.
    pub(super) light: Words,
    pub(super) mask: Words,
    pub(super) incident: Lanes,
    pub(super) half: Lanes,
    pub(super) difference: Lanes,
    /// Zero for samples that carry no light.
    pub(super) weight: Lanes,
}

impl Block {
    pub(super) fn new() -> Box<Self> {
        const REALS: Lanes = [0.0; WIDTH];
        const WORDS: Words = [0; WIDTH];
        Box::new(Self {
            normal: [REALS; 3],
            outgoing: [REALS; 3],
            position: [REALS; 3],
            reach: REALS,
            alpha: REALS,
            key: [WORDS; 2],
            frame: WORDS,
            cached: WORDS,
            owner: WORDS,
            index: WORDS,
            stratum: [REALS; 2],
            place: [REALS; 2],
            choice: [WORDS; 2],
            row: WORDS,
            column: WORDS,
            direction: [REALS; 3],
            part: WORDS,
            mass: REALS,
            light_at: [REALS; 2],
            mask_at: [REALS; 2],
            light: WORDS,
            mask: WORDS,
            incident: REALS,
            half: REALS,
            difference: REALS,
            weight: REALS,
        })
    }

    /// Puts samples `first..` of a point into `lanes`.
    pub(super) fn fill(
        &mut self,
        lanes: std::ops::Range<usize>,
        owner: usize,
        point: &ShadingPoint,
        key: Counter,
        radius: f32,
        set: &Stratified,
        first: usize,
    ) {
        let put = |into: &mut [Lanes; 3], v: Vec3| {
            for (axis, value) in into.iter_mut().zip(v.to_array()) {
                axis[lanes.clone()].fill(value);
            }
        };
        put(&mut self.normal, point.surface.normal);
        put(&mut self.outgoing, point.outgoing);
        put(&mut self.position, point.surface.position);
        self.reach[lanes.clone()].fill(radius * radius - point.surface.position.length_squared());
        self.alpha[lanes.clone()].fill(point.alpha);
        for (word, key) in self.key.iter_mut().zip(key.0) {
            word[lanes.clone()].fill(key);
        }
        self.frame[lanes.clone()].fill(point.frame);
        self.cached[lanes.clone()].fill(point.cached);
        self.owner[lanes.clone()].fill(owner as u32);
        for (i, lane) in (first..).zip(lanes) {
            self.index[lane] = i as u32;
            let [column, row] = set.cell(i);
            self.stratum[0][lane] = column;
            self.stratum[1][lane] = row;
        }
    }

    /// Draws the first `filled` samples, those of `points`.
    pub(super) fn evaluate(
        &mut self,
        plan: &Plan,
        points: &[ShadingPoint],
        strategy: usize,
        filled: usize,
    ) {
        Arch::new().dispatch(Evaluate {
            block: self,
            plan,
            points,
            strategy,
            filled,
        });
    }

    #[inline(always)]
    fn steps(&mut self, plan: &Plan, points: &[ShadingPoint], strategy: usize, filled: usize) {
        self.numbers(strategy as u32, Stratified::new(plan.counts[strategy]));
        let strategy = STRATEGIES[strategy];
        match strategy {
            Strategy::Light => self.draw_light(plan, filled),
            Strategy::Material(lobe) => self.draw_material(plan, lobe),
        }
        self.cosines();
        self.weigh(plan, strategy, filled);
        self.drop_hidden(plan, points, filled);
        self.masks(plan);
    }

    #[inline(always)]
    fn numbers(&mut self, sequence: u32, set: Stratified) {
        for i in 0..WIDTH {
            let key = Counter([self.key[0][i], self.key[1][i]]);
            let [a, b, light, mask] = key.words(sequence, self.index[i]);
            let stratum = [self.stratum[0][i], self.stratum[1][i]];
            let [x, y] = set.point_in(stratum, [unit(a), unit(b)]);
            self.place[0][i] = x;
            self.place[1][i] = y;
            self.choice[0][i] = light;
            self.choice[1][i] = mask;
        }
    }

    #[inline(always)]
    fn draw_light(&mut self, plan: &Plan, filled: usize) {
        let lights = plan.scene.lights;
        for i in 0..filled {
            let cell = lights.cell([self.place[0][i], self.place[1][i]]);
            self.row[i] = cell.row;
            self.column[i] = cell.column;
            [self.place[0][i], self.place[1][i]] = cell.place;
        }
        let columns = plan.scene.environment_grid.columns as u32;
        for i in 0..WIDTH {
            let (row, column) = (self.row[i], self.column[i]);
            let [u, v] = lights.coordinates(Cell {
                row,
                column,
                place: [self.place[0][i], self.place[1][i]],
            });
            self.light_at[0][i] = u;
            self.light_at[1][i] = v;
            put(&mut self.direction, i, LatLong::direction(u, v));
            self.light[i] = row * columns + column;
        }
    }

    #[inline(always)]
    fn draw_material(&mut self, plan: &Plan, lobe: Lobe) {
        let grid = plan.scene.environment_grid;
        for i in 0..WIDTH {
            let (normal, outgoing) = (take(&self.normal, i), take(&self.outgoing, i));
            let sampler = MaterialSampler::new(0.5, self.alpha[i], normal, outgoing);
            let direction = sampler.sample(lobe, [self.place[0][i], self.place[1][i]]);
            put(&mut self.direction, i, direction);
            let [u, v] = LatLong::coordinates(direction);
            self.light_at[0][i] = u;
            self.light_at[1][i] = v;
            self.light[i] = grid.stochastic_at(u, v, unit_pair(self.choice[0][i]));
        }
    }

    #[inline(always)]
    fn cosines(&mut self) {
        for i in 0..WIDTH {
            let (normal, outgoing) = (take(&self.normal, i), take(&self.outgoing, i));
            let direction = take(&self.direction, i);
            let half = warp::unit(direction + outgoing);
            self.incident[i] = normal.dot(direction);
            self.half[i] = normal.dot(half);
            self.difference[i] = half.dot(direction);
        }
    }

    /// The power heuristic's weight (exponent 2) over the strategy's count and density, for samples above the horizon.
    #[inline(always)]
    fn weigh(&mut self, plan: &Plan, strategy: Strategy, filled: usize) {
        let PathScene {
            lights,
            environment_grid,
            ..
        } = plan.scene;
        let mass = lights.mass();
        for i in 0..filled {
            self.mass[i] = match plan.lookup {
                Lookup::Stochastic => mass[self.light[i] as usize],
                Lookup::Bilinear => {
                    let [u, v] = [self.light_at[0][i], self.light_at[1][i]];
                    environment_grid.bilinear_at(u, v).gather(mass)
                }
            };
        }
        let [from_light, from_cosine, from_normal] = plan.counts.map(|n| n as f32);
        let microfacet = plan.scene.model == Model::Microfacet;
        for i in 0..WIDTH {
            let (incident, direction) = (self.incident[i], take(&self.direction, i));
            let view = take(&self.normal, i).dot(take(&self.outgoing, i));
            let light = from_light * self.mass[i] * lights.per_solid_angle(direction);
            let mut material = from_cosine * std::f32::consts::FRAC_1_PI * incident;
            if microfacet {
                material +=
                    from_normal * warp::ggx_visible_density(self.half[i], view, self.alpha[i]);
            }
            let own = if strategy == Strategy::Light {
                light
            } else {
                material
            };
            let weight = own / (light * light + material * material);
            let carries = (incident > 0.0) & (!microfacet | (view > 0.0)) & (own > 0.0);
            self.weight[i] = if carries { weight } else { 0.0 };
        }
    }

    #[inline(always)]
    fn drop_hidden(&mut self, plan: &Plan, points: &[ShadingPoint], filled: usize) {
        let PathScene {
            bvh, visibility, ..
        } = plan.scene;
        match visibility {
            Visibility::Cached(cache) => {
                let fine = cache.fine();
                for i in 0..WIDTH {
                    self.part[i] = fine.texel_at(self.light_at[0][i], self.light_at[1][i]) as u32;
                }
                for i in 0..filled {
                    let seen = cache.bit(self.cached[i] as usize, self.part[i] as usize);
                    self.weight[i] = if seen { self.weight[i] } else { 0.0 };
                }
            }
            Visibility::Rays => {
                let mut open = [false; WIDTH];
                for i in 0..filled {
                    let surface = &points[self.owner[i] as usize].surface;
                    let above = surface.geometric_normal.dot(take(&self.direction, i)) > 0.0;
                    open[i] = above & (self.weight[i] > 0.0);
                }
                let owners = self.owner[..filled].chunk_by(|a, b| a == b);
                let mut first = 0;
                for run in owners {
                    let lanes = first..first + run.len();
                    first = lanes.end;
                    let rays = Rays {
                        direction: [0, 1, 2].map(|axis| &self.direction[axis][lanes.clone()]),
                        open: &mut open[lanes],
                    };
                    bvh.close_blocked(offset_origin(&points[run[0] as usize].surface), rays);
                }
                for (weight, open) in self.weight.iter_mut().zip(open) {
                    *weight = if open { *weight } else { 0.0 };
                }
            }
        }
    }

    /// Where each sample leaves its frame's shell (Eq. 5).
    #[inline(always)]
    fn masks(&mut self, plan: &Plan) {
        let grid = plan.scene.mask_grid;
        let frames = plan.scene.radii.len() as u32;
        for i in 0..WIDTH {
            let (position, direction) = (take(&self.position, i), take(&self.direction, i));
            let [u, v] = LatLong::coordinates(shell_place(position, direction, self.reach[i]));
            self.mask_at[0][i] = u;
            self.mask_at[1][i] = v;
            let texel = grid.stochastic_at(u, v, unit_pair(self.choice[1][i]));
            self.mask[i] = texel * frames + self.frame[i];
        }
    }
}

/// [`Block::steps`], compiled for the widest SIMD that the machine has.
struct Evaluate<'a, 'b> {
    block: &'a mut Block,
    plan: &'a Plan<'b>,
    points: &'a [ShadingPoint],
    strategy: usize,
    filled: usize,
}

impl WithSimd for Evaluate<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.block
            .steps(self.plan, self.points, self.strategy, self.filled);
    }
}

#[inline(always)]
fn take(from: &[Lanes; 3], i: usize) -> Vec3 {
    Vec3::new(from[0][i], from[1][i], from[2][i])
}

#[inline(always)]
fn put(into: &mut [Lanes; 3], i: usize, v: Vec3) {
    into[0][i] = v.x;
    into[1][i] = v.y;
    into[2][i] = v.z;
}
