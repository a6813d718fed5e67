//! What usually sets a mesh and its cameras apart.

use glam::{Affine3A, Mat3, Mat4, Vec3};
use render::camera::Camera;

use crate::capture::transforms::Transforms;

/// Factors between the units and conventions in use.
const SCALES: [(f32, &str); 8] = [
    (0.001, "0.001 (millimetres for metres)"),
    (1000.0, "1000 (metres for millimetres)"),
    (0.01, "0.01 (centimetres for metres)"),
    (100.0, "100 (metres for centimetres)"),
    (0.1, "0.1"),
    (10.0, "10"),
    (0.0254, "0.0254 (inches for metres)"),
    (1.0 / 0.0254, "39.37 (metres for inches)"),
];
/// Factors between photographs and the focal length that was known for them before they were resized.
const SIZES: [f32; 2] = [0.5, 2.0];

/// A hypothesis: what the mesh, the cameras and the masks should have been, in the capture's own frame.
pub(super) struct Cause {
    pub name: String,
    pub remedy: String,
    /// How many things would have gone wrong at once.
    pub changes: usize,
    pub mesh: Affine3A,
    pub inverted_masks: bool,
    camera: CameraChange,
}

#[derive(Clone, Copy, PartialEq)]
enum CameraChange {
    None,
    OpenCv,
    WorldToCamera,
    Colmap,
}

impl Cause {
    /// The camera under this hypothesis, from one of the recentred frame.
    pub fn camera_from(&self, camera: &Camera, centre: Vec3) -> Camera {
        let mut own = camera.world_from_camera;
        own.w_axis += centre.extend(0.0);
        let flip = Mat4::from_scale(Vec3::new(1.0, -1.0, -1.0));
        let world_from_camera = match self.camera {
            CameraChange::None => own,
            CameraChange::OpenCv => own * flip,
            CameraChange::WorldToCamera => own.inverse(),
            CameraChange::Colmap => own.inverse() * flip,
        };
        Camera {
            world_from_camera,
            ..camera.clone()
        }
    }

    fn and(&self, other: &Self) -> Self {
        Self {
            name: format!("{}, and {}", self.name, other.name),
            remedy: format!("{}, and {}", self.remedy, other.remedy),
            changes: self.changes + other.changes,
            mesh: other.mesh * self.mesh,
            inverted_masks: self.inverted_masks || other.inverted_masks,
            camera: if self.camera == CameraChange::None {
                other.camera
            } else {
                self.camera
            },
        }
    }
}

/// All hypotheses of one change, then those of two of different kinds.
pub(super) fn candidates(centre: Vec3, transforms: &Transforms) -> Vec<Cause> {
    let kinds = [axes(centre, transforms), scales(), cameras()];
    let mut causes = Vec::new();
    for (kind, first) in kinds.iter().enumerate() {
        for other in &kinds[kind + 1..] {
            causes.extend(
                first
                    .iter()
                    .flat_map(|first| other.iter().map(|other| first.and(other))),
            );
        }
    }
    let inverted = Cause {
        inverted_masks: true,
        ..on_mesh(
            "the masks are inverted (dark where the object is)",
            "invert the masks",
            Affine3A::IDENTITY,
        )
    };
    let mut all: Vec<Cause> = kinds.into_iter().flatten().chain([inverted]).collect();
    all.append(&mut causes);
    all
}

fn on_mesh(name: &str, remedy: &str, mesh: Affine3A) -> Cause {
    Cause {
        name: name.into(),
        remedy: remedy.into(),
        changes: 1,
        mesh,
        inverted_masks: false,
        camera: CameraChange::None,
    }
}

fn axes(centre: Vec3, transforms: &Transforms) -> Vec<Cause> {
    let turn = |x, y, z| Affine3A::from_mat3(Mat3::from_cols(x, y, z));
    let quarter = |quarters: f32| Affine3A::from_rotation_z(quarters * std::f32::consts::FRAC_PI_2);
    let mirror = |scale| Affine3A::from_scale(scale);
    let mut causes = vec![
        on_mesh(
            "the mesh is y up and the cameras z up",
            "export the mesh with z up",
            turn(Vec3::X, Vec3::Z, Vec3::NEG_Y),
        ),
        on_mesh(
            "the mesh is z up and the cameras y up",
            "export the mesh in the cameras' frame, as .obj or .ply, which are taken as they are (glTF is y up and is turned when it is read)",
            turn(Vec3::X, Vec3::NEG_Z, Vec3::Y),
        ),
        on_mesh(
            "the mesh is turned by 180° about z",
            "turn it back",
            quarter(2.0),
        ),
        on_mesh(
            "the mesh is turned by −90° about z",
            "turn it by 90° about z",
            quarter(1.0),
        ),
        on_mesh(
            "the mesh is turned by 90° about z",
            "turn it by −90° about z",
            quarter(3.0),
        ),
        on_mesh(
            "the mesh is mirrored in x",
            "mirror it back",
            mirror(Vec3::new(-1.0, 1.0, 1.0)),
        ),
        on_mesh(
            "the mesh is mirrored in y",
            "mirror it back",
            mirror(Vec3::new(1.0, -1.0, 1.0)),
        ),
        on_mesh(
            "the mesh is mirrored in z",
            "mirror it back",
            mirror(Vec3::new(1.0, 1.0, -1.0)),
        ),
        on_mesh(
            "the mesh lies away from the origin that the cameras look at",
            "move its middle to the origin",
            Affine3A::from_translation(-centre),
        ),
    ];
    if let Some(applied) = applied(transforms) {
        causes.push(on_mesh(
            "`applied_transform` was applied to the cameras but not to the mesh",
            "apply it to the mesh (and `applied_scale` after it, where there is one)",
            applied,
        ));
        causes.push(on_mesh(
            "`applied_transform` was applied to the mesh but not to the cameras",
            "apply its inverse to the mesh",
            applied.inverse(),
        ));
    }
    causes
}

/// What nerfstudio did to the cameras, where it moved them.
fn applied(transforms: &Transforms) -> Option<Affine3A> {
    let moved = affine(transforms.applied_transform.as_deref()?)?;
    let scale = transforms.applied_scale.unwrap_or(1.0) as f32;
    let usable = scale.is_finite() && scale > 0.0;
    usable.then(|| Affine3A::from_scale(Vec3::splat(scale)) * moved)
}

/// The transform of three or four rows of four numbers, when it has an inverse.
fn affine(rows: &[Vec<f64>]) -> Option<Affine3A> {
    if rows.len() < 3 || rows.iter().any(|row| row.len() != 4) {
        return None;
    }
    let column = |c: usize| Vec3::new(rows[0][c] as f32, rows[1][c] as f32, rows[2][c] as f32);
    let transform = Affine3A::from_mat3_translation(
        Mat3::from_cols(column(0), column(1), column(2)),
        column(3),
    );
    (transform.is_finite() && transform.matrix3.determinant() != 0.0).then_some(transform)
}

fn scales() -> Vec<Cause> {
    let scaled = |(factor, what): (f32, &str)| {
        let name =
            format!("the mesh's unit is not that of the cameras: it should be scaled by {what}");
        on_mesh(
            &name,
            "scale the mesh so",
            Affine3A::from_scale(Vec3::splat(factor)),
        )
    };
    SCALES
        .map(scaled)
        .into_iter()
        .chain(SIZES.map(sized))
        .collect()
}

/// A mesh that is seen too small or too large by a factor of no unit. Around the middle of the photographs the unit and the focal
/// length do the same.
fn sized(factor: f32) -> Cause {
    on_mesh(
        &format!(
            "the mesh is seen {} than the masks show it, by a factor of {:.2}: its unit is not that of the cameras, or the focal length \
             not that of the photographs, as after resizing them",
            if factor > 1.0 { "smaller" } else { "larger" },
            factor.max(1.0 / factor)
        ),
        &format!(
            "scale the mesh by {factor:.3}, or correct the focal length (in transforms.json `fl_x` and `fl_y`, or `camera_angle_x`)"
        ),
        Affine3A::from_scale(Vec3::splat(factor)),
    )
}

/// The same by a factor that was measured: one of a known unit, which explains as much, is named rather.
pub(super) fn measured(factor: f32) -> Cause {
    Cause {
        changes: 2,
        ..sized(factor)
    }
}

fn cameras() -> Vec<Cause> {
    let on_cameras = |name, remedy, camera| Cause {
        camera,
        ..on_mesh(name, remedy, Affine3A::IDENTITY)
    };
    vec![
        on_cameras(
            "`transform_matrix` has OpenCV's camera axes (y down, looking along +z)",
            "negate its second and third columns",
            CameraChange::OpenCv,
        ),
        on_cameras(
            "`transform_matrix` is world to camera",
            "invert it",
            CameraChange::WorldToCamera,
        ),
        on_cameras(
            "`transform_matrix` is world to camera with OpenCV's axes, as COLMAP stores it",
            "invert it and negate the second and third columns of the result",
            CameraChange::Colmap,
        ),
    ]
}
