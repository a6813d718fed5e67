//! The parts of the page, in reading order.

use render::image::Image;
use serde_json::{Value, json};

use super::{
    ReportOptions, chart, chosen, pictures,
    text::{self, duration, escaped, number, table},
    viewer::{self, Viewer},
};
use crate::{
    capture::{Capture, Frame},
    image_io::ImageIoError,
    reconstruction::Reconstruction,
    wording::{amount, counted},
};

/// Longest side of an embedded photograph in pixels.
const LONGEST_SIDE: usize = 320;
/// The share of a photograph's object that must not clip.
const PHOTOGRAPH_WHITE: f64 = 0.99;
/// The share of directions whose light must not clip: less, since small lights are far brighter than what they light.
const ENVIRONMENT_WHITE: f64 = 0.95;

/// The reconstruction with what all parts of the page share.
pub(super) struct Page<'a> {
    capture: &'a Capture,
    reconstruction: &'a Reconstruction,
    options: &'a ReportOptions,
    photograph_exposure: f32,
    environment_exposure: f32,
    agreement: Agreement,
    kappa_white: f32,
    /// The standard deviation of an albedo that is shown as white.
    doubt_white: f32,
    viewer: Option<Viewer>,
}

/// One frame's pictures by kind, as URIs.
pub(super) struct FramePictures {
    name: String,
    pictures: Vec<(&'static str, String)>,
}

/// Residuals over all object pixels.
struct Agreement {
    /// Root mean square, in units of radiance.
    rms: f64,
    /// Root mean square in standard deviations of the noise, where that is known.
    sigmas: Option<f64>,
}

impl<'a> Page<'a> {
    pub(super) fn new(
        capture: &'a Capture,
        reconstruction: &'a Reconstruction,
        options: &'a ReportOptions,
    ) -> Self {
        let images: Vec<&Image> = capture.frames.iter().map(|frame| &frame.image).collect();
        let photograph_exposure = pictures::exposure(&images, PHOTOGRAPH_WHITE, |frame, index| {
            capture.frames[frame]
                .mask
                .data
                .get(index)
                .is_some_and(|&coverage| coverage > 0.5)
        });
        let environment_exposure =
            pictures::exposure(&[&reconstruction.environment], ENVIRONMENT_WHITE, |_, _| {
                true
            });
        let agreement = agreement(capture, reconstruction);
        let kappa_white = pictures::kappa_white(reconstruction);
        Self {
            capture,
            reconstruction,
            options,
            photograph_exposure,
            environment_exposure,
            agreement,
            kappa_white,
            doubt_white: pictures::doubt_white(reconstruction),
            viewer: Viewer::new(capture, reconstruction, kappa_white),
        }
    }

    pub(super) fn title(&self) -> String {
        let name = self
            .capture
            .path
            .file_name()
            .unwrap_or(self.capture.path.as_os_str());
        name.to_string_lossy().into_owned()
    }

    /// What was done and how well it went, in one sentence, and what to know before trusting it.
    pub(super) fn header(&self) -> String {
        let solved = self.reconstruction;
        let frames = counted(self.capture.frames.len(), "photograph");
        let size = self
            .capture
            .frames
            .first()
            .map_or_else(String::new, |frame| {
                format!(
                    " of {} × {} pixels",
                    frame.camera.width, frame.camera.height
                )
            });
        let what = if solved.occluders.is_empty() {
            " and materials"
        } else {
            ", materials and what blocked the light of each photograph"
        };
        let iterations = solved.curve.last().map_or(0, |last| last.iteration);
        let iterations = counted(iterations as usize, "iteration");
        let psnr = solved.metrics.photometric.psnr;
        let agreement = [
            psnr.map(|psnr| format!("to {} dB", number(psnr))),
            self.agreement
                .sigmas
                .map(|sigmas| format!("to {} σ of the sensor's noise", number(sigmas))),
        ];
        let agreement: Vec<String> = agreement.into_iter().flatten().collect();
        let agreement = if agreement.is_empty() {
            format!("with an RMS residual of {}", number(self.agreement.rms))
        } else {
            agreement.join(", ")
        };
        let ended = text::ended(solved.ended);
        let notes = if solved.notes.is_empty() {
            String::new()
        } else {
            let items: String = solved
                .notes
                .iter()
                .map(|note| format!("<li>{}</li>", escaped(note)))
                .collect();
            format!("<aside aria-label=\"Notes\"><ul>{items}</ul></aside>\n")
        };
        format!(
            "<header>\n<p class=\"kicker\">Reconstruction</p>\n<h1>{title}</h1>\n<p class=\"summary\">Light{what} were \
             recovered from {frames}{size} in {time} ({iterations}, {ended}); the renders agree \
             with the photographs {agreement}.{doubt}{limit}</p>\n{notes}</header>\n",
            title = escaped(&self.title()),
            time = duration(solved.seconds()),
            doubt = self.doubt_in_words(),
            limit = text::limit(&solved.metrics),
        )
    }

    /// By how much the result is expected to be off. Lamps weigh most in it, and the prior lets their texels differ more than those of
    /// most lamps do: of even ones, errors are about half of what is told.
    fn doubt_in_words(&self) -> String {
        let doubt = self.reconstruction.uncertainty.as_ref();
        doubt.map_or(String::new(), |doubt| {
            format!(
                " If the model is right, light is expected to be off by {} of its RMS and albedo by {}, and by less where light is \
                 smoother than its prior allows.",
                number(doubt.summary.environment),
                number(doubt.summary.albedo)
            )
        })
    }

    /// The pictures of the frames that are embedded.
    pub(super) fn frames(&self) -> Result<Vec<FramePictures>, ImageIoError> {
        let settings = &self.reconstruction.settings;
        chosen::frames(self.capture.frames.len(), self.options.frames, |frame| {
            settings.holds_out(frame)
        })
        .into_iter()
        .map(|index| self.frame_pictures(index, &self.capture.frames[index]))
        .collect()
    }

    fn frame_pictures(&self, index: usize, frame: &Frame) -> Result<FramePictures, ImageIoError> {
        let solved = self.reconstruction;
        let small = |image: &Image| pictures::reduced(image, LONGEST_SIDE);
        let shown = |image: &Image| pictures::tonemapped(&small(image), self.photograph_exposure);
        let mut displays = vec![("photograph", shown(&frame.image))];
        if let Some(render) = solved.renders.get(index) {
            let (seen, model, mask) = (small(&frame.image), small(render), small(&frame.mask));
            displays.push(("render", shown(render)));
            let scale = self.agreement.rms.max(f64::MIN_POSITIVE) as f32;
            displays.push((
                "residual",
                pictures::residual(&seen, &model, &mask, solved.noise, scale),
            ));
        }
        if let Some(materials) = solved.materials.get(index) {
            let materials = small(materials);
            displays.push(("albedo", pictures::tonemapped(&materials, 1.0)));
            if !solved.settings.lambertian && materials.channels == 5 {
                displays.push(("alpha", pictures::grey(&materials, 3, 1.0)));
                displays.push(("kappa", pictures::grey(&materials, 4, self.kappa_white)));
            }
        }
        let doubt = solved.uncertainty.as_ref();
        if let Some(deviation) = doubt.and_then(|doubt| doubt.albedo.get(index)) {
            let shown = pictures::tonemapped(&small(deviation), 1.0 / self.doubt_white);
            displays.push(("albedo-sd", shown));
        }
        if let Some(mask) = solved.occluders.get(index) {
            displays.push((
                "occluder",
                pictures::blocked(&solved.environment, mask, self.environment_exposure),
            ));
        }
        let uri =
            |(kind, display): (&'static str, Image)| Ok((kind, pictures::data_uri(&display)?));
        let pictures = displays.into_iter().map(uri).collect::<Result<_, _>>()?;
        let name = match solved.settings.holds_out(index) {
            true => format!("{} (held out)", frame.name),
            false => frame.name.clone(),
        };
        Ok(FramePictures { name, pictures })
    }

    /// Photographs, renders, residuals, materials and mask of one frame at a time.
    pub(super) fn frame_section(&self, frames: &[FramePictures]) -> String {
        let Some(first) = frames.first() else {
            return String::new();
        };
        let unit = if self.reconstruction.noise.is_some() {
            "σ of the noise".to_owned()
        } else {
            format!("RMS residuals of {}", number(self.agreement.rms))
        };
        let (range, white) = (pictures::RESIDUAL_RANGE, self.kappa_white);
        let caption = |kind: &str| match kind {
            "photograph" => "Photograph".to_owned(),
            "residual" => format!(
                "Photograph − render, −{range} <span class=\"scale\" style=\"background:linear-gradient(90deg,#2166ab,#f5f5f5,#b2172b)\"></span> \
                 +{range} {unit}"
            ),
            "albedo" => "Albedo".to_owned(),
            "albedo-sd" => {
                format!(
                    "Standard deviation of the albedo, white at {}",
                    self.doubt_white
                )
            }
            "alpha" => "Roughness α, black 0 to white 1".to_owned(),
            "kappa" => format!("Reflectance κ head-on, black 0 to white {white}"),
            _ => "Light its occluder blocks (orange), over the environment".to_owned(),
        };
        let figure = |(kind, source): &(&str, String)| {
            format!(
                "<figure><img id=\"frame-{kind}\" src=\"{source}\" alt=\"{kind}\"><figcaption>{}</figcaption></figure>\n",
                caption(kind)
            )
        };
        let picture = |wanted: &str| first.pictures.iter().find(|(kind, _)| *kind == wanted);
        // Both in one frame with an edge to move between them; a photograph without a render stands alone.
        let both = picture("photograph").zip(picture("render"));
        let wipe = both.map_or(String::new(), |((_, photograph), (_, render))| {
            format!(
                "<figure><div class=\"wipe\"><img id=\"frame-render\" src=\"{render}\" alt=\"render\"><img id=\"frame-photograph\" \
                 src=\"{photograph}\" alt=\"photograph\"></div><input id=\"edge\" type=\"range\" min=\"0\" max=\"100\" value=\"50\" \
                 aria-label=\"edge between photograph and render\"><figcaption>Photograph, left of the edge; render, right of it\
                 </figcaption></figure>\n"
            )
        });
        let alone = |kind: &str| both.is_none() || !matches!(kind, "photograph" | "render");
        let rest = first.pictures.iter().filter(|(kind, _)| alone(kind));
        let figures: String = rest.map(figure).collect();
        format!(
            "<section>\n<h2>Photographs, renders and what is left</h2>\n<p>A good fit leaves noise without structure. \
             Red: the photograph is brighter than the render; blue: darker.</p>\n<div class=\"control\"><label for=\"frame\">\
             Frame</label><input id=\"frame\" type=\"range\" min=\"0\" max=\"{last}\" value=\"0\"><output id=\"frame-name\" \
             for=\"frame\">frame {name}</output></div>\n<div class=\"row\">\n{wipe}{figures}</div>\n</section>\n",
            last = frames.len() - 1,
            name = escaped(&first.name),
        )
    }

    /// The object in other light; nothing where no materials were recovered.
    pub(super) fn viewer_section(&self) -> String {
        self.viewer
            .as_ref()
            .map_or_else(String::new, Viewer::section)
    }

    /// The script element of the viewer, where there is one.
    pub(super) fn viewer_script(&self) -> String {
        self.viewer.as_ref().map_or_else(String::new, |_| {
            format!("<script>\n{}</script>\n", viewer::script())
        })
    }

    /// The recovered light, with an exposure to look into its highlights and shadows.
    pub(super) fn environment_section(&self) -> Result<String, ImageIoError> {
        let environment = &self.reconstruction.environment;
        let still = pictures::data_uri(&pictures::tonemapped(
            environment,
            self.environment_exposure,
        ))?;
        Ok(format!(
            "<section>\n<h2>Environment</h2>\n<p>Light from all directions: top is up (+z), the centre looks along +x, \
             azimuth falls to the right.</p>\n<div class=\"control\"><label for=\"exposure\">Exposure</label>\
             <input id=\"exposure\" type=\"range\" min=\"-6\" max=\"6\" step=\"0.5\" value=\"0\"><output id=\"stops\" \
             for=\"exposure\">0 stops</output></div>\n<figure class=\"wide\"><img id=\"environment-still\" src=\"{still}\" \
             alt=\"environment map\"><canvas id=\"environment\" width=\"{width}\" height=\"{height}\" hidden></canvas>\
             <figcaption>{width} × {height} texels, mean radiance {mean}</figcaption></figure>\n{doubt}\
             <p><output id=\"texel\">Point at a texel for its radiance.</output></p>\n</section>\n",
            width = environment.width,
            height = environment.height,
            mean = means(environment),
            doubt = self.environment_doubt()?,
        ))
    }

    /// How unsure each direction is.
    fn environment_doubt(&self) -> Result<String, ImageIoError> {
        let solved = self.reconstruction;
        let Some(doubt) = &solved.uncertainty else {
            return Ok(String::new());
        };
        let shown = pictures::doubt(&solved.environment, &doubt.environment);
        Ok(format!(
            "<figure class=\"wide\"><img id=\"environment-sd\" src=\"{}\" alt=\"standard deviation of the environment\">\
             <figcaption>Standard deviation beside radiance: black is sure, mid-grey unsure by the whole value, white by far more. By Laplace's \
             approximation, which takes the model and its shape, cameras and one bounce for granted; {} numbers are known from the \
             photographs rather than from what is assumed{}.</figcaption></figure>\n",
            pictures::data_uri(&shown)?,
            number(doubt.summary.known),
            text::unfinished(&doubt.summary),
        ))
    }

    /// All masks over the environment.
    pub(super) fn occluder_section(&self) -> Result<String, ImageIoError> {
        let solved = self.reconstruction;
        if solved.occluders.is_empty() {
            return Ok(String::new());
        }
        let mut figures = String::new();
        for (index, mask) in solved.occluders.iter().enumerate() {
            let display = pictures::blocked(&solved.environment, mask, self.environment_exposure);
            let name = self
                .capture
                .frames
                .get(index)
                .map_or("", |frame| frame.name.as_str());
            let doubt = solved.uncertainty.as_ref();
            let doubt = doubt.and_then(|doubt| doubt.summary.occluders.get(index).copied()?);
            let doubt = doubt.map_or(String::new(), |doubt| format!(" ± {}", number(doubt)));
            figures += &format!(
                "<figure><img loading=\"lazy\" src=\"{}\" alt=\"occluder\"><figcaption>{}{doubt}</figcaption></figure>\n",
                pictures::data_uri(&display)?,
                escaped(name)
            );
        }
        let doubted = match solved.uncertainty {
            Some(_) => "; ± the expected error of a mask, directions weighted by their light",
            None => "",
        };
        Ok(format!(
            "<section>\n<h2>Occluders</h2>\n<p>What stood in the way of the light while each photograph was taken, \
             orange, seen from the object's centre{doubted}.</p>\n<div class=\"strip\">\n{figures}</div>\n</section>\n"
        ))
    }

    /// Loss curve, metrics, settings and how to repeat the run.
    pub(super) fn numbers_section(&self) -> String {
        let solved = self.reconstruction;
        let json = |value: serde_json::Result<Value>| value.unwrap_or_default();
        let curve = match chart::loss_curve(&solved.curve) {
            svg if svg.is_empty() => String::new(),
            svg => format!("<h3>Loss</h3>\n<div class=\"wide\">{svg}</div>\n"),
        };
        let mut settings = json(serde_json::to_value(&solved.settings));
        settings["memory"] = json!(amount(solved.settings.memory));
        format!(
            "<section>\n<h2>How it was solved</h2>\n<p>To repeat the run:</p>\n<pre>{command}</pre>\n{curve}\
             <div class=\"split\">\n<div><h3>Metrics</h3>{metrics}</div>\n<div><h3>Settings</h3>{settings}</div>\n</div>\n</section>\n",
            command = escaped(&self.options.command),
            metrics = table(&json(serde_json::to_value(&solved.metrics))),
            settings = table(&settings),
        )
    }

    /// What the page's script needs.
    pub(super) fn data(&self, frames: &[FramePictures]) -> Value {
        let frame = |frame: &FramePictures| {
            let pictures: serde_json::Map<String, Value> = frame
                .pictures
                .iter()
                .map(|(kind, uri)| ((*kind).to_owned(), json!(uri)))
                .collect();
            json!({"name": frame.name, "pictures": pictures})
        };
        json!({
            "frames": frames.iter().map(frame).collect::<Vec<_>>(),
            "environment": {
                "radiance": pictures::floats(&self.reconstruction.environment),
                "exposure": self.environment_exposure,
                "deviation": self.reconstruction.uncertainty.as_ref().map(|doubt| pictures::floats(&doubt.environment)),
            },
            "object": self.viewer.as_ref().map(|viewer| viewer.data(self.photograph_exposure)),
        })
    }
}

fn means(image: &Image) -> String {
    let count = (image.width * image.height) as f64;
    let mean = |channel: usize| {
        let values = image.data.iter().skip(channel).step_by(image.channels);
        number(values.map(|&value| f64::from(value)).sum::<f64>() / count)
    };
    (0..image.channels.min(3))
        .map(mean)
        .collect::<Vec<_>>()
        .join(", ")
}

fn agreement(capture: &Capture, solved: &Reconstruction) -> Agreement {
    let (mut squares, mut sigmas, mut count) = (0.0, 0.0, 0u64);
    for (frame, render) in capture.frames.iter().zip(&solved.renders) {
        let pixels = frame.image.data.chunks_exact(frame.image.channels);
        let pixels = pixels.zip(render.data.chunks_exact(render.channels));
        for ((seen, model), &coverage) in pixels.zip(&frame.mask.data) {
            if coverage < 0.999 {
                continue;
            }
            for channel in 0..3 {
                let (seen, model) = (f64::from(seen[channel]), f64::from(model[channel]));
                squares += (seen - model).powi(2);
                let sigma = solved
                    .noise
                    .map_or(f64::INFINITY, |noise| noise.sigma(model));
                sigmas += ((seen - model) / sigma).powi(2);
                count += 1;
            }
        }
    }
    let rms = |sum: f64| (sum / count.max(1) as f64).sqrt();
    Agreement {
        rms: rms(squares),
        sigmas: solved.noise.map(|_| rms(sigmas)),
    }
}
