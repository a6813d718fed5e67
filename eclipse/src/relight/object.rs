//! The object that a run recovered.

use std::{io, path::Path};

use glam::{Vec2, Vec3};
use render::{
    bsdf::{Material, Model},
    bvh::Hit,
    mesh::Mesh,
};

use serde::Deserialize;

use super::RelightError;
use crate::{
    files::read_limited,
    layout::{MESH, SETTINGS},
    mesh_io::{MeshSurface, read_surfaced_glb},
    reconstruction::VertexMaterial,
    settings::Reading,
};

/// Smallest α that is rendered: narrower lobes are noise, and the fit has none.
const LEAST_ALPHA: f32 = 0.02;

/// Largest `settings.json` that is read, in bytes.
const MAX_SETTINGS: u64 = 1 << 20;

/// A mesh with its materials, recentred as captures are.
#[derive(Clone, Debug)]
pub struct Object {
    /// The shape; the middle of its bounding box is the origin.
    pub mesh: Mesh,
    /// Where the origin lies in the object's own frame.
    pub centre: Vec3,
    /// What the surface is like.
    pub surface: MeshSurface,
    /// Reflectance model.
    pub model: Model,
}

impl Object {
    /// Takes any mesh with its materials.
    pub fn new(mut mesh: Mesh, surface: MeshSurface, model: Model) -> Self {
        let [low, high] = mesh.bounds();
        let centre = 0.5 * low + 0.5 * high;
        mesh.positions
            .iter_mut()
            .for_each(|position| *position -= centre);
        Self {
            mesh,
            centre,
            surface,
            model,
        }
    }

    /// Reads what a run left in `folder`: the mesh with its materials, and whether they are purely diffuse.
    ///
    /// # Errors
    /// [`RelightError::Object`] when there is no such mesh, or settings that cannot be read.
    pub fn read(folder: &Path) -> Result<Self, RelightError> {
        let (mesh, surface) = read_surfaced_glb(&folder.join(MESH))
            .map_err(|source| RelightError::Object { source })?;
        let lambertian = match settings(folder)? {
            Some(settings) => settings.lambertian,
            // Without a word about it: a surface that mirrors nothing head-on is matt.
            None => most_kappa(&surface) <= 0.0,
        };
        let model = if lambertian {
            Model::Lambertian
        } else {
            Model::Microfacet
        };
        Ok(Self::new(mesh, surface, model))
    }

    /// The material where a ray met the mesh.
    pub fn material(&self, hit: &Hit) -> Material {
        let corners = self.mesh.faces[hit.face as usize].map(|vertex| vertex as usize);
        let Vec2 { x: b, y: c } = hit.barycentric;
        let weights = [1.0 - b - c, b, c];
        let VertexMaterial {
            albedo,
            alpha,
            kappa,
        } = match &self.surface {
            MeshSurface::Vertices(materials) => {
                blend(corners.map(|vertex| materials[vertex]), weights)
            }
            MeshSurface::Maps(maps) => {
                let uv = |k: usize| weights[k] * self.mesh.uvs[corners[k]];
                maps.at(uv(0) + uv(1) + uv(2))
            }
        };
        Material {
            albedo: albedo.map(|value| value.clamp(0.0, 1.0)),
            alpha: alpha.clamp(LEAST_ALPHA, 1.0),
            kappa: kappa.clamp(0.0, 1.0),
        }
    }
}

/// What is stored is what is interpolated: the roughness √α, as in the maps.
fn blend(materials: [VertexMaterial; 3], weights: [f32; 3]) -> VertexMaterial {
    let sum = |value: &dyn Fn(&VertexMaterial) -> f32| {
        let terms = materials.iter().zip(weights);
        terms
            .map(|(material, weight)| weight * value(material))
            .sum::<f32>()
    };
    let roughness = sum(&|material| material.alpha.max(0.0).sqrt());
    VertexMaterial {
        albedo: std::array::from_fn(|channel| sum(&|material| material.albedo[channel])),
        alpha: roughness * roughness,
        kappa: sum(&|material| material.kappa),
    }
}

/// How the run that left `folder` read its capture, as far as its settings say.
///
/// # Errors
/// Settings that cannot be read.
pub fn reading(folder: &Path) -> Result<Reading, RelightError> {
    Ok(settings(folder)?.map_or(Reading::default(), |settings| settings.reading))
}

/// The part of `settings.json` that matters here; those of later versions have it too.
#[derive(Deserialize)]
struct Part {
    /// Whether the run fitted no lobe.
    lambertian: bool,
    #[serde(default)]
    reading: Reading,
}

/// The settings of a run, if there are some.
fn settings(folder: &Path) -> Result<Option<Part>, RelightError> {
    let path = folder.join(SETTINGS);
    match read_limited(&path, MAX_SETTINGS) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(source) => Err(RelightError::Read { path, source }),
        Ok(bytes) => match serde_json::from_slice(&bytes) {
            Ok(part) => Ok(Some(part)),
            Err(source) => Err(RelightError::Settings { path, source }),
        },
    }
}

fn most_kappa(surface: &MeshSurface) -> f32 {
    match surface {
        MeshSurface::Vertices(materials) => materials
            .iter()
            .map(|material| material.kappa)
            .fold(0.0, f32::max),
        MeshSurface::Maps(maps) => maps.kappa.data.iter().copied().fold(0.0, f32::max),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn materials_are_blended_between_vertices() {
        let vertex = |albedo: f32, alpha: f32, kappa: f32| VertexMaterial {
            albedo: [albedo; 3],
            alpha,
            kappa,
        };
        let object = Object::new(
            Mesh {
                positions: vec![Vec3::ZERO, 2.0 * Vec3::X, 2.0 * Vec3::Y],
                faces: vec![[0, 1, 2]],
                ..Mesh::default()
            },
            MeshSurface::Vertices(vec![
                vertex(0.0, 0.04, 0.0),
                vertex(0.4, 0.36, 0.2),
                vertex(0.8, 0.04, 0.0),
            ]),
            Model::Microfacet,
        );
        assert_eq!(object.centre, Vec3::new(1.0, 1.0, 0.0));
        let hit = Hit {
            t: 1.0,
            face: 0,
            barycentric: Vec2::new(0.5, 0.25),
        };
        let material = object.material(&hit);
        assert!((material.albedo[0] - 0.4).abs() < 1e-6);
        // Roughness 0.2, 0.6, 0.2 gives 0.4 in the middle.
        assert!((material.alpha - 0.16).abs() < 1e-6);
        assert!((material.kappa - 0.1).abs() < 1e-6);
    }
}
