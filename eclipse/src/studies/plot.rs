//! Charts as SVG.

use plotters::{
    coord::{
        combinators::{LogCoord, WithKeyPoints},
        ranged1d::{AsRangedCoord, ValueFormatter},
    },
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

use super::{
    StudyError,
    evidence::{Axis, Chart, Series},
};
use crate::report::text::number;

const SIZE: (u32, u32) = (820, 440);
/// Room on the right for the legend.
const LEGEND: i32 = 170;
/// Axes and words: readable on light and dark pages.
const INK: RGBColor = RGBColor(120, 128, 138);
/// Colours that stay apart for colour-blind readers (Okabe and Ito 2008, without yellow and black).
const COLOURS: [RGBColor; 6] = [
    RGBColor(213, 94, 0),
    RGBColor(230, 159, 0),
    RGBColor(0, 158, 115),
    RGBColor(86, 180, 233),
    RGBColor(0, 114, 178),
    RGBColor(204, 121, 167),
];

/// The chart as an SVG element that stands alone.
pub(super) fn svg(name: &str, chart: &Chart) -> Result<String, StudyError> {
    let mut text = String::new();
    let drawn = {
        let root = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
        let (x, y) = (drawable(&chart.x), drawable(&chart.y));
        // The kinds of axes differ in type.
        match (chart.x.logarithmic, chart.y.logarithmic) {
            (false, false) => draw(&root, chart, x[0]..x[1], y[0]..y[1]),
            (false, true) => draw(&root, chart, x[0]..x[1], by_ratios(y)),
            (true, false) => draw(&root, chart, by_ratios(x), y[0]..y[1]),
            (true, true) => draw(&root, chart, by_ratios(x), by_ratios(y)),
        }
        .and_then(|()| root.present().map_err(|e| e.to_string()))
    };
    drawn.map_err(|reason| StudyError::Plot {
        name: name.to_owned(),
        reason,
    })?;
    Ok(scalable(&text))
}

/// A logarithmic axis.
fn by_ratios([low, high]: [f64; 2]) -> WithKeyPoints<LogCoord<f64>> {
    (low..high).log_scale().with_key_points(marks([low, high]))
}

/// Where such an axis is marked: at powers of ten and, where few of them are on it, at their double and fivefold too.
fn marks([low, high]: [f64; 2]) -> Vec<f64> {
    let decades = (high / low).log10();
    let within_decade: &[f64] = if decades < 2.5 {
        &[1.0, 2.0, 5.0]
    } else {
        &[1.0]
    };
    // No more than about eight, however long it is.
    let every = (decades / 8.0).ceil().max(1.0) as i32;
    let powers =
        (low.log10().floor() as i32..=high.log10().ceil() as i32).filter(|p| p % every == 0);
    let marks: Vec<f64> = powers
        .flat_map(|power| within_decade.iter().map(move |m| m * 10f64.powi(power)))
        .filter(|mark| (low..=high).contains(mark))
        .collect();
    if marks.len() < 2 {
        return vec![low, high];
    }
    marks
}

fn draw<X, Y>(
    root: &DrawingArea<SVGBackend<'_>, plotters::coord::Shift>,
    chart: &Chart,
    x: X,
    y: Y,
) -> Result<(), String>
where
    X: AsRangedCoord<Value = f64>,
    Y: AsRangedCoord<Value = f64>,
    X::CoordDescType: ValueFormatter<f64>,
    Y::CoordDescType: ValueFormatter<f64>,
{
    let mut context = ChartBuilder::on(root)
        .margin(10)
        .margin_right(LEGEND)
        .x_label_area_size(44)
        .y_label_area_size(70)
        .build_cartesian_2d(x, y)
        .map_err(|e| e.to_string())?;
    let small = ("sans-serif", 13).into_font().color(&INK);
    let label = |value: &f64| number(*value).replace(".00e", "e");
    context
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(INK.mix(0.25))
        .axis_style(INK)
        .x_labels(9)
        .y_labels(8)
        .x_desc(chart.x.label.as_str())
        .y_desc(chart.y.label.as_str())
        .x_label_formatter(&label)
        .y_label_formatter(&label)
        .label_style(small.clone())
        .axis_desc_style(small.clone())
        .draw()
        .map_err(|e| e.to_string())?;
    let labels = labels(&chart.series);
    for series in &chart.series {
        let index = labels.iter().position(|label| *label == series.label);
        let colour = COLOURS[index.unwrap_or_default() % COLOURS.len()];
        let points = series.points.iter().copied();
        let shown = points.filter(|p| within(p[0], &chart.x) && within(p[1], &chart.y));
        if series.dots {
            let dots = shown.map(|p| Circle::new((p[0], p[1]), 2, colour.mix(0.5).filled()));
            context.draw_series(dots).map_err(|e| e.to_string())?;
        } else {
            let style = colour.stroke_width(2);
            let line = LineSeries::new(shown.map(|p| (p[0], p[1])), style);
            context.draw_series(line).map_err(|e| e.to_string())?;
        }
    }
    legend(root, &labels, &small).map_err(|e| e.to_string())
}

/// What the legend names, each once: seeds of one thing share a label and a colour.
fn labels(series: &[Series]) -> Vec<&str> {
    let mut labels: Vec<&str> = Vec::new();
    for series in series {
        if !labels.contains(&series.label.as_str()) {
            labels.push(&series.label);
        }
    }
    labels
}

/// Right of the plot, where it hides nothing.
fn legend(
    root: &DrawingArea<SVGBackend<'_>, plotters::coord::Shift>,
    labels: &[&str],
    small: &TextStyle<'_>,
) -> Result<(), Box<dyn std::error::Error>> {
    let left = SIZE.0 as i32 - LEGEND + 12;
    let style = small.clone().pos(Pos::new(HPos::Left, VPos::Center));
    for (index, label) in labels.iter().enumerate() {
        let colour = COLOURS[index % COLOURS.len()];
        let y = 24 + 20 * index as i32;
        let box_of = [(left, y - 2), (left + 16, y + 2)];
        root.draw(&Rectangle::new(box_of, colour.filled()))?;
        root.draw(&Text::new(*label, (left + 24, y), style.clone()))?;
    }
    Ok(())
}

/// The range of an axis, or one that can be drawn in its place: ends that are apart, finite and, where logarithms are taken,
/// positive. A logarithmic axis from zero would have no end of marks.
fn drawable(axis: &Axis) -> [f64; 2] {
    let [a, b] = axis.range;
    if axis.logarithmic {
        let sound = |v: f64| v.is_finite() && v > 0.0;
        return match (sound(a), sound(b)) {
            (true, true) if a != b => [a, b],
            (true, _) => [a, 10.0 * a],
            (false, true) => [1e-3 * b, b],
            (false, false) => [1e-3, 1.0],
        };
    }
    match (a.is_finite(), b.is_finite()) {
        (true, true) if a != b => [a, b],
        (true, _) => [a, a + 1.0],
        (false, true) => [b - 1.0, b],
        (false, false) => [0.0, 1.0],
    }
}

/// Whether a value can be drawn: a logarithm needs positive ones, and what lies outside would be drawn over the words.
fn within(value: f64, axis: &Axis) -> bool {
    let [a, b] = drawable(axis);
    value >= a.min(b) && value <= a.max(b)
}

/// The picture's size as a view box, so that pages may scale it.
fn scalable(svg: &str) -> String {
    let fixed = format!("<svg width=\"{}\" height=\"{}\"", SIZE.0, SIZE.1);
    svg.replacen(&fixed, "<svg", 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(logarithmic: bool, points: Vec<[f64; 2]>) -> Chart {
        let axis = |range| match logarithmic {
            true => Axis::logarithmic("σ", range),
            false => Axis::linear("σ", range),
        };
        Chart {
            x: Axis::linear("k", [0.0, 2.0]),
            y: axis([1e-4, 1.0]),
            series: vec![Series::line("first", points)],
        }
    }

    /// Heights of the polyline's points.
    fn heights(svg: &str) -> Vec<f64> {
        let curve = svg.split("<polyline").find(|p| p.contains("#D55E00"));
        let points = curve.unwrap().split("points=\"").nth(1).unwrap();
        let points = points.split('"').next().unwrap();
        let pairs = points.split_whitespace();
        pairs
            .map(|p| p.split(',').nth(1).unwrap().parse().unwrap())
            .collect()
    }

    #[test]
    fn axes_without_a_sound_range_are_drawn_all_the_same() {
        for range in [
            [0.0, 1.0],
            [0.0, 0.0],
            [f64::NAN, 2.0],
            [1.0, f64::INFINITY],
            [3.0, 3.0],
        ] {
            for axis in [Axis::linear("σ", range), Axis::logarithmic("σ", range)] {
                let mut chart = chart(false, vec![[0.0, 1.0], [1.0, 2.0]]);
                chart.y = axis;
                let drawn = svg("test", &chart).unwrap();
                assert!(
                    drawn.len() < 100_000 && drawn.contains("</svg>"),
                    "{range:?}"
                );
            }
        }
    }

    #[test]
    fn a_logarithmic_axis_has_marks_however_short_it_is() {
        assert_eq!(marks([0.3, 1.7]), [0.5, 1.0]);
        assert_eq!(marks([1.1, 1.9]), [1.1, 1.9]);
        assert_eq!(marks([0.8, 30.0]), [1.0, 2.0, 5.0, 10.0, 20.0]);
        assert_eq!(marks([1e-3, 1.0]).len(), 4);
        assert!((3..=9).contains(&marks([1e-20, 1e10]).len()));
    }

    #[test]
    fn equal_ratios_are_equal_steps_on_a_logarithmic_axis_only() {
        let points = vec![[0.0, 1.0], [1.0, 1e-2], [2.0, 1e-4]];
        let ratio = |logarithmic| {
            let h = heights(&svg("test", &chart(logarithmic, points.clone())).unwrap());
            (h[1] - h[0]) / (h[2] - h[0])
        };
        assert!((ratio(true) - 0.5).abs() < 0.01);
        assert!((ratio(false) - 0.99).abs() < 0.01);
    }

    #[test]
    fn seeds_of_one_thing_share_a_colour_and_a_name() {
        let mut chart = chart(false, vec![[0.0, 0.1], [1.0, 0.2]]);
        let first = chart.series[0].clone();
        chart.series.push(first.of_seed(1));
        chart
            .series
            .push(Series::line("second", vec![[0.0, 0.3], [1.0, 0.4]]));
        let svg = svg("test", &chart).unwrap();
        let curves = |colour: &str| {
            let elements = svg.split("<polyline").skip(1);
            let of = |element: &&str| {
                element
                    .split("/>")
                    .next()
                    .is_some_and(|e| e.contains(colour))
            };
            elements.filter(of).count()
        };
        assert_eq!(svg.matches("first").count(), 1);
        assert_eq!((curves("#D55E00"), curves("#E69F00")), (2, 1), "{svg}");
    }

    #[test]
    fn what_cannot_be_drawn_is_left_out() {
        let points = vec![
            [0.0, 1.0],
            [0.5, 0.0],
            [1.0, f64::NAN],
            [1.5, 5.0],
            [2.0, 0.1],
        ];
        let svg = svg("test", &chart(true, points)).unwrap();
        assert_eq!(heights(&svg).len(), 2);
        assert!(svg.contains("first") && !svg.contains("NaN"));
    }
}
