//! Images that are bent the same way in all frames: a stand-in for what no effect describes.

use super::{Effect, Stage, Term, support::gradient};
use crate::criticism::scene::Scene;

/// A displacement's shape over the image, from its middle: 1 in the corners.
type Shape = (&'static str, fn([f32; 2]) -> f32);

/// Shapes of either component.
const SHAPES: [Shape; 7] = [
    ("x", |[x, _]| x),
    ("y", |[_, y]| y),
    ("x²", |[x, _]| x * x),
    ("xy", |[x, y]| x * y),
    ("y²", |[_, y]| y * y),
    ("x r²", |[x, y]| x * (x * x + y * y)),
    ("y r²", |[x, y]| y * (x * x + y * y)),
];

/// A smooth displacement over the image, such as a lens that bends straight lines leaves.
pub struct ImageWarp;

impl Effect for ImageWarp {
    fn id(&self) -> &'static str {
        "image_warp"
    }
    fn describe(&self) -> &'static str {
        "images bent the same way in all frames"
    }
    fn stage(&self) -> Stage {
        Stage::Optics
    }
    fn stands_for_unknown(&self) -> bool {
        true
    }
    fn confused_with(&self) -> &'static [&'static str] {
        &["pose_error", "finer_albedo"]
    }
    fn terms(&self, scene: &Scene<'_>) -> Vec<Term> {
        let mut terms = Vec::new();
        for (component, towards) in ["across", "down"].into_iter().enumerate() {
            for (name, shape) in SHAPES {
                let field = scene.on_views(|v| {
                    let view = &scene.seen.views[v];
                    let image = &scene.capture.frames[view.frame as usize].image;
                    let half = [0.5 * image.width as f32, 0.5 * image.height as f32];
                    let corner = half[0].hypot(half[1]);
                    let from = [0, 1].map(|k| (view.at[k] - half[k]) / corner);
                    // What is moved there lay a pixel before.
                    let slopes = gradient(&scene.renders[view.frame as usize], view.at);
                    let slope = [slopes.0, slopes.1][component];
                    [0, 1, 2].map(|c| -shape(from) * slope[c])
                });
                let name = format!("displacement {towards} by {name} (pixels in the corners)");
                terms.push(Term::new(name, 1.0, field));
            }
        }
        terms
    }
}
