//! From where an object is seen.

use std::f32::consts::TAU;

use glam::Vec3;
use render::camera::Camera;

/// Margin around the object in the picture.
const MARGIN: f32 = 1.1;
/// Widest angle of view that an orbit chooses by itself, as a share of the sphere's radius over its distance.
const WIDEST: f32 = 0.95;

/// Cameras on a circle around the object, at even distances, counter-clockwise seen from above.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orbit {
    /// How many.
    pub frames: usize,
    /// Pixels across and down.
    pub size: [usize; 2],
    /// Height above the horizon, in degrees.
    pub elevation: f32,
    /// Where the first stands, in degrees from +x towards +y.
    pub azimuth: f32,
    /// Distance from the object's centre, in its bounding radii.
    pub distance: f32,
}

impl Orbit {
    /// The cameras around an object of `radius` whose centre is the origin; the whole of it is in the picture.
    pub fn cameras(&self, radius: f32) -> Vec<Camera> {
        let [width, height] = self.size;
        // The angle holds across; of a picture that is higher than wide, too, since the object fits the narrower side.
        let narrow = 2.0 * (MARGIN / self.distance).min(WIDEST).asin();
        let across = 0.5 * narrow;
        let angle = if height < width {
            2.0 * (across.tan() * width as f32 / height as f32).atan()
        } else {
            narrow
        };
        let (sin, cos) = self.elevation.to_radians().sin_cos();
        let camera = |index: usize| {
            let azimuth = self.azimuth.to_radians() + TAU * index as f32 / self.frames as f32;
            let direction = Vec3::new(cos * azimuth.cos(), cos * azimuth.sin(), sin);
            let eye = self.distance * radius * direction;
            Camera::look_at(width, height, angle, eye, Vec3::ZERO)
        };
        (0..self.frames).map(camera).collect()
    }
}

/// At most `count` of `items`, evenly spread from the first on.
pub fn evenly<T>(items: Vec<T>, count: Option<usize>) -> Vec<T> {
    let all = items.len();
    let count = count.map_or(all, |count| count.clamp(1, all.max(1)));
    let mut chosen = (0..count).map(|k| k * all / count).peekable();
    let mut items = items.into_iter().enumerate();
    std::iter::from_fn(|| items.find(|(index, _)| chosen.next_if_eq(index).is_some()))
        .map(|(_, item)| item)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_orbit_goes_around_and_sees_all_of_the_object() {
        for size in [[64, 64], [96, 48], [48, 96]] {
            let orbit = Orbit {
                frames: 8,
                size,
                elevation: 20.0,
                azimuth: 90.0,
                distance: 4.0,
            };
            let cameras = orbit.cameras(2.0);
            assert_eq!(cameras.len(), 8);
            assert!(cameras[0].centre().y > 7.0 && cameras[2].centre().x < -7.0);
            for camera in &cameras {
                assert!((camera.distance() - 8.0).abs() < 1e-4);
                // The sphere's outline touches no side of the picture and fills most of the narrower one.
                let across = camera.world_from_camera.x_axis.truncate();
                let up = camera.world_from_camera.y_axis.truncate();
                let tangent = 2.0 / (1.0f32 - 0.25 * 0.25).sqrt();
                let [x, _] = camera.project(tangent * across).unwrap();
                let [_, y] = camera.project(tangent * up).unwrap();
                let (right, top) = (size[0] as f32 - x, y);
                assert!(
                    right.min(top) > 0.0 && right.min(top) < 6.0,
                    "{size:?} {right} {top}"
                );
            }
        }
    }

    #[test]
    fn frames_are_spread_evenly() {
        let all: Vec<usize> = (0..10).collect();
        assert_eq!(evenly(all.clone(), None), all);
        assert_eq!(evenly(all.clone(), Some(99)), all);
        assert_eq!(evenly(all.clone(), Some(1)), [0]);
        assert_eq!(evenly(all.clone(), Some(5)), [0, 2, 4, 6, 8]);
        assert_eq!(evenly(all, Some(3)), [0, 3, 6]);
    }
}
