//! Energy: what a surface may give back.

use eclipse_tests::scenes;
use glam::Vec3;
use render::bsdf::{Cosines, Material, Model, microfacet};
use render::lat_long::LatLong;
use render::reference::Reference;

/// ∫ f cos dω over the hemisphere around +z for a view at `cos_o`, by a fine grid.
fn reflectance(model: Model, material: &Material, cos_o: f32) -> f64 {
    let outgoing = Vec3::new((1.0 - cos_o * cos_o).sqrt(), 0.0, cos_o);
    let grid = LatLong::new(400, 800);
    let mut sum = 0.0;
    for r in 0..grid.rows / 2 {
        for c in 0..grid.columns {
            let d = grid.texel_direction(r, c);
            let f = model.evaluate(material, Vec3::Z, d, outgoing);
            sum += f64::from(f[0] * d.z * grid.solid_angle(r));
        }
    }
    sum
}

#[test]
fn a_white_lambertian_object_vanishes_in_the_furnace() {
    let bvh = scenes::sphere();
    let environment = scenes::furnace(0.7);
    let reference = Reference::new(&bvh, &environment, Model::Lambertian, 2);
    let camera = scenes::camera(24);
    let white = Material {
        albedo: [1.0; 3],
        alpha: 0.5,
        kappa: 0.0,
    };
    let image = reference.frame(&camera, None, |_| white);
    let mut full = 0;
    for pixel in image.data.chunks_exact(4).filter(|p| p[3] == 1.0) {
        full += 1;
        // Facets hide a sliver above the horizon; the grid is coarse.
        assert!((pixel[0] / 0.7 - 1.0).abs() < 5e-3, "{pixel:?}");
    }
    assert!(full > 100);
}

#[test]
fn the_white_coated_surface_hardly_gains_energy_and_reflects_more_than_two_thirds() {
    for alpha in [0.1, 0.3, 0.6, 1.0] {
        for kappa in [0.0, 0.04, 0.5, 1.0] {
            for cos_o in [0.2, 0.6, 1.0] {
                let white = Material {
                    albedo: [1.0; 3],
                    alpha,
                    kappa,
                };
                let share = reflectance(Model::Microfacet, &white, cos_o);
                // The diffuse factor of S1 looks at the incident angle only, so that at grazing views a smooth white
                // surface gives back a few percent more than it gets: a property of the printed model.
                let bound = if cos_o < 0.3 { 1.05 } else { 1.0 + 2e-3 };
                assert!(
                    share < bound,
                    "alpha {alpha} kappa {kappa} cos {cos_o}: {share}"
                );
            }
        }
        // The printed second cosine would leave two thirds of this before Fresnel's share is taken.
        let matte = Material {
            albedo: [1.0; 3],
            alpha,
            kappa: 0.0,
        };
        assert!(reflectance(Model::Microfacet, &matte, 1.0) > 0.8);
    }
    let white = Material {
        albedo: [1.0; 3],
        alpha: 0.5,
        kappa: 0.0,
    };
    assert!((reflectance(Model::Lambertian, &white, 0.5) - 1.0).abs() < 1e-3);
}

#[test]
fn the_specular_lobe_is_reciprocal_and_the_diffuse_one_as_printed_is_not() {
    let one_way = Cosines {
        incident: 0.8_f64,
        outgoing: 0.3,
        half: 0.9,
        difference: 0.6,
    };
    let back = Cosines {
        incident: 0.3,
        outgoing: 0.8,
        ..one_way
    };
    let (diffuse, specular) = microfacet(one_way, 0.4, 0.04);
    let (diffuse_back, specular_back) = microfacet(back, 0.4, 0.04);
    assert!((specular - specular_back).abs() < 1e-12);
    // F(n·ωi) has no partner F(n·ωo) in S1: light that leaves at a grazing angle is not reduced.
    assert!(diffuse > diffuse_back + 0.05);
}
