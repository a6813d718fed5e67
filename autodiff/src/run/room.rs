//! How large blocks are, and what they need.

use super::chunk::{Span, widest};
use super::lane::Lane;
use super::rows::PARTIALS;
use super::sizes::{Extent, Sizes};
use crate::buffer::Buffer;
use crate::graph::{NodeId, Op};
use crate::op::tile::TILE;
use crate::program::{Phase, Program};

/// How many times larger than others a value along an axis may be in a block.
const WIDE: usize = 16;

/// Bytes of a thread's arena, values and adjoints, that blocks are made smaller for. Not all of it is in use at once: a network of
/// 4 x 128 takes 84, 67, 66, 69 and 73 ms in blocks of 1,008, 256, 192, 128 and 64 lanes, with 1 MiB of L2.
const ARENA: usize = 2 << 20;
/// Lanes that blocks of many channels keep, and what they are a multiple of: tiles of matrix products are whole.
const FEW_LANES: usize = 64;

/// Channels this many elements apart compete for the same lines of L1; matrix products read many channels at once.
const CONFLICT: usize = 256;

/// Lanes of the largest block of a phase.
pub(super) fn stride(
    program: &Program,
    extent: &Extent,
    phase: &Phase,
    sizes: &Sizes,
    spans: &[Span],
) -> usize {
    let longest = spans.iter().map(|span| span.lanes.len()).max().unwrap_or(0);
    // Few values of a phase are wide: they may overflow L1 as long as blocks keep enough lanes.
    let wide = WIDE.saturating_mul(sizes.block) / widest(program, extent, phase);
    let wanted = sizes
        .block
        .min(wide)
        .min(fitting(program, extent, phase))
        .min(longest);
    let stride = wanted.next_multiple_of(PARTIALS).max(PARTIALS);
    let multiplies = |id: &NodeId| matches!(program.nodes[*id].op, Op::Matmul);
    if stride % CONFLICT == 0 && phase.nodes.iter().any(multiplies) {
        return stride - TILE;
    }
    stride
}

/// Lanes whose values and adjoints fit into [`ARENA`], of [`f32`].
fn fitting(program: &Program, extent: &Extent, phase: &Phase) -> usize {
    let elements = |id: &NodeId| {
        let shape = program.nodes[*id].shape;
        shape.channels.saturating_mul(extent.axis(shape.axis))
    };
    let lane = phase
        .locals
        .iter()
        .map(elements)
        .fold(0, usize::saturating_add);
    let lane = lane.saturating_mul(2 * size_of::<f32>());
    (ARENA / lane.max(1) / FEW_LANES * FEW_LANES).max(FEW_LANES)
}

/// Threads to share work among.
pub(super) fn threads(sizes: &Sizes) -> usize {
    let available = rayon::current_num_threads();
    sizes.threads.unwrap_or(available).clamp(1, available)
}

/// Makes room in an arena for the first `count` locals of a phase.
pub(super) fn grow<R: Lane>(
    arena: &mut Vec<Buffer<R>>,
    phase: &Phase,
    count: usize,
    room: impl Fn(NodeId) -> usize,
) {
    if arena.len() < count {
        arena.resize_with(count, || Buffer::zeros(0));
    }
    for (slot, &id) in phase.locals[..count].iter().enumerate() {
        arena[slot].grow(room(id));
    }
}

/// Elements of scratch that a block needs: products of a contraction, or the operands of a dense layer, twice.
pub(super) fn scratch_len(program: &Program, phase: &Phase, stride: usize, widest: usize) -> usize {
    let needs = phase.nodes.iter().map(|&id| {
        let node = &program.nodes[id];
        match node.op {
            Op::SegmentDot => stride * widest,
            Op::Matmul => 2 * stride * program.nodes[node.inputs[0]].shape.channels,
            _ => 0,
        }
    });
    needs.max().unwrap_or(0)
}
