//! Bundle adjustment: the residuals of the BA evaluation and their sparse Jacobian, on the tape.
//!
//! A camera has a rotation vector, a centre, a focal length, a principal point and two coefficients of radial distortion; an
//! observation weighs the distance between the projection of a point and a feature. Each residual depends on one camera, one
//! point and one weight, so that two reverse passes give all rows of the Jacobian: one for each coordinate.

use autodiff::{Graph, GraphError, Program, RunError, Sizes, Var, Workspace};

/// Parameters of a camera.
pub const CAMERA: usize = 11;

/// Observations, each with the parameters that it sees.
#[derive(Clone, Debug, Default)]
pub struct Input {
    pub cameras: Vec<[f64; CAMERA]>,
    pub points: Vec<[f64; 3]>,
    pub weights: Vec<f64>,
    pub features: Vec<[f64; 2]>,
    /// Camera and point of each observation.
    pub seen: Vec<(usize, usize)>,
}

/// The derivatives of one observation's residuals, by camera, point and weight; and that of its weight's error.
#[derive(Clone, Copy, Debug, Default)]
pub struct Block {
    pub rows: [[f64; CAMERA + 4]; 2],
    pub weight: f64,
}

/// The recorded residuals with the input bound.
pub struct Ba {
    program: Program,
    ws: Workspace<f64>,
    input: Input,
}

impl Ba {
    pub fn new(input: Input) -> Result<Self, Box<dyn std::error::Error>> {
        let program = record()?;
        let sizes = Sizes::new().lanes("observation", input.seen.len());
        let mut ws = program.workspace::<f64>(&sizes)?;
        ws.set("feature", &channels(&input.features, |f| f))?;
        bind(&mut ws, &input)?;
        Ok(Ba { program, ws, input })
    }

    /// Residuals of all observations, and the errors of their weights.
    pub fn objective(&mut self) -> Result<(Vec<[f64; 2]>, Vec<f64>), RunError> {
        bind(&mut self.ws, &self.input)?;
        self.program.forward(&mut self.ws)?;
        let residual = self.ws.output("residual")?;
        let n = self.input.seen.len();
        let pairs = (0..n).map(|i| [residual[i], residual[n + i]]).collect();
        Ok((pairs, self.ws.output("weight error")?.to_vec()))
    }

    /// One block of the Jacobian for each observation.
    pub fn jacobian(&mut self) -> Result<Vec<Block>, RunError> {
        bind(&mut self.ws, &self.input)?;
        let n = self.input.seen.len();
        let mut blocks = vec![Block::default(); n];
        for coordinate in 0..2 {
            let mut cotangent = vec![0.0; 2 * n];
            cotangent[coordinate * n..(coordinate + 1) * n].fill(1.0);
            self.program
                .vjp_with(&mut self.ws, &[("residual", &cotangent)])?;
            let camera = self.ws.gradient("camera")?;
            let point = self.ws.gradient("point")?;
            let weight = self.ws.gradient("weight")?;
            for (i, block) in blocks.iter_mut().enumerate() {
                let row = &mut block.rows[coordinate];
                for c in 0..CAMERA {
                    row[c] = camera[c * n + i];
                }
                for c in 0..3 {
                    row[CAMERA + c] = point[c * n + i];
                }
                row[CAMERA + 3] = weight[i];
            }
        }
        self.program.vjp(&mut self.ws, "weight error")?;
        let weight = self.ws.gradient("weight")?;
        for (block, weight) in blocks.iter_mut().zip(weight) {
            block.weight = *weight;
        }
        Ok(blocks)
    }
}

fn bind(ws: &mut Workspace<f64>, input: &Input) -> Result<(), RunError> {
    ws.set(
        "camera",
        &channels(&input.seen, |&(c, _)| &input.cameras[c]),
    )?;
    ws.set("point", &channels(&input.seen, |&(_, p)| &input.points[p]))?;
    ws.set("weight", &input.weights)
}

/// `[channel][lane]` from one array per lane.
fn channels<'a, T, const N: usize>(lanes: &'a [T], of: impl Fn(&'a T) -> &'a [f64; N]) -> Vec<f64> {
    (0..N)
        .flat_map(|c| lanes.iter().map(move |lane| (c, lane)))
        .map(|(c, lane)| of(lane)[c])
        .collect()
}

fn record() -> Result<Program, GraphError> {
    let g = Graph::new();
    let observation = g.domain("observation");
    let camera = g.param("camera", &observation, CAMERA);
    let point = g.param("point", &observation, 3);
    let weight = g.param("weight", &observation, 1);
    let feature = g.input("feature", &observation, 2);
    let part = |first: usize, count: usize| {
        let channels: Vec<Var> = (first..first + count).map(|c| camera.channel(c)).collect();
        Var::stack(&channels.iter().collect::<Vec<_>>())
    };
    let rotated = rotate(&part(0, 3), &(point - part(3, 3)));
    let plane = Var::stack(&[&rotated.channel(0), &rotated.channel(1)]) / rotated.channel(2);
    let radius = plane.dot(&plane);
    let distortion = camera.channel(9) * &radius + camera.channel(10) * radius.square() + 1.0;
    let projected = plane * distortion * camera.channel(6) + part(7, 2);
    let residual = (projected - feature) * &weight;
    let error = 1.0 - weight.square();
    g.compile(&[("residual", &residual), ("weight error", &error)])
}

/// The point `v` turned by the rotation vector `r` (Rodrigues); to first order where the rotation is zero.
fn rotate(r: &Var, v: &Var) -> Var {
    let square = r.dot(r);
    let turned = square.gt_scalar(0.0);
    let angle = square.sqrt();
    let axis = r / &angle;
    let (sine, cosine) = (angle.sin(), angle.cos());
    let along = axis.dot(v) * (1.0 - &cosine);
    let general = v * &cosine + cross(&axis, v) * &sine + &axis * &along;
    turned.select(&general, &(v + cross(r, v)))
}

fn cross(a: &Var, b: &Var) -> Var {
    let entry = |i: usize, j: usize| a.channel(i) * b.channel(j) - a.channel(j) * b.channel(i);
    Var::stack(&[&entry(1, 2), &entry(2, 0), &entry(0, 1)])
}
