//! Mistakes are returned, with the operation as it was written, both operands and what to do; none of them panics.

mod common;

use std::sync::Arc;

use autodiff::{Detached, Graph, GraphError, RunError, Sizes, Var};
use common::Identity;

/// The first mistake of what `record` records besides a sound output.
fn mistake(record: impl FnOnce(&Graph)) -> GraphError {
    let g = Graph::new();
    record(&g);
    let sound: Var = g.constant(1.0);
    let error = g.compile(&[("sound", &sound)]).err();
    error.expect("a mistake")
}

/// The message holds all of these, and the place in this file.
fn says(error: &GraphError, words: &[&str]) {
    let text = error.to_string();
    for word in words.iter().chain(&["tests/errors.rs:"]) {
        assert!(text.contains(word), "`{word}` is missing: {text}");
    }
}

fn is_mismatch(error: &GraphError) -> bool {
    matches!(error, GraphError::ShapeMismatch { .. })
}

/// What is recorded, and what is to be said of it.
type Case = (fn(&Graph), &'static str);

#[test]
fn what_follows_a_mistake_is_recorded_without_a_panic() {
    // A weight too small for its operand would make a value of no channels, which has none to take.
    let error = mistake(|g| {
        let f = g.param("f", &g.domain("lane"), 3);
        let w = g.param("w", &g.uniform(), 1);
        let layer = f.matmul(&w, None);
        assert_eq!(layer.channels(), 1);
        let _ = layer.channel(0).normalize() + layer.channel(7);
    });
    assert!(is_mismatch(&error), "{error}");
    says(&error, &["matmul", "out x in channels"]);
    let error = mistake(|g| {
        let _ = g.param("f", &g.uniform(), 0).channel(1);
    });
    says(&error, &["channel"]);
}

#[test]
fn operands_that_do_not_fit_are_named_with_the_operation_and_the_fix() {
    let two = |g: &Graph| -> (Var, Var) {
        let (lane, other) = (g.domain("lane"), g.domain("other"));
        (g.param("f", &lane, 3), g.param("w", &other, 3))
    };
    type Operation = fn(&Var, &Var) -> Var;
    let operations: [(&str, Operation); 11] = [
        ("add", |a, b| a + b),
        ("sub", |a, b| a - b),
        ("mul", |a, b| a * b),
        ("div", |a, b| a / b),
        ("pow", |a, b| a.pow(b)),
        ("min", |a, b| a.min(b)),
        ("mul_add", |a, b| a.mul_add(b, a)),
        ("dot", |a, b| a.dot(b)),
        ("segment_dot", |a, b| a.segment_dot(b)),
        ("stack", |a, b| Var::stack(&[a, b])),
        ("lt", |a, b| a.lt(b).to_array().attach()),
    ];
    for (op, operation) in operations {
        let error = mistake(|g| {
            let (f, w) = two(g);
            operation(&f, &w);
        });
        assert!(is_mismatch(&error), "{error}");
        says(
            &error,
            &[
                &format!("`{op}`"),
                "`f` (lane x 3)",
                "`w` (other x 3)",
                "`expand`",
            ],
        );
    }
    let error = mistake(|g| {
        let (f, _) = two(g);
        let pair = Var::stack(&[&f.channel(0), &f.channel(1)]).label("pair");
        let _ = f + pair;
    });
    says(
        &error,
        &["`add`", "`f` (lane x 3)", "`pair` (lane x 2)", "`channel`"],
    );
    let error = mistake(|g| {
        let (f, w) = two(g);
        g.mask("m", &g.domain("third")).select(&f, &w);
    });
    says(&error, &["`select`", "`m` (third)", "`f` (lane x 3)"]);
    let error = mistake(|g| {
        let (a, b) = (g.axis("a"), g.axis("b"));
        let x = g.param_along("x", &g.uniform(), 1, &a);
        let _ = x * g.param_along("y", &g.uniform(), 1, &b);
    });
    says(
        &error,
        &[
            "`mul`",
            "`x` (uniform x a)",
            "`y` (uniform x b)",
            "`sum_axis`",
        ],
    );
    let error = mistake(|g| {
        let (f, w) = two(g);
        f.matmul(&w, None);
    });
    assert!(is_mismatch(&error));
    says(&error, &["`matmul`", "`f`", "`w`", "out x in"]);
    let error = mistake(|g| {
        let (f, w) = two(g);
        let index = g.index("i", &w.domain(), &f.domain());
        f.gather_weighted(&[(&index, &w)]);
    });
    assert!(is_mismatch(&error));
    says(&error, &["`gather_weighted`", "`f`", "`w`", "one channel"]);
    // Stacked values may differ in channels.
    let g = Graph::new();
    let (f, _) = two(&g);
    let stacked = Var::stack(&[&f, &f.channel(1), &f.sum_channels()]);
    assert_eq!(stacked.channels(), 5);
    assert!(g.compile(&[("y", &stacked)]).is_ok());
}

#[test]
fn operands_that_cannot_be_used_are_named_with_the_fix() {
    type Case = (fn(&Graph, &Var), &'static [&'static str]);
    let cases: [Case; 12] = [
        (|_, f| drop(f.channel(3)), &["`channel`", "channel 3 of 3"]),
        (
            |_, f| drop(f.segment_sum()),
            &["`segment_sum`", "`segments`"],
        ),
        (|_, f| drop(f.segment_mean()), &["`segment_mean`"]),
        (|_, f| drop(f.segment_dot(f)), &["`segment_dot`"]),
        (
            |g, f| drop(f.expand(&g.domain("free"))),
            &["`expand`", "`segments`"],
        ),
        (
            |g, f| {
                let other = g.domain("other");
                drop(f.gather(&g.index("i", &f.domain(), &other)));
            },
            &["`gather`", "`i`", "`other`"],
        ),
        (
            |g, f| {
                let own = g.index("i", &f.domain(), &f.domain());
                let away = g.index("j", &g.domain("other"), &f.domain());
                let one: Detached = g.constant(1.0);
                drop(f.gather_weighted(&[(&own, &one), (&away, &one)]));
            },
            &["`gather_weighted`", "one domain"],
        ),
        (
            |_, f| drop(f.gather_weighted::<autodiff::Fixed>(&[])),
            &["`gather_weighted`", "one to eight"],
        ),
        (
            |g, f| {
                let weight = g.param("weight", &g.uniform(), 6);
                drop(f.matmul(&weight, Some(f)));
            },
            &["`matmul`", "bias", "2 channels"],
        ),
        (
            |g, f| drop(g.param("none", &f.domain(), 0)),
            &["`none`", "at least one channel"],
        ),
        (
            |g, _| {
                g.segments("s", &g.uniform());
            },
            &["`segments`", "`sum_lanes`"],
        ),
        (
            |_, f| drop(f * Var::stack(&[])),
            &["`mul`", "another graph"],
        ),
    ];
    for (case, words) in cases {
        let error = mistake(|g| case(g, &g.param("f", &g.domain("lane"), 3)));
        says(&error, words);
    }
}

#[test]
fn a_name_is_used_once() {
    let cases: [Case; 5] = [
        (
            |g| {
                g.domain("x");
                g.domain("x");
            },
            "domain",
        ),
        (
            |g| {
                g.axis("x");
                g.axis("x");
            },
            "axis",
        ),
        (
            |g| {
                g.param("x", &g.uniform(), 1);
                g.input("x", &g.uniform(), 1);
            },
            "the name",
        ),
        (
            |g| {
                g.index("x", &g.uniform(), &g.uniform());
                g.mask("x", &g.uniform());
            },
            "the name",
        ),
        (
            |g| {
                // A label does not free a name.
                g.param("x", &g.uniform(), 1).label("y");
                g.param("x", &g.uniform(), 1);
            },
            "the name",
        ),
    ];
    for (case, what) in cases {
        let error = mistake(case);
        assert!(matches!(error, GraphError::Duplicate { .. }));
        says(&error, &[what, "`x`", "another name"]);
    }
    let g = Graph::new();
    let x = g.param("x", &g.uniform(), 1);
    let error = g.compile(&[("y", &x), ("y", &(&x * 2.0))]).err();
    says(&error.expect("a mistake"), &["the output `y`"]);
}

#[test]
fn a_label_on_a_parameter_leaves_its_name() {
    let g = Graph::new();
    let x = g.param("x", &g.uniform(), 1).label("brightness");
    let mask = g.input("mask", &g.uniform(), 1).label("weight");
    let program = g.compile(&[("y", &(x * mask).square())]).unwrap();
    assert_eq!(program.params().collect::<Vec<_>>(), ["x"]);
    let mut ws = program.workspace::<f64>(&Sizes::new()).unwrap();
    ws.set("mask", &[2.0]).unwrap();
    assert!(matches!(program.forward(&mut ws), Err(RunError::Unbound { name, .. }) if name == "x"));
    ws.set("x", &[3.0]).unwrap();
    program.hvp(&mut ws, "y", &[("x", &[1.0])]).unwrap();
    assert_eq!(ws.gradient("x").unwrap(), [24.0]);
    assert_eq!(ws.hessian_product("x").unwrap(), [8.0]);
    assert!(ws.set("brightness", &[1.0]).is_err());
    ws.set("x", &[f64::NAN]).unwrap();
    let found = program.find_non_finite(&mut ws).unwrap().unwrap();
    assert_eq!(found.origin, "brightness");
}

/// What another graph offers, all of it further on than anything of an empty one.
struct Foreign {
    domain: autodiff::Domain,
    child: autodiff::Domain,
    axis: autodiff::Axis,
    index: autodiff::Index,
    x: Var,
    mask: autodiff::Mask,
}

fn foreign() -> Foreign {
    let g = Graph::new();
    for i in 0..9 {
        let lane = g.domain(&format!("domain {i}"));
        g.axis(&format!("axis {i}"));
        g.index(&format!("index {i}"), &lane, &lane);
    }
    let domain = g.domain("domain");
    let child = g.segments("child", &domain);
    Foreign {
        domain,
        child,
        axis: g.axis("axis"),
        index: g.index("index", &child, &domain),
        x: (g.param("x", &child, 3) * 2.0).label("far"),
        mask: g.mask("mask", &child),
    }
}

#[test]
fn what_belongs_to_another_graph_is_a_mistake_and_never_a_panic() {
    type Case = (&'static str, fn(&Graph, &Var, &Foreign));
    // What is made of a mistake is used again.
    let cases: [Case; 22] = [
        ("add", |_, a, f| drop((a + &f.x).sum())),
        ("add", |_, a, f| drop((&f.x + a).sum() + a)),
        ("mul_add", |_, a, f| drop(a.mul_add(a, &f.x).segment_sum())),
        ("dot", |_, a, f| drop(a.dot(&f.x) + a)),
        ("segment_dot", |_, a, f| drop(a.segment_dot(&f.x).sum())),
        ("stack", |_, a, f| drop(Var::stack(&[a, &f.x]).sum())),
        ("expand", |_, a, f| drop(a.expand(&f.child).segment_sum())),
        ("gather", |_, a, f| drop(a.gather(&f.index).segment_sum())),
        ("gather_weighted", |_, a, f| {
            drop(a.gather_weighted(&[(&f.index, a)]).segment_sum())
        }),
        ("gather_weighted", |g, a, f| {
            let own = g.index("own", &a.domain(), &a.domain());
            drop(a.gather_weighted(&[(&own, &f.x)]).segment_sum())
        }),
        ("matmul", |_, a, f| drop(a.matmul(&f.x, None).segment_sum())),
        ("matmul", |g, a, f| {
            let weight = g.param("weight", &g.uniform(), 6);
            drop(a.matmul(&weight, Some(&f.x)).sum())
        }),
        ("linear_map", |_, a, f| {
            drop(a.linear_map(&f.domain, Arc::new(Identity(3))).segment_sum())
        }),
        ("select", |g, a, f| {
            let mask = g.mask("mask", &a.domain());
            drop(mask.select(a, &f.x).sum())
        }),
        ("select", |_, a, f| drop(f.mask.select(a, a).sum())),
        ("min", |g, a, f| {
            let mask = g.mask("mask", &a.domain());
            drop((&mask & &f.mask).select(a, a).sum())
        }),
        ("declaration", |g, _, f| {
            drop(g.param("p", &f.domain, 1).segment_sum())
        }),
        ("declaration", |g, a, f| {
            let along = g.param_along("p", &a.domain(), 1, &f.axis);
            drop(along.sum_axis() * a)
        }),
        ("index", |g, a, f| {
            let index = g.index("i", &f.domain, &a.domain());
            drop(a.gather(&index).segment_sum())
        }),
        ("index", |g, a, f| {
            let index = g.index("i", &a.domain(), &f.domain);
            drop(a.gather(&index).segment_sum())
        }),
        ("segments", |g, a, f| {
            let child = g.segments("c", &f.domain);
            drop(a.expand(&child).segment_sum())
        }),
        ("custom", |g, _, f| drop(g.custom(Double, [&f.x]).sum())),
    ];
    let foreign = foreign();
    for (op, case) in cases {
        let g = Graph::new();
        let a = g.param("near", &g.domain("lane"), 3);
        case(&g, &a, &foreign);
        // Where the other graph's value comes first, its graph has the mistake.
        let error = g.compile(&[("near", &a)]).err();
        let Some(error) = error else { continue };
        assert!(
            matches!(error, GraphError::OtherGraph { .. }),
            "{op}: {error}"
        );
        says(
            &error,
            &[&format!("`{op}`"), "of another graph", "the same"],
        );
    }
    let error = mistake(|g| drop(g.param("near", &g.uniform(), 3) * &foreign.x));
    says(&error, &["`near` (uniform x 3)", "`far` (child x 3)"]);
    let g = Graph::new();
    let error = g.compile(&[("y", &foreign.x)]).err();
    says(&error.expect("a mistake"), &["`compile`", "`far`"]);
}

struct Double;

impl autodiff::CustomOp<1> for Double {
    fn name(&self) -> &'static str {
        "custom"
    }
    fn eval<R: autodiff::Real, F: autodiff::Fma>(&self, [x]: [R; 1]) -> R {
        x + x
    }
}

#[test]
fn what_is_bound_is_checked() {
    let g = Graph::new();
    let (lane, table) = (g.domain("lane"), g.domain("table"));
    let child = g.segments("child", &lane);
    let frame = g.axis("frame");
    let x = g.param_along("x", &table, 2, &frame);
    let mapped = x.linear_map(&lane, Arc::new(Identity(4))).label("mapped");
    let (index, mask) = (g.index("index", &child, &lane), g.mask("mask", &child));
    let y = mask.select_or_zero(&mapped.gather(&index));
    let program = g.compile(&[("y", &y)]).unwrap();
    let sizes = || Sizes::new().lanes("lane", 4).lanes("table", 4);
    let whole = || sizes().per_parent("child", 2).axis("frame", 3);
    let fails = |sizes: Sizes, words: &[&str]| {
        let error = program.workspace::<f32>(&sizes).err().expect("an error");
        let predicted = program.memory::<f32>(&sizes).err();
        let is_map = matches!(error, RunError::MapShape { .. });
        assert!(is_map || predicted.as_ref() == Some(&error));
        let text = error.to_string();
        for word in words {
            assert!(text.contains(word), "`{word}` is missing: {text}");
        }
    };
    fails(Sizes::new().axis("frame", 3), &["`lane`", "`Sizes::lanes`"]);
    fails(
        sizes().per_parent("child", 2),
        &["`frame`", "`Sizes::axis`"],
    );
    fails(
        sizes().axis("frame", 3),
        &["`child`", "`Sizes::per_parent`"],
    );
    fails(whole().axis("frame", 0), &["`frame`", "at least one"]);
    fails(whole().lanes("child", 9), &["`child`", "9", "8"]);
    fails(whole().lanes("nothing", 9), &["`nothing`", "`lane`"]);
    fails(
        whole().offsets("child", vec![0, 1]),
        &["2 entries", "`lane`"],
    );
    fails(
        whole().offsets("child", vec![1, 1, 1, 1, 1]),
        &["start at 0"],
    );
    fails(
        whole().offsets("child", vec![0, 2, 1, 1, 1]),
        &["never fall"],
    );
    fails(whole().lanes("table", 5), &["`mapped`", "4 -> 4", "5 -> 4"]);

    let mut ws = program.workspace::<f32>(&whole()).unwrap();
    let unbound = |ws: &mut autodiff::Workspace<f32>, words: [&str; 3]| {
        let error = program.vjp(ws, "y").expect_err("an error");
        assert!(matches!(error, RunError::Unbound { .. }), "{error}");
        for word in words {
            assert!(error.to_string().contains(word), "{word}: {error}");
        }
    };
    unbound(&mut ws, ["`x`", "table x 2 x frame", "`set`"]);
    ws.set("x", &[1.0; 24]).unwrap();
    unbound(&mut ws, ["`mask`", "child", "`set_mask`"]);
    ws.set_mask("mask", &[true; 8]).unwrap();
    unbound(&mut ws, ["`index`", "one index per lane", "`set_index`"]);
    let length = |error: RunError| {
        assert!(matches!(error, RunError::Length { .. }), "{error}");
    };
    length(ws.set("x", &[1.0; 23]).unwrap_err());
    length(ws.set_mask("mask", &[true; 7]).unwrap_err());
    length(ws.set_index("index", &[0; 9]).unwrap_err());
    ws.set_index("index", &[3; 8]).unwrap();
    length(program.vjp_with(&mut ws, &[("y", &[1.0])]).unwrap_err());
    length(program.jvp(&mut ws, &[("x", &[1.0])]).unwrap_err());
    let unknown = |error: RunError, known: &str| {
        assert!(matches!(error, RunError::Unknown { .. }), "{error}");
        assert!(error.to_string().contains(known), "{error}");
    };
    unknown(ws.set("z", &[]).unwrap_err(), "`x`");
    unknown(ws.set_index("z", &[]).unwrap_err(), "`index`");
    unknown(program.vjp(&mut ws, "z").unwrap_err(), "`y`");
    unknown(ws.gradient("z").err().unwrap(), "`x`");
    let mut other = {
        let again = g.compile(&[("y", &y)]).unwrap();
        again.workspace::<f32>(&whole()).unwrap()
    };
    assert_eq!(program.forward(&mut other), Err(RunError::OtherProgram));
    // All that went wrong left the workspace as it was.
    program.vjp(&mut ws, "y").unwrap();
    assert_eq!(ws.output("y").unwrap(), [1.0; 48]);
}

#[test]
fn sizes_that_no_memory_holds_are_refused() {
    let g = Graph::new();
    let lane = g.domain("lane");
    let loss = g.param("x", &lane, 3).square().sum();
    let program = g.compile(&[("loss", &loss)]).unwrap();
    for lanes in [usize::MAX, usize::MAX / 3 + 1, isize::MAX as usize / 3] {
        let sizes = Sizes::new().lanes("lane", lanes);
        let errors = [
            program.memory::<f32>(&sizes).err(),
            program.workspace::<f64>(&sizes).err(),
        ];
        for error in errors {
            let text = error.expect("a mistake").to_string();
            assert!(text.contains("`lane`"), "{text}");
            assert!(text.contains("more than can be addressed"), "{text}");
        }
    }
    // A block of any size is cut to what there is.
    let sizes = Sizes::new().lanes("lane", 5).block(usize::MAX);
    let mut ws = program.workspace::<f32>(&sizes).unwrap();
    ws.set("x", &[1.0; 15]).unwrap();
    program.vjp(&mut ws, "loss").unwrap();
    assert_eq!(ws.gradient("x").unwrap(), [2.0; 15]);
}
