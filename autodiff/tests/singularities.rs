//! The table of singularities in the documentation, row by row: value, forward and reverse derivatives, the Hessian's product,
//! in both precisions, simplified and as recorded.

use autodiff::{Graph, Scalar, Sizes, Var};

const INFINITE: f64 = f64::INFINITY;
const NAN: f64 = f64::NAN;

type Record = fn(&Var, &Var) -> Var;

struct Row {
    name: &'static str,
    record: Record,
    at: [f64; 2],
    value: f64,
    /// By `x` and by `y`, in reverse.
    slopes: [f64; 2],
    /// The same forward, where several operations disagree: the zero rule looks at what comes in, from one side or the other.
    forward: [f64; 2],
}

const fn row(
    name: &'static str,
    record: Record,
    at: [f64; 2],
    value: f64,
    slopes: [f64; 2],
) -> Row {
    Row {
        name,
        record,
        at,
        value,
        slopes,
        forward: slopes,
    }
}

const fn chain(case: Row, forward: [f64; 2]) -> Row {
    Row { forward, ..case }
}

const PI: f64 = std::f64::consts::PI;

const TABLE: &[Row] = &[
    row(
        "sqrt at 0",
        |x, _| x.sqrt(),
        [0.0, 0.0],
        0.0,
        [INFINITE, 0.0],
    ),
    row("sqrt below", |x, _| x.sqrt(), [-1.0, 0.0], NAN, [NAN, 0.0]),
    row(
        "rsqrt at 0",
        |x, _| x.rsqrt(),
        [0.0, 0.0],
        INFINITE,
        [-INFINITE, 0.0],
    ),
    row(
        "rsqrt of sqrt at 0",
        |x, _| x.sqrt().recip(),
        [0.0, 0.0],
        INFINITE,
        [-INFINITE, 0.0],
    ),
    row(
        "rsqrt below",
        |x, _| x.rsqrt(),
        [-1.0, 0.0],
        NAN,
        [NAN, 0.0],
    ),
    row(
        "recip at 0",
        |x, _| x.recip(),
        [0.0, 0.0],
        INFINITE,
        [-INFINITE, 0.0],
    ),
    row(
        "number over 0",
        |x, _| 2.0 / x,
        [0.0, 0.0],
        INFINITE,
        [-INFINITE, 0.0],
    ),
    row(
        "div by 0",
        |x, y| x / y,
        [1.0, 0.0],
        INFINITE,
        [INFINITE, -INFINITE],
    ),
    row(
        "div by 0, below",
        |x, y| x / y,
        [-1.0, 0.0],
        -INFINITE,
        [INFINITE, INFINITE],
    ),
    row("0 / 0", |x, y| x / y, [0.0, 0.0], NAN, [INFINITE, NAN]),
    row(
        "x recip",
        |x, y| x * y.recip(),
        [1.0, 0.0],
        INFINITE,
        [INFINITE, -INFINITE],
    ),
    chain(
        row(
            "0 recip",
            |x, y| x * y.recip(),
            [0.0, 0.0],
            NAN,
            [INFINITE, 0.0],
        ),
        [INFINITE, NAN],
    ),
    chain(
        row(
            "recip 0",
            |x, y| y.recip() * x,
            [0.0, 0.0],
            NAN,
            [INFINITE, 0.0],
        ),
        [INFINITE, NAN],
    ),
    row(
        "ln at 0",
        |x, _| x.ln(),
        [0.0, 0.0],
        -INFINITE,
        [INFINITE, 0.0],
    ),
    row("ln below", |x, _| x.ln(), [-2.0, 0.0], NAN, [-0.5, 0.0]),
    row("pow(0, 0)", |x, y| x.pow(y), [0.0, 0.0], 1.0, [0.0, 0.0]),
    row(
        "pow(0, 1/2)",
        |x, y| x.pow(y),
        [0.0, 0.5],
        0.0,
        [INFINITE, 0.0],
    ),
    row("pow(0, 1)", |x, y| x.pow(y), [0.0, 1.0], 0.0, [1.0, 0.0]),
    row("pow(0, 2)", |x, y| x.pow(y), [0.0, 2.0], 0.0, [0.0, 0.0]),
    row(
        "pow(0, -1)",
        |x, y| x.pow(y),
        [0.0, -1.0],
        INFINITE,
        [-INFINITE, 0.0],
    ),
    row("pow(-1, 2)", |x, y| x.pow(y), [-1.0, 2.0], NAN, [NAN, NAN]),
    row("pow(-1, 0)", |x, y| x.pow(y), [-1.0, 0.0], 1.0, [0.0, NAN]),
    row("pow(-1, 1)", |x, y| x.pow(y), [-1.0, 1.0], NAN, [1.0, NAN]),
    row("powi(0, 0)", |x, _| x.powi(0), [0.0, 0.0], 1.0, [0.0, 0.0]),
    row(
        "powi(0, -1)",
        |x, _| x.powi(-1),
        [0.0, 0.0],
        INFINITE,
        [-INFINITE, 0.0],
    ),
    row(
        "powi(0, -2)",
        |x, _| x.powi(-2),
        [0.0, 0.0],
        INFINITE,
        [-INFINITE, 0.0],
    ),
    row(
        "powi(0, -3)",
        |x, _| x.powi(-3),
        [0.0, 0.0],
        INFINITE,
        [-INFINITE, 0.0],
    ),
    row(
        "acos at 1",
        |x, _| x.acos(),
        [1.0, 0.0],
        0.0,
        [-INFINITE, 0.0],
    ),
    row(
        "acos at -1",
        |x, _| x.acos(),
        [-1.0, 0.0],
        PI,
        [-INFINITE, 0.0],
    ),
    row("acos beyond", |x, _| x.acos(), [1.5, 0.0], NAN, [NAN, 0.0]),
    row(
        "atan2(0, 0)",
        |x, y| x.atan2(y),
        [0.0, 0.0],
        0.0,
        [NAN, NAN],
    ),
    row(
        "normalize 0",
        |x, y| Var::stack(&[x, y]).normalize().channel(0),
        [0.0, 0.0],
        NAN,
        [INFINITE, 0.0],
    ),
    row(
        "exp far above",
        |x, _| x.exp(),
        [1000.0, 0.0],
        INFINITE,
        [INFINITE, 0.0],
    ),
    row(
        "exp far below",
        |x, _| x.exp(),
        [-1000.0, 0.0],
        0.0,
        [0.0, 0.0],
    ),
    row("exp of NaN", |x, _| x.exp(), [NAN, 0.0], NAN, [NAN, 0.0]),
    row(
        "ln of infinity",
        |x, _| x.ln(),
        [INFINITE, 0.0],
        INFINITE,
        [0.0, 0.0],
    ),
    row(
        "sigmoid far above",
        |x, _| x.sigmoid(),
        [1000.0, 0.0],
        1.0,
        [0.0, 0.0],
    ),
    row(
        "sigmoid far below",
        |x, _| x.sigmoid(),
        [-1000.0, 0.0],
        0.0,
        [0.0, 0.0],
    ),
    row(
        "sigmoid of NaN",
        |x, _| x.sigmoid(),
        [NAN, 0.0],
        NAN,
        [NAN, 0.0],
    ),
    row(
        "softplus far above",
        |x, _| x.softplus(),
        [1000.0, 0.0],
        1000.0,
        [1.0, 0.0],
    ),
    row(
        "softplus far below",
        |x, _| x.softplus(),
        [-1000.0, 0.0],
        0.0,
        [0.0, 0.0],
    ),
    row(
        "softplus of NaN",
        |x, _| x.softplus(),
        [NAN, 0.0],
        NAN,
        [NAN, 0.0],
    ),
    row(
        "sin of infinity",
        |x, _| x.sin(),
        [INFINITE, 0.0],
        NAN,
        [NAN, 0.0],
    ),
    row(
        "cos of infinity",
        |x, _| x.cos(),
        [-INFINITE, 0.0],
        NAN,
        [NAN, 0.0],
    ),
    row(
        "0 times infinity",
        |x, y| x * y,
        [0.0, INFINITE],
        NAN,
        [INFINITE, 0.0],
    ),
    row("abs of NaN", |x, _| x.abs(), [NAN, 0.0], NAN, [0.0, 0.0]),
    row(
        "clamp of NaN",
        |x, _| x.clamp(0.0, 1.0),
        [NAN, 0.0],
        NAN,
        [1.0, 0.0],
    ),
    row(
        "where lt of NaN",
        |x, y| x.lt(y).select(x, y),
        [NAN, 2.0],
        2.0,
        [0.0, 1.0],
    ),
    row(
        "where le of NaN",
        |x, y| y.le(x).select(x, y),
        [NAN, 2.0],
        2.0,
        [0.0, 1.0],
    ),
    row(
        "where gt of NaN",
        |x, y| x.gt_scalar(1.0).select(x, y),
        [NAN, 2.0],
        2.0,
        [0.0, 1.0],
    ),
    row(
        "where not lt of NaN",
        |x, y| (!&x.lt(y)).select(x, y),
        [NAN, 2.0],
        NAN,
        [1.0, 0.0],
    ),
    row("abs at 0", |x, _| x.abs(), [0.0, 0.0], 0.0, [0.0, 0.0]),
    row("relu at 0", |x, _| x.relu(), [0.0, 0.0], 0.0, [0.0, 0.0]),
    row("relu of NaN", |x, _| x.relu(), [NAN, 0.0], NAN, [0.0, 0.0]),
    row(
        "clamp at low",
        |x, _| x.clamp(0.0, 1.0),
        [0.0, 0.0],
        0.0,
        [1.0, 0.0],
    ),
    row(
        "clamp at high",
        |x, _| x.clamp(0.0, 1.0),
        [1.0, 0.0],
        1.0,
        [1.0, 0.0],
    ),
    row("min at a tie", |x, y| x.min(y), [2.0, 2.0], 2.0, [1.0, 0.0]),
    row("max at a tie", |x, y| x.max(y), [2.0, 2.0], 2.0, [1.0, 0.0]),
    row("min(NaN, 1)", |x, y| x.min(y), [NAN, 1.0], NAN, [1.0, 0.0]),
    row("max(NaN, 1)", |x, y| x.max(y), [NAN, 1.0], NAN, [1.0, 0.0]),
    row("min(1, NaN)", |x, y| x.min(y), [1.0, NAN], 1.0, [1.0, 0.0]),
    row("max(1, NaN)", |x, y| x.max(y), [1.0, NAN], 1.0, [1.0, 0.0]),
    row(
        "log_sum_exp of nothing",
        |x, _| x.log_sum_exp(),
        [-INFINITE, 0.0],
        NAN,
        [NAN, 0.0],
    ),
];

fn same(a: f64, b: f64) -> bool {
    a == b || (a.is_nan() && b.is_nan()) || (a - b).abs() < 1e-6
}

fn check<S: Scalar>(case: &Row, simplify: bool) {
    let g = Graph::new();
    let lane = g.domain("lane");
    let (x, y) = (g.param("x", &lane, 1), g.param("y", &lane, 1));
    let z = (case.record)(&x, &y);
    // The same behind a mask.
    let masked = g.mask("mask", &lane).select_or_zero(&z);
    let outputs = [("z", &z), ("masked", &masked)];
    let program = match simplify {
        true => g.compile(&outputs),
        false => g.compile_as_recorded(&outputs),
    };
    let program = program.unwrap();
    // One lane, and the last of many.
    for lanes in [1, 70] {
        let sizes = Sizes::new().lanes("lane", lanes);
        let mut ws = program.workspace::<S>(&sizes).unwrap();
        let fill = |bad: f64| -> Vec<S> {
            let mut all = vec![S::from_f64(0.75); lanes];
            all[lanes - 1] = S::from_f64(bad);
            all
        };
        ws.set("x", &fill(case.at[0])).unwrap();
        ws.set("y", &fill(case.at[1])).unwrap();
        ws.set_mask("mask", &vec![false; lanes]).unwrap();
        let last = |array: &[S]| array[lanes - 1].to_f64();
        let context = format!("{}, {lanes} lanes, simplified: {simplify}", case.name);
        program.vjp(&mut ws, "z").unwrap();
        let value = last(ws.output("z").unwrap());
        assert!(same(value, case.value), "{context}: value {value}");
        for (name, slope) in ["x", "y"].into_iter().zip(case.slopes) {
            let reverse = last(ws.gradient(name).unwrap());
            assert!(
                same(reverse, slope),
                "{context}: {reverse} by {name} in reverse"
            );
        }
        let ones = fill(1.0);
        for (name, slope) in ["x", "y"].into_iter().zip(case.forward) {
            program.jvp(&mut ws, &[(name, &ones)]).unwrap();
            let forward = last(ws.tangent("z").unwrap());
            assert!(
                same(forward, slope),
                "{context}: {forward} by {name} forward"
            );
            assert_eq!(last(ws.tangent("masked").unwrap()), 0.0, "{context}");
        }
        program.vjp(&mut ws, "masked").unwrap();
        assert_eq!(last(ws.output("masked").unwrap()), 0.0, "{context}");
        for name in ["x", "y"] {
            assert_eq!(last(ws.gradient(name).unwrap()), 0.0, "{context}");
        }
        // Second derivatives: the gradient is the same, along any direction; masked, nothing is left.
        for direction in ["x", "y"] {
            program.hvp(&mut ws, "z", &[(direction, &ones)]).unwrap();
            let chained = !same(case.slopes[0], case.forward[0])
                || !same(case.slopes[1], case.forward[1])
                || case.name == "normalize 0";
            for (name, slope) in ["x", "y"].into_iter().zip(case.slopes) {
                let reverse = last(ws.gradient(name).unwrap());
                // A derivative of 0 that moves is not nothing.
                let as_expected = same(reverse, slope) || (chained && reverse.is_nan());
                assert!(
                    as_expected,
                    "{context}: {reverse} by {name} along {direction}"
                );
            }
            program
                .hvp(&mut ws, "masked", &[(direction, &ones)])
                .unwrap();
            for name in ["x", "y"] {
                assert_eq!(last(ws.gradient(name).unwrap()), 0.0, "{context}");
                assert_eq!(last(ws.hessian_product(name).unwrap()), 0.0, "{context}");
            }
        }
    }
}

#[test]
fn every_row_of_the_table_holds() {
    for case in TABLE {
        for simplify in [true, false] {
            check::<f32>(case, simplify);
            check::<f64>(case, simplify);
        }
    }
}

/// Second derivatives at the rows whose first ones are finite: what the formula of the side that was taken says.
#[test]
fn second_derivatives_at_kinks_are_those_of_the_side_taken() {
    type Kink = (&'static str, Record, [f64; 2], [[f64; 2]; 2]);
    let zero = [[0.0; 2]; 2];
    let cases: [Kink; 7] = [
        ("abs", |x, _| x.abs() * 3.0, [0.0, 1.0], zero),
        ("relu", |x, _| x.relu().square(), [0.0, 1.0], zero),
        (
            "clamp",
            |x, _| x.clamp(0.0, 1.0).square(),
            [1.0, 1.0],
            [[2.0, 0.0], [0.0, 0.0]],
        ),
        (
            "min",
            |x, y| x.min(y).square(),
            [2.0, 2.0],
            [[2.0, 0.0], [0.0, 0.0]],
        ),
        (
            "max",
            |x, y| x.max(y).square(),
            [2.0, 2.0],
            [[2.0, 0.0], [0.0, 0.0]],
        ),
        (
            "select",
            |x, y| x.lt(y).select(&x.square(), &y.sqrt()),
            [-1.0, 0.0],
            [[2.0, 0.0], [0.0, 0.0]],
        ),
        (
            "powi",
            |x, _| x.powi(2),
            [0.0, 0.0],
            [[2.0, 0.0], [0.0, 0.0]],
        ),
    ];
    for (name, record, at, expected) in cases {
        let g = Graph::new();
        let (x, y) = (g.param("x", &g.uniform(), 1), g.param("y", &g.uniform(), 1));
        let program = g.compile(&[("z", &record(&x, &y))]).unwrap();
        let mut ws = program.workspace::<f64>(&Sizes::new()).unwrap();
        ws.set("x", &at[..1]).unwrap();
        ws.set("y", &at[1..]).unwrap();
        for (direction, row) in ["x", "y"].into_iter().zip(expected) {
            program.hvp(&mut ws, "z", &[(direction, &[1.0])]).unwrap();
            let found = ["x", "y"].map(|by| ws.hessian_product(by).unwrap()[0]);
            assert_eq!(found, row, "{name} along {direction}");
        }
    }
}
