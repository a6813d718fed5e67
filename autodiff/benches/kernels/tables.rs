//! Gradients of lookups in tables from small to large: single rows of three channels, and four weighted rows of one.

use autodiff::{Graph, Program, Sizes, Workspace};

use super::timing::{best, numbers};

const LANES: usize = 1 << 18;
const CORNERS: usize = 4;

/// Prints the time of both, table by table.
pub fn run() {
    println!("gradients of {LANES} lookups (milliseconds)");
    println!("{:>9} {:>14} {:>14}", "rows", "one row of 3", "4 weighted");
    for rows in [1 << 10, 1 << 13, 1 << 15, 1 << 17, 1 << 20, 1 << 22] {
        let [single, weighted] = [single(), weighted()];
        let mut single_ws = bind(&single, rows, 3, 1);
        let mut weighted_ws = bind(&weighted, rows, 1, CORNERS);
        let [a, b] = best([&mut || step(&single, &mut single_ws), &mut || {
            step(&weighted, &mut weighted_ws)
        }]);
        println!("{rows:>9} {a:>14.2} {b:>14.2}");
    }
}

fn single() -> Program {
    let g = Graph::new();
    let (lane, row) = (g.domain("lane"), g.domain("row"));
    let table = g.param("table", &row, 3);
    let index = g.index("index0", &lane, &row);
    let loss = table.gather(&index).square().sum();
    g.compile(&[("loss", &loss)]).expect("a sound graph")
}

fn weighted() -> Program {
    let g = Graph::new();
    let (lane, row) = (g.domain("lane"), g.domain("row"));
    let table = g.param("table", &row, 1);
    let corners: [_; CORNERS] = std::array::from_fn(|k| {
        let index = g.index(&format!("index{k}"), &lane, &row);
        (index, g.input(&format!("weight{k}"), &lane, 1))
    });
    let corners: [_; CORNERS] = std::array::from_fn(|k| (&corners[k].0, &corners[k].1));
    let loss = table.gather_weighted(&corners).square().sum();
    g.compile(&[("loss", &loss)]).expect("a sound graph")
}

fn bind(program: &Program, rows: usize, channels: usize, corners: usize) -> Workspace<f32> {
    let sizes = Sizes::new().lanes("lane", LANES).lanes("row", rows);
    let mut ws = program.workspace::<f32>(&sizes).expect("sound sizes");
    let table = numbers(1, channels * rows, 0.0, 1.0);
    ws.set("table", &table).expect("a table");
    for k in 0..corners {
        let at = numbers(2 + k as u64, LANES, 0.0, rows as f32);
        let index: Vec<u32> = at
            .iter()
            .map(|&x| (x as u32).min(rows as u32 - 1))
            .collect();
        ws.set_index(&format!("index{k}"), &index)
            .expect("an index");
        if corners > 1 {
            let weight = numbers(20 + k as u64, LANES, 0.0, 1.0);
            ws.set(&format!("weight{k}"), &weight).expect("weights");
        }
    }
    ws
}

fn step(program: &Program, ws: &mut Workspace<f32>) {
    program.vjp(ws, "loss").expect("a bound program");
}
