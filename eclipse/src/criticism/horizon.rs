//! Where light comes from, and how much of it every site receives: texels of a grid far away, or known lamps.

use std::f32::consts::PI;

use glam::Vec3;
use rayon::prelude::*;
use render::{
    bvh::{Bvh, SurfacePoint, offset_origin},
    lat_long::LatLong,
    transport::{Quadrature, TransportRow},
};

use super::{
    light::Light,
    observe::{Observations, View},
};
use crate::capture::{Lamp, Lamps};

/// What the sites may receive of every source.
pub struct Horizon {
    /// The sources.
    pub sources: Sources,
    /// Directions towards them from afar.
    pub directions: Vec<Vec3>,
    /// Visibility × cosine × solid angle of each site; of a lamp, visibility × cosine × π, so that its radiance is what a white
    /// surface reflects that faces it.
    pub rows: Vec<TransportRow>,
}

/// What light comes from.
#[derive(Clone, Debug, PartialEq)]
pub enum Sources {
    /// Every texel of a grid around the scene, in all frames.
    Grid(LatLong),
    /// One lamp a frame.
    Lamps(Vec<Source>),
}

/// A lamp, far or near.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Source {
    /// Unit vector towards it from the object's middle.
    pub direction: Vec3,
    /// One over its distance, in the capture's unit; 0 for a lamp at infinity.
    pub nearness: f32,
}

impl From<&Lamp> for Source {
    fn from(lamp: &Lamp) -> Self {
        Self {
            direction: lamp.direction,
            nearness: 0.0,
        }
    }
}

impl Source {
    /// Unit vector towards it from a place, and its light there relative to the middle.
    pub fn seen_from(&self, point: Vec3) -> (Vec3, f32) {
        let to = self.direction - self.nearness * point;
        let squared = to.length_squared().max(1e-12);
        (to / squared.sqrt(), 1.0 / squared)
    }
}

impl Horizon {
    /// Of these sites, by quadrature over `grid`.
    pub fn of_grid(bvh: &Bvh, grid: LatLong, sites: &[SurfacePoint]) -> Self {
        // Shadow edges are as fine on a coarse grid of light: more rays a texel.
        let side = (100 / grid.rows.max(1)).clamp(2, 4);
        let quadrature = Quadrature::new(grid, side);
        Self {
            sources: Sources::Grid(grid),
            directions: (0..grid.len())
                .map(|d| grid.texel_direction(d / grid.columns, d % grid.columns))
                .collect(),
            rows: quadrature.rows(bvh, sites),
        }
    }

    /// Of these sites under `lamps` as they are given.
    pub fn of_lamps(bvh: &Bvh, lamps: &Lamps, sites: &[SurfacePoint]) -> Self {
        let sources: Vec<Source> = lamps.lamps.iter().map(Source::from).collect();
        Self::of_sources(bvh, lamps.ball, sources, sites)
    }

    /// Of these sites under these lamps; on a `ball` nothing but its own horizon hides one.
    pub fn of_sources(bvh: &Bvh, ball: bool, sources: Vec<Source>, sites: &[SurfacePoint]) -> Self {
        let rows = sites
            .par_iter()
            .map(|site| {
                let mut row = TransportRow::default();
                for (k, source) in sources.iter().enumerate() {
                    let light = arriving(bvh, ball, source, site);
                    if light > 0.0 {
                        row.texel.push(k as u16);
                        row.weight.push(PI * light);
                    }
                }
                row
            })
            .collect();
        Self {
            directions: sources.iter().map(|s| s.direction).collect(),
            sources: Sources::Lamps(sources),
            rows,
        }
    }

    /// What is known of the light.
    pub fn light(&self) -> Light {
        match self.sources {
            Sources::Grid(_) => Light::Environment,
            Sources::Lamps(_) => Light::Lamps,
        }
    }

    /// The grid of light, where no lamps are known.
    pub fn grid(&self) -> Option<LatLong> {
        match self.sources {
            Sources::Grid(grid) => Some(grid),
            Sources::Lamps(_) => None,
        }
    }

    /// The lamps, where they are known.
    pub fn lamps(&self) -> Option<&[Source]> {
        match &self.sources {
            Sources::Grid(_) => None,
            Sources::Lamps(lamps) => Some(lamps),
        }
    }

    /// What lights a view: source, weight, and the unit direction it comes from.
    pub fn row(
        &self,
        seen: &Observations,
        view: &View,
    ) -> impl Iterator<Item = (usize, f32, Vec3)> {
        let site = view.site as usize;
        let row = &self.rows[site];
        let point = seen.sites[site].point.position;
        let own = self.lamps().map(|lamps| {
            let frame = view.frame as usize;
            (frame, lamps[frame].seen_from(point).0)
        });
        let entries = row.texel.iter().zip(&row.weight);
        entries.filter_map(move |(&source, &weight)| {
            let source = usize::from(source);
            match own {
                None => Some((source, weight, self.directions[source])),
                Some((frame, incident)) => (frame == source).then_some((source, weight, incident)),
            }
        })
    }
}

/// The light of a lamp of one that arrives at a site: visibility × cosine × fall-off.
pub fn arriving(bvh: &Bvh, ball: bool, source: &Source, site: &SurfacePoint) -> f32 {
    let (incident, light) = source.seen_from(site.position);
    let cosine = site.normal.dot(incident);
    if cosine <= 0.0 {
        return 0.0;
    }
    let clear = ball
        || (site.geometric_normal.dot(incident) > 0.0
            && !bvh.blocked(offset_origin(site), incident));
    if clear { cosine * light } else { 0.0 }
}
