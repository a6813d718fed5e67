//! The finer model between rounds of the solve: it finds a planted lobe, and stands still where everything is explained.

use std::sync::LazyLock;

use eclipse::{
    image_io::read_exr,
    reconstruct::{
        detail::{correct, patch_of_site},
        lobe, noise,
        patches::{Observations, PatchOptions},
        shading::{Lobe, Scene},
        surface::{Surface, eyes},
    },
    reconstruction::Noise,
};
use eclipse_tests::perfect;
use glam::Vec3;
use render::{bvh::Bvh, lat_long::LatLong};

const ALBEDO: f32 = 0.6;

struct Planted {
    surface: Surface,
    patches: Observations,
    radiance: Vec<f32>,
    eyes: Vec<Vec3>,
    noise: Noise,
}

impl Planted {
    /// The bundled capture's shape, cameras and light; what was seen is replaced by `lobe` and one albedo.
    fn new(lobe: Option<Lobe>) -> Self {
        let capture = perfect::capture();
        let bvh = Bvh::new(&capture.mesh).unwrap();
        let noise = noise::estimate(&capture.frames);
        let grid = LatLong::new(50, 100);
        let all = |_: usize, _: u32| true;
        let mut surface = Surface::new(&bvh, &capture.frames, &noise, grid, 600, 0, &all);
        let options = PatchOptions {
            count: 80,
            members: 4,
            model_error: 0.006,
        };
        let patches = Observations::gather(&bvh, &capture.frames, &noise, &options, 0, &all);
        let environment = perfect::bundled().join("truth/environment.exr");
        let radiance = read_exr(&environment).unwrap().data;
        let eyes = eyes(&capture.frames);
        let scene = Scene {
            grid,
            radiance: &radiance,
            occluders: None,
            lobe,
            eyes: &eyes,
        };
        let sites: Vec<usize> = (0..surface.places.len()).collect();
        let shades = surface
            .shades(&scene, &sites, &surface.frames(&sites))
            .concat();
        for (view, shade) in surface.seen.views.iter_mut().zip(&shades) {
            view.value = std::array::from_fn(|c| ALBEDO * shade.diffuse[c] + shade.specular[c]);
            view.weight = view.value.map(|v| 1.0 / (0.01 * v).powi(2).max(1e-9));
        }
        Self {
            surface,
            patches,
            radiance,
            eyes,
            noise,
        }
    }

    fn scene(&self, lobe: Option<Lobe>) -> Scene<'_> {
        Scene {
            grid: self.surface.grid,
            radiance: &self.radiance,
            occluders: None,
            lobe,
            eyes: &self.eyes,
        }
    }
}

static PLANTED: LazyLock<Planted> = LazyLock::new(|| Planted::new(Some(LOBE)));
const LOBE: Lobe = Lobe {
    alpha: 0.35,
    kappa: 0.08,
};

#[test]
fn a_planted_lobe_is_found() {
    let found = lobe::fit(&PLANTED.scene(None), &PLANTED.surface);
    assert!((found.alpha - LOBE.alpha).abs() < 0.02, "{found:?}");
    assert!((found.kappa - LOBE.kappa).abs() < 0.01, "{found:?}");
    let near = lobe::fit(&PLANTED.scene(Some(found)), &PLANTED.surface);
    assert!((near.alpha - LOBE.alpha).abs() < 0.02, "{near:?}");
}

#[test]
fn data_that_the_finer_model_explains_leave_the_solver_where_it_is() {
    let Planted {
        surface,
        patches,
        noise,
        ..
    } = &*PLANTED;
    let of = patch_of_site(surface, patches);
    // Whatever the patches' own model says, it is told to say the same again.
    let predicted: Vec<[f32; 3]> = patches
        .views
        .iter()
        .map(|v| v.value.map(|x| 1.3 * x))
        .collect();
    let scene = PLANTED.scene(Some(LOBE));
    let data = correct(surface, &scene, noise, patches, &of, &predicted, 0.004);
    let used = data.weight.iter().filter(|w| w[1] > 0.0).count();
    assert!(used > patches.views.len() / 2, "{used}");
    let views = data.value.iter().zip(&data.weight).zip(&predicted);
    for ((value, weight), predicted) in views.filter(|((_, weight), _)| weight[1] > 0.0) {
        for c in 0..3 {
            let off = value[c] / predicted[c].max(1e-9) - 1.0;
            assert!(weight[c] == 0.0 || off.abs() < 2e-3, "{off}");
        }
    }
}

#[test]
fn a_frame_that_the_finer_model_calls_too_dark_is_asked_to_be_brighter() {
    let mut planted = Planted::new(None);
    for view in planted
        .surface
        .seen
        .views
        .iter_mut()
        .filter(|v| v.frame == 5)
    {
        view.value = view.value.map(|v| 1.04 * v);
    }
    let of = patch_of_site(&planted.surface, &planted.patches);
    let predicted = vec![[0.2; 3]; planted.patches.views.len()];
    let Planted {
        surface,
        patches,
        noise,
        ..
    } = &planted;
    let data = correct(
        surface,
        &planted.scene(None),
        noise,
        patches,
        &of,
        &predicted,
        0.004,
    );
    let mean = |chosen: bool| {
        let views = patches.views.iter().zip(&data.value).zip(&data.weight);
        let of: Vec<f32> = views
            .filter(|((view, _), weight)| (view.frame == 5) == chosen && weight[1] > 0.0)
            .map(|((_, value), _)| value[1] / 0.2)
            .collect();
        of.iter().sum::<f32>() / of.len() as f32
    };
    // Albedo takes up the mean over all frames of what the one frame has more.
    assert!(
        (mean(true) / mean(false) - 1.04).abs() < 5e-3,
        "{} {}",
        mean(true),
        mean(false)
    );
}
