//! The physics a simulation may have left out: one file an effect, one trait, one list.

pub mod camera_map;
pub mod support;

mod ambient_light;
mod black_level;
mod capacity;
mod clipping;
mod defocus;
mod emission;
mod exposure_drift;
mod ground_bounce;
mod image_pattern;
mod image_warp;
mod interreflection;
mod lamp_direction;
mod medium;
mod moving_light;
mod moving_occluder;
mod near_field_light;
mod normal_error;
mod occluder_bounce;
mod pose_error;
mod response_curve;
mod specular_lobe;
mod surface_change;
mod translucency;
mod veiling_glare;
mod view_dependence;
mod vignetting;

use autodiff::{Detached, Var};
use glam::Vec3;

use camera_map::CameraMap;

use super::{
    horizon::{Horizon, Source},
    light::Light,
    observe::Observations,
    scene::Scene,
};
use crate::capture::Capture;

/// The share of light that reaches a view from a texel.
pub type Passing = Box<dyn Fn(usize, usize) -> f32 + Sync>;
/// The share of light that passes in a frame from a direction, on a shell around the scene that is seen from its middle.
pub type Mask = Box<dyn Fn(usize, Vec3) -> f32 + Sync>;

/// Where in the forward model an effect acts, in the order light meets these places.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// Light on its way to the object.
    IncidentLight,
    /// Light within the scene.
    Transport,
    /// Reflection.
    Material,
    /// Between the surface and the lens.
    Medium,
    /// Where and how sharply the lens forms the image.
    Optics,
    /// Light scattered by the lens.
    Glare,
    /// Light lost towards the image's corners.
    Falloff,
    /// Exposure and white balance.
    Exposure,
    /// Offsets of the sensor.
    Offset,
    /// The relation of values to light.
    Response,
    /// The upper end of the sensor's range.
    Saturation,
}

/// One number of an effect, with the change of the photographs it stands for.
pub struct Term {
    /// What it is, with its unit.
    pub name: String,
    /// Standard deviation that is expected of it before data are seen: how strong the effect usually is.
    pub scale: f64,
    /// Its lower bound: 0 for what cannot be negative, else −∞.
    pub least: f64,
    /// Its upper bound, mostly ∞.
    pub most: f64,
    /// `[observation][colour]`; what it means is the effect's own affair, see [`Effect::record`].
    pub field: Vec<f32>,
    /// The frame it belongs to, if it is a frame's own.
    pub frame: Option<u32>,
}

impl Term {
    /// A number that may have either sign and belongs to all frames.
    pub fn new(name: impl Into<String>, scale: f64, field: Vec<f32>) -> Self {
        Self {
            name: name.into(),
            scale,
            least: f64::NEG_INFINITY,
            most: f64::INFINITY,
            field,
            frame: None,
        }
    }

    /// The same, never negative.
    pub fn positive(self) -> Self {
        Self { least: 0.0, ..self }
    }

    /// The same, never above `most`.
    pub fn at_most(self, most: f64) -> Self {
        Self { most, ..self }
    }

    /// The same, of one frame.
    pub fn of(self, frame: u32) -> Self {
        Self {
            frame: Some(frame),
            ..self
        }
    }
}

/// A term on the tape.
pub struct Recorded {
    /// Its number.
    pub beta: Var,
    /// Its field.
    pub field: Detached,
}

/// A piece of physics that the baseline leaves out. At its null value, all numbers zero, it changes no bit of the model.
pub trait Effect: Sync {
    /// Its name in reports and on the command line.
    fn id(&self) -> &'static str;
    /// What it is, for people.
    fn describe(&self) -> &'static str;
    /// Where it acts.
    fn stage(&self) -> Stage;
    /// The least relative change of the object's image (RMS) that is worth telling.
    fn interest(&self) -> f64 {
        0.003
    }
    /// What it is mistaken for most easily.
    fn confused_with(&self) -> &'static [&'static str];
    /// What further photograph, or what care in taking them, shows whether it is there, whatever it is mistaken for; nothing for stand-ins
    /// that have no name of their own.
    fn shown_by(&self) -> &'static str {
        ""
    }
    /// Whether it is no physics but more freedom for what the model has already.
    fn is_capacity(&self) -> bool {
        self.stands_for_unknown()
    }
    /// For capacity: whether it stands for physics that has no name here, rather than for a model that is too coarse. Where it does
    /// best, no name is right.
    fn stands_for_unknown(&self) -> bool {
        false
    }
    /// Whether it can be told under such light: physics of lens and sensor under any, since it acts on light however that came; all
    /// else where the environment is fitted, unless the effect says otherwise.
    fn under(&self, light: Light) -> bool {
        let of_lens_or_sensor = self.stage() >= Stage::Glare && !self.is_capacity();
        light == Light::Environment || of_lens_or_sensor
    }
    /// Its numbers and fields for the model as it stands; empty where it makes no sense.
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term>;
    /// For effects that let a share of light pass to each view from each texel: those shares at `beta`.
    ///
    /// They are multiplied into the light transport; [`record`](Self::record) then acts on what differs from `beta`.
    fn passing(&self, _horizon: &Horizon, _seen: &Observations, _beta: &[f64]) -> Option<Passing> {
        None
    }
    /// For effects that block light: what of it they let pass at `beta`, as somebody in the middle would see it; `None` where that is
    /// everything.
    fn mask(&self, _seen: &Observations, _beta: &[f64]) -> Option<Mask> {
        None
    }
    /// For effects that move known lamps: where `beta` puts them.
    ///
    /// They light the model from there; [`record`](Self::record) then acts on what differs from `beta`.
    fn moved_lamps(
        &self,
        _lamps: &[Source],
        _seen: &Observations,
        _beta: &[f64],
    ) -> Option<Vec<Source>> {
        None
    }
    /// All that [`camera_map`](Self::camera_map) needs: its numbers, and what its fields say that is the same everywhere.
    fn camera_numbers(&self, _terms: &[Term], beta: &[f64]) -> Vec<f64> {
        beta.to_vec()
    }
    /// For effects of the camera that can be taken back: what it does to whole photographs, given its
    /// [`camera_numbers`](Self::camera_numbers); `None` for all others, and for numbers that are not its own.
    fn camera_map(&self, _capture: &Capture, _numbers: &[f64]) -> Option<CameraMap> {
        None
    }
    /// Whether [`camera_map`](Self::camera_map) is there.
    fn is_of_the_camera(&self) -> bool {
        false
    }
    /// Whether [`record`](Self::record) uses its numbers as [`weighted`] sum only, so that one derivative serves all of them.
    fn is_of_one_sum(&self) -> bool {
        true
    }
    /// Its place in the forward model: from the values that reach it to those that leave it.
    fn record(&self, value: &Var, terms: &[Recorded]) -> Var {
        match weighted(terms) {
            Some(sum) => value + sum,
            None => value.clone(),
        }
    }
}

/// Σ β · field.
pub fn weighted(terms: &[Recorded]) -> Option<Var> {
    let mut parts = terms.iter().map(|t| &t.beta * &t.field);
    let first = parts.next()?;
    Some(parts.fold(first, |sum, part| sum + part))
}

/// All effects. The order is that of reports; it decides nothing.
pub fn all() -> Vec<&'static dyn Effect> {
    vec![
        &moving_occluder::MovingOccluder,
        &occluder_bounce::OccluderBounce,
        &exposure_drift::ExposureDrift,
        &response_curve::ResponseCurve,
        &vignetting::Vignetting,
        &black_level::BlackLevel,
        &veiling_glare::VeilingGlare,
        &clipping::Clipping,
        &interreflection::Interreflection,
        &ground_bounce::GroundBounce,
        &near_field_light::NearFieldLight,
        &lamp_direction::LampDirection,
        &ambient_light::AmbientLight,
        &moving_light::MovingLight,
        &emission::Emission,
        &specular_lobe::SpecularLobe,
        &translucency::Translucency,
        &pose_error::PoseError,
        &defocus::Defocus,
        &normal_error::NormalError,
        &medium::Medium,
        &capacity::FinerAlbedo,
        &capacity::FinerEnvironment,
        &capacity::FinerOccluders,
        &capacity::FinerLamps,
        &image_pattern::ImagePattern,
        &image_warp::ImageWarp,
        &surface_change::SurfaceChange,
        &view_dependence::ViewDependence,
    ]
}

/// The effect of this name.
pub fn by_id(id: &str) -> Option<&'static dyn Effect> {
    all().into_iter().find(|effect| effect.id() == id)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is looked for under known lamps decides what can be named there: an effect that changes its stage must not slip in or out.
    #[test]
    fn what_each_light_lets_tell() {
        let told = |light| -> Vec<&str> {
            let under = all().into_iter().filter(|effect| effect.under(light));
            under.map(|effect| effect.id()).collect()
        };
        assert_eq!(
            told(Light::Lamps),
            [
                "exposure_drift",
                "response_curve",
                "vignetting",
                "black_level",
                "veiling_glare",
                "clipping",
                "near_field_light",
                "lamp_direction",
                "ambient_light",
                "emission",
                "specular_lobe",
                "pose_error",
                "normal_error",
                "finer_albedo",
                "finer_lamps",
            ]
        );
        let lamps_alone = ["lamp_direction", "ambient_light", "finer_lamps"];
        let expected: Vec<&str> = all()
            .iter()
            .map(|effect| effect.id())
            .filter(|id| !lamps_alone.contains(id))
            .collect();
        assert_eq!(told(Light::Environment), expected);
    }
}
