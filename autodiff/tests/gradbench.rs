//! Mixtures of Gaussians and bundle adjustment against derivations by hand, to 1e-8, and the suite's messages.

#[path = "../examples/gradbench/ba.rs"]
mod ba;
#[path = "../examples/gradbench/gmm.rs"]
mod gmm;
#[path = "../examples/gradbench/messages.rs"]
mod messages;

use serde_json::{Value, json};
use std::f64::consts::PI;

fn numbers(seed: u64, n: usize) -> Vec<f64> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    (0..n)
        .map(|_| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(99);
            2.0 * (state >> 11) as f64 / (1u64 << 53) as f64 - 1.0
        })
        .collect()
}

fn matrix(seed: u64, rows: usize, columns: usize) -> Vec<Vec<f64>> {
    let all = numbers(seed, rows * columns);
    (0..rows)
        .map(|r| all[r * columns..(r + 1) * columns].to_vec())
        .collect()
}

fn close(what: &str, a: &[f64], b: &[f64]) {
    assert_eq!(a.len(), b.len(), "{what}");
    let norm = b.iter().fold(1.0f64, |norm, x| norm.max(x.abs()));
    for (a, b) in a.iter().zip(b) {
        assert!(
            (a - b).abs() <= 1e-8 * norm,
            "{what}: {a} on the tape, {b} by hand"
        );
    }
}

fn log_sum_exp(x: &[f64]) -> f64 {
    let largest = x
        .iter()
        .fold(f64::NEG_INFINITY, |largest, &x| largest.max(x));
    x.iter().map(|x| (x - largest).exp()).sum::<f64>().ln() + largest
}

/// The objective and its gradient, written out.
fn gmm_by_hand(input: &gmm::Input) -> (f64, gmm::Gradient) {
    let (n, k, d) = (input.x.len(), input.alpha.len(), input.dimensions());
    let m = input.m as f64;
    let at = |i: usize, j: usize| i * d - i * (i + 1) / 2 + (j - i - 1);
    let mut gradient = gmm::Gradient {
        alpha: vec![0.0; k],
        mu: vec![vec![0.0; d]; k],
        q: vec![vec![0.0; d]; k],
        l: vec![vec![0.0; d * (d - 1) / 2]; k],
    };
    let mut value = -((n * d) as f64) * 0.5 * (2.0 * PI).ln();
    for x in &input.x {
        let mut terms = vec![0.0; k];
        let (mut centered, mut scaled) = (vec![vec![0.0; d]; k], vec![vec![0.0; d]; k]);
        for c in 0..k {
            for j in 0..d {
                centered[c][j] = x[j] - input.mu[c][j];
            }
            for j in 0..d {
                scaled[c][j] = input.q[c][j].exp() * centered[c][j];
                for i in 0..j {
                    scaled[c][j] += input.l[c][at(i, j)] * centered[c][i];
                }
            }
            terms[c] = input.alpha[c] + input.q[c].iter().sum::<f64>()
                - 0.5 * scaled[c].iter().map(|y| y * y).sum::<f64>();
        }
        let total = log_sum_exp(&terms);
        value += total;
        for c in 0..k {
            let share = (terms[c] - total).exp();
            gradient.alpha[c] += share;
            for j in 0..d {
                let y = scaled[c][j];
                let diagonal = input.q[c][j].exp();
                gradient.q[c][j] += share * (1.0 - y * centered[c][j] * diagonal);
                gradient.mu[c][j] += share * y * diagonal;
                for i in 0..j {
                    gradient.l[c][at(i, j)] -= share * y * centered[c][i];
                    gradient.mu[c][i] += share * y * input.l[c][at(i, j)];
                }
            }
        }
    }
    let total = log_sum_exp(&input.alpha);
    value -= n as f64 * total;
    let square = input.gamma * input.gamma;
    for c in 0..k {
        gradient.alpha[c] -= n as f64 * (input.alpha[c] - total).exp();
        for j in 0..d {
            let diagonal = (2.0 * input.q[c][j]).exp();
            value -= 0.5 * square * diagonal - m * input.q[c][j];
            gradient.q[c][j] += m - square * diagonal;
        }
        for (l, to) in input.l[c].iter().zip(&mut gradient.l[c]) {
            value -= 0.5 * square * l * l;
            *to -= square * l;
        }
    }
    (
        value + k as f64 * gmm::wishart_constant(d, input.m, input.gamma),
        gradient,
    )
}

#[test]
fn mixtures_agree_with_the_hand_derivation() {
    for (d, k, n, m) in [(1, 3, 5, 0), (2, 5, 40, 0), (4, 3, 17, 2), (10, 7, 30, 1)] {
        let input = gmm::Input {
            alpha: numbers(1, k),
            mu: matrix(2, k, d),
            q: matrix(3, k, d),
            l: matrix(4, k, d * (d - 1) / 2),
            x: matrix(5, n, d),
            gamma: 1.3,
            m,
        };
        let (value, by_hand) = gmm_by_hand(&input);
        let mut gmm = gmm::Gmm::new(input).unwrap();
        close("objective", &[gmm.objective().unwrap()], &[value]);
        let gradient = gmm.gradient().unwrap();
        close("alpha", &gradient.alpha, &by_hand.alpha);
        close("mu", &gradient.mu.concat(), &by_hand.mu.concat());
        close("q", &gradient.q.concat(), &by_hand.q.concat());
        close("l", &gradient.l.concat(), &by_hand.l.concat());
    }
}

/// In one dimension the multivariate gamma function is the gamma function: `Gamma(1) = 1`.
#[test]
fn the_constant_of_the_prior_is_right_where_it_is_known() {
    // d = 1, m = 0: n = 2, so 2 (ln gamma - ln(2) / 2) - ln Gamma(1).
    let known = 2.0 * (1.3f64.ln() - 0.5 * 2f64.ln());
    assert!((gmm::wishart_constant(1, 0, 1.3) - known).abs() < 1e-14);
    // d = 2, m = 0: n = 3; Gamma_2(3/2) = sqrt(pi) Gamma(3/2) Gamma(1) = pi / 2.
    let known = 6.0 * (1.3f64.ln() - 0.5 * 2f64.ln()) - (PI / 2.0).ln();
    assert!((gmm::wishart_constant(2, 0, 1.3) - known).abs() < 1e-14);
}

type V = [f64; 3];

fn dot(a: V, b: V) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: V, b: V) -> V {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// The turned vector, and its derivatives by each entry of the rotation vector and of the vector.
fn turned(r: V, v: V) -> (V, [V; 3], [V; 3]) {
    let angle = dot(r, r).sqrt();
    let n = r.map(|x| x / angle);
    let (s, c) = angle.sin_cos();
    let turn = |v: V| -> V {
        let (across, along) = (cross(n, v), dot(n, v) * (1.0 - c));
        std::array::from_fn(|i| v[i] * c + across[i] * s + n[i] * along)
    };
    let unit = |k: usize| -> V { std::array::from_fn(|i| if i == k { 1.0 } else { 0.0 }) };
    let by_r = std::array::from_fn(|k| {
        let by_axis: V = std::array::from_fn(|i| (unit(k)[i] - n[i] * n[k]) / angle);
        let (across, moved) = (cross(n, v), cross(by_axis, v));
        std::array::from_fn(|i| {
            let by_angle = -v[i] * s + across[i] * c + n[i] * dot(n, v) * s;
            let by_axes = by_axis[i] * dot(n, v) + n[i] * dot(by_axis, v);
            by_angle * n[k] + moved[i] * s + by_axes * (1.0 - c)
        })
    });
    (turn(v), by_r, std::array::from_fn(|k| turn(unit(k))))
}

/// Residual and Jacobian of one observation, written out.
fn ba_by_hand(
    camera: &[f64; 11],
    point: V,
    weight: f64,
    feature: [f64; 2],
) -> ([f64; 2], ba::Block) {
    let from: V = std::array::from_fn(|i| point[i] - camera[3 + i]);
    let (at, by_r, by_v) = turned([camera[0], camera[1], camera[2]], from);
    let p = [at[0] / at[2], at[1] / at[2]];
    let square = p[0] * p[0] + p[1] * p[1];
    let stretch = 1.0 + camera[9] * square + camera[10] * square * square;
    let slope = camera[9] + 2.0 * camera[10] * square;
    let focal = camera[6];
    // Derivative of the distorted position along a direction of the position in the camera's frame.
    let along = |u: V| -> [f64; 2] {
        let dp: [f64; 2] = std::array::from_fn(|i| (u[i] - p[i] * u[2]) / at[2]);
        let radial = 2.0 * (p[0] * dp[0] + p[1] * dp[1]) * slope;
        std::array::from_fn(|i| focal * (dp[i] * stretch + p[i] * radial))
    };
    let mut block = ba::Block {
        weight: -2.0 * weight,
        ..Default::default()
    };
    let mut residual = [0.0; 2];
    for i in 0..2 {
        let unweighted = p[i] * stretch * focal + camera[7 + i] - feature[i];
        residual[i] = weight * unweighted;
        let row = &mut block.rows[i];
        for k in 0..3 {
            row[k] = weight * along(by_r[k])[i];
            row[3 + k] = -weight * along(by_v[k])[i];
            row[11 + k] = weight * along(by_v[k])[i];
        }
        row[6] = weight * p[i] * stretch;
        row[7 + i] = weight;
        row[9] = weight * focal * p[i] * square;
        row[10] = weight * focal * p[i] * square * square;
        row[14] = unweighted;
    }
    (residual, block)
}

#[test]
fn bundle_adjustment_agrees_with_the_hand_derivation() {
    let (n, m, p) = (3, 5, 70);
    let cameras: Vec<[f64; 11]> = (0..n)
        .map(|c| {
            let x = numbers(10 + c as u64, 11);
            let (f, u, v) = (700.0 + 50.0 * x[6], 300.0 + x[7], 200.0 + x[8]);
            [
                x[0],
                x[1],
                x[2],
                x[3],
                x[4],
                x[5] - 4.0,
                f,
                u,
                v,
                0.1 * x[9],
                0.02 * x[10],
            ]
        })
        .collect();
    let input = ba::Input {
        cameras,
        points: (0..m)
            .map(|q| numbers(30 + q as u64, 3).try_into().unwrap())
            .collect(),
        weights: numbers(50, p),
        features: (0..p)
            .map(|i| numbers(60 + i as u64, 2).try_into().unwrap())
            .collect(),
        seen: (0..p).map(|i| (i % n, i % m)).collect(),
    };
    let by_hand: Vec<_> = input
        .seen
        .iter()
        .enumerate()
        .map(|(i, &(c, q))| {
            ba_by_hand(
                &input.cameras[c],
                input.points[q],
                input.weights[i],
                input.features[i],
            )
        })
        .collect();
    let weights = input.weights.clone();
    let mut ba = ba::Ba::new(input).unwrap();
    let (residuals, errors) = ba.objective().unwrap();
    let blocks = ba.jacobian().unwrap();
    for (i, (residual, block)) in by_hand.iter().enumerate() {
        close("residual", &residuals[i], residual);
        close("error", &[errors[i]], &[1.0 - weights[i] * weights[i]]);
        for row in 0..2 {
            close("row", &blocks[i].rows[row], &block.rows[row]);
        }
        close("weight", &[blocks[i].weight], &[block.weight]);
    }
}

#[test]
fn a_camera_that_does_not_turn_has_a_derivative() {
    let mut camera = [0.0; 11];
    (camera[5], camera[6]) = (-4.0, 800.0);
    let input = ba::Input {
        cameras: vec![camera],
        points: vec![[0.3, -0.2, 1.0]],
        weights: vec![1.0],
        features: vec![[0.0; 2]],
        seen: vec![(0, 0)],
    };
    let mut ba = ba::Ba::new(input).unwrap();
    let still = ba.jacobian().unwrap()[0];
    camera[1] = 1e-7;
    let (_, near) = ba_by_hand(&camera, [0.3, -0.2, 1.0], 1.0, [0.0; 2]);
    for row in 0..2 {
        for k in 0..15 {
            let (a, b) = (still.rows[row][k], near.rows[row][k]);
            assert!((a - b).abs() < 1e-3, "{k}: {a} {b}");
        }
    }
}

/// What is answered to an evaluation.
fn evaluated(module: &str, function: &str, input: Value) -> Value {
    let (kind, id) = ("evaluate", 7);
    let message =
        json!({ "kind": kind, "id": id, "module": module, "function": function, "input": input });
    let answer = messages::answer(&message);
    assert_eq!(answer["id"], 7);
    answer
}

#[test]
fn what_is_known_is_said_and_every_answer_bears_its_message_s_number() {
    let start = messages::answer(&json!({ "kind": "start", "id": 0, "eval": "gmm" }));
    assert_eq!(start, json!({ "id": 0, "tool": "autodiff" }));
    for (module, known) in [("hello", true), ("gmm", true), ("ba", true), ("ode", false)] {
        let define = json!({ "kind": "define", "id": 1, "module": module });
        assert_eq!(
            messages::answer(&define),
            json!({ "id": 1, "success": known })
        );
    }
    let analysis = json!({ "kind": "analysis", "id": 2, "valid": true });
    assert_eq!(messages::answer(&analysis), json!({ "id": 2 }));
}

#[test]
fn hello_squares_and_doubles() {
    for (function, expected) in [("square", 9.0), ("double", 6.0)] {
        let answer = evaluated("hello", function, json!(3.0));
        assert_eq!(answer["success"], true);
        assert_eq!(answer["output"], expected);
        assert_eq!(answer["timings"][0]["name"], "evaluate");
        assert!(answer["timings"][0]["nanoseconds"].is_u64());
    }
}

#[test]
fn evaluations_are_run_as_often_as_asked_and_answer_in_the_input_s_shapes() {
    let (k, d) = (3, 2);
    let input = json!({
        "d": d, "k": k, "n": 5, "min_runs": 4, "min_seconds": 0.0,
        "alpha": numbers(1, k), "mu": matrix(2, k, d), "q": matrix(3, k, d), "l": matrix(4, k, 1),
        "x": matrix(5, 5, d), "gamma": 1.3, "m": 1,
    });
    let by_hand = gmm::Input {
        alpha: numbers(1, k),
        mu: matrix(2, k, d),
        q: matrix(3, k, d),
        l: matrix(4, k, 1),
        x: matrix(5, 5, d),
        gamma: 1.3,
        m: 1,
    };
    let (objective, gradient) = gmm_by_hand(&by_hand);
    let answer = evaluated("gmm", "objective", input.clone());
    close(
        "objective",
        &[answer["output"].as_f64().unwrap()],
        &[objective],
    );
    assert_eq!(answer["timings"].as_array().unwrap().len(), 4);
    let answer = evaluated("gmm", "jacobian", input);
    let flat = |value: &Value| -> Vec<f64> {
        let rows = value.as_array().unwrap().iter();
        rows.flat_map(|row| row.as_array().unwrap().iter().filter_map(Value::as_f64))
            .collect()
    };
    let output = &answer["output"];
    close("alpha", &flat(&json!([output["alpha"]])), &gradient.alpha);
    close("mu", &flat(&output["mu"]), &gradient.mu.concat());
    close("q", &flat(&output["q"]), &gradient.q.concat());
    close("l", &flat(&output["l"]), &gradient.l.concat());
}

#[test]
fn jacobians_of_bundles_are_shortened_to_the_first_observation_and_the_last_entry() {
    let (n, m, p) = (2, 3, 20);
    let camera = [
        0.1, -0.2, 0.05, 0.3, 0.1, -0.4, 1.2, 0.02, -0.03, 0.01, -0.02,
    ];
    let input = json!({
        "n": n, "m": m, "p": p, "cam": camera, "x": [0.3, -0.5, 2.0], "w": 0.7, "feat": [0.1, 0.2],
    });
    let objective = evaluated("ba", "objective", input.clone());
    assert_eq!(objective["output"]["reproj_error"]["repeated"], p);
    let weight = objective["output"]["w_err"]["element"].as_f64().unwrap();
    close("weight", &[weight], &[1.0 - 0.7 * 0.7]);
    let answer = evaluated("ba", "jacobian", input);
    let output = &answer["output"];
    let len = |name: &str| output[name].as_array().unwrap().len();
    // Two rows of eleven parameters of a camera, three of a point, and a weight; then the last.
    assert_eq!([len("rows"), len("cols"), len("vals")], [31, 31, 31]);
    let columns = 11 * n + 3 * m + p;
    assert_eq!(output["cols"][30], columns - 1);
    assert_eq!(output["rows"][30], 2 * 15 * p + p);
    assert_eq!(output["rows"][1], 15);
    close(
        "the last weight",
        &[output["vals"][30].as_f64().unwrap()],
        &[-2.0 * 0.7],
    );
}

#[test]
fn mistakes_are_answered_not_fatal() {
    let missing = evaluated("ba", "objective", json!({ "n": 1, "m": 1, "p": 0 }));
    assert_eq!(missing["success"], false);
    assert!(missing["error"].as_str().unwrap().contains("`p`"));
    let unknown = evaluated("hello", "cube", json!(1.0));
    assert_eq!(unknown["success"], false);
    assert!(unknown["error"].as_str().unwrap().contains("`cube`"));
    let wrong = evaluated(
        "gmm",
        "objective",
        json!({ "alpha": "none", "gamma": 1.0, "m": 0 }),
    );
    assert!(wrong["error"].as_str().unwrap().contains("`alpha`"));
}
