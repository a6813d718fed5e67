//! The loss curve as inline SVG.

use std::fmt::Write;

use super::text::number;
use crate::reconstruction::CurvePoint;

const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 240.0;
const LEFT: f64 = 56.0;
const BOTTOM: f64 = 34.0;
/// More points than this cannot be told apart at the chart's width.
const MOST_POINTS: usize = 1000;

/// Loss over seconds; logarithmic when it spans more than a decade. Empty when there are not two finite points.
pub(super) fn loss_curve(curve: &[CurvePoint]) -> String {
    let points: Vec<(f64, f64)> = curve
        .iter()
        .filter(|point| point.loss.is_finite() && point.seconds.is_finite())
        .map(|point| (point.seconds, point.loss))
        .collect();
    if points.len() < 2 {
        return String::new();
    }
    let range = |values: &mut dyn Iterator<Item = f64>| {
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
            (low.min(v), high.max(v))
        })
    };
    let (low, high) = range(&mut points.iter().map(|point| point.1));
    let logarithmic = low > 0.0 && high / low > 10.0;
    let ticks = if logarithmic {
        decades(low, high)
    } else {
        linear_ticks(low, high)
    };
    let (low, high) = (low.min(ticks[0]), high.max(ticks[ticks.len() - 1]));
    let scale = |value: f64| if logarithmic { value.log10() } else { value };
    let span = (scale(high) - scale(low)).max(f64::MIN_POSITIVE);
    let y = |value: f64| (HEIGHT - BOTTOM) * (1.0 - (scale(value) - scale(low)) / span) + 6.0;
    let (start, end) = range(&mut points.iter().map(|point| point.0));
    let x =
        |value: f64| LEFT + (WIDTH - LEFT) * (value - start) / (end - start).max(f64::MIN_POSITIVE);

    let mut svg = format!(
        r#"<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="Loss over seconds">"#
    );
    for tick in &ticks {
        let _ = write!(
            svg,
            r#"<line class="grid" x1="{LEFT}" x2="{WIDTH}" y1="{y:.1}" y2="{y:.1}"/><text x="{x}" y="{text:.1}" text-anchor="end">{label}</text>"#,
            y = y(*tick),
            x = LEFT - 8.0,
            text = y(*tick) + 4.0,
            label = number(*tick),
        );
    }
    for tick in linear_ticks(start, end)
        .iter()
        .filter(|tick| (start..=end).contains(*tick))
    {
        let _ = write!(
            svg,
            r#"<text x="{:.1}" y="{:.1}" text-anchor="middle">{} s</text>"#,
            x(*tick),
            HEIGHT - 8.0,
            number(*tick),
        );
    }
    let step = points.len().div_ceil(MOST_POINTS);
    let last = points.len() - 1;
    let kept = points
        .iter()
        .enumerate()
        .filter(|(index, _)| index % step == 0 || *index == last);
    let path: Vec<String> = kept
        .map(|(_, &(seconds, loss))| format!("{:.1},{:.1}", x(seconds), y(loss)))
        .collect();
    let _ = write!(
        svg,
        r#"<polyline class="curve" points="{}"/></svg>"#,
        path.join(" ")
    );
    svg
}

/// Powers of ten around the range, no more than about six.
fn decades(low: f64, high: f64) -> Vec<f64> {
    let (from, to) = (low.log10().floor() as i32, high.log10().ceil() as i32);
    let step = ((to - from) / 6 + 1) as usize;
    (from..=to + step as i32 - 1)
        .step_by(step)
        .map(|power| 10f64.powi(power))
        .collect()
}

/// Round values around the range, about five.
fn linear_ticks(low: f64, high: f64) -> Vec<f64> {
    let span = (high - low).max(high.abs() * 1e-6).max(f64::MIN_POSITIVE);
    let power = 10f64.powf((span / 4.0).log10().floor());
    let factors = [1.0, 2.0, 5.0, 10.0];
    let step = factors
        .into_iter()
        .map(|f| f * power)
        .find(|step| span / step <= 5.0)
        .unwrap_or(span);
    let (from, to) = ((low / step).floor() as i64, (high / step).ceil() as i64);
    (from..=to.max(from + 1))
        .map(|tick| tick as f64 * step)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(losses: &[f64]) -> Vec<CurvePoint> {
        let point = |(index, &loss): (usize, &f64)| CurvePoint {
            iteration: index as u64,
            seconds: index as f64,
            loss,
            samples_per_second: 1e6,
        };
        losses.iter().enumerate().map(point).collect()
    }

    #[test]
    fn a_falling_loss_goes_from_top_left_to_bottom_right() {
        let svg = loss_curve(&curve(&[100.0, 10.0, 1.0]));
        // 206 units of height start at 6: decades lie 103 apart.
        assert!(
            svg.contains(r#"points="56.0,6.0 308.0,109.0 560.0,212.0""#),
            "{svg}"
        );
    }

    #[test]
    fn values_that_are_not_finite_are_left_out_and_too_few_give_nothing() {
        assert_eq!(loss_curve(&curve(&[f64::NAN, 1.0])), "");
        assert!(!loss_curve(&curve(&[3.0, f64::NAN, 1.0, f64::INFINITY])).contains("NaN"));
    }

    #[test]
    fn constant_and_negative_losses_are_drawn() {
        for losses in [[0.0; 3], [2.0; 3], [-1.0, -2.0, -3.0]] {
            let svg = loss_curve(&curve(&losses));
            assert!(
                svg.contains("polyline") && !svg.contains("NaN") && !svg.contains("inf"),
                "{svg}"
            );
        }
    }

    #[test]
    fn long_curves_are_thinned_but_keep_their_end() {
        let losses: Vec<f64> = (0..100_000).map(|i| 1.0 + f64::from(100_000 - i)).collect();
        let svg = loss_curve(&curve(&losses));
        assert!(svg.len() < 30_000);
        assert!(svg.contains("560.0,"));
    }
}
