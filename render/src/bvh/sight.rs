//! Which of many directions a surface point sees.

use glam::Vec3;

use super::{Bvh, Rays, SurfacePoint, offset_origin};

/// The directions that were looked along last, and what was seen; kept, it spares the memory of every further look.
#[derive(Clone, Debug, Default)]
pub struct Sight {
    direction: [Vec<f32>; 3],
    open: Vec<bool>,
}

impl Sight {
    /// Looks from `point` along unit directions: true where they are above the surface, by both of its normals, and the object is not
    /// in the way. In their order.
    pub fn look(
        &mut self,
        bvh: &Bvh,
        point: &SurfacePoint,
        directions: impl Iterator<Item = Vec3>,
    ) -> &[bool] {
        self.direction.iter_mut().for_each(Vec::clear);
        self.open.clear();
        for direction in directions {
            let above =
                point.normal.dot(direction) > 0.0 && point.geometric_normal.dot(direction) > 0.0;
            self.open.push(above);
            (0..3).for_each(|axis| self.direction[axis].push(direction[axis]));
        }
        let rays = Rays {
            direction: [0, 1, 2].map(|axis| self.direction[axis].as_slice()),
            open: &mut self.open,
        };
        bvh.close_blocked(offset_origin(point), rays);
        &self.open
    }
}
