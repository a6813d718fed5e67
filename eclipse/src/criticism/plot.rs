//! Mean residuals along an axis as SVG, with the band that a null would stay in.

use super::locate::Axis;

const WIDTH: f64 = 500.0;
const HEIGHT: f64 = 190.0;
const LEFT: f64 = 52.0;
const BOTTOM: f64 = 34.0;

/// The plot of one axis.
pub fn axis(axis: &Axis) -> String {
    if axis.at.len() < 2 {
        return String::new();
    }
    let (low, high) = (axis.at[0], axis.at[axis.at.len() - 1]);
    let largest = axis
        .before
        .iter()
        .chain(&axis.after)
        .fold(0.002f64, |m, v| m.max(v.abs()))
        * 1.1;
    let x = |v: f64| LEFT + (v - low) / (high - low) * (WIDTH - LEFT - 10.0);
    let y = |v: f64| {
        let middle = 0.5 * (HEIGHT - BOTTOM) + 6.0;
        middle - v.clamp(-largest, largest) / largest * 0.5 * (HEIGHT - BOTTOM - 12.0)
    };
    let line = |values: &[f64]| -> String {
        axis.at
            .iter()
            .zip(values)
            .map(|(a, v)| format!("{:.1},{:.1} ", x(*a), y(*v)))
            .collect()
    };
    let upper = axis.at.iter().zip(&axis.error);
    let lower = axis.at.iter().zip(&axis.error).rev();
    let band: String = upper
        .map(|(a, e)| format!("{:.1},{:.1} ", x(*a), y(2.0 * e)))
        .chain(lower.map(|(a, e)| format!("{:.1},{:.1} ", x(*a), y(-2.0 * e))))
        .collect();
    let label = |v: f64, text: String| {
        format!(
            "<text x=\"{:.0}\" y=\"{:.0}\" text-anchor=\"end\">{text}</text>",
            LEFT - 5.0,
            y(v) + 4.0
        )
    };
    format!(
        "<svg width=\"{WIDTH}\" height=\"{HEIGHT}\" font-size=\"11\" role=\"img\"><polygon points=\"{band}\" fill=\"#e5e7eb\"/>\
         <line x1=\"{LEFT}\" x2=\"{:.0}\" y1=\"{:.1}\" y2=\"{:.1}\" stroke=\"#999\"/>\
         <polyline points=\"{}\" fill=\"none\" stroke=\"#c2410c\" stroke-width=\"1.6\"/>\
         <polyline points=\"{}\" fill=\"none\" stroke=\"#1d4ed8\" stroke-width=\"1.6\"/>{}{}{}\
         <text x=\"{LEFT}\" y=\"{:.0}\">{low:.2}</text><text x=\"{:.0}\" y=\"{:.0}\" text-anchor=\"end\">{high:.2}</text>\
         <text x=\"{:.0}\" y=\"{:.0}\" text-anchor=\"middle\">{} — mean residual, <tspan fill=\"#c2410c\">before</tspan>, \
         <tspan fill=\"#1d4ed8\">after</tspan>, null ± 2 σ</text></svg>\n",
        WIDTH - 10.0,
        y(0.0),
        y(0.0),
        line(&axis.before),
        line(&axis.after),
        label(0.9 * largest, format!("{:+.1} %", 90.0 * largest)),
        label(0.0, "0".into()),
        label(-0.9 * largest, format!("{:+.1} %", -90.0 * largest)),
        HEIGHT - 20.0,
        WIDTH - 10.0,
        HEIGHT - 20.0,
        0.5 * (WIDTH + LEFT),
        HEIGHT - 6.0,
        axis.name
    )
}
