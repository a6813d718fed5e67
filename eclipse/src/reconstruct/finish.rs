//! From light and occluders to everything a run leaves: albedo at pixel resolution, images through each camera, scores.

use rayon::prelude::*;
use render::{bvh::Bvh, image::Image, lat_long::LatLong};

use super::{
    shading::{Lobe, Masks, Scene, Shade},
    sites::{Blend, Sites},
    surface::{Surface, eyes},
};
use crate::{
    capture::Frame,
    reconstruction::{Noise, VertexMaterial},
};

/// The light and the occluders that a solve found.
#[derive(Clone, Copy)]
pub struct Found<'a> {
    /// The object.
    pub bvh: &'a Bvh,
    /// Its surface in fine.
    pub surface: &'a Surface,
    /// Photographs.
    pub frames: &'a [Frame],
    /// Their noise.
    pub noise: &'a Noise,
    /// Grid of light.
    pub grid: LatLong,
    /// Radiance, `[texel][channel]`.
    pub radiance: &'a [f32],
    /// Occluders, if modelled.
    pub occluders: Option<&'a Masks>,
    /// Specular reflection; `None` for Lambertian surfaces.
    pub lobe: Option<Lobe>,
    /// Seed of every random number.
    pub seed: u64,
}

impl<'a> Found<'a> {
    /// The same under these occluders.
    pub fn under<'b>(&self, occluders: Option<&'b Masks>) -> Found<'b>
    where
        'a: 'b,
    {
        Found { occluders, ..*self }
    }
}

/// What is left at the end, see [`crate::reconstruction::Reconstruction`].
pub struct Finished {
    /// Materials through each camera.
    pub materials: Vec<Image>,
    /// Material at each vertex.
    pub vertex_materials: Vec<VertexMaterial>,
    /// The photographs as the model renders them.
    pub renders: Vec<Image>,
}

/// Fits the albedo finely to the pixels of the surface's sites, and renders every frame.
pub fn finish(found: &Found<'_>) -> Finished {
    let frames = found.frames;
    let seen = &found.surface.seen;
    if seen.patches.is_empty() {
        return nothing(found);
    }
    let points = seen
        .patches
        .iter()
        .map(|p| (p.position, p.normal))
        .collect();
    let sites = Sites::new(points, seen.spacing);
    let pixels: Vec<Vec<Option<Blend>>> = frames
        .iter()
        .map(|frame| sites.pixels(found.bvh, frame))
        .collect();

    let shades = shades(found, &pixels);
    let fitted: Vec<([f32; 3], [f32; 3])> = (0..sites.len())
        .into_par_iter()
        .map(|s| found.surface.albedo(s, &shades[s]))
        .collect();
    let surface = Fitted::new(&fitted, found.lobe);

    let images = frames.iter().zip(&pixels).enumerate();
    let (materials, renders) = images
        .map(|(t, (frame, pixels))| surface.through(t as u32, frame, pixels, &shades))
        .unzip();
    let mesh = found.bvh.mesh();
    let vertex_materials = mesh
        .positions
        .par_iter()
        .zip(&mesh.normals)
        .map(|(&position, &normal)| surface.material(&sites.blend(position, normal)))
        .collect();
    Finished {
        materials,
        vertex_materials,
        renders,
    }
}

/// Of every site, in the frames that see it or interpolate from it.
fn shades(found: &Found<'_>, pixels: &[Vec<Option<Blend>>]) -> Vec<Vec<Shade>> {
    let sites: Vec<usize> = (0..found.surface.places.len()).collect();
    let mut frames = found.surface.frames(&sites);
    for (t, pixels) in pixels.iter().enumerate() {
        for (site, _) in pixels.iter().flatten().flatten() {
            let frames = &mut frames[*site as usize];
            if frames.last() != Some(&(t as u32)) {
                frames.push(t as u32);
            }
        }
    }
    frames.par_iter_mut().for_each(|frames| {
        frames.sort_unstable();
        frames.dedup();
    });
    let scene = Scene {
        grid: found.grid,
        radiance: found.radiance,
        occluders: found.occluders,
        lobe: found.lobe,
        eyes: &eyes(found.frames),
    };
    found.surface.shades(&scene, &sites, &frames)
}

/// Materials at the sites.
struct Fitted {
    albedo: Vec<[f32; 3]>,
    /// How much a site counts beside its neighbours, of (0, 1].
    sure: Vec<f32>,
    lobe: Option<Lobe>,
}

impl Fitted {
    fn new(fitted: &[([f32; 3], [f32; 3])], lobe: Option<Lobe>) -> Self {
        let total = |sure: &[f32; 3]| sure.iter().sum::<f32>();
        let mut sorted: Vec<f32> = fitted.iter().map(|(_, sure)| total(sure)).collect();
        sorted.sort_unstable_by(f32::total_cmp);
        // Sites in deep shadow know little: a tenth of what is usual halves their say.
        let half = 0.1 * sorted[sorted.len() / 2] + 1e-12;
        Self {
            albedo: fitted.iter().map(|(albedo, _)| *albedo).collect(),
            sure: fitted
                .iter()
                .map(|(_, sure)| 1e-6 + total(sure) / (total(sure) + half))
                .collect(),
            lobe,
        }
    }

    fn material(&self, blend: &Blend) -> VertexMaterial {
        let weight = |&(site, weight): &(u32, f32)| weight * self.sure[site as usize];
        let sum: f32 = blend.iter().map(weight).sum();
        let albedo = std::array::from_fn(|c| {
            let part = |b: &(u32, f32)| weight(b) * self.albedo[b.0 as usize][c];
            blend.iter().map(part).sum::<f32>() / sum
        });
        let lobe = self.lobe.unwrap_or(Lobe {
            alpha: 1.0,
            kappa: 0.0,
        });
        VertexMaterial {
            albedo,
            alpha: lobe.alpha,
            kappa: lobe.kappa,
        }
    }

    /// Materials and the render of a frame.
    fn through(
        &self,
        frame: u32,
        photograph: &Frame,
        pixels: &[Option<Blend>],
        shades: &[Vec<Shade>],
    ) -> (Image, Image) {
        let (width, height) = (photograph.image.width, photograph.image.height);
        let mut materials = Image::filled(width, height, 5, 0.0);
        let mut render = Image::filled(width, height, 3, 0.0);
        for (p, blend) in pixels.iter().enumerate() {
            let Some(blend) = blend else { continue };
            let material = self.material(blend);
            materials.data[5 * p..5 * p + 3].copy_from_slice(&material.albedo);
            materials.data[5 * p + 3] = material.alpha;
            materials.data[5 * p + 4] = material.kappa;
            for (site, weight) in blend.iter().filter(|b| b.1 > 0.0) {
                let of_site = &shades[*site as usize];
                let Ok(i) = of_site.binary_search_by_key(&frame, |s| s.frame) else {
                    continue;
                };
                for c in 0..3 {
                    let value = material.albedo[c] * of_site[i].diffuse[c] + of_site[i].specular[c];
                    render.data[3 * p + c] += weight * value;
                }
            }
        }
        (materials, render)
    }
}

/// When no pixel can be fitted: materials of unknown albedo.
fn nothing(found: &Found<'_>) -> Finished {
    let image = |frame: &Frame, channels| {
        Image::filled(frame.image.width, frame.image.height, channels, 0.0)
    };
    let unknown = VertexMaterial {
        albedo: [0.5; 3],
        alpha: 1.0,
        kappa: 0.0,
    };
    Finished {
        materials: found.frames.iter().map(|f| image(f, 5)).collect(),
        vertex_materials: vec![unknown; found.bvh.mesh().positions.len()],
        renders: found.frames.iter().map(|f| image(f, 3)).collect(),
    }
}

/// Peak signal-to-noise ratio (dB, peak 1) of renders over the object's pixels that `counted` allows.
pub fn psnr(
    frames: &[Frame],
    renders: &[Image],
    counted: &dyn Fn(usize, u32) -> bool,
) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0u64);
    for (t, (frame, render)) in frames.iter().zip(renders).enumerate() {
        for p in (0..frame.mask.data.len()).filter(|&p| frame.mask.data[p] > 0.999) {
            if counted(t, p as u32) {
                for i in 3 * p..3 * p + 3 {
                    sum += f64::from(render.data[i] - frame.image.data[i]).powi(2);
                    count += 1;
                }
            }
        }
    }
    (count > 0).then(|| -10.0 * (sum / count as f64).max(1e-20).log10())
}

/// Radiance on `grid` as an image of `rows` × 2·`rows`, interpolated when the grid is another.
pub fn environment(grid: LatLong, radiance: &[f32], rows: usize) -> Image {
    let to = LatLong::new(rows, 2 * rows);
    let data = (0..to.len())
        .flat_map(|texel| {
            let direction = to.texel_direction(texel / to.columns, texel % to.columns);
            let around = grid.bilinear(direction);
            (0..3).map(move |c| {
                (0..4)
                    .map(|q| around.weight[q] * radiance[3 * around.index[q] as usize + c])
                    .sum::<f32>()
            })
        })
        .collect();
    Image {
        width: to.columns,
        height: to.rows,
        channels: 3,
        data,
    }
}
