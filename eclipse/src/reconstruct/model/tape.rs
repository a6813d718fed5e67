//! The recording of the model.

use std::sync::Arc;

use autodiff::{Array, Differentiable, Graph, GraphError, Program};
use render::{maps::PyramidMap, pyramid::Pyramid};

/// Colour varies less than brightness: standard deviation of each chroma component relative to luminance.
const CHROMA: f64 = 0.68;

/// How heavy the tails of light are: coefficients are sinh(`TAIL` z)/`TAIL` of a normal z. Most of a wall is smooth, but
/// there are lamps and windows, whose edges are far outside of any normal distribution.
pub(super) const TAIL: f32 = 0.5;

/// The coefficient, in standard deviations, that `z` stands for.
pub(super) fn coefficient(z: f32) -> f32 {
    (TAIL * z).sinh() / TAIL
}

/// How the variances of luminance and the two chroma components add up to that of each channel's logarithm.
pub(super) fn mixed_variances() -> [[f64; 3]; 3] {
    let [red_green, blue_yellow] = [CHROMA.powi(2) / 2.0, CHROMA.powi(2) / 6.0];
    let side = [1.0, red_green, blue_yellow];
    [side, side, [1.0, 0.0, 4.0 * blue_yellow]]
}

/// How fast the coefficient changes with `z`.
pub(super) fn steepness(z: f32) -> f32 {
    (TAIL * z).cosh()
}

/// Residuals and predictions of a lot of frames, and radiance.
pub(super) fn record(pyramid: &Pyramid) -> Result<Program, GraphError> {
    let g = Graph::new();
    let (level, texel, patch) = (g.domain("level"), g.domain("texel"), g.domain("patch"));
    let mask_texel = g.domain("mask texel");
    let direction = g.segments("direction", &patch);

    // Light (Eq. 7): luminance and two chroma components.
    let z = g.param("environment", &level, 3);
    let steep = f64::from(TAIL);
    let heavy = ((&z * steep).exp() - (&z * -steep).exp()) * (0.5 / steep);
    let coefficients = heavy * g.input("deviation", &level, 1);
    let log = coefficients.linear_map(&texel, Arc::new(PyramidMap(pyramid.clone())));
    let luminance = log.channel(0) + g.input("log radiance", &g.uniform(), 1);
    let red_green = log.channel(1) * (CHROMA / 2f64.sqrt());
    let blue_yellow = log.channel(2) * (CHROMA / 6f64.sqrt());
    let log = Array::stack(&[
        &(&luminance + &red_green + &blue_yellow),
        &(&luminance - &red_green + &blue_yellow),
        &(&luminance - &blue_yellow * 2.0),
    ]);
    let radiance = log.clamp(-20.0, 14.0).exp();

    let arriving = radiance.gather(&g.index("own texel", &direction, &texel))
        * g.input("transport", &direction, 1);
    let albedo = g.param("albedo", &patch, 3);
    let frame = g.axis("frame");
    let corners = CORNERS.map(|k| g.index(k, &direction, &mask_texel));
    let weights = WEIGHTS.map(|k| g.input(k, &direction, 1));
    let lookups: Vec<_> = corners.iter().zip(&weights).collect();
    let masks = g
        .param_along("mask", &mask_texel, 1, &frame)
        .gather_weighted(&lookups);
    let predicted = &albedo * arriving.segment_dot(&masks);
    let value = g.input_along("value", &patch, 3, &frame);
    let weight = g.input_along("root weight", &patch, 3, &frame);
    let residual = (&predicted - value) * weight;
    g.compile::<_, Differentiable>(&[
        ("radiance", &radiance),
        ("residual", &residual),
        ("predicted", &predicted),
    ])
}

/// A ray's lookups in the masks: texels.
pub(super) const CORNERS: [&str; 4] = ["corner 0", "corner 1", "corner 2", "corner 3"];
/// The same: weights.
pub(super) const WEIGHTS: [&str; 4] = ["weight 0", "weight 1", "weight 2", "weight 3"];
