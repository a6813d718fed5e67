//! `report.html`: one self-contained page that shows what was recovered and how well it explains the photographs.

mod chart;
mod chosen;
pub(crate) mod pictures;
pub mod radiance;
mod sections;
pub(crate) mod text;
mod viewer;

use crate::{capture::Capture, image_io::ImageIoError, reconstruction::Reconstruction};

/// The look of every page of the house.
pub(crate) const STYLE: &str = include_str!("report/style.css");

/// What the page says beyond the reconstruction itself.
#[derive(Clone, Debug, Default)]
pub struct ReportOptions {
    /// The command that repeats the run.
    pub command: String,
    /// Most frames whose photographs are embedded, evenly spread; all masks are shown.
    pub frames: usize,
}

impl ReportOptions {
    /// The page of a run repeated by `command`.
    pub fn new(command: impl Into<String>) -> Self {
        Self {
            command: command.into(),
            frames: 16,
        }
    }
}

/// The page as HTML, without references to anything outside itself.
///
/// # Errors
/// An image that PNG cannot hold.
pub fn html(
    capture: &Capture,
    reconstruction: &Reconstruction,
    options: &ReportOptions,
) -> Result<String, ImageIoError> {
    let page = sections::Page::new(capture, reconstruction, options);
    let frames = page.frames()?;
    let title = text::escaped(&page.title());
    let body = [
        page.header(),
        page.frame_section(&frames),
        page.viewer_section(),
        page.environment_section()?,
        page.occluder_section()?,
        page.numbers_section(),
    ];
    // A closing tag inside the data would end the script element.
    let data = page.data(&frames).to_string().replace('<', "\\u003c");
    Ok(format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width\">\n<title>{title}</title>\n<style>\n{style}</style>\n\
         </head>\n<body>\n{body}<footer>Written by eclipse {version}. Radiance is linear and scene-referred; light and \
         albedo share one unknown scale per channel.</footer>\n\
         <script type=\"application/json\" id=\"data\">{data}</script>\n<script>\n{script}</script>\n{viewer}</body>\n</html>\n",
        style = STYLE,
        script = include_str!("report/script.js"),
        viewer = page.viewer_script(),
        body = body.concat(),
        version = env!("CARGO_PKG_VERSION"),
    ))
}
