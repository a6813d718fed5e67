//! Light that differs from view to view: a map for each, and maps in the axes of the camera.

use std::{
    path::{Path, PathBuf},
    str::FromStr,
};

use glam::{Mat3, Vec3};
use render::{
    camera::Camera,
    convention::{Convention, convert},
    environment::EnvironmentMap,
    lat_long::LatLong,
};

use super::{RelightError, View};
use crate::image_io::{
    Clamped, EXTENSIONS, EnvironmentIoError, EnvironmentOptions, read_foreign_environment,
};

/// Where Stanford-ORB keeps the maps of a scene's views.
const BENCHMARK: &str = "env_map";
/// How maps in a camera's axes are laid out where nobody says otherwise: so are Stanford-ORB's.
const OF_CAMERAS: Convention = Convention::Skylibs;

/// What the directions of a map are told in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Axes {
    /// The world's: the same for all views.
    #[default]
    World,
    /// Those of the view's camera: x right, y up, z towards whoever looks.
    Camera,
}

impl Axes {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::World, Self::Camera];

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::World => "world",
            Self::Camera => "camera",
        }
    }
}

impl FromStr for Axes {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|axes| axes.name() == name);
        found.ok_or_else(|| format!("unknown axes `{name}`; use world or camera"))
    }
}

/// The light of each of some views.
#[derive(Clone, Debug)]
pub struct Lights {
    /// The map of each view.
    files: Vec<PathBuf>,
    options: EnvironmentOptions,
    axes: Axes,
}

impl Lights {
    /// Of `views`, all from the map `path`, which matters in each camera's axes.
    pub fn of_one(path: &Path, views: &[View], options: EnvironmentOptions, axes: Axes) -> Self {
        Self {
            files: vec![path.to_owned(); views.len()],
            options,
            axes,
        }
    }

    /// Of `views`, each from a map of its own in `folder`: called as its frame, or lying in `env_map` beside it, as Stanford-ORB's.
    ///
    /// # Errors
    /// [`RelightError::NoLight`] for a view without a map.
    pub fn of_each(
        folder: &Path,
        views: &[View],
        options: EnvironmentOptions,
        axes: Axes,
    ) -> Result<Self, RelightError> {
        let file = |view: &View| {
            let (parent, name) = view.frame.rsplit_once('/').unwrap_or(("", &view.frame));
            let places = [
                folder.join(&view.frame),
                folder.join(parent).join(BENCHMARK).join(name),
            ];
            let mut candidates = places.iter().flat_map(|place| {
                EXTENSIONS.map(|extension| {
                    // What stands behind a dot of the name is none of its extension.
                    let mut file = place.clone().into_os_string();
                    file.push(format!(".{extension}"));
                    PathBuf::from(file)
                })
            });
            let found = candidates.find(|path| path.is_file());
            found.ok_or_else(|| {
                let places = places.iter().map(|place| place.display().to_string());
                RelightError::NoLight {
                    view: view.frame.clone(),
                    places: places.collect::<Vec<_>>().join(" and "),
                }
            })
        };
        Ok(Self {
            files: views.iter().map(file).collect::<Result<_, _>>()?,
            options,
            axes,
        })
    }

    /// The light of view `index`, which `camera` sees, in the world's axes, and what was changed of its map to make light of it.
    ///
    /// # Errors
    /// [`EnvironmentIoError`] names the file and what is wrong with it.
    pub fn read(
        &self,
        index: usize,
        camera: &Camera,
    ) -> Result<(EnvironmentMap, Option<Clamped>), EnvironmentIoError> {
        let path = &self.files[index];
        match self.axes {
            Axes::World => read_foreign_environment(path, &self.options),
            Axes::Camera => self.turned(path, camera),
        }
    }

    /// A map in the axes of `camera`, brought to the world's.
    fn turned(
        &self,
        path: &Path,
        camera: &Camera,
    ) -> Result<(EnvironmentMap, Option<Clamped>), EnvironmentIoError> {
        // As it is stored: taken for a map of ours it is not moved, but averaged where it is large.
        let stored = EnvironmentOptions {
            convention: Some(Convention::Blender),
            rotate: 0.0,
            rows: self.options.rows,
        };
        let (map, clamped) = read_foreign_environment(path, &stored)?;
        let rows = map.grid().rows;
        let convention = self.options.convention.unwrap_or(OF_CAMERAS);
        let about = Mat3::from_rotation_z(self.options.rotate.to_radians());
        let turn = about * Mat3::from_mat4(camera.world_from_camera) * y_up();
        let grid = LatLong::new(rows, 2 * rows);
        let mut turned = convert(map.image(), convention, Convention::Blender, grid, turn);
        // Weights may miss one or zero by a rounding error: light stays what it may be.
        turned
            .data
            .iter_mut()
            .for_each(|value| *value = value.max(0.0));
        let light = EnvironmentMap::new(turned).map_err(|source| EnvironmentIoError::Light {
            path: path.to_owned(),
            source,
        })?;
        Ok((light, clamped))
    }
}

/// Takes directions of a world with z up, as [`convert`] has them, to those with y up, as cameras do.
fn y_up() -> Mat3 {
    Mat3::from_cols(Vec3::X, Vec3::NEG_Z, Vec3::Y)
}

#[cfg(test)]
mod tests {
    use std::f32::consts::{PI, TAU};

    use render::image::Image;

    use super::*;
    use crate::image_io::{Rows, write_exr};

    fn view(frame: &str, camera: Camera) -> View {
        View {
            name: "000".to_owned(),
            frame: frame.to_owned(),
            camera,
        }
    }

    #[test]
    fn a_map_in_camera_axes_shines_from_where_the_camera_has_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        // From +x, a little from above: right is +y, and behind the camera +x.
        let eye = Vec3::new(5.0, 0.0, 2.0);
        let camera = Camera::look_at(8, 8, 0.5, eye, Vec3::ZERO);
        let views = [view("a", camera.clone())];
        let axes = [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z];
        for of_camera in axes {
            // Stanford-ORB's own formula: the middle of the map is −z of the camera, x lies to its right.
            let mut map = Image::filled(64, 32, 3, 0.0);
            for row in 0..32 {
                for column in 0..64 {
                    let theta = PI * (row as f32 + 0.5) / 32.0;
                    let phi = TAU * ((column as f32 + 0.5) / 64.0 - 0.5);
                    let (sin, cos) = phi.sin_cos();
                    let d = Vec3::new(theta.sin() * sin, theta.cos(), -theta.sin() * cos);
                    let value = (20.0 * (d.dot(of_camera) - 1.0)).exp();
                    map.pixel_mut(column, row).fill(value);
                }
            }
            write_exr(&path, &map, &["R", "G", "B"]).unwrap();
            let options = EnvironmentOptions {
                rows: Rows::AtMost(1024),
                ..Default::default()
            };
            let lights = Lights::of_one(&path, &views, options, Axes::Camera);
            let (light, _) = lights.read(0, &camera).unwrap();
            let of_world = camera.world_from_camera.transform_vector3(of_camera);
            assert!(light.radiance(of_world)[0] > 0.8, "{of_camera}");
            assert!(light.radiance(-of_world)[0] < 0.01, "{of_camera}");
            let aside = of_world.any_orthonormal_vector();
            assert!(light.radiance(aside)[0] < 0.01, "{of_camera}");

            // Turned about the world's vertical afterwards.
            let options = EnvironmentOptions {
                rotate: 90.0,
                ..options
            };
            let lights = Lights::of_one(&path, &views, options, Axes::Camera);
            let (light, _) = lights.read(0, &camera).unwrap();
            let quarter = Mat3::from_rotation_z(TAU / 4.0) * of_world;
            assert!(light.radiance(quarter)[0] > 0.8, "{of_camera}");
        }
    }

    #[test]
    fn each_view_has_its_map_by_its_name_or_as_the_benchmark_keeps_it() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in ["cup_scene002/env_map", "test"] {
            std::fs::create_dir_all(at(name)).unwrap();
        }
        let camera = Camera::look_at(8, 8, 0.5, 5.0 * Vec3::X, Vec3::ZERO);
        let views = ["cup_scene002/0003", "test/view.001"].map(|frame| view(frame, camera.clone()));
        let find = || {
            let options = EnvironmentOptions::default();
            Lights::of_each(folder.path(), &views, options, Axes::World)
        };
        std::fs::write(at("cup_scene002/env_map/0003.exr"), "").unwrap();
        let error = find().unwrap_err().to_string();
        assert!(error.contains("\"test/view.001\""), "{error}");
        std::fs::write(at("test/view.001.hdr"), "").unwrap();
        let expected = ["cup_scene002/env_map/0003.exr", "test/view.001.hdr"].map(at);
        assert_eq!(find().unwrap().files, expected);
    }

    #[test]
    fn axes_have_names() {
        for axes in Axes::ALL {
            assert_eq!(axes.name().parse(), Ok(axes));
        }
        assert!("earth".parse::<Axes>().is_err());
    }
}
