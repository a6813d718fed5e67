//! A sweep as people see it: errors over what is varied, with somebody in the light and with nobody.

use super::Curve;
use crate::studies::evidence::{Axis, Chart, Content, Figure, Series};

/// The means as lines, and a dot a seed.
pub(super) fn figure(curve: &Curve) -> Figure {
    let sweep = &curve.sweep;
    let line = |label: &str, which: usize| {
        let points = sweep.points.iter().zip(curve.means(which));
        Series::line(label, points.map(|((x, _), y)| [*x, y]).collect())
    };
    let dots = |label: &str, which: usize| {
        let points = sweep.points.iter().zip(&curve.errors);
        let of_seeds = points.map(|((x, _), pairs)| (*x, pairs.iter().map(|p| p[which]).collect()));
        Series::dots_by_seed(label, of_seeds)
    };
    let xs = || sweep.points.iter().map(|p| p.0);
    let (low, high) = (xs().fold(f64::INFINITY, f64::min), xs().fold(0.0, f64::max));
    let ys = || curve.errors.iter().flatten().flatten().copied();
    let worst = 1.1 * ys().fold(0.0, f64::max).max(1e-3);
    Figure {
        name: sweep.name.to_owned(),
        caption: format!(
            "Relative MSE of the light over {}: a dot a seed, and means as lines.",
            sweep.label
        ),
        content: Content::Chart(Chart {
            x: match sweep.logarithmic {
                true => Axis::logarithmic(sweep.label, [0.9 * low, 1.1 * high]),
                false => Axis::linear(sweep.label, [0.0, 1.05 * high]),
            },
            y: Axis::linear("relative MSE of the light", [0.0, worst]),
            series: [
                vec![line("unseen occluder, mean", 0)],
                dots("unseen occluder", 0),
                vec![line("no occluder, mean", 1)],
                dots("no occluder", 1),
            ]
            .concat(),
        }),
    }
}
