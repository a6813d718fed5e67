//! Hot spots on the page: where they are in their frames, and in which frames.

use std::path::Path;

use super::{
    diagnose::Outcome,
    locate::HotSpot,
    page::escaped,
    plot::{self, Shown},
};
use crate::image_io::{ImageIoError, reduce, reduced_size};

/// Longest side of a picture of a whole frame, pixels.
const SIDE: usize = 128;
/// Significance from which on a frame's mark is fully coloured.
const FULL: f64 = 20.0;
/// Width of the strip of frames and height of each of its two rows.
const STRIP: [f64; 2] = [500.0, 18.0];

/// The strip of frames and the tables of before and after; `shown` says how photographs look.
///
/// # Errors
/// An image that cannot be encoded, which would be a bug.
pub fn section(outcome: &Outcome<'_>, shown: &Shown) -> Result<String, ImageIoError> {
    let d = &outcome.diagnosis;
    let [before, after] = [&d.hot_spots, &d.hot_spots_after];
    let mut text = "<h2>Where they differ</h2>".to_owned();
    if before.is_empty() && after.is_empty() {
        return Ok(text + "<p>Nowhere beyond noise.</p>");
    }
    text += &strip(outcome.study.seen.frames, [before, after]);
    for (title, spots) in [("Most, before", before), ("Most, after", after)] {
        if spots.is_empty() {
            text += &format!("<h3>{title}</h3><p>Nowhere beyond noise.</p>");
            continue;
        }
        let mut rows = String::new();
        for (k, spot) in spots.iter().enumerate() {
            let frame = &outcome.study.capture.frames[spot.frame];
            let size = [frame.image.width, frame.image.height];
            let small = reduce(&frame.image, reduced_size(size, SIDE));
            let picture = plot::picture(&small, |p| shown.photograph(p))?;
            let boxed = plot::boxed(&picture, size, &[spot.pixels]);
            rows += &row(k + 1, spot, &boxed, &frame.name);
        }
        text += &format!(
            "<h3>{title}</h3><table><tr><th></th><th>place</th><th>frame</th><th>pixels</th><th>surface</th><th>mean residual</th>\
             <th>relative</th><th>shared by neighbours</th></tr>{rows}</table>"
        );
    }
    Ok(text)
}

fn row(rank: usize, spot: &HotSpot, picture: &str, name: &str) -> String {
    let [l, t, r, b] = spot.pixels;
    let [x, y, z] = spot.surface_point;
    let shared = spot
        .shared
        .map_or("–".into(), |shared| format!("{shared:+.2} σ²"));
    let file = Path::new(name).file_name().unwrap_or_default();
    format!(
        "<tr><td>{rank}</td><td>{picture}</td><td>{} <small>{}</small></td><td>{l:.0}–{r:.0} × {t:.0}–{b:.0}</td>\
         <td>({x:.2}, {y:.2}, {z:.2})</td><td>{:+.1} σ</td><td>{:+.1} ± {:.1} %</td><td>{shared}</td></tr>",
        spot.frame,
        escaped(&file.to_string_lossy()),
        spot.sigma,
        100.0 * spot.relative,
        100.0 * spot.relative_error(),
    )
}

/// All frames in a row, before above and after below; coloured where hot spots are.
fn strip(frames: usize, spots: [&Vec<HotSpot>; 2]) -> String {
    let [width, height] = STRIP;
    let left = 50.0;
    let each = (width - left) / frames.max(1) as f64;
    let mut cells = String::new();
    for (k, (spots, label)) in spots.into_iter().zip(["before", "after"]).enumerate() {
        let top = k as f64 * (height + 2.0);
        cells += &format!("<text x=\"0\" y=\"{:.0}\">{label}</text>", top + 13.0);
        for t in 0..frames {
            // The first is the strongest.
            let strongest = spots.iter().find(|spot| spot.frame == t);
            let (colour, title) = match strongest {
                None => ("#eee".to_owned(), format!("frame {t}")),
                Some(spot) => {
                    let share = (spot.sigma / FULL).clamp(-1.0, 1.0).abs();
                    let hue = if spot.sigma > 0.0 {
                        "194,65,12"
                    } else {
                        "29,78,216"
                    };
                    (
                        format!("rgba({hue},{:.2})", 0.3 + 0.7 * share),
                        format!("frame {t}: {:+.1} σ", spot.sigma),
                    )
                }
            };
            cells += &format!(
                "<rect x=\"{:.1}\" y=\"{top:.0}\" width=\"{:.1}\" height=\"{height}\" fill=\"{colour}\"><title>{title}</title></rect>",
                left + t as f64 * each,
                (0.9 * each).max(0.5)
            );
        }
    }
    let bottom = 2.0 * (height + 2.0) + 12.0;
    format!(
        "<p>Frames in order, each in the colour of its strongest hot spot: red where the photograph is brighter, blue where it is darker.</p>\
         <svg class=\"strip\" width=\"{width}\" height=\"{:.0}\" font-size=\"11\" role=\"img\">{cells}\
         <text x=\"{left}\" y=\"{bottom:.0}\">0</text><text x=\"{width}\" y=\"{bottom:.0}\" text-anchor=\"end\">{}</text></svg>\n",
        bottom + 4.0,
        frames.saturating_sub(1)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_with_hot_spots_are_marked() {
        let spot = |frame, sigma| HotSpot {
            frame,
            name: String::new(),
            pixels: [0.0, 0.0, 8.0, 8.0],
            surface_point: [0.0; 3],
            sigma,
            relative: 0.02,
            shared: None,
        };
        let before = vec![spot(2, 30.0), spot(4, -10.0), spot(2, -5.0)];
        let svg = strip(6, [&before, &Vec::new()]);
        assert_eq!(svg.matches("<rect").count(), 12);
        assert_eq!(svg.matches("#eee").count(), 10);
        assert!(svg.contains("rgba(194,65,12,1.00)") && svg.contains("rgba(29,78,216,0.65)"));
        assert!(svg.contains("frame 2: +30.0 σ"));
        assert!(row(1, &before[0], "", "a&b").contains("+2.0 ± 0.1 %"));
    }
}
