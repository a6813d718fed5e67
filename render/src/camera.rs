//! Perspective cameras with OpenCV distortion, and orthographic ones.

use glam::{Mat4, Vec2, Vec3};

/// A camera, OpenGL axes (+x right, +y up, looking along −z): a pinhole with OpenCV lens distortion, or orthographic.
///
/// Pixel (i, j) covers [i, i+1] × [j, j+1], j counted from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// How points come onto the image.
    pub projection: Projection,
    /// Focal lengths in pixels; of an orthographic camera the pixels that a unit of length takes.
    pub focal: [f32; 2],
    /// Principal point in pixels, pixel corners at integers.
    pub principal: [f32; 2],
    /// OpenCV distortion coefficients `k1 k2 p1 p2`, zero for an ideal lens.
    pub distortion: [f32; 4],
    /// Camera-to-world transform, rigid.
    pub world_from_camera: Mat4,
}

/// How points come onto the image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Projection {
    /// Through the centre of projection.
    #[default]
    Perspective,
    /// Along the viewing direction, from however far.
    Orthographic,
}

/// A half line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it starts.
    pub origin: Vec3,
    /// Where it goes: a unit vector.
    pub direction: Vec3,
}

impl Camera {
    /// An ideal camera with square pixels and a central principal point, from its horizontal field of view (radians).
    pub fn from_fov(width: usize, height: usize, angle_x: f32, world_from_camera: Mat4) -> Self {
        let focal = 0.5 * width as f32 / (0.5 * angle_x).tan();
        Self {
            width,
            height,
            projection: Projection::Perspective,
            focal: [focal; 2],
            principal: [0.5 * width as f32, 0.5 * height as f32],
            distortion: [0.0; 4],
            world_from_camera,
        }
    }

    /// An ideal camera at `eye` that looks at `target` with the world's z up in the image.
    ///
    /// Looking straight up or down leaves the roll open; y is taken as up then.
    pub fn look_at(width: usize, height: usize, angle_x: f32, eye: Vec3, target: Vec3) -> Self {
        let back = (eye - target).try_normalize().unwrap_or(Vec3::Z);
        let up = if back.z.abs() > 0.9999 {
            Vec3::Y
        } else {
            Vec3::Z
        };
        let right = up.cross(back).normalize();
        let axes = [
            right.extend(0.0),
            back.cross(right).extend(0.0),
            back.extend(0.0),
            eye.extend(1.0),
        ];
        Self::from_fov(
            width,
            height,
            angle_x,
            Mat4::from_cols(axes[0], axes[1], axes[2], axes[3]),
        )
    }

    /// The centre of projection in the world; of an orthographic camera the place that its rays start beside.
    pub fn centre(&self) -> Vec3 {
        self.world_from_camera.w_axis.truncate()
    }

    /// The distance of the centre of projection from the world's origin: the radius r_t of its occluder shell.
    pub fn distance(&self) -> f32 {
        self.centre().length()
    }

    /// The world ray through the place (x, y) of the image, in pixels with pixel corners at integers.
    pub fn ray(&self, x: f32, y: f32) -> Ray {
        // OpenCV's image axes point right and down; the camera's y points up and it looks along −z.
        let distorted = Vec2::new(
            (x - self.principal[0]) / self.focal[0],
            (y - self.principal[1]) / self.focal[1],
        );
        let ideal = self.undistort(distorted);
        let [right, up] = [ideal.x, -ideal.y];
        let world = |local: Vec3| self.world_from_camera.transform_vector3(local);
        match self.projection {
            Projection::Perspective => Ray {
                origin: self.centre(),
                direction: world(Vec3::new(right, up, -1.0)).normalize(),
            },
            Projection::Orthographic => Ray {
                origin: self.centre() + world(Vec3::new(right, up, 0.0)),
                direction: world(Vec3::NEG_Z).normalize(),
            },
        }
    }

    /// The unit direction from a world point to the camera.
    pub fn direction_from(&self, point: Vec3) -> Vec3 {
        match self.projection {
            Projection::Perspective => (self.centre() - point).normalize(),
            Projection::Orthographic => self.world_from_camera.z_axis.truncate(),
        }
    }

    /// The side of a pixel at a world point that faces the camera, in units of length.
    pub fn footprint(&self, point: Vec3) -> f32 {
        match self.projection {
            Projection::Perspective => self.centre().distance(point) / self.focal[0],
            Projection::Orthographic => 1.0 / self.focal[0],
        }
    }

    /// The image place (x, y) in pixels of a world point, unless it is not in front of the camera or so far aside that the lens model
    /// has folded over.
    pub fn project(&self, point: Vec3) -> Option<[f32; 2]> {
        let offset = point - self.centre();
        let axes = self.world_from_camera;
        let depth = -offset.dot(axes.z_axis.truncate());
        if depth <= 0.0 {
            return None;
        }
        let right = offset.dot(axes.x_axis.truncate());
        let down = -offset.dot(axes.y_axis.truncate());
        let scale = match self.projection {
            Projection::Perspective => depth,
            Projection::Orthographic => 1.0,
        };
        let ideal = Vec2::new(right, down) / scale;
        if ideal.length_squared() > self.fold() {
            return None;
        }
        let d = self.distort(ideal).0;
        Some([
            d.x * self.focal[0] + self.principal[0],
            d.y * self.focal[1] + self.principal[1],
        ])
    }

    /// OpenCV's distortion of an ideal image point (right, down at unit depth), with its Jacobian by rows.
    fn distort(&self, p: Vec2) -> (Vec2, [[f32; 2]; 2]) {
        let [k1, k2, p1, p2] = self.distortion;
        let (x, y) = (p.x, p.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * k2);
        // d(radial)/dx = slope · x, likewise for y.
        let slope = 2.0 * k1 + 4.0 * k2 * r2;
        let distorted = Vec2::new(
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        );
        let mixed = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y;
        let jacobian = [
            [radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x, mixed],
            [mixed, radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x],
        ];
        (distorted, jacobian)
    }

    /// The squared radius of ideal image points at which the lens model folds over: from there on its radial polynomial brings what is
    /// further aside back into the image. It was fitted to what is within; infinite where it never folds.
    fn fold(&self) -> f32 {
        let [k1, k2, ..] = self.distortion.map(f64::from);
        // Where d/dr (r + k₁r³ + k₂r⁵) = 1 + 3k₁s + 5k₂s² first is zero, s = r²; written so that k₂ → 0 is no special case.
        let discriminant = 9.0 * k1 * k1 - 20.0 * k2;
        if discriminant < 0.0 {
            return f32::INFINITY;
        }
        let denominator = -3.0 * k1 + discriminant.sqrt();
        if denominator > 0.0 {
            (2.0 / denominator) as f32
        } else {
            f32::INFINITY
        }
    }

    /// The ideal image point of a distorted one, by Newton's method from the distorted point; the edge of what the lens model images
    /// for points beyond.
    fn undistort(&self, distorted: Vec2) -> Vec2 {
        if self.distortion == [0.0; 4] {
            return distorted;
        }
        let mut p = distorted;
        for _ in 0..20 {
            let (value, [[a, b], [c, d]]) = self.distort(p);
            let residual = value - distorted;
            let determinant = a * d - b * c;
            // Where the lens model folds over there is no inverse.
            if determinant.abs() < 1e-6 {
                break;
            }
            let step = Vec2::new(
                d * residual.x - b * residual.y,
                a * residual.y - c * residual.x,
            ) / determinant;
            p -= step;
            if step.length_squared() < 1e-14 {
                break;
            }
        }
        let fold = self.fold();
        if p.length_squared() <= fold {
            p
        } else {
            fold.sqrt() * distorted.normalize_or_zero()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_lies_beyond_the_fold_of_a_lens_model_is_not_imaged() {
        // r − 0.3 r³ turns back at r = 1.054, where it is 0.703.
        let camera = Camera {
            focal: [100.0; 2],
            principal: [100.0; 2],
            distortion: [-0.3, 0.0, 0.0, 0.0],
            ..Camera::look_at(200, 200, 0.5, Vec3::Z, Vec3::ZERO)
        };
        let aside = |tangent: f32| {
            let axes = camera.world_from_camera;
            let right = tangent * axes.x_axis.truncate();
            camera.project(camera.centre() - axes.z_axis.truncate() + right)
        };
        let [x, _] = aside(1.05).unwrap();
        assert!((x - 170.27).abs() < 0.01, "{x}");
        // Without the fold this would be imaged in the middle of what is seen.
        assert_eq!(aside(1.7), None);
        let far = camera.ray(190.0, 100.0).direction;
        let edge = camera.ray(170.27, 100.0).direction;
        assert!(far.distance(edge) < 0.02, "{far} {edge}");
        let other = Camera {
            distortion: [0.3, 0.1, 0.0, 0.0],
            ..camera.clone()
        };
        assert_eq!(other.fold(), f32::INFINITY);
    }

    fn camera() -> Camera {
        let eye = Vec3::new(3.0, -2.0, 1.5);
        Camera {
            focal: [140.0, 150.0],
            principal: [63.0, 66.0],
            distortion: [0.12, -0.05, 0.003, -0.002],
            ..Camera::look_at(128, 128, 0.5, eye, Vec3::ZERO)
        }
    }

    #[test]
    fn projecting_a_point_of_a_ray_gives_the_pixel_back() {
        let camera = camera();
        for (x, y) in [(0.0, 0.0), (64.5, 60.2), (127.9, 3.3), (20.0, 128.0)] {
            let ray = camera.ray(x, y);
            let [x2, y2] = camera.project(ray.origin + 2.7 * ray.direction).unwrap();
            assert!(
                (x - x2).abs() < 2e-3 && (y - y2).abs() < 2e-3,
                "{x} {y} -> {x2} {y2}"
            );
            assert!(camera.project(ray.origin - ray.direction).is_none());
        }
    }

    #[test]
    fn orthographic_rays_are_parallel_and_lead_back() {
        let camera = Camera {
            projection: Projection::Orthographic,
            distortion: [0.0; 4],
            ..camera()
        };
        let toward = camera.direction_from(Vec3::ONE);
        for (x, y) in [(0.0, 0.0), (64.5, 60.2), (127.9, 3.3)] {
            let ray = camera.ray(x, y);
            assert!((ray.direction + toward).length() < 1e-6);
            let [x2, y2] = camera.project(ray.origin + 2.7 * ray.direction).unwrap();
            assert!((x - x2).abs() < 2e-3 && (y - y2).abs() < 2e-3);
        }
        // A unit of length across takes as many pixels however far away.
        let [right, up] = [
            camera.world_from_camera.x_axis,
            camera.world_from_camera.y_axis,
        ];
        for depth in [1.0, 9.0] {
            let at = camera.centre() - depth * toward;
            let [x0, y0] = camera.project(at).unwrap();
            let [x1, _] = camera.project(at + right.truncate()).unwrap();
            let [_, y1] = camera.project(at + up.truncate()).unwrap();
            assert!((x1 - x0 - 140.0).abs() < 1e-2 && (y0 - y1 - 150.0).abs() < 1e-2);
            assert_eq!(camera.footprint(at), 1.0 / 140.0);
        }
    }

    #[test]
    fn the_centre_looks_at_the_target_and_up_is_up() {
        let camera = Camera {
            principal: [64.0, 64.0],
            distortion: [0.0; 4],
            ..camera()
        };
        let ray = camera.ray(64.0, 64.0);
        assert!((ray.direction + camera.centre().normalize()).length() < 1e-5);
        assert!(camera.ray(64.0, 0.0).direction.z > ray.direction.z);
        assert!((camera.distance() - Vec3::new(3.0, -2.0, 1.5).length()).abs() < 1e-5);
    }
}
