//! A network of four hidden layers of 128 on the lanes of a domain, forward and backward; `mlp.py` is the same in PyTorch.

use autodiff::{Graph, Program, Sizes, Var, Workspace};

use super::timing::numbers;

pub const BATCH: usize = 16_384;
const WIDTH: usize = 128;
const HIDDEN: usize = 4;
const ENDS: usize = 3;

fn layers() -> [(usize, usize); HIDDEN + 1] {
    std::array::from_fn(|k| {
        let inner = if k == 0 { ENDS } else { WIDTH };
        let outer = if k == HIDDEN { ENDS } else { WIDTH };
        (inner, outer)
    })
}

pub fn record() -> Program {
    let g = Graph::new();
    let lane = g.domain("lane");
    let target = g.input("target", &lane, ENDS);
    let mut x: Var = g.input("x", &lane, ENDS).attach();
    for (k, (inner, outer)) in layers().into_iter().enumerate() {
        let weight = g.param(&format!("weight{k}"), &g.uniform(), inner * outer);
        let bias = g.param(&format!("bias{k}"), &g.uniform(), outer);
        x = x.matmul(&weight, Some(&bias));
        if k < HIDDEN {
            x = x.relu();
        }
    }
    let loss = (x - target).square().sum();
    g.compile(&[("loss", &loss)]).expect("a sound graph")
}

pub fn bind(program: &Program) -> Workspace<f32> {
    let sizes = Sizes::new().lanes("lane", BATCH);
    let mut ws = program.workspace::<f32>(&sizes).expect("sound sizes");
    ws.set("x", &numbers(1, ENDS * BATCH, -1.0, 1.0))
        .expect("an input");
    ws.set("target", &numbers(2, ENDS * BATCH, -1.0, 1.0))
        .expect("a target");
    for (k, (inner, outer)) in layers().into_iter().enumerate() {
        let scale = (2.0 / inner as f32).sqrt();
        let weight = numbers(10 + k as u64, inner * outer, -scale, scale);
        ws.set(&format!("weight{k}"), &weight).expect("a weight");
        ws.set(&format!("bias{k}"), &vec![0.0; outer])
            .expect("a bias");
    }
    ws
}

/// One step's worth: parameters have changed, value and gradient are wanted.
pub fn step(program: &Program, ws: &mut Workspace<f32>, bias: &[f32; ENDS]) {
    ws.set(&format!("bias{HIDDEN}"), bias).expect("a bias");
    program.vjp(ws, "loss").expect("a bound program");
}
