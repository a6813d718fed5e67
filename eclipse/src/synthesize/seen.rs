//! What cameras see of an object, kept between captures of it under other light.

use glam::Vec3;
use render::{mesh::Mesh, reference::Looks};

use super::Shooting;

/// What the cameras of one [`Shooting`] see of one object, as far as it was looked at. It takes about 250 bytes a place on the object, of
/// which each pixel has sixteen: 170 MB for 48 photographs of 48 x 48 pixels.
#[derive(Clone, Debug, Default)]
pub struct Seen {
    of: Option<Of>,
    looks: Vec<Looks>,
}

/// What it is that was seen, and from where.
#[derive(Clone, Debug, PartialEq)]
struct Of {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    faces: Vec<[u32; 3]>,
    frames: usize,
    resolution: usize,
    distance: f32,
}

impl Of {
    fn new(mesh: &Mesh, shooting: &Shooting) -> Self {
        Self {
            positions: mesh.positions.clone(),
            normals: mesh.normals.clone(),
            faces: mesh.faces.clone(),
            frames: shooting.frames,
            resolution: shooting.resolution,
            distance: shooting.distance,
        }
    }
}

impl Seen {
    /// Forgets what is of another object or of other cameras.
    pub(super) fn forget_others(&mut self, mesh: &Mesh, shooting: &Shooting) {
        let of = Some(Of::new(mesh, shooting));
        if self.of != of {
            self.looks.clear();
            self.of = of;
        }
    }

    /// What camera `index` sees; `look` tells where it is the next that was not asked for.
    pub(super) fn of(&mut self, index: usize, look: impl FnOnce() -> Looks) -> &Looks {
        if index == self.looks.len() {
            self.looks.push(look());
        }
        &self.looks[index]
    }
}

#[cfg(test)]
mod tests {
    use render::{bsdf::Model, image::Image};

    use super::super::{Occluders, Pattern, Scene, synthesize, synthesize_seen};
    use super::*;

    #[test]
    fn captures_are_the_same_with_what_was_seen_before_and_without() {
        let shooting = Shooting {
            frames: 2,
            resolution: 10,
            distance: 3.0,
            noise: 0.01,
            seed: 1,
        };
        let scene = |radius: f32, radiance: f32, occluders| Scene {
            mesh: Mesh::sphere(Vec3::ZERO, radius, 12),
            environment: Image::filled(20, 10, 3, radiance),
            model: Model::Lambertian,
            albedo: Pattern {
                mean: [0.5; 3],
                variation: 0.2,
            },
            alpha: 1.0,
            kappa: 0.0,
            occluders,
        };
        let mut seen = Seen::default();
        let fewer = Shooting {
            frames: 1,
            ..shooting.clone()
        };
        for (scene, shooting) in [
            (scene(1.0, 0.5, Occluders::None), &shooting),
            (scene(1.0, 0.7, Occluders::Operator), &shooting),
            (scene(2.0, 0.7, Occluders::Operator), &shooting),
            (scene(2.0, 0.7, Occluders::None), &fewer),
        ] {
            let plain = synthesize(&scene, shooting, |_| true).unwrap();
            let again = synthesize_seen(&scene, shooting, Some(&mut seen), |_| true).unwrap();
            assert!(seen.of == Some(Of::new(&again.capture.mesh, shooting)));
            assert_eq!(seen.looks.len(), shooting.frames);
            let photographs = plain.capture.frames.iter().zip(&again.capture.frames);
            for (plain, again) in photographs {
                assert_eq!(plain.image.data, again.image.data);
                assert_eq!(plain.mask.data, again.mask.data);
            }
        }
    }
}
