//! What an effect may look at to say how it would change the photographs: the capture, and the model as it stands.

use glam::Vec3;
use render::{bvh::Bvh, image::Image};

use super::{
    fit::Active,
    horizon::Horizon,
    observe::Observations,
    transport::{Lobe, Transport},
};
use crate::capture::Capture;

/// The fitted model with everything an effect's fields are made from. Values are `[observation][colour]`, flat.
pub struct Scene<'a> {
    /// The photographs and the shape.
    pub capture: &'a Capture,
    /// The shape, for rays.
    pub bvh: &'a Bvh,
    /// What is looked at.
    pub seen: &'a Observations,
    /// What every site may receive of the light's sources.
    pub horizon: &'a Horizon,
    /// Light transport to every view.
    pub transport: &'a Transport,
    /// The same as if no occluder were in the model.
    pub bare: &'a Transport,
    /// Specular reflection; `None` for Lambertian surfaces.
    pub lobe: Option<Lobe>,
    /// Radiance, `[source][colour]`.
    pub radiance: &'a [f32],
    /// Albedo of every site, `[site][colour]`.
    pub albedo: &'a [f32],
    /// What an albedo of one would reflect into each view.
    pub diffuse: &'a [f32],
    /// What the lobe reflects into each view.
    pub specular: &'a [f32],
    /// Values of all observations, the background's zeros included, before any effect.
    pub value: &'a [f32],
    /// Renders of whole frames, zero off the object.
    pub renders: &'a [Image],
    /// Radius of the object's bounding sphere.
    pub radius: f32,
    /// Effects in the model.
    pub active: &'a [Active],
}

impl Scene<'_> {
    /// The numbers of an effect in the model; none where it is not in there.
    pub fn numbers(&self, id: &str) -> &[f64] {
        let own = self.active.iter().find(|active| active.effect.id() == id);
        own.map_or(&[], |active| &active.beta)
    }

    /// Numbers in a field: three an observation.
    pub fn size(&self) -> usize {
        3 * self.seen.len()
    }

    /// A field from a function of the view of the surface (index) that is zero on the background.
    pub fn on_views(&self, of: impl Fn(usize) -> [f32; 3] + Sync) -> Vec<f32> {
        use rayon::prelude::*;
        let mut field = vec![0.0; self.size()];
        field[..3 * self.seen.views.len()]
            .par_chunks_exact_mut(3)
            .enumerate()
            .for_each(|(v, out)| out.copy_from_slice(&of(v)));
        field
    }

    /// A field from a function of any observation.
    pub fn everywhere(&self, of: impl Fn(usize) -> [f32; 3]) -> Vec<f32> {
        (0..self.seen.len()).flat_map(of).collect()
    }

    /// What light `radiance` (`[texel][colour]`) from afar reflects into every view.
    pub fn lit_by(&self, radiance: &[f32]) -> Vec<f32> {
        self.on_views(|v| {
            let albedo = self.albedo_of(v);
            let mut sum = [0.0; 3];
            for (texel, [diffuse, specular]) in self.transport.row(v) {
                for c in 0..3 {
                    sum[c] += (albedo[c] * diffuse + specular) * radiance[3 * texel + c];
                }
            }
            sum
        })
    }

    /// The albedo of a view's site.
    pub fn albedo_of(&self, view: usize) -> [f32; 3] {
        let site = self.seen.views[view].site as usize;
        [0, 1, 2].map(|c| self.albedo[3 * site + c])
    }

    /// The value of a view.
    pub fn value_of(&self, view: usize) -> [f32; 3] {
        [0, 1, 2].map(|c| self.value[3 * view + c])
    }

    /// The middle of all values of the object.
    pub fn typical(&self) -> f32 {
        let mut values: Vec<f32> = self.value[..3 * self.seen.views.len()].to_vec();
        values.sort_unstable_by(f32::total_cmp);
        values.get(values.len() / 2).map_or(1.0, |v| v.max(1e-6))
    }

    /// The unit direction from a view's site to its camera.
    pub fn outgoing(&self, view: usize) -> Vec3 {
        self.seen.outgoing(&self.seen.views[view])
    }

    /// Time of a frame, from −1 for the first to 1 for the last.
    pub fn time(&self, frame: u32) -> f32 {
        if self.seen.frames < 2 {
            return 0.0;
        }
        2.0 * frame as f32 / (self.seen.frames - 1) as f32 - 1.0
    }
}
