//! What a study leaves in its folder: `study.html`, `summary.json`, and for each figure its pictures and `NAME.csv`.

use std::{fmt::Write as _, fs, io::Write as _, path::Path};

use base64::{Engine, engine::general_purpose::STANDARD};
use render::image::Image;

use super::{
    Evidence, StudyError,
    evidence::{Chart, Content, Figure, Picture, Tone},
    plot,
};
use crate::{
    files::atomic,
    image_io::{encode_png8, linear_to_srgb},
    report::{STYLE, text},
};

/// Name of the page within a study's folder.
pub const PAGE: &str = "study.html";
/// Name of the numbers within a study's folder.
pub const SUMMARY: &str = "summary.json";

/// Writes everything into a folder, the page last; it names the `command` that makes it again.
///
/// # Errors
/// A file that cannot be written, or a plot that cannot be drawn.
pub fn write(folder: &Path, evidence: &Evidence, command: &str) -> Result<(), StudyError> {
    fs::create_dir_all(folder)?;
    let mut figures = String::new();
    for figure in &evidence.figures {
        figures += &write_figure(folder, figure)?;
    }
    let summary = serde_json::to_string_pretty(&evidence.summary())? + "\n";
    put(&folder.join(SUMMARY), summary.as_bytes())?;
    let page = html(evidence, &figures, command);
    put(&folder.join(PAGE), page.as_bytes())
}

/// Writes a figure's files; its part of the page.
fn write_figure(folder: &Path, figure: &Figure) -> Result<String, StudyError> {
    let name = &figure.name;
    let caption = text::escaped(&figure.caption);
    let title = text::escaped(&figure.name.replace('-', " "));
    let (shown, data) = match &figure.content {
        Content::Chart(chart) if chart.series.iter().all(|s| s.points.is_empty()) => {
            return Ok(format!(
                "<h2>{title}</h2>\n<p>Not drawn: nothing was measured here.</p>\n"
            ));
        }
        Content::Chart(chart) => {
            let svg = plot::svg(name, chart)?;
            put(&folder.join(format!("{name}.svg")), svg.as_bytes())?;
            (svg, chart_csv(chart))
        }
        Content::Pictures(pictures) => {
            let mut cells = String::new();
            for (index, picture) in pictures.iter().enumerate() {
                let path = folder.join(format!("{name}-{index}.png"));
                let png = encode_png8(&toned(picture), &path)?;
                put(&path, &png)?;
                let _ = write!(
                    cells,
                    "<figure><img alt=\"\" src=\"data:image/png;base64,{}\"><figcaption>{}</figcaption></figure>",
                    STANDARD.encode(&png),
                    text::escaped(&picture.label)
                );
            }
            (
                format!("<div class=\"row\">{cells}</div>"),
                pictures_csv(pictures),
            )
        }
    };
    put(&folder.join(format!("{name}.csv")), data.as_bytes())?;
    Ok(format!(
        "<h2>{title}</h2>\n<p>{caption}</p>\n{shown}\n<p><small>Data: {name}.csv</small></p>\n"
    ))
}

fn html(evidence: &Evidence, figures: &str, command: &str) -> String {
    let paragraphs = |of: &[String]| -> String {
        of.iter()
            .map(|words| format!("<p>{}</p>\n", text::escaped(words)))
            .collect()
    };
    let (details, notes) = (paragraphs(&evidence.details), paragraphs(&evidence.notes));
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width\">\n<title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n\
         <header>\n<p class=\"summary\"><b>{verdict}</b>: {sentence}</p>\n<p class=\"kicker\">{source}</p>\n<h1>{title}</h1>\n\
         <p>The claim: {claim}</p>\n</header>\n{details}{figures}<h2>Numbers</h2>\n{numbers}\n<h2>How</h2>\n{notes}\
         <footer>Written by eclipse {version}; <code>{command}</code> makes it again.</footer>\n</body>\n</html>\n",
        title = text::escaped(evidence.title),
        verdict = evidence.verdict.words(),
        sentence = text::escaped(&evidence.sentence),
        source = text::escaped(evidence.source),
        claim = text::escaped(evidence.claim),
        numbers = text::table(&evidence.numbers),
        version = env!("CARGO_PKG_VERSION"),
        command = text::escaped(command),
    )
}

/// A line a point; with its seed where a series has one.
fn chart_csv(chart: &Chart) -> String {
    let seeded = chart.series.iter().any(|series| series.seed.is_some());
    let mut csv = format!(
        "series,{}{},{}\n",
        if seeded { "seed," } else { "" },
        quoted(&chart.x.label),
        quoted(&chart.y.label)
    );
    for series in &chart.series {
        let label = quoted(&series.label);
        let seed = match series.seed {
            Some(seed) => format!("{seed},"),
            None if seeded => ",".to_owned(),
            None => String::new(),
        };
        for [x, y] in &series.points {
            let _ = writeln!(csv, "{label},{seed}{x},{y:e}");
        }
    }
    csv
}

/// A line a pixel; a column a channel, empty where a picture has fewer than another.
fn pictures_csv(pictures: &[Picture]) -> String {
    let most = pictures.iter().map(|picture| picture.values.channels).max();
    let most = most.unwrap_or(0);
    let names = match most {
        1 => "value".to_owned(),
        3 => "r,g,b".to_owned(),
        n => (0..n)
            .map(|c| format!("channel {c}"))
            .collect::<Vec<_>>()
            .join(","),
    };
    let mut csv = format!("picture,row,column,{names}\n");
    for picture in pictures {
        let label = quoted(&picture.label);
        let image = &picture.values;
        for (p, values) in image.data.chunks_exact(image.channels).enumerate() {
            let (row, column) = (p / image.width, p % image.width);
            let _ = write!(csv, "{label},{row},{column}");
            for value in values {
                let _ = write!(csv, ",{value}");
            }
            csv.push_str(&",".repeat(most - values.len()));
            csv.push('\n');
        }
    }
    csv
}

/// A field of a CSV file (RFC 4180).
fn quoted(field: &str) -> String {
    if field.contains([',', '"', '\n']) {
        format!("\"{}\"", field.replace('"', "\"\""))
    } else {
        field.to_owned()
    }
}

/// A picture as it is shown.
fn toned(picture: &Picture) -> Image {
    let values = &picture.values;
    let mut image = Image::filled(values.width, values.height, 3, 0.0);
    let pixels = values.data.chunks_exact(values.channels);
    for (out, pixel) in image.data.chunks_exact_mut(3).zip(pixels) {
        let colour = match picture.tone {
            Tone::Light { white } => {
                [0, 1, 2].map(|c| linear_to_srgb((pixel[c % pixel.len()] / white).min(1.0)))
            }
            Tone::Heat { low, high } => heat(((pixel[0] - low) / (high - low)).clamp(0.0, 1.0)),
        };
        out.copy_from_slice(&colour);
    }
    image
}

/// Blue at 0, pale in the middle, red at 1.
fn heat(x: f32) -> [f32; 3] {
    const STOPS: [[f32; 3]; 5] = [
        [0.13, 0.25, 0.55],
        [0.45, 0.68, 0.85],
        [0.97, 0.96, 0.92],
        [0.95, 0.55, 0.38],
        [0.65, 0.06, 0.13],
    ];
    let place = x * (STOPS.len() - 1) as f32;
    let index = (place as usize).min(STOPS.len() - 2);
    let part = place - index as f32;
    [0, 1, 2].map(|c| STOPS[index][c] + part * (STOPS[index + 1][c] - STOPS[index][c]))
}

fn put(path: &Path, bytes: &[u8]) -> Result<(), StudyError> {
    Ok(atomic::write(path, |file| file.write_all(bytes))?)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::{
        super::{
            Verdict,
            evidence::{Axis, Series},
        },
        *,
    };

    fn evidence() -> Evidence {
        let chart = Chart {
            x: Axis::linear("k, index", [0.0, 1.0]),
            y: Axis::logarithmic("σ", [1e-3, 1.0]),
            series: vec![Series::line("a \"b\"", vec![[0.0, 1.0], [1.0, 0.01]])],
        };
        let picture = Picture {
            label: "map".into(),
            values: Image {
                width: 2,
                height: 1,
                channels: 1,
                data: vec![0.0, 1.0],
            },
            tone: Tone::Heat {
                low: 0.0,
                high: 1.0,
            },
        };
        let figure = |name: &str, content| Figure {
            name: name.into(),
            caption: "x < y".into(),
            content,
        };
        Evidence {
            name: "test",
            title: "A test",
            source: "Fig. 0",
            claim: "1 < 2",
            verdict: Verdict::of(&[true, false]),
            sentence: "one of two".into(),
            numbers: json!({"ratio": 0.5}),
            figures: vec![
                figure("curve", Content::Chart(chart)),
                figure("maps", Content::Pictures(vec![picture])),
            ],
            details: Vec::new(),
            notes: vec!["how".into()],
        }
    }

    #[test]
    fn a_study_leaves_a_page_its_numbers_plots_and_their_data() {
        let folder = tempfile::tempdir().unwrap();
        let command = "eclipse study test --captures 'a & b'";
        write(folder.path(), &evidence(), command).unwrap();
        let read = |name: &str| fs::read_to_string(folder.path().join(name)).unwrap();
        let page = read(PAGE);
        let body = page.split("<body>").nth(1).unwrap();
        let first = body.trim_start().lines().nth(1).unwrap();
        assert!(
            first.contains("held here in part</b>: one of two"),
            "{first}"
        );
        assert!(page.contains("x &lt; y") && page.contains("1 &lt; 2"));
        assert!(
            page.contains("<code>eclipse study test --captures 'a &amp; b'</code> makes it again")
        );
        assert!(!page.contains("src=\"http") && !page.contains("href"));
        assert_eq!(
            read("curve.csv"),
            "series,\"k, index\",σ\n\"a \"\"b\"\"\",0,1e0\n\"a \"\"b\"\"\",1,1e-2\n"
        );
        assert_eq!(
            read("maps.csv"),
            "picture,row,column,value\nmap,0,0,0\nmap,0,1,1\n"
        );
        assert!(
            read("curve.svg").contains("viewBox") && folder.path().join("maps-0.png").is_file()
        );
        let summary: serde_json::Value = serde_json::from_str(&read(SUMMARY)).unwrap();
        assert_eq!(summary["verdict"], "held_in_part");
        assert_eq!(summary["numbers"]["ratio"], 0.5);
    }

    #[test]
    fn every_channel_of_a_picture_has_its_column() {
        let picture = |label: &str, channels: usize| {
            let image = Image::filled(1, 1, channels, 0.5);
            Picture::light(label, &image, 1.0)
        };
        assert_eq!(
            pictures_csv(&[picture("light", 3), picture("mask", 1)]),
            "picture,row,column,r,g,b\nlight,0,0,0.5,0.5,0.5\nmask,0,0,0.5,,\n"
        );
    }

    #[test]
    fn seeds_stand_beside_the_points_that_have_one() {
        let chart = Chart {
            x: Axis::linear("x", [0.0, 1.0]),
            y: Axis::linear("y", [0.0, 1.0]),
            series: vec![
                Series::line("a", vec![[0.0, 1.0]]).of_seed(2),
                Series::dots("b", vec![[1.0, 0.5]]),
            ],
        };
        assert_eq!(chart_csv(&chart), "series,seed,x,y\na,2,0,1e0\nb,,1,5e-1\n");
    }

    #[test]
    fn small_is_blue_and_large_is_red() {
        let ([r0, _, b0], [r1, _, b1]) = (heat(0.0), heat(1.0));
        assert!(b0 > r0 && r1 > b1);
    }
}
