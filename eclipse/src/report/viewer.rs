//! The object in other light: its mesh and materials packed for WebGL, and the part of the page around them.

mod thinned;

use base64::{Engine, engine::general_purpose::STANDARD};
use glam::Vec3;
use render::mesh::Mesh;
use serde_json::{Value, json};

use super::radiance::NAME;
use crate::{
    capture::Capture, image_io::linear_to_srgb, reconstruction::Reconstruction,
    reconstruction::VertexMaterial,
};

/// The scripts of the viewer, in the order in which they need each other; they share one scope of their own.
const SCRIPTS: [&str; 5] = [
    include_str!("viewer/radiance.js"),
    include_str!("viewer/openexr.js"),
    include_str!("viewer/light.js"),
    include_str!("viewer/shaders.js"),
    include_str!("viewer/viewer.js"),
];
/// More triangles than this are merged: a page of some eight megabytes, and no finer on a screen.
const MOST_FACES: usize = 250_000;

/// The object as the viewer shows it; `None` for a reconstruction without materials at the mesh's vertices.
pub(super) struct Viewer {
    mesh: Mesh,
    materials: Vec<VertexMaterial>,
    coated: bool,
    rows: usize,
    columns: usize,
    faces: usize,
    /// From +x towards +y and above the horizon, in radians: where the first photograph was taken from.
    view: [f32; 2],
    /// Reflectance κ that is shown white.
    kappa_white: f32,
}

impl Viewer {
    pub(super) fn new(
        capture: &Capture,
        solved: &Reconstruction,
        kappa_white: f32,
    ) -> Option<Self> {
        let (mesh, materials) = (&capture.mesh, &solved.vertex_materials);
        if mesh.faces.is_empty() || materials.len() != mesh.positions.len() {
            return None;
        }
        let faces = mesh.faces.len();
        let (mut mesh, materials) = thinned::thinned(mesh, materials, MOST_FACES);
        mesh.ensure_normals();
        let eye = capture
            .frames
            .first()
            .map_or(Vec3::X, |frame| frame.camera.centre());
        let view = [eye.y.atan2(eye.x), eye.z.atan2(eye.truncate().length())];
        Some(Self {
            mesh,
            materials,
            coated: !solved.settings.lambertian,
            rows: solved.environment.height,
            columns: solved.environment.width,
            faces,
            view,
            kappa_white,
        })
    }

    /// The heading, the controls and the canvas.
    pub(super) fn section(&self) -> String {
        let merged = if self.mesh.faces.len() < self.faces {
            format!(
                "<li>Its {} triangles were merged to {}.</li>",
                self.faces,
                self.mesh.faces.len()
            )
        } else {
            String::new()
        };
        let gloss = if self.coated {
            format!(
                "<option value=\"2\">roughness α, black 0 to white 1</option><option value=\"3\">reflectance κ, black 0 to white \
                 {}</option>",
                self.kappa_white
            )
        } else {
            String::new()
        };
        let coat = if self.coated {
            "<li>Highlights are lobes that look the same from all sides, gathered beforehand for roughnesses √α of 0.2 to 1 and \
             blended between; at grazing angles true ones are longer. Below 0.2 they are blended with a mirror image.</li>"
        } else {
            ""
        };
        format!(
            "<section id=\"viewer\">\n<h2>In other light</h2>\n<p>The recovered object under the recovered light, or under a map \
             of your own: choose one, or drop it on the picture; the <code>{NAME}</code> that a run leaves beside this page \
             is one. Drag to turn the object, pinch or scroll (after a click) to come \
             closer; arrow keys, + and − work too.</p>\n\
             <div id=\"viewer-controls\">\n<div class=\"control\"><button id=\"viewer-recovered\" type=\"button\">Recovered \
             light</button><button id=\"viewer-lamp\" type=\"button\">A lamp</button><label class=\"button\">Choose a map \
             …<input id=\"viewer-file\" type=\"file\" accept=\".exr,.hdr,.pic,.rgbe\"></label></div>\n\
             <div class=\"control\"><label for=\"viewer-exposure\">Exposure</label><input id=\"viewer-exposure\" type=\"range\" \
             min=\"-6\" max=\"6\" step=\"0.25\" value=\"0\"><output id=\"viewer-stops\" for=\"viewer-exposure\">0 \
             stops</output></div>\n\
             <div class=\"control\"><label for=\"viewer-rotation\">Light turned</label><input id=\"viewer-rotation\" \
             type=\"range\" min=\"-180\" max=\"180\" step=\"1\" value=\"0\"><output id=\"viewer-degrees\" \
             for=\"viewer-rotation\">0°</output></div>\n\
             <div class=\"control\"><label for=\"viewer-shown\">Show</label><select id=\"viewer-shown\"><option value=\"0\">the \
             object, lit</option><option value=\"1\">albedo</option>{gloss}<option value=\"4\">normals</option></select><label>\
             <input id=\"viewer-backdrop\" type=\"checkbox\" checked> the light behind it</label></div>\n</div>\n\
             <figure class=\"wide\" id=\"viewer-drop\"><canvas id=\"viewer-canvas\" tabindex=\"0\" role=\"img\" \
             aria-label=\"the recovered object, lit\" data-rows=\"{rows}\" data-columns=\"{columns}\"></canvas><figcaption \
             id=\"viewer-message\" role=\"status\">The viewer needs scripts.</figcaption></figure>\n\
             <details><summary>What is accepted, and what is approximated</summary><ul>\n\
             <li>Maps are OpenEXR pictures (rows of one part; stored, RLE, ZIPS or ZIP) or Radiance pictures (.hdr, RGBE), \
             equirectangular and twice as wide as high, at most 8192 × 4096; top row up (+z), centre column along +x, azimuth falling \
             to the right. They stay on this computer.</li>\n\
             <li>Every map is shown as bright on average as the recovered light; exposure counts from there. Values beyond \
             white clip; there is no tone curve.</li>\n\
             <li>There are no shadows: every point receives all light of its half of the sky, neither blocked nor reflected by \
             the rest of the object. <code>eclipse relight</code> renders with shadows.</li>\n\
             <li>Diffuse light is the exact sum over a map of 256 × 128. The light that a coat keeps from the diffuse part on \
             its way out is taken for a direction halfway to the normal.</li>\n{coat}{merged}</ul></details>\n</section>\n",
            rows = self.rows,
            columns = self.columns,
        )
    }

    /// What the script draws: base64 of little-endian numbers, four a vertex, at `exposure` from radiance to display.
    pub(super) fn data(&self, exposure: f32) -> Value {
        let [low, high] = self.mesh.bounds();
        let extent = (high - low).max(Vec3::splat(f32::MIN_POSITIVE));
        let unit = |share: f32| (share.clamp(0.0, 1.0) * f32::from(u16::MAX)).round() as u16;
        let signed = |share: f32| (share.clamp(-1.0, 1.0) * f32::from(i16::MAX)).round() as i16;
        let (mut places, mut normals, mut albedo) = (Vec::new(), Vec::new(), Vec::new());
        let vertices = self.mesh.positions.iter().zip(&self.mesh.normals);
        for ((&position, normal), material) in vertices.zip(&self.materials) {
            let [x, y, z] = ((position - low) / extent).to_array();
            places.extend([x, y, z, material.kappa].map(unit));
            let roughness = if self.coated {
                material.alpha.max(0.0).sqrt()
            } else {
                1.0
            };
            normals.extend([normal.x, normal.y, normal.z, roughness].map(signed));
            let colour = material
                .albedo
                .map(|value| (255.0 * linear_to_srgb(value.clamp(0.0, 1.0))).round() as u8);
            albedo.extend([colour[0], colour[1], colour[2], 255]);
        }
        let bytes = |values: &mut dyn Iterator<Item = Vec<u8>>| {
            STANDARD.encode(values.flatten().collect::<Vec<u8>>())
        };
        json!({
            "places": bytes(&mut places.iter().map(|value: &u16| value.to_le_bytes().to_vec())),
            "normals": bytes(&mut normals.iter().map(|value: &i16| value.to_le_bytes().to_vec())),
            "albedo": STANDARD.encode(albedo),
            "faces": bytes(&mut self.mesh.faces.iter().flatten().map(|index| index.to_le_bytes().to_vec())),
            "low": low.to_array(),
            "extent": extent.to_array(),
            "radius": self.mesh.bounding_radius(),
            "coated": self.coated,
            "kappaWhite": self.kappa_white,
            "azimuth": self.view[0],
            "elevation": self.view[1],
            "exposure": exposure,
        })
    }
}

/// The viewer's script, in a scope of its own.
pub(super) fn script() -> String {
    format!("(() => {{\n\"use strict\";\n{}}})();\n", SCRIPTS.concat())
}
