//! Pictures of the page: residuals along an axis as SVG, with the band that a null would stay in, and images as PNG, with boxes on them.

use std::path::Path;

use base64::{Engine, engine::general_purpose::STANDARD};
use render::image::Image;

use super::axes::Axis;
use crate::image_io::{ImageIoError, encode_png8, linear_to_srgb};

const WIDTH: f64 = 500.0;
const LEFT: f64 = 52.0;
/// Height of the panels: mean residuals, and what neighbours share.
const HEIGHTS: [f64; 2] = [156.0, 74.0];
const BOTTOM: f64 = 34.0;
const BEFORE: &str = "#c2410c";
const AFTER: &str = "#1d4ed8";

/// The plot of one axis.
pub fn axis(axis: &Axis) -> String {
    if axis.at.len() < 2 {
        return String::new();
    }
    let (low, high) = (axis.at[0], axis.at[axis.at.len() - 1]);
    let means = Panel {
        axis,
        top: 0.0,
        height: HEIGHTS[0],
        least: 0.002,
        values: [&axis.before, &axis.after],
        error: &axis.error,
        label: &|v| format!("{:+.1} %", 100.0 * v),
    };
    let shared = Panel {
        top: HEIGHTS[0],
        height: HEIGHTS[1],
        least: 0.1,
        values: [&axis.shared_before, &axis.shared_after],
        error: &axis.shared_error,
        label: &|v| format!("{v:+.2} σ²"),
        ..means
    };
    let height = HEIGHTS[0] + HEIGHTS[1] + BOTTOM;
    format!(
        "<svg width=\"{WIDTH}\" height=\"{height}\" font-size=\"11\" role=\"img\">{}{}\
         <text x=\"{LEFT}\" y=\"{:.0}\">{low:.2}</text><text x=\"{:.0}\" y=\"{:.0}\" text-anchor=\"end\">{high:.2}</text>\
         <text x=\"{:.0}\" y=\"{:.0}\" text-anchor=\"middle\">{}</text></svg>\n",
        means.draw(),
        shared.draw(),
        height - 20.0,
        WIDTH - 10.0,
        height - 20.0,
        0.5 * (WIDTH + LEFT),
        height - 6.0,
        axis.name
    )
}

/// What the plots show, for people.
pub fn legend() -> String {
    format!(
        "<p>Above: mean residual, <span style=\"color:{BEFORE}\">before</span> and <span style=\"color:{AFTER}\">after</span>. Below: what \
         neighbouring residuals share, in units of the noise's variance. Grey: ± 2 σ of a null. Dots: what stands out of chance by \
         either, all bins of all axes considered (false discoveries at 1 %).</p>"
    )
}

/// One scale of values over an axis.
#[derive(Clone, Copy)]
struct Panel<'a> {
    axis: &'a Axis,
    top: f64,
    height: f64,
    /// The scale reaches at least so far.
    least: f64,
    /// Before and after.
    values: [&'a [f64]; 2],
    error: &'a [f64],
    label: &'a dyn Fn(f64) -> String,
}

impl Panel<'_> {
    fn draw(&self) -> String {
        let axis = self.axis;
        let largest = self
            .values
            .into_iter()
            .flatten()
            .fold(self.least, |most, v| most.max(v.abs()))
            * 1.1;
        let (low, high) = (axis.at[0], axis.at[axis.at.len() - 1]);
        let x = |v: f64| LEFT + (v - low) / (high - low) * (WIDTH - LEFT - 10.0);
        let y = |v: f64| {
            let middle = self.top + 0.5 * self.height;
            middle - v.clamp(-largest, largest) / largest * 0.5 * (self.height - 8.0)
        };
        let point = |(a, v): (&f64, f64)| format!("{:.1},{:.1} ", x(*a), y(v));
        let upper = axis.at.iter().zip(self.error.iter().map(|e| 2.0 * e));
        let lower = axis.at.iter().zip(self.error.iter().map(|e| -2.0 * e));
        let band: String = upper.chain(lower.rev()).map(point).collect();
        let found = [&axis.found_before, &axis.found_after];
        let lines: String = self
            .values
            .into_iter()
            .zip([BEFORE, AFTER])
            .zip(found)
            .map(|((values, colour), found)| {
                let all = || axis.at.iter().zip(values.iter().copied());
                let line: String = all().map(point).collect();
                let dots: String = all()
                    .zip(found)
                    .filter(|(_, found)| **found)
                    .map(|((a, v), _)| {
                        format!("<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"2.6\" fill=\"{colour}\"/>", x(*a), y(v))
                    })
                    .collect();
                format!(
                    "<polyline points=\"{line}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.6\"/>{dots}"
                )
            })
            .collect();
        let labels: String = [0.9 * largest, 0.0, -0.9 * largest]
            .into_iter()
            .map(|v| {
                let text = if v == 0.0 {
                    "0".into()
                } else {
                    (self.label)(v)
                };
                format!(
                    "<text x=\"{:.0}\" y=\"{:.0}\" text-anchor=\"end\">{text}</text>",
                    LEFT - 5.0,
                    y(v) + 4.0
                )
            })
            .collect();
        format!(
            "<polygon points=\"{band}\" fill=\"#e5e7eb\"/><line x1=\"{LEFT}\" x2=\"{:.0}\" y1=\"{:.1}\" y2=\"{:.1}\" stroke=\"#999\"/>{lines}{labels}",
            WIDTH - 10.0,
            y(0.0),
            y(0.0)
        )
    }
}

/// An image inside the page; `of` says what a pixel looks like, sRGB.
///
/// # Errors
/// An image that PNG cannot hold.
pub fn picture(image: &Image, of: impl Fn(&[f32]) -> [f32; 3]) -> Result<String, ImageIoError> {
    let mut display = Image::filled(image.width, image.height, 3, 0.0);
    for (out, pixel) in display
        .data
        .chunks_exact_mut(3)
        .zip(image.data.chunks_exact(image.channels))
    {
        out.copy_from_slice(&of(pixel));
    }
    let png = encode_png8(&display, Path::new("diagnosis.html"))?;
    Ok(format!(
        "<img alt=\"\" src=\"data:image/png;base64,{}\">",
        STANDARD.encode(png)
    ))
}

/// How photographs look on the page.
pub struct Shown {
    /// The value that is white.
    pub white: f32,
}

impl Shown {
    /// A pixel, sRGB.
    pub fn photograph(&self, pixel: &[f32]) -> [f32; 3] {
        [0, 1, 2].map(|c| linear_to_srgb(pixel[c] / self.white))
    }
}

/// A picture of a frame of `size` pixels with boxes on it: left, top, right, bottom, pixels of the frame.
pub fn boxed(picture: &str, size: [usize; 2], boxes: &[[f32; 4]]) -> String {
    let outline = |[left, top, right, bottom]: &[f32; 4]| {
        let across = |x: f32| 100.0 * x / size[0].max(1) as f32;
        let down = |y: f32| 100.0 * y / size[1].max(1) as f32;
        format!(
            "<span style=\"left:{:.1}%;top:{:.1}%;width:{:.1}%;height:{:.1}%\"></span>",
            across(*left),
            down(*top),
            across(right - left),
            down(bottom - top)
        )
    };
    let outlines: String = boxes.iter().map(outline).collect();
    format!("<div class=\"boxed\">{picture}{outlines}</div>")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_keep_their_place() {
        let html = boxed("<img>", [200, 100], &[[50.0, 25.0, 100.0, 75.0]]);
        let place = "left:25.0%;top:25.0%;width:25.0%;height:50.0%";
        assert!(html.contains(place), "{html}");
    }

    #[test]
    fn what_stands_out_has_a_dot_in_both_panels() {
        let plain = || vec![0.0, 0.01, 0.0];
        let shown = Axis {
            name: "frame",
            at: vec![0.0, 1.0, 2.0],
            before: plain(),
            after: plain(),
            error: vec![0.001; 3],
            shared_before: plain(),
            shared_after: plain(),
            shared_error: vec![0.001; 3],
            found_before: vec![false, true, false],
            found_after: vec![false; 3],
        };
        let svg = axis(&shown);
        assert_eq!(svg.matches("<circle").count(), 2);
        assert_eq!(svg.matches("<polyline").count(), 4);
        assert!(!svg.contains("NaN"));
        let single = Axis {
            at: vec![0.0],
            ..shown
        };
        assert_eq!(axis(&single), "");
    }
}
