//! The integrand on the tape: tables of the unknowns, and paths re-evaluated against them.
//!
//! The environment is a table of texels (pyramid → exp, Eq. 7), the occluders a table of texels × frames (harmonics →
//! sigmoid, Eq. 6); both are evaluated once an iteration. Paths only gather from them. Directions, densities and visibility
//! come in as inputs, which carry no gradient.

use std::f64::consts::PI;
use std::sync::Arc;

use autodiff::{Detached, Domain, Graph, Index, RunError, Scalar, Sizes, Var, Workspace};

use crate::bsdf::Model;
use crate::lat_long::LatLong;
use crate::maps::{HarmonicMap, PyramidMap};
use crate::path::{Corners, Lookup, PathBatch};
use crate::pyramid::Pyramid;

/// A table of the tape that samples look up: one lane a texel.
pub struct Table {
    /// The domain of its texels.
    pub texel: Domain,
    /// Its values.
    pub value: Var,
}

/// The material at every pixel's surface point.
pub struct Shading {
    /// Diffuse albedo, 3 channels.
    pub albedo: Var,
    /// Roughness α.
    pub alpha: Var,
    /// Specular reflectance at normal incidence κ.
    pub kappa: Var,
}

/// Records L = exp(Σ aᵏ L_k): parameter `environment` on the domain `pyramid` (3 channels) to the domain `texel`.
pub fn record_environment(g: &Graph, pyramid: &Pyramid) -> Table {
    let levels = g.domain("pyramid");
    let texel = g.domain("texel");
    let parameter = g.param("environment", &levels, 3);
    let value = parameter
        .linear_map(&texel, Arc::new(PyramidMap(pyramid.clone())))
        .exp()
        .label("radiance");
    Table { texel, value }
}

/// Records M = σ(Σ a Y): parameter `occluders` on the domain `coefficient` to the domain `mask texel`.
///
/// Lanes are coefficient × frames + frame and texel × frames + frame.
pub fn record_masks(g: &Graph, degree: usize, grid: LatLong, frames: usize) -> Table {
    let coefficient = g.domain("coefficient");
    let texel = g.domain("mask texel");
    let parameter = g.param("occluders", &coefficient, 1);
    let map = Arc::new(HarmonicMap::new(degree, grid, frames));
    let value = parameter
        .linear_map(&texel, map)
        .sigmoid()
        .label("transmittance");
    Table { texel, value }
}

/// Records M = σ(v): parameter `occluders`, a free value for every texel and frame, on the domain `mask texel`.
///
/// Lanes are texel × frames + frame, as of [`record_masks`].
pub fn record_free_masks(g: &Graph) -> Table {
    let texel = g.domain("mask texel");
    let parameter = g.param("occluders", &texel, 1);
    let value = parameter.sigmoid().label("transmittance");
    Table { texel, value }
}

/// The sizes of the tables' domains; with no frames, those of the environment alone.
pub fn table_sizes(
    sizes: Sizes,
    pyramid: &Pyramid,
    degree: usize,
    grid: LatLong,
    frames: usize,
) -> Sizes {
    let sizes = free_table_sizes(sizes, pyramid, grid, frames);
    match frames {
        0 => sizes,
        _ => sizes.lanes("coefficient", (degree + 1).pow(2) * frames),
    }
}

/// The same where masks are those of [`record_free_masks`].
pub fn free_table_sizes(sizes: Sizes, pyramid: &Pyramid, grid: LatLong, frames: usize) -> Sizes {
    let sizes = sizes
        .lanes("pyramid", pyramid.len())
        .lanes("texel", pyramid.finest().len());
    match frames {
        0 => sizes,
        _ => sizes.lanes("mask texel", grid.len() * frames),
    }
}

/// Records the radiance of every pixel from its samples: 3 channels on `pixel`.
///
/// The samples live on a new domain `{name} sample`, and everything bound by [`bind_batch`] is named `{name} ..`. Without
/// `masks` there are no occluders. Batches must have been drawn with the same `lookup`.
pub fn record_radiance(
    g: &Graph,
    name: &str,
    pixel: &Domain,
    model: Model,
    reading: Lookup,
    environment: &Table,
    masks: Option<&Table>,
    shading: &Shading,
) -> Var {
    let sample = g.segments(&format!("{name} sample"), pixel);
    let input = |what: &str| g.input(&format!("{name} {what}"), &sample, 1);
    let incident = input("incident");
    let weight = input("weight") * &incident;
    let light = lookup(g, name, "light", &sample, environment, reading);
    let light = match masks {
        Some(masks) => light * lookup(g, name, "mask", &sample, masks, reading),
        None => light,
    };
    let diffuse = &shading.albedo * (1.0 / PI);
    match model {
        Model::Lambertian => diffuse * light.segment_dot(&weight),
        Model::Microfacet => {
            let outgoing = g.input(&format!("{name} outgoing"), pixel, 1);
            let lobes = Lobes::record(
                shading,
                &outgoing,
                &sample,
                &incident,
                &input("half"),
                &input("difference"),
            );
            diffuse * light.segment_dot(&(lobes.factor * &weight))
                + light.segment_dot(&(lobes.specular * &weight))
        }
    }
}

/// Adds the sizes of a batch of paths.
pub fn batch_sizes(sizes: Sizes, name: &str, batch: &PathBatch) -> Sizes {
    sizes.offsets(&format!("{name} sample"), batch.offsets.clone())
}

/// Binds a batch of paths to what [`record_radiance`] recorded under the same name, model and masks.
///
/// # Errors
/// When a length differs from the workspace's sizes or an index is out of its table.
pub fn bind_batch<S: Scalar>(
    ws: &mut Workspace<S>,
    name: &str,
    model: Model,
    masked: bool,
    batch: &PathBatch,
) -> Result<(), RunError> {
    let mut bind = |what: &str, values: &Arc<[f32]>| ws.bind_f32(&format!("{name} {what}"), values);
    bind("incident", &batch.incident)?;
    bind("weight", &batch.weight)?;
    if model == Model::Microfacet {
        bind("outgoing", &batch.outgoing)?;
        bind("half", &batch.half)?;
        bind("difference", &batch.difference)?;
    }
    bind_corners(ws, name, "light", &batch.light)?;
    if masked {
        bind_corners(ws, name, "mask", &batch.mask)?;
    }
    Ok(())
}

/// Binds single-precision numbers to an input of a workspace of any precision.
///
/// # Errors
/// As [`Workspace::bind`].
pub fn bind_values<S: Scalar>(
    ws: &mut Workspace<S>,
    name: &str,
    values: &[f32],
) -> Result<(), RunError> {
    ws.bind(
        name,
        values.iter().map(|&v| S::from_f64(f64::from(v))).collect(),
    )
}

fn bind_corners<S: Scalar>(
    ws: &mut Workspace<S>,
    name: &str,
    what: &str,
    corners: &Corners,
) -> Result<(), RunError> {
    for (k, index) in corners.index.iter().enumerate() {
        ws.bind_index(&format!("{name} {what} index {k}"), Arc::clone(index))?;
    }
    for (k, weight) in corners.weight.iter().enumerate() {
        ws.bind_f32(&format!("{name} {what} weight {k}"), weight)?;
    }
    Ok(())
}

/// Records the lookup of every sample in a table.
fn lookup(
    g: &Graph,
    name: &str,
    what: &str,
    sample: &Domain,
    table: &Table,
    reading: Lookup,
) -> Var {
    if reading == Lookup::Stochastic {
        let index = g.index(&format!("{name} {what} index 0"), sample, &table.texel);
        return table.value.gather(&index);
    }
    let corners: Vec<(Index, Detached)> = (0..4)
        .map(|k| {
            let index = g.index(&format!("{name} {what} index {k}"), sample, &table.texel);
            (
                index,
                g.input(&format!("{name} {what} weight {k}"), sample, 1),
            )
        })
        .collect();
    let corners: Vec<(&Index, &Detached)> = corners
        .iter()
        .map(|(index, weight)| (index, weight))
        .collect();
    table.value.gather_weighted(&corners)
}

/// The two parts of [`microfacet`](crate::bsdf::microfacet) on the tape: f = ρ/π · factor + specular.
struct Lobes {
    factor: Var,
    specular: Var,
}

impl Lobes {
    fn record(
        shading: &Shading,
        outgoing: &Detached,
        sample: &Domain,
        incident: &Detached,
        half: &Detached,
        difference: &Detached,
    ) -> Self {
        // What depends on the pixel alone is computed once a pixel.
        let k = shading.alpha.affine(1.0, 1.0).square() * 0.125;
        let view = &k + (1.0 - &k) * outgoing;
        let a2 = shading.alpha.square();
        // α² / (4π (k + (1 − k) n·ωo)): the parts of D and G that the samples share.
        let shared = (&a2 * (0.25 / PI) / view).expand(sample);
        let (k, a2, kappa) = (
            k.expand(sample),
            a2.expand(sample),
            shading.kappa.expand(sample),
        );
        // 1 − F = (1 − κ)(1 − (1 − cos)⁵).
        let grazing = |cos: &Detached| cos.affine(-1.0, 1.0).powi(5);
        let (far, near) = (grazing(incident), grazing(difference));
        let pass = kappa.affine(-1.0, 1.0);
        let fresnel = &kappa + &pass * &near;
        let factor = pass.square() * (far.affine(-1.0, 1.0) * near.affine(-1.0, 1.0));
        let cos2 = half.square();
        let s = cos2.affine(-1.0, 1.0) + &a2 * &cos2;
        let light = &k + (1.0 - &k) * incident;
        let specular = shared * fresnel / (s.square() * light);
        Self { factor, specular }
    }
}
