//! Quadrature on the tape: points × directions × frames, loss and gradient.

use std::sync::Arc;

use autodiff::{Differentiable, Graph, GraphError, Program, Sizes};
use render::bvh::Bvh;
use render::maps::{HarmonicMap, PyramidMap};
use render::occluder::mask_lookup;
use render::path::ShadingPoint;
use render::pyramid::Pyramid;
use render::transport::{Quadrature, TransportRow};

use super::{DEGREE, FRAMES, GRID, Report, seconds};

/// Measures a pass over `points`, every one of them seen in every frame, on `threads` threads.
pub fn quadrature(bvh: &Bvh, points: &[ShadingPoint], threads: usize) -> Report {
    let surfaces: Vec<_> = points.iter().map(|p| p.surface).collect();
    let rows = Quadrature::new(GRID, 2).rows(bvh, &surfaces);
    let pyramid = Pyramid::new(GRID, 6);
    let program = record(&pyramid)?;
    let (mut offsets, mut texel, mut weight) = (vec![0], Vec::new(), Vec::new());
    let mut corners: [(Vec<u32>, Vec<f32>); 4] = Default::default();
    for (
        TransportRow {
            texel: texels,
            weight: weights,
        },
        surface,
    ) in rows.iter().zip(&surfaces)
    {
        weight.extend_from_slice(weights);
        for &t in texels {
            texel.push(u32::from(t));
            let direction = GRID.texel_direction(usize::from(t) / 100, usize::from(t) % 100);
            let lookup = mask_lookup(GRID, surface.position, direction, 5.0);
            for (k, (index, weight)) in corners.iter_mut().enumerate() {
                index.push(lookup.index[k]);
                weight.push(lookup.weight[k]);
            }
        }
        offsets.push(texel.len() as u32);
    }
    let samples = texel.len() * FRAMES;
    let sizes = Sizes::new()
        .lanes("level", pyramid.len())
        .lanes("coefficient", (DEGREE + 1).pow(2))
        .lanes("texel", GRID.len())
        .lanes("point", points.len())
        .offsets("direction", offsets)
        .axis("frame", FRAMES)
        .threads(threads);
    let mut ws = program.workspace::<f32>(&sizes)?;
    ws.set("environment", &vec![0.1; 3 * pyramid.len()])?;
    ws.set("occluders", &vec![0.1; (DEGREE + 1).pow(2) * FRAMES])?;
    ws.set("albedo", &vec![0.5; 3 * points.len()])?;
    ws.set("photograph", &vec![0.4; 3 * points.len() * FRAMES])?;
    ws.set_index("own texel", &texel)?;
    ws.set("transport", &weight)?;
    for (k, (index, weight)) in corners.iter().enumerate() {
        ws.set_index(&format!("corner {k}"), index)?;
        ws.set(&format!("corner weight {k}"), weight)?;
    }
    let mut failed = None;
    let time = seconds(|| failed = program.vjp(&mut ws, "loss").err());
    if let Some(error) = failed {
        return Err(error.into());
    }
    println!(
        "quadrature, Lambertian, {} points, {threads} thread(s): loss and gradient {:.0} M samples/s",
        points.len(),
        samples as f64 / time / 1e6
    );
    Ok(())
}

/// Σ (albedo Σ_d transport · light · mask − photograph)², with the unknowns of the Monte Carlo estimator.
fn record(pyramid: &Pyramid) -> Result<Program, GraphError> {
    let g = Graph::new();
    let (level, texel, point) = (g.domain("level"), g.domain("texel"), g.domain("point"));
    let coefficient = g.domain("coefficient");
    let direction = g.segments("direction", &point);
    let frame = g.axis("frame");
    let radiance = g
        .param("environment", &level, 3)
        .linear_map(&texel, Arc::new(PyramidMap(pyramid.clone())))
        .exp();
    let masks = g
        .param_along("occluders", &coefficient, 1, &frame)
        .linear_map(&texel, Arc::new(HarmonicMap::new(DEGREE, GRID, 1)))
        .sigmoid();
    let arriving = radiance.gather(&g.index("own texel", &direction, &texel))
        * g.input("transport", &direction, 1);
    let corners: Vec<_> = (0..4)
        .map(|k| {
            (
                g.index(&format!("corner {k}"), &direction, &texel),
                g.input(&format!("corner weight {k}"), &direction, 1),
            )
        })
        .collect();
    let corners: Vec<_> = corners
        .iter()
        .map(|(index, weight)| (index, weight))
        .collect();
    let received = arriving.segment_dot(&masks.gather_weighted(&corners));
    let render = g.param("albedo", &point, 3) * received;
    let deviation = render - g.input_along("photograph", &point, 3, &frame);
    g.compile::<_, Differentiable>(&[("loss", &deviation.square().sum())])
}
