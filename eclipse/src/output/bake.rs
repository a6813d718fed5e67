//! Materials at vertices drawn into textures over the mesh's texture coordinates.

use glam::Vec2;
use render::{image::Image, mesh::Mesh};

use crate::reconstruction::VertexMaterial;

/// Texels across and down: about one a vertex of a mesh of 262,144.
const SIDE: usize = 512;
/// Texels by which islands are widened, so that filtering at their seams meets no background.
const WIDENING: usize = 4;
/// Texture coordinates beyond this many repeats are taken for damage.
const MOST_REPEATS: f32 = 8.0;
/// The share of the surface that may have no place of its own on the maps: a fault here and there, of which nobody sees much.
const MOST_LOST: f64 = 0.01;
/// The share of the area that triangles take on the maps that may be taken twice: whole texels are counted, seams among them.
const MOST_SHARED: f64 = 0.05;

/// Maps of the materials, row 0 at v = 0.
pub(super) struct Textures {
    /// Linear albedo.
    pub base_color: Image,
    /// glTF roughness.
    pub roughness: Image,
    /// κ.
    pub specular: Image,
}

/// Interpolates `materials` over the triangles of `mesh`, which has a texture coordinate a vertex.
///
/// `None` where its coordinates are no place for them: parts that lie on one another, as mirrored halves, repeated patterns and
/// objects of several meshes do, would take each other's materials, and triangles without extent there would have none.
pub(super) fn bake(mesh: &Mesh, materials: &[VertexMaterial]) -> Option<Textures> {
    let mut texels = vec![None; SIDE * SIDE];
    let (mut whole, mut lost, mut taken) = (0.0, 0.0, 0.0);
    for (face, area) in mesh.faces.iter().zip(mesh.areas()) {
        let corners = face.map(|vertex| mesh.uvs[vertex as usize] * SIDE as f32);
        let values = face.map(|vertex| flat(&materials[vertex as usize]));
        whole += f64::from(area);
        match draw(&mut texels, corners, values) {
            Some(place) => taken += f64::from(place),
            None => lost += f64::from(area),
        }
    }
    let filled = texels.iter().flatten().count() as f64;
    if lost > MOST_LOST * whole || filled < (1.0 - MOST_SHARED) * taken {
        return None;
    }
    for _ in 0..WIDENING {
        texels = widened(&texels);
    }
    let map = |channels: std::ops::Range<usize>| Image {
        width: SIDE,
        height: SIDE,
        channels: channels.len(),
        data: texels
            .iter()
            .flat_map(|texel| texel.unwrap_or([0.5; 5])[channels.clone()].to_vec())
            .collect(),
    };
    Some(Textures {
        base_color: map(0..3),
        roughness: map(3..4),
        specular: map(4..5),
    })
}

type Values = [f32; 5];

/// Albedo, roughness, κ: what is interpolated is what is stored.
fn flat(material: &VertexMaterial) -> Values {
    let [r, g, b] = material.albedo;
    [r, g, b, material.alpha.max(0.0).sqrt(), material.kappa]
}

/// Fills the texels whose centres lie in the triangle, and returns its area there, `None` where it has none that is possible;
/// coordinates repeat.
fn draw(texels: &mut [Option<Values>], [a, b, c]: [Vec2; 3], values: [Values; 3]) -> Option<f32> {
    let area = (b - a).perp_dot(c - a);
    let (low, high) = (a.min(b).min(c).floor(), a.max(b).max(c).ceil());
    let limit = MOST_REPEATS * SIDE as f32;
    let absurd = !area.is_finite() || low.abs().max(high.abs()).max_element() > limit;
    if absurd || area.abs() < f32::MIN_POSITIVE {
        return None;
    }
    for y in low.y as i32..high.y as i32 {
        for x in low.x as i32..high.x as i32 {
            let point = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
            let u = (c - b).perp_dot(point - b) / area;
            let v = (a - c).perp_dot(point - c) / area;
            let weights = [u, v, 1.0 - u - v];
            if weights.iter().all(|&weight| weight >= 0.0) {
                let wrap = |k: i32| k.rem_euclid(SIDE as i32) as usize;
                let value = |k: usize| {
                    (0..3)
                        .map(|corner| weights[corner] * values[corner][k])
                        .sum()
                };
                texels[wrap(y) * SIDE + wrap(x)] = Some(std::array::from_fn(value));
            }
        }
    }
    Some(0.5 * area.abs())
}

/// Empty texels take the mean of their filled neighbours.
fn widened(texels: &[Option<Values>]) -> Vec<Option<Values>> {
    let neighbours = |index: usize| {
        let (x, y) = ((index % SIDE) as i32, (index / SIDE) as i32);
        let around = (-1..=1).flat_map(move |dy| (-1..=1).map(move |dx| (x + dx, y + dy)));
        let inside =
            around.filter(|&(x, y)| (0..SIDE as i32).contains(&x) && (0..SIDE as i32).contains(&y));
        inside.filter_map(|(x, y)| texels[y as usize * SIDE + x as usize])
    };
    let mean = |index: usize| {
        let count = neighbours(index).count();
        let sum = |k: usize| neighbours(index).map(|values| values[k]).sum::<f32>();
        (count > 0).then(|| std::array::from_fn(|k| sum(k) / count as f32))
    };
    (0..texels.len())
        .map(|index| texels[index].or_else(|| mean(index)))
        .collect()
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    /// Triangles apart from each other, all alike, with these texture coordinates.
    fn mesh(triangles: &[[[f32; 2]; 3]]) -> Mesh {
        let corners = [Vec3::ZERO, Vec3::X, Vec3::Y];
        let place = |k: usize| corners.map(|corner| corner + 2.0 * k as f32 * Vec3::X);
        Mesh {
            positions: (0..triangles.len()).flat_map(place).collect(),
            uvs: triangles
                .iter()
                .flatten()
                .map(|&uv| Vec2::from(uv))
                .collect(),
            faces: (0..triangles.len() as u32)
                .map(|k| [3 * k, 3 * k + 1, 3 * k + 2])
                .collect(),
            ..Mesh::default()
        }
    }

    fn grey(triangles: &[[[f32; 2]; 3]]) -> Option<Textures> {
        let material = VertexMaterial {
            albedo: [0.1; 3],
            alpha: 0.5,
            kappa: 0.04,
        };
        bake(&mesh(triangles), &vec![material; 3 * triangles.len()])
    }

    #[test]
    fn materials_are_interpolated_over_the_triangle_and_widened_around_it() {
        let mesh = mesh(&[[[0.25, 0.25], [0.75, 0.25], [0.25, 0.75]]]);
        let material = |red: f32| VertexMaterial {
            albedo: [red, 0.5, 0.25],
            alpha: 0.36,
            kappa: 0.04,
        };
        let maps = bake(&mesh, &[material(0.0), material(1.0), material(0.0)]);
        let maps = maps.expect("a triangle with a place of its own");
        // Red grows from 0 at u = ¼ to 1 at u = ¾.
        for column in [140, 200, 256] {
            let expected = ((column as f32 + 0.5) / SIDE as f32 - 0.25) / 0.5;
            assert!((maps.base_color.pixel(column, 160)[0] - expected).abs() < 1e-4);
        }
        assert!((maps.roughness.pixel(140, 160)[0] - 0.6).abs() < 1e-6);
        assert!((maps.specular.pixel(140, 160)[0] - 0.04).abs() < 1e-6);
        // Widened by four texels, no further; green tells the object from the background of ½ by blue.
        assert!((maps.base_color.pixel(124, 160)[2] - 0.25).abs() < 1e-6);
        assert_eq!(maps.base_color.pixel(123, 160)[2], 0.5);
    }

    #[test]
    fn coordinates_may_repeat_but_absurd_ones_are_no_place() {
        for (offset, filled) in [(3.0, true), (-2.0, true), (1e9, false), (f32::NAN, false)] {
            let uvs = [[0.0, 0.0], [0.9, 0.0], [0.0, 0.9]].map(|[u, v]| [u + offset, v]);
            let maps = grey(&[uvs]);
            assert_eq!(maps.is_some(), filled, "{offset}");
            let red = maps.map_or(0.1, |maps| maps.base_color.pixel(50, 50)[0]);
            assert!((red - 0.1).abs() < 1e-5, "{offset}: {red}");
        }
    }

    #[test]
    fn parts_that_share_their_place_or_have_none_get_no_textures() {
        let first = [[0.0, 0.0], [0.45, 0.0], [0.0, 0.45]];
        let moved = |by: f32| first.map(|[u, v]| [u + by, v]);
        // Side by side, and with a common edge whose texels count once.
        assert!(grey(&[first, moved(0.5)]).is_some());
        assert!(grey(&[first, [first[1], [0.45, 0.45], first[2]]]).is_some());
        // Mirrored onto each other, a whole repeat apart, half covered.
        for second in [[first[0], first[2], first[1]], moved(1.0), moved(0.1)] {
            assert!(grey(&[first, second]).is_none(), "{second:?}");
        }
        // All at one point, as programs write that have no coordinates.
        assert!(grey(&[first, [[0.7; 2]; 3]]).is_none());
        assert!(grey(&[[[0.0; 2]; 3]]).is_none());
    }
}
