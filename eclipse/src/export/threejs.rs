//! A page for three.js.

use super::{Scene, y_up};
use crate::layout::{ENVIRONMENT, MESH};

/// The version of the library that the page asks for.
const VERSION: &str = "0.170.0";

/// The page.
pub(super) fn scene(scene: &Scene) -> String {
    let triple = |v: glam::Vec3| format!("{}, {}, {}", v.x, v.y, v.z);
    let (position, target) = (
        triple(y_up(scene.camera.centre())),
        triple(y_up(scene.target)),
    );
    let distance = (scene.camera.centre() - scene.target).length();
    let (near, far, angle) = (0.01 * distance, 10.0 * distance, scene.field_of_view);
    format!(
        r#"<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>The recovered object in the recovered light</title>
<style>body {{ margin: 0; overflow: hidden }}</style>
<!-- Serve this folder (python3 -m http.server): pages opened from a disk may load no files. -->
<script type="importmap">
{{ "imports": {{
    "three": "https://cdn.jsdelivr.net/npm/three@{VERSION}/build/three.module.js",
    "three/addons/": "https://cdn.jsdelivr.net/npm/three@{VERSION}/examples/jsm/"
}} }}
</script>
<script type="module">
import * as THREE from "three";
import {{ OrbitControls }} from "three/addons/controls/OrbitControls.js";
import {{ EXRLoader }} from "three/addons/loaders/EXRLoader.js";
import {{ GLTFLoader }} from "three/addons/loaders/GLTFLoader.js";

const renderer = new THREE.WebGLRenderer({{ antialias: true }});
renderer.setSize(innerWidth, innerHeight);
renderer.toneMapping = THREE.NoToneMapping;
document.body.append(renderer.domElement);

const scene = new THREE.Scene();
const camera = new THREE.PerspectiveCamera({angle}, innerWidth / innerHeight, {near}, {far});
camera.position.set({position});
const controls = new OrbitControls(camera, renderer.domElement);
controls.target.set({target});
controls.update();

// Laid out for three.js: no rotation.
new EXRLoader().setDataType(THREE.FloatType).load("{ENVIRONMENT}", (map) => {{
    map.mapping = THREE.EquirectangularReflectionMapping;
    scene.environment = scene.background = map;
}});
new GLTFLoader().load("{MESH}", (gltf) => scene.add(gltf.scene));

addEventListener("resize", () => {{
    camera.aspect = innerWidth / innerHeight;
    camera.updateProjectionMatrix();
    renderer.setSize(innerWidth, innerHeight);
}});
renderer.setAnimationLoop(() => renderer.render(scene, camera));
</script>
</html>
"#
    )
}
