//! The three passes over one chunk: values, tangents with them, and adjoints.

use std::mem::take;

use super::block::{
    Env, Lanes, View, Worker, blocks, into_adjoint, is_computed, is_constant, store,
};
use super::chunk::Chunk;
use super::contract;
use super::linear::{self, add_lanes};
use super::lookup::{self, Rows};
use super::matmul::{Matrix, Outer, Product, outer, product};
use super::segments::{collect, expand};
use crate::buffer::Buffer;
use crate::graph::{CORNERS, NodeId, Op};
use crate::op::{Element, RESULT};
use crate::program::PullKind;
use crate::real::Real;

/// Most operands of an elementwise primitive.
const OPERANDS: usize = 3;

/// Runs the blocks of a chunk forward: values, and tangents of moving nodes when `tangents`.
pub(super) fn forward<R: Real>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    chunk: &mut Chunk<R>,
    tangents: bool,
) {
    for sink in &mut chunk.sink {
        sink.as_mut_slice().fill(R::default());
    }
    if tangents {
        for sink in &mut chunk.sink_tangent {
            sink.as_mut_slice().fill(R::default());
        }
    }
    fill_constants(env, worker, |_| true);
    if tangents {
        fill_constant_tangents(env, worker);
    }
    let span = chunk.span.clone();
    for lanes in blocks(chunk, env.stride) {
        for &id in &env.phase.nodes {
            let op = &env.program.nodes[id].op;
            if op.is_sink() {
                let at = sink_position(env, id);
                accumulate(env, worker, chunk, lanes, id, at, false);
                if tangents && env.moving[id] {
                    accumulate(env, worker, chunk, lanes, id, at, true);
                }
            } else if !is_constant(op) {
                value(env, worker, lanes, id);
                if tangents && env.moving[id] {
                    tangent(env, worker, lanes, id);
                }
            }
        }
        store(env, &span, lanes, &worker.values, &mut chunk.store, |_| {
            true
        });
        if tangents {
            let targets = &mut chunk.store_tangent;
            store(env, &span, lanes, &worker.tangents, targets, |id| {
                env.moving[id]
            });
        }
    }
}

/// Replays the blocks of a chunk and runs them backward.
pub(super) fn reverse<R: Real>(env: &Env<R>, worker: &mut Worker<R>, chunk: &mut Chunk<R>) {
    for pull in &mut chunk.pull {
        pull.as_mut_slice().fill(R::default());
    }
    fill_constants(env, worker, |id| env.replay[id]);
    let span = chunk.span.clone();
    for lanes in blocks(chunk, env.stride) {
        for &id in &env.phase.nodes {
            let op = &env.program.nodes[id].op;
            if env.replay[id] && !op.is_sink() && !is_constant(op) {
                value(env, worker, lanes, id);
            }
        }
        worker.written[..env.phase.locals.len()].fill(false);
        seed(env, worker, lanes);
        for &id in env.phase.nodes.iter().rev() {
            if env.live[id] {
                adjoint(env, worker, chunk, lanes, id);
            }
        }
        for (pull, target) in env.phase.pulls.iter().zip(&mut chunk.pull) {
            if pull.kind != PullKind::Lanes || !env.live[pull.target] {
                continue;
            }
            let (id, slot) = (pull.target, env.slot(pull.target));
            if !worker.written[slot] {
                continue;
            }
            let axis = env.axis(id);
            let source = worker.adjoints[slot].as_slice();
            for c in 0..env.channels(id) {
                let from = c * env.pitch(id);
                let to = (c * span.lanes.len() + lanes.start - span.lanes.start) * axis;
                target.as_mut_slice()[to..to + lanes.len * axis]
                    .copy_from_slice(&source[from..from + lanes.len * axis]);
            }
        }
    }
}

/// Starts the adjoints of a block with what later phases left for its stored nodes.
fn seed<R: Real>(env: &Env<R>, worker: &mut Worker<R>, lanes: Lanes) {
    let all = env.extent.lanes[env.phase.domain];
    for &id in &env.phase.stores {
        if !env.live[id] || !env.seeded[id] {
            continue;
        }
        let axis = env.axis(id);
        let source = env.adjoints[id].as_slice();
        into_adjoint(env, worker, id, |target, _| {
            for c in 0..env.channels(id) {
                let from = (c * all + lanes.start) * axis;
                let to = c * env.pitch(id);
                target[to..to + lanes.len * axis]
                    .copy_from_slice(&source[from..from + lanes.len * axis]);
            }
        });
    }
}

fn fill_constants<R: Real>(env: &Env<R>, worker: &mut Worker<R>, wanted: impl Fn(NodeId) -> bool) {
    let lanes = Lanes {
        start: 0,
        len: env.stride,
    };
    for &id in &env.phase.nodes {
        if is_constant(&env.program.nodes[id].op) && wanted(id) {
            value(env, worker, lanes, id);
        }
    }
}

fn fill_constant_tangents<R: Real>(env: &Env<R>, worker: &mut Worker<R>) {
    let lanes = Lanes {
        start: 0,
        len: env.stride,
    };
    for &id in &env.phase.nodes {
        if is_constant(&env.program.nodes[id].op) && env.moving[id] {
            tangent(env, worker, lanes, id);
        }
    }
}

fn value<R: Real>(env: &Env<R>, worker: &mut Worker<R>, lanes: Lanes, id: NodeId) {
    let slot = env.slot(id);
    let mut out = take(&mut worker.values[slot]);
    let mut scratch = take(&mut worker.scratch);
    let view = values(env, worker);
    let node = &env.program.nodes[id];
    match &node.op {
        Op::Element(element) => {
            let len = lanes.len * env.axis(id);
            for c in 0..node.shape.channels {
                let start = c * env.pitch(id);
                let x = operands(env, view, lanes, &node.inputs, c);
                let y = &mut out.as_mut_slice()[start..start + len];
                element.evaluate(env.arch, &x[..node.inputs.len()], y);
            }
        }
        Op::GatherWeighted(_) => {
            interpolate(env, lanes, id, view, view, true, true, &mut out);
        }
        Op::Matmul => dense(
            env,
            lanes,
            id,
            view,
            view,
            (true, true, true),
            &mut out,
            &mut scratch,
        ),
        _ => push_linear(env, view, lanes, id, &mut out, |_| true),
    }
    worker.values[slot] = out;
    worker.scratch = scratch;
}

fn tangent<R: Real>(env: &Env<R>, worker: &mut Worker<R>, lanes: Lanes, id: NodeId) {
    let slot = env.slot(id);
    let mut out = take(&mut worker.tangents[slot]);
    let mut scratch = take(&mut worker.scratch);
    let values = values(env, worker);
    let tangents = tangents_of(env, worker);
    let node = &env.program.nodes[id];
    let moving = |id: NodeId| env.moving[id];
    match &node.op {
        Op::Element(element) => {
            let len = lanes.len * env.axis(id);
            for c in 0..node.shape.channels {
                let start = c * env.pitch(id);
                let x = operands(env, values, lanes, &node.inputs, c);
                let y = &worker.values[slot].as_slice()[start..start + len];
                let target = &mut out.as_mut_slice()[start..start + len];
                let mut add = false;
                for (i, &input) in node.inputs.iter().enumerate() {
                    if moving(input) {
                        let source = env.channel(tangents, lanes, input, c);
                        let x = &x[..node.inputs.len()];
                        element.pass(env.arch, i, x, y, source, target, add);
                        add = true;
                    }
                }
            }
        }
        Op::GatherWeighted(_) => {
            let table = moving(node.inputs[0]);
            if table {
                interpolate(env, lanes, id, tangents, values, true, true, &mut out);
            }
            if node.inputs[1..].iter().any(|&w| moving(w)) {
                interpolate(env, lanes, id, values, tangents, !table, false, &mut out);
            }
        }
        Op::Matmul => {
            let bias = node.inputs.get(2).is_some_and(|&b| moving(b));
            if moving(node.inputs[0]) {
                dense(
                    env,
                    lanes,
                    id,
                    tangents,
                    values,
                    (true, false, true),
                    &mut out,
                    &mut scratch,
                );
            }
            if moving(node.inputs[1]) {
                let first = !moving(node.inputs[0]);
                dense(
                    env,
                    lanes,
                    id,
                    values,
                    tangents,
                    (first, false, true),
                    &mut out,
                    &mut scratch,
                );
            }
            if bias {
                let first = !moving(node.inputs[0]) && !moving(node.inputs[1]);
                let tangent = tangents.whole[node.inputs[2]].as_slice();
                for (c, t) in tangent.iter().enumerate() {
                    let start = c * env.stride;
                    let row = &mut out.as_mut_slice()[start..start + lanes.len];
                    super::rows::put_value(row, *t, !first);
                }
            }
        }
        _ => push_linear(env, tangents, lanes, id, &mut out, moving),
    }
    worker.tangents[slot] = out;
    worker.scratch = scratch;
}

/// Values as seen from a block.
fn values<'v, R: Real>(env: &Env<'v, R>, worker: &'v Worker<R>) -> View<'v, R> {
    View {
        local: &worker.values,
        whole: env.values,
        tables: env.tables,
    }
}

/// Tangents as seen from a block.
fn tangents_of<'v, R: Real>(env: &Env<'v, R>, worker: &'v Worker<R>) -> View<'v, R> {
    View {
        local: &worker.tangents,
        whole: env.tangents,
        tables: env.table_tangents,
    }
}

/// One channel of each operand.
fn operands<'v, R: Real>(
    env: &Env<R>,
    view: View<'v, R>,
    lanes: Lanes,
    inputs: &[NodeId],
    channel: usize,
) -> [&'v [R]; OPERANDS] {
    std::array::from_fn(|i| {
        inputs
            .get(i)
            .map_or(&[][..], |&input| env.channel(view, lanes, input, channel))
    })
}

/// Operations that are linear in their only differentiable operand.
fn push_linear<R: Real>(
    env: &Env<R>,
    view: View<R>,
    lanes: Lanes,
    id: NodeId,
    out: &mut Buffer<R>,
    present: impl Fn(NodeId) -> bool,
) {
    let node = &env.program.nodes[id];
    let (pitch, axis) = (env.pitch(id), env.axis(id));
    let len = lanes.len * axis;
    let input = node.inputs[0];
    let all = env.all_lanes(input) * axis;
    match node.op {
        Op::Gather(index) => {
            let index = &env.indices[index][lanes.start..lanes.start + lanes.len];
            lookup::gather(
                view.table(env, input),
                rows(env, id),
                index,
                out.as_mut_slice(),
            );
        }
        Op::Expand => {
            for c in 0..node.shape.channels {
                let parents = &view.whole[input].as_slice()[c * all..(c + 1) * all];
                let out = &mut out.as_mut_slice()[c * pitch..c * pitch + len];
                expand(env, lanes, axis, parents, 0, out, false, false);
            }
        }
        _ => linear::push(env, view, lanes, id, out, present),
    }
}

/// Calls `run` with the corners of an interpolated lookup; `wanted` leaves out weights.
fn with_corners<R: Real>(
    env: &Env<R>,
    lanes: Lanes,
    id: NodeId,
    weights: View<R>,
    wanted: impl Fn(NodeId) -> bool,
    run: impl FnOnce(&[(&[u32], &[R])]),
) {
    let node = &env.program.nodes[id];
    let Op::GatherWeighted(indices) = &node.op else {
        return;
    };
    let mut group: [(&[u32], &[R]); CORNERS] = [(&[], &[]); CORNERS];
    let mut count = 0;
    for (&index, &weight) in indices.iter().zip(&node.inputs[1..]) {
        if !wanted(weight) {
            continue;
        }
        let rows = &env.indices[index][lanes.start..lanes.start + lanes.len];
        group[count] = (rows, env.channel(weights, lanes, weight, 0));
        count += 1;
    }
    if count > 0 {
        run(&group[..count]);
    }
}

fn interpolate<R: Real>(
    env: &Env<R>,
    lanes: Lanes,
    id: NodeId,
    tables: View<R>,
    weights: View<R>,
    first: bool,
    all_weights: bool,
    out: &mut Buffer<R>,
) {
    let table = tables.table(env, env.program.nodes[id].inputs[0]);
    let wanted = |weight: NodeId| all_weights || env.moving[weight];
    with_corners(env, lanes, id, weights, wanted, |corners| {
        let (rows, out) = (rows(env, id), out.as_mut_slice());
        lookup::gather_weighted(env.arch, table, rows, lanes.len, corners, out, first);
    });
}

/// The layout of a lookup.
fn rows<R: Real>(env: &Env<R>, id: NodeId) -> Rows {
    Rows {
        channels: env.channels(id),
        axis: env.axis(id),
        pitch: env.pitch(id),
    }
}

/// The block of an operand of a dense layer: its arena slot, or a padded copy of the whole array's lanes.
fn padded<'v, R: Real>(
    env: &Env<R>,
    view: View<'v, R>,
    lanes: Lanes,
    id: NodeId,
    scratch: &'v mut Buffer<R>,
) -> &'v [R] {
    if is_computed(env, id) {
        return view.local[env.slot(id)].as_slice();
    }
    for c in 0..env.channels(id) {
        scratch.as_mut_slice()[c * env.stride..c * env.stride + lanes.len]
            .copy_from_slice(env.channel(view, lanes, id, c));
    }
    scratch.as_slice()
}

/// A dense layer on `xs` and `weights`; the flags: overwrite, add the bias, use it at all.
fn dense<R: Real>(
    env: &Env<R>,
    lanes: Lanes,
    id: NodeId,
    xs: View<R>,
    weights: View<R>,
    (first, bias, _): (bool, bool, bool),
    out: &mut Buffer<R>,
    scratch: &mut Buffer<R>,
) {
    let inputs = &env.program.nodes[id].inputs;
    let inner = env.channels(inputs[0]);
    product(
        env.arch,
        Product {
            matrix: Matrix {
                data: weights.whole[inputs[1]].as_slice(),
                rows: inner,
                columns: 1,
            },
            bias: inputs
                .get(2)
                .filter(|_| bias)
                .map(|&bias| weights.whole[bias].as_slice()),
            x: padded(env, xs, lanes, inputs[0], scratch),
            x_pitch: env.stride,
            out: out.as_mut_slice(),
            pitch: env.stride,
            out_rows: env.channels(id),
            inner,
            lanes: lanes.len,
            add: !first,
        },
    );
}

fn sink_position<R>(env: &Env<R>, id: NodeId) -> usize {
    env.phase
        .sinks
        .iter()
        .position(|&sink| sink == id)
        .unwrap_or(0)
}

/// Adds a block to an accumulation over lanes, of values or of tangents.
fn accumulate<R: Real>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    chunk: &mut Chunk<R>,
    lanes: Lanes,
    id: NodeId,
    at: usize,
    tangents: bool,
) {
    let node = &env.program.nodes[id];
    let mut scratch = take(&mut worker.scratch);
    let values = values(env, worker);
    let moving = tangents_of(env, worker);
    let view = if tangents { moving } else { values };
    let sums = if tangents {
        chunk.sink_tangent[at].as_mut_slice()
    } else {
        chunk.sink[at].as_mut_slice()
    };
    let (channels, axis, input) = (node.shape.channels, env.axis(id), node.inputs[0]);
    match node.op {
        Op::SumLanes => {
            let first = lanes.start - chunk.span.lanes.start;
            for c in 0..channels {
                let source = env.channel(view, lanes, input, c);
                add_lanes(env, c, axis, first, source, sums);
            }
        }
        Op::SegmentSum { mean } => {
            for c in 0..channels {
                let source = env.channel(view, lanes, input, c);
                let span = &chunk.span;
                collect(env, span, lanes, (c, channels), axis, source, sums, mean);
            }
        }
        Op::SegmentDot => {
            let (a, b) = (node.inputs[0], node.inputs[1]);
            let (span, scratch) = (&chunk.span, scratch.as_mut_slice());
            if !tangents {
                contract::push(
                    env,
                    span,
                    lanes,
                    id,
                    (a, values),
                    (b, values),
                    sums,
                    scratch,
                );
            } else {
                contract_tangent(env, span, lanes, id, values, moving, sums, scratch);
            }
        }
        _ => {}
    }
    worker.scratch = scratch;
}

fn contract_tangent<R: Real>(
    env: &Env<R>,
    span: &super::chunk::Span,
    lanes: Lanes,
    id: NodeId,
    values: View<R>,
    tangents: View<R>,
    sums: &mut [R],
    scratch: &mut [R],
) {
    let inputs = &env.program.nodes[id].inputs;
    let (a, b) = (inputs[0], inputs[1]);
    if env.moving[a] {
        contract::push(
            env,
            span,
            lanes,
            id,
            (a, tangents),
            (b, values),
            sums,
            scratch,
        );
    }
    if env.moving[b] {
        contract::push(
            env,
            span,
            lanes,
            id,
            (a, values),
            (b, tangents),
            sums,
            scratch,
        );
    }
}

/// Passes the adjoint of a node on to its operands.
fn adjoint<R: Real>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    chunk: &mut Chunk<R>,
    lanes: Lanes,
    id: NodeId,
) {
    let node = &env.program.nodes[id];
    if node.op.is_sink() {
        return sink_adjoint(env, worker, lanes, id);
    }
    let slot = env.slot(id);
    if !worker.written[slot] {
        return;
    }
    let g = take(&mut worker.adjoints[slot]);
    match &node.op {
        Op::Element(element) => element_adjoint(env, worker, lanes, id, *element, g.as_slice()),
        Op::Splat | Op::Expand | Op::Gather(_) | Op::GatherWeighted(_) | Op::Matmul => {
            whole_adjoint(env, worker, chunk, lanes, id, g.as_slice())
        }
        _ => linear::pull(env, worker, lanes, id, g.as_slice()),
    }
    worker.adjoints[slot] = g;
}

fn element_adjoint<R: Real>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    lanes: Lanes,
    id: NodeId,
    element: Element,
    g: &[R],
) {
    let node = &env.program.nodes[id];
    let (pitch, len) = (env.pitch(id), lanes.len * env.axis(id));
    for (i, &input) in node.inputs.iter().enumerate() {
        if !env.live[input] {
            continue;
        }
        let slot = env.slot(input);
        let add = std::mem::replace(&mut worker.written[slot], true);
        let mut target = take(&mut worker.adjoints[slot]);
        let view = values(env, worker);
        let single = env.channels(input) == 1;
        for c in 0..node.shape.channels {
            let x = operands(env, view, lanes, &node.inputs, c);
            let start = c * pitch;
            let y = &worker.values[env.slot(id)].as_slice()[start..start + len];
            let to = if single { 0 } else { start };
            let target = &mut target.as_mut_slice()[to..to + len];
            let add = add || (single && c > 0);
            let x = &x[..node.inputs.len()];
            element.pass(env.arch, i, x, y, &g[start..start + len], target, add);
        }
        worker.adjoints[slot] = target;
    }
}

fn sink_adjoint<R: Real>(env: &Env<R>, worker: &mut Worker<R>, lanes: Lanes, id: NodeId) {
    if !env.seeded[id] {
        return;
    }
    let node = &env.program.nodes[id];
    let g = env.adjoints[id].as_slice();
    let (channels, axis, input) = (node.shape.channels, env.axis(id), node.inputs[0]);
    let (pitch, len) = (env.stride * axis, lanes.len * axis);
    match node.op {
        Op::SumLanes => into_adjoint(env, worker, input, |target, add| {
            for c in 0..channels {
                let row = &g[c * axis..(c + 1) * axis];
                let target = &mut target[c * pitch..c * pitch + len];
                if axis == 1 {
                    super::rows::put_value(target, row[0], add);
                } else {
                    for lane in target.chunks_exact_mut(axis) {
                        super::rows::put(env.arch, lane, row, add);
                    }
                }
            }
        }),
        Op::SegmentSum { mean } => into_adjoint(env, worker, input, |target, add| {
            let all = env.all_lanes(id) * axis;
            for c in 0..channels {
                let parents = &g[c * all..(c + 1) * all];
                let target = &mut target[c * pitch..c * pitch + len];
                expand(env, lanes, axis, parents, 0, target, mean, add);
            }
        }),
        Op::SegmentDot => {
            let (a, b) = (node.inputs[0], node.inputs[1]);
            if env.live[a] {
                contract::pull(env, worker, lanes, id, (a, b), g);
            }
            if env.live[b] {
                contract::pull(env, worker, lanes, id, (b, a), g);
            }
        }
        _ => {}
    }
}

/// Adjoints of operands that are whole: accumulated by the chunk.
fn whole_adjoint<R: Real>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    chunk: &mut Chunk<R>,
    lanes: Lanes,
    id: NodeId,
    g: &[R],
) {
    let node = &env.program.nodes[id];
    let (channels, axis, input) = (node.shape.channels, env.axis(id), node.inputs[0]);
    let (pitch, len) = (env.pitch(id), lanes.len * axis);
    let pull = |target: NodeId, kind: PullKind| {
        env.live[target]
            .then(|| env.phase.pull(target, kind, id))
            .flatten()
    };
    match &node.op {
        Op::Splat => {
            if let Some(at) = pull(input, PullKind::Uniform) {
                let first = lanes.start - chunk.span.lanes.start;
                for c in 0..channels {
                    let source = &g[c * pitch..c * pitch + len];
                    let sums = chunk.pull[at].as_mut_slice();
                    add_lanes(env, c, axis, first, source, sums);
                }
            }
        }
        Op::Expand => {
            if let Some(at) = pull(input, PullKind::Parents) {
                for c in 0..channels {
                    let source = &g[c * pitch..c * pitch + len];
                    let sums = chunk.pull[at].as_mut_slice();
                    let span = &chunk.span;
                    collect(env, span, lanes, (c, channels), axis, source, sums, false);
                }
            }
        }
        Op::Gather(index) => {
            if let Some(at) = pull(input, PullKind::Table) {
                let index = &env.indices[*index][lanes.start..lanes.start + lanes.len];
                let table = chunk.pull[at].as_mut_slice();
                lookup::scatter(env.arch, table, rows(env, id), index, g);
            }
        }
        Op::GatherWeighted(indices) => {
            let view = values(env, worker);
            if let Some(at) = pull(input, PullKind::Table) {
                let table = chunk.pull[at].as_mut_slice();
                with_corners(
                    env,
                    lanes,
                    id,
                    view,
                    |_| true,
                    |corners| {
                        let rows = rows(env, id);
                        lookup::scatter_weighted(env.arch, table, rows, lanes.len, corners, g);
                    },
                );
            }
            let whole = View {
                local: &[],
                whole: env.values,
                tables: env.tables,
            };
            let table = whole.table(env, input);
            for (&index, &weight) in indices.iter().zip(&node.inputs[1..]) {
                if !env.live[weight] {
                    continue;
                }
                let index = &env.indices[index][lanes.start..lanes.start + lanes.len];
                into_adjoint(env, worker, weight, |target, add| {
                    let target = &mut target[..lanes.len];
                    lookup::pull_weight(table, rows(env, id), index, g, target, add);
                });
            }
        }
        Op::Matmul => dense_adjoint(env, worker, chunk, lanes, id, g),
        _ => {}
    }
}

fn dense_adjoint<R: Real>(
    env: &Env<R>,
    worker: &mut Worker<R>,
    chunk: &mut Chunk<R>,
    lanes: Lanes,
    id: NodeId,
    g: &[R],
) {
    let inputs = &env.program.nodes[id].inputs;
    let (x, weight) = (inputs[0], inputs[1]);
    let (rows, inner) = (env.channels(id), env.channels(x));
    if env.live[x] {
        into_adjoint(env, worker, x, |target, add| {
            product(
                env.arch,
                Product {
                    // The transposed matrix.
                    matrix: Matrix {
                        data: env.values[weight].as_slice(),
                        rows: 1,
                        columns: inner,
                    },
                    bias: None,
                    x: g,
                    x_pitch: env.stride,
                    out: target,
                    pitch: env.stride,
                    out_rows: inner,
                    inner: rows,
                    lanes: lanes.len,
                    add,
                },
            );
        });
    }
    if env.live[weight] {
        if let Some(at) = env.phase.pull(weight, PullKind::Weight, id) {
            let mut scratch = take(&mut worker.scratch);
            let view = values(env, worker);
            let (copy, transposed) = scratch.as_mut_slice().split_at_mut(inner * env.stride);
            for c in 0..inner {
                copy[c * env.stride..c * env.stride + lanes.len]
                    .copy_from_slice(env.channel(view, lanes, x, c));
            }
            outer(
                env.arch,
                Outer {
                    g,
                    g_pitch: env.stride,
                    x: copy,
                    x_pitch: env.stride,
                    rows,
                    columns: inner,
                    lanes: lanes.len,
                    transposed,
                    sums: chunk.pull[at].as_mut_slice(),
                },
            );
            worker.scratch = scratch;
        }
    }
    if let Some(&bias) = inputs.get(2)
        && env.live[bias]
        && let Some(at) = env.phase.pull(bias, PullKind::Weight, id)
    {
        for (c, sum) in chunk.pull[at].as_mut_slice().iter_mut().enumerate() {
            for x in &g[c * env.stride..c * env.stride + lanes.len] {
                *sum = *sum + *x;
            }
        }
    }
}

/// Marks the nodes of a phase whose values its reverse pass reads.
pub(super) fn mark_replay(
    program: &crate::program::Program,
    phase: &crate::program::Phase,
    live: &[bool],
    replay: &mut [bool],
) {
    for &id in &phase.nodes {
        replay[id] = false;
    }
    for &id in phase.nodes.iter().rev() {
        let node = &program.nodes[id];
        if live[id] {
            match &node.op {
                Op::Element(element) => {
                    for (i, &input) in node.inputs.iter().enumerate() {
                        if !live[input] {
                            continue;
                        }
                        let reads = element.reads(i);
                        if reads & RESULT != 0 {
                            replay[id] = true;
                        }
                        for (j, &other) in node.inputs.iter().enumerate() {
                            if reads & (1 << j) != 0 {
                                replay[other] = true;
                            }
                        }
                    }
                }
                Op::SegmentDot => {
                    let (a, b) = (node.inputs[0], node.inputs[1]);
                    replay[a] |= live[b];
                    replay[b] |= live[a];
                }
                Op::GatherWeighted(_) => node.inputs[1..].iter().for_each(|&w| replay[w] = true),
                Op::Matmul => replay[node.inputs[0]] |= live[node.inputs[1]],
                _ => {}
            }
        }
        if replay[id] && !node.op.is_sink() {
            node.inputs.iter().for_each(|&input| replay[input] = true);
        }
    }
}
