//! What has not been computed is an error, not zeros or the results of before.

use autodiff::{Graph, RunError, Sizes};

#[test]
fn results_are_those_of_what_is_bound_or_an_error() {
    let g = Graph::new();
    let x = g.param("x", &g.uniform(), 1);
    let program = g.compile(&[("y", &x.square())]).unwrap();
    let mut ws = program.workspace::<f64>(&Sizes::new()).unwrap();
    let missing = |found: Result<&[f64], RunError>, call: &str| match found {
        Err(error @ RunError::NotComputed { .. }) => assert!(error.to_string().contains(call)),
        other => panic!("{other:?}"),
    };
    missing(ws.output("y"), "`Program::forward`");
    missing(ws.tangent("y"), "`Program::jvp`");
    missing(ws.gradient("x"), "`Program::vjp`");
    missing(ws.hessian_product("x"), "`Program::hvp`");
    assert!(matches!(ws.output("z"), Err(RunError::Unknown { .. })));
    // A call that fails computes nothing.
    assert!(program.vjp(&mut ws, "y").is_err());
    missing(ws.gradient("x"), "`Program::vjp`");

    ws.set("x", &[3.0]).unwrap();
    program.hvp(&mut ws, "y", &[("x", &[1.0])]).unwrap();
    assert_eq!(ws.gradient("x").unwrap(), [6.0]);
    assert_eq!(ws.hessian_product("x").unwrap(), [2.0]);
    missing(ws.output("y"), "`Program::forward`");
    program.forward(&mut ws).unwrap();
    assert_eq!(ws.output("y").unwrap(), [9.0]);
    missing(ws.tangent("y"), "`Program::jvp`");
    program.jvp(&mut ws, &[("x", &[1.0])]).unwrap();
    assert_eq!(ws.tangent("y").unwrap(), [6.0]);

    // An optimiser reads gradients while it binds new parameters; values are then those of before.
    ws.set("x", &[4.0]).unwrap();
    missing(ws.output("y"), "`Program::forward`");
    assert_eq!(ws.gradient("x").unwrap(), [6.0]);
    program.vjp(&mut ws, "y").unwrap();
    assert_eq!(
        (ws.output("y").unwrap(), ws.gradient("x").unwrap()),
        (&[16.0][..], &[8.0][..])
    );
}

/// One program serves threads that have a workspace each.
#[test]
fn threads_share_a_program() {
    let g = Graph::new();
    let lane = g.domain("lane");
    let x = g.param("x", &lane, 1);
    let program = g.compile(&[("y", &x.exp().square().sum())]).unwrap();
    let gradient = |lanes: usize| {
        let mut ws = program
            .workspace::<f64>(&Sizes::new().lanes("lane", lanes))
            .unwrap();
        ws.set("x", &vec![0.5; lanes]).unwrap();
        // Workspaces move between threads too.
        std::thread::scope(|scope| {
            scope.spawn(|| program.vjp(&mut ws, "y").unwrap());
        });
        ws.gradient("x").unwrap().to_vec()
    };
    let [few, many] = std::thread::scope(|scope| {
        [3, 5000]
            .map(|lanes| scope.spawn(move || gradient(lanes)))
            .map(|thread| thread.join().unwrap())
    });
    assert!(few.iter().chain(&many).all(|g| *g == few[0]));
    assert!((few[0] - 2.0 * 1.0f64.exp()).abs() < 1e-12);
}
