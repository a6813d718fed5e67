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
pub(super) fn bake(mesh: &Mesh, materials: &[VertexMaterial]) -> Textures {
    let mut texels = vec![None; SIDE * SIDE];
    for face in &mesh.faces {
        let corners = face.map(|vertex| mesh.uvs[vertex as usize] * SIDE as f32);
        let values = face.map(|vertex| flat(&materials[vertex as usize]));
        draw(&mut texels, corners, values);
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
    Textures {
        base_color: map(0..3),
        roughness: map(3..4),
        specular: map(4..5),
    }
}

type Values = [f32; 5];

/// Albedo, roughness, κ: what is interpolated is what is stored.
fn flat(material: &VertexMaterial) -> Values {
    let [r, g, b] = material.albedo;
    [r, g, b, material.alpha.max(0.0).sqrt(), material.kappa]
}

/// Fills the texels whose centres lie in the triangle; coordinates repeat.
fn draw(texels: &mut [Option<Values>], [a, b, c]: [Vec2; 3], values: [Values; 3]) {
    let area = (b - a).perp_dot(c - a);
    let (low, high) = (a.min(b).min(c).floor(), a.max(b).max(c).ceil());
    let limit = MOST_REPEATS * SIDE as f32;
    if area.abs() < f32::MIN_POSITIVE || low.abs().max(high.abs()).max_element() > limit {
        return;
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
    use super::*;

    #[test]
    fn materials_are_interpolated_over_the_triangle_and_widened_around_it() {
        let mesh = Mesh {
            uvs: vec![
                Vec2::new(0.25, 0.25),
                Vec2::new(0.75, 0.25),
                Vec2::new(0.25, 0.75),
            ],
            faces: vec![[0, 1, 2]],
            ..Mesh::default()
        };
        let material = |red: f32| VertexMaterial {
            albedo: [red, 0.5, 0.25],
            alpha: 0.36,
            kappa: 0.04,
        };
        let maps = bake(&mesh, &[material(0.0), material(1.0), material(0.0)]);
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
    fn repeating_and_absurd_coordinates_are_harmless() {
        let material = VertexMaterial {
            albedo: [0.1; 3],
            alpha: 0.5,
            kappa: 0.04,
        };
        for (offset, filled) in [(3.0, true), (-2.0, true), (1e9, false), (f32::NAN, false)] {
            let uvs = [[0.0, 0.0], [0.9, 0.0], [0.0, 0.9]].map(|[u, v]| Vec2::new(u + offset, v));
            let mesh = Mesh {
                uvs: uvs.to_vec(),
                faces: vec![[0, 1, 2]],
                ..Mesh::default()
            };
            let red = bake(&mesh, &[material; 3]).base_color.pixel(50, 50)[0];
            assert_eq!((red - 0.1).abs() < 1e-5, filled, "{offset}: {red}");
        }
    }
}
