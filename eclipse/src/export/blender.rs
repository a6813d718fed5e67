//! A script for Blender.

use super::{SIZE, Scene};
use crate::layout::{ENVIRONMENT, MESH};

/// The script.
pub(super) fn scene(scene: &Scene) -> String {
    let rows: Vec<String> = (0..4)
        .map(|row| {
            let [a, b, c, d] = scene.camera.world_from_camera.row(row).to_array();
            format!("    ({a}, {b}, {c}, {d}),")
        })
        .collect();
    let rows = rows.join("\n");
    let angle = scene.field_of_view.to_radians();
    format!(
        r#""""The recovered object in the recovered light: blender --python scene.py"""

import pathlib

import bpy
from mathutils import Matrix

HERE = pathlib.Path(__file__).resolve().parent
CAMERA = Matrix((
{rows}
))

bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
bpy.ops.import_scene.gltf(filepath=str(HERE / "{MESH}"))

# Materials at vertices are attributes, which a material has to ask for.
for thing in [thing for thing in scene.objects if thing.type == "MESH"]:
    attributes = thing.data.attributes
    colors = thing.data.color_attributes
    for slot in thing.material_slots:
        tree = slot.material.node_tree
        surface = tree.nodes.get("Principled BSDF")
        if surface is None:
            continue
        wanted = [("Base Color", "Color", colors[0].name if len(colors) else None)]
        wanted += [("Roughness", "Fac", "_ROUGHNESS" if "_ROUGHNESS" in attributes else None)]
        for socket, output, name in wanted:
            if name is not None and not surface.inputs[socket].is_linked:
                node = tree.nodes.new("ShaderNodeAttribute")
                node.attribute_name = name
                tree.links.new(node.outputs[output], surface.inputs[socket])

# The light: Blender's own layout, no mapping node.
world = bpy.data.worlds.new("recovered light")
world.use_nodes = True
scene.world = world
image = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
image.image = bpy.data.images.load(str(HERE / "{ENVIRONMENT}"))
image.projection = "EQUIRECTANGULAR"
background = world.node_tree.nodes["Background"]
world.node_tree.links.new(image.outputs["Color"], background.inputs["Color"])

camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
camera.data.sensor_fit = "HORIZONTAL"
camera.data.angle = {angle}
camera.matrix_world = CAMERA
scene.collection.objects.link(camera)
scene.camera = camera
scene.render.engine = "CYCLES"
# Light bounces once, as in the reconstruction: more would be brighter than the photographs.
scene.cycles.max_bounces = 0
scene.render.resolution_x = scene.render.resolution_y = {SIZE}
scene.view_settings.view_transform = "Standard"
"#
    )
}
