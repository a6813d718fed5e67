//! `sum over a point's lanes of coefficient (3 channels) x interpolated row (48 long)`: the kernel of a linear solver, with
//! rows looked up at four corners of a table of 5,000.

use std::sync::Arc;

use autodiff::{Graph, Sizes};

use super::timing::{best, numbers};

const POINTS: usize = 200;
const LANES: usize = 1_500;
const ROWS: usize = 5_000;
const FRAMES: usize = 48;

pub fn run() {
    let g = Graph::new();
    let (point, texel) = (g.domain("point"), g.domain("texel"));
    let lane = g.segments("lane", &point);
    let frame = g.axis("frame");
    let table = g.param_along("table", &texel, 1, &frame);
    let light = g.param("light", &texel, 3);
    let transport = g.input("transport", &lane, 1);
    let own = g.index("own", &lane, &texel);
    let corner: Vec<_> = (0..4)
        .map(|k| g.index(&format!("corner{k}"), &lane, &texel))
        .collect();
    let weight: Vec<_> = (0..4)
        .map(|k| g.input(&format!("weight{k}"), &lane, 1))
        .collect();
    let corners: Vec<_> = corner.iter().zip(&weight).collect();
    let rows = table.gather_weighted(&corners);
    let image = (light.gather(&own) * &transport).segment_dot(&rows);
    let program = g.compile(&[("image", &image)]).expect("a sound graph");

    let n = POINTS * LANES;
    let sizes = Sizes::new()
        .lanes("point", POINTS)
        .lanes("texel", ROWS)
        .per_parent("lane", LANES)
        .axis("frame", FRAMES);
    let sizes = match std::env::var("BLOCK").ok().and_then(|b| b.parse().ok()) {
        Some(block) => sizes.block(block),
        None => sizes,
    };
    let mut ws = program.workspace::<f32>(&sizes).expect("sound sizes");
    let table = numbers(1, ROWS * FRAMES, 0.0, 1.0);
    let light = numbers(2, 3 * ROWS, 0.0, 1.0);
    ws.set("table", &table).expect("a table");
    ws.set("light", &light).expect("light");
    ws.set("transport", &numbers(3, n, 0.0, 1.0))
        .expect("transport");
    // A point's lanes are texels in order, most of them visible; the lookup is nearby.
    let own: Arc<[u32]> = (0..n)
        .map(|i| ((i % LANES) * 3 + i / LANES % 3) as u32)
        .collect();
    ws.bind_index("own", own.clone()).expect("an index");
    let mut corners = Vec::new();
    for (k, step) in [0, 1, 100, 101].into_iter().enumerate() {
        let index: Arc<[u32]> = own.iter().map(|&i| (i + 7 + step) % ROWS as u32).collect();
        ws.bind_index(&format!("corner{k}"), index.clone())
            .expect("an index");
        let weight: Arc<[f32]> = Arc::from(numbers(20 + k as u64, n, 0.0, 0.5));
        ws.bind(&format!("weight{k}"), weight.clone())
            .expect("a weight");
        corners.push((index, weight));
    }
    let transport = ws.value("transport").expect("transport").to_vec();

    // By hand, one thread: rows interpolated into registers, three sums of a point in cache.
    let mut image = vec![0.0f32; 3 * POINTS * FRAMES];
    let arch = pulp::Arch::new();
    let mut by_hand = || {
        arch.dispatch(
            #[inline(always)]
            || {
                for p in 0..POINTS {
                    let mut sums = [[0.0f32; FRAMES]; 3];
                    for l in p * LANES..(p + 1) * LANES {
                        let mut row = [0.0f32; FRAMES];
                        for (index, weight) in &corners {
                            let start = index[l] as usize * FRAMES;
                            let source = &table[start..start + FRAMES];
                            for k in 0..FRAMES {
                                row[k] += weight[l] * source[k];
                            }
                        }
                        let t = own[l] as usize;
                        for c in 0..3 {
                            let a = light[c * ROWS + t] * transport[l];
                            for k in 0..FRAMES {
                                sums[c][k] += a * row[k];
                            }
                        }
                    }
                    for c in 0..3 {
                        let start = (c * POINTS + p) * FRAMES;
                        image[start..start + FRAMES].copy_from_slice(&sums[c]);
                    }
                }
            },
        )
    };
    let (mut second, direction) = (
        program.workspace::<f32>(&sizes).expect("sound sizes"),
        light.clone(),
    );
    copy(&ws, &mut second, &corners, &own, &transport);
    let directions: [(&str, &[f32]); 2] = [("table", &table), ("light", &direction)];
    let cotangent = numbers(50, 3 * POINTS * FRAMES, -1.0, 1.0);
    let mut third = program.workspace::<f32>(&sizes).expect("sound sizes");
    copy(&ws, &mut third, &corners, &own, &transport);
    let mut fourth = program.workspace::<f32>(&sizes).expect("sound sizes");
    copy(&ws, &mut fourth, &corners, &own, &transport);
    let [hand, primal, tangent, reverse, product] = best([
        &mut by_hand,
        &mut || program.forward(&mut ws).expect("a bound program"),
        &mut || {
            program
                .jvp(&mut second, &directions)
                .expect("a bound program")
        },
        &mut || {
            program
                .vjp_with(&mut third, &[("image", &cotangent)])
                .expect("a bound program")
        },
        &mut || {
            let done = program.gauss_newton(&mut fourth, "image", &directions, None);
            done.expect("a bound program");
        },
    ]);
    let elements = (n * FRAMES) as f64 / 1e6;
    println!("contraction, {n} lanes x {FRAMES} x 3 (milliseconds, and 1e9 lane-frames a second)");
    for (name, ms) in [
        ("hand", hand),
        ("forward", primal),
        ("jvp", tangent),
        ("vjp (replay + reverse)", reverse),
        ("gauss_newton", product),
    ] {
        println!("  {name}: {ms:.2} ({:.2})", elements / ms);
    }
}

/// An index array and its weights.
type Corner = (Arc<[u32]>, Arc<[f32]>);

fn copy(
    from: &autodiff::Workspace<f32>,
    to: &mut autodiff::Workspace<f32>,
    corners: &[Corner],
    own: &Arc<[u32]>,
    transport: &[f32],
) {
    for name in ["table", "light"] {
        to.set(name, from.value(name).expect("a value"))
            .expect("a sound array");
    }
    to.set("transport", transport).expect("a sound array");
    to.bind_index("own", own.clone()).expect("an index");
    for (k, (index, weight)) in corners.iter().enumerate() {
        to.bind_index(&format!("corner{k}"), index.clone())
            .expect("an index");
        to.bind(&format!("weight{k}"), weight.clone())
            .expect("a weight");
    }
}
