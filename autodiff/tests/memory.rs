//! Memory: predicted before a run, and not allocated again after the first.

use autodiff::{Graph, Program, Sizes, Workspace};

fn program() -> Program {
    let g = Graph::new();
    let (pixel, texel) = (g.domain("pixel"), g.domain("texel"));
    let sample = g.segments("sample", &pixel);
    let frame = g.axis("frame");
    let light = g.param("light", &texel, 3);
    let rows = g.param_along("rows", &texel, 1, &frame);
    let index = g.index("index", &sample, &texel);
    let cosine = g.input("cosine", &sample, 1);
    let image = (light.exp().gather(&index) * &cosine).segment_dot(&rows.sigmoid().gather(&index));
    let loss = image.square().sum();
    g.compile(&[("image", &image), ("loss", &loss)]).unwrap()
}

const PIXELS: usize = 300;

fn sizes() -> Sizes {
    Sizes::new()
        .lanes("pixel", PIXELS)
        .lanes("texel", 500)
        .per_parent("sample", 40)
        .axis("frame", 24)
}

fn workspace(program: &Program) -> Workspace<f32> {
    let mut ws = program.workspace::<f32>(&sizes()).unwrap();
    let index: Vec<u32> = (0..PIXELS as u32 * 40).map(|i| i * 7 % 500).collect();
    ws.set_index("index", &index).unwrap();
    ws.set("cosine", &vec![0.5; index.len()]).unwrap();
    ws.set("light", &[0.1; 1500]).unwrap();
    ws.set("rows", &[0.2; 500 * 24]).unwrap();
    ws
}

fn run(program: &Program, ws: &mut Workspace<f32>) {
    let (light, rows) = ([1.0; 1500], [1.0; 500 * 24]);
    program.forward(ws).unwrap();
    program.vjp(ws, "loss").unwrap();
    let direction: [(&str, &[f32]); 2] = [("light", &light), ("rows", &rows)];
    program.gauss_newton(ws, "image", &direction, None).unwrap();
    ws.set("light", &[0.3; 1500]).unwrap();
    program.vjp(ws, "loss").unwrap();
}

#[test]
fn memory_is_within_its_prediction() {
    let program = program();
    let predicted = program.memory::<f32>(&sizes()).unwrap();
    let mut ws = workspace(&program);
    program.forward(&mut ws).unwrap();
    assert!(ws.bytes() <= predicted.values);
    program.vjp(&mut ws, "loss").unwrap();
    assert!(ws.bytes() <= predicted.values + predicted.adjoints);
    run(&program, &mut ws);
    assert!(ws.bytes() <= predicted.total());
    // A prediction is of use only if it is tight.
    assert!(
        ws.bytes() * 10 >= predicted.total() * 8,
        "{} of {predicted:?}",
        ws.bytes()
    );
}

#[test]
fn later_runs_allocate_nothing() {
    let program = program();
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    pool.install(|| {
        let mut ws = workspace(&program);
        run(&program, &mut ws);
        let steady = allocation_counter::measure(|| run(&program, &mut ws));
        assert_eq!(steady.count_total, 0);
    });
}
