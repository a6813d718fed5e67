//! A scene for Mitsuba 3.

use render::bsdf::Model;

use super::{SIZE, Scene, ply::mean_kappa, y_up};
use crate::layout::ENVIRONMENT;

/// The object with materials at its vertices: Mitsuba reads no glTF.
pub(super) const MESH: &str = "mesh.ply";

/// Least index of refraction: at 1 there would be no surface.
const LEAST_INDEX: f32 = 1.001;

/// The scene as XML.
pub(super) fn scene(scene: &Scene) -> String {
    let triple = |v: glam::Vec3| format!("{}, {}, {}", v.x, v.y, v.z);
    let origin = triple(y_up(scene.camera.centre()));
    let target = triple(y_up(scene.target));
    let fov = scene.field_of_view;
    let material = material(scene);
    format!(
        r#"<!-- The recovered object in the recovered light: mitsuba scene.xml -->
<scene version="3.0.0">
    <default name="spp" value="256"/>
    <!-- Light bounces once, as in the reconstruction. -->
    <integrator type="path">
        <integer name="max_depth" value="2"/>
    </integrator>
    <sensor type="perspective">
        <float name="fov" value="{fov}"/>
        <string name="fov_axis" value="x"/>
        <transform name="to_world">
            <lookat origin="{origin}" target="{target}" up="0, 1, 0"/>
        </transform>
        <sampler type="independent">
            <integer name="sample_count" value="$spp"/>
        </sampler>
        <film type="hdrfilm">
            <integer name="width" value="{SIZE}"/>
            <integer name="height" value="{SIZE}"/>
            <string name="pixel_format" value="rgba"/>
            <rfilter type="box"/>
        </film>
    </sensor>
    <!-- Laid out for Mitsuba: no to_world. -->
    <emitter type="envmap">
        <string name="filename" value="{ENVIRONMENT}"/>
    </emitter>
    <shape type="ply">
        <string name="filename" value="{MESH}"/>
        <bsdf type="twosided">
{material}
        </bsdf>
    </shape>
</scene>
"#
    )
}

fn material(scene: &Scene) -> String {
    let attribute = |parameter: &str, name: &str| {
        format!(
            r#"                <texture type="mesh_attribute" name="{parameter}">
                    <string name="name" value="vertex_{name}"/>
                </texture>"#
        )
    };
    if scene.object.model == Model::Lambertian {
        let albedo = attribute("reflectance", "color");
        return format!("            <bsdf type=\"diffuse\">\n{albedo}\n            </bsdf>");
    }
    let (albedo, roughness) = (
        attribute("base_color", "color"),
        attribute("roughness", "roughness"),
    );
    // Reflectance at normal incidence is ((η − 1)/(η + 1))²; one for the whole object.
    let root = mean_kappa(scene.object).clamp(0.0, 0.9).sqrt();
    let index = ((1.0 + root) / (1.0 - root)).max(LEAST_INDEX);
    format!(
        "            <bsdf type=\"principled\">\n{albedo}\n{roughness}\n                \
         <float name=\"eta\" value=\"{index}\"/>\n            </bsdf>"
    )
}
