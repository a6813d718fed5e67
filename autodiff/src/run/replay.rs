//! What the reverse pass of a phase has to recompute.

use super::lane::Function;
use crate::graph::{NodeId, Op};
use crate::op::RESULT;
use crate::program::{Phase, Program};

/// Marks the nodes of a phase whose values its reverse pass reads.
pub(super) fn mark_replay(program: &Program, phase: &Phase, live: &[bool], replay: &mut [bool]) {
    for &id in &phase.nodes {
        replay[id] = false;
    }
    for &id in phase.nodes.iter().rev() {
        let node = &program.nodes[id];
        if live[id] {
            match &node.op {
                Op::Element(_) | Op::Custom(_) => {
                    let Some(function) = Function::of(node) else {
                        continue;
                    };
                    for (i, &input) in node.inputs.iter().enumerate() {
                        if !live[input] {
                            continue;
                        }
                        let reads = function.reads(i);
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

/// Whether node `user` reads the value of its operand `input` in the reverse pass.
pub(super) fn reads_value(
    program: &Program,
    user: NodeId,
    input: NodeId,
    live: &[bool],
    replay: &[bool],
) -> bool {
    let node = &program.nodes[user];
    if !node.inputs.contains(&input) {
        return false;
    }
    if replay[user] && !node.op.is_sink() {
        return true;
    }
    if !live[user] {
        return false;
    }
    let mut operands = node.inputs.iter().enumerate();
    match &node.op {
        Op::Element(_) | Op::Custom(_) => Function::of(node).is_some_and(|function| {
            let read = |i: usize| {
                if live[node.inputs[i]] {
                    function.reads(i)
                } else {
                    0
                }
            };
            let all = (0..node.inputs.len()).fold(0, |all, i| all | read(i));
            operands.any(|(j, &other)| other == input && all & (1 << j) != 0)
        }),
        Op::SegmentDot => {
            let (a, b) = (node.inputs[0], node.inputs[1]);
            (input == a && live[b]) || (input == b && live[a])
        }
        Op::GatherWeighted(_) => node.inputs[1..].contains(&input),
        Op::Matmul => input == node.inputs[0] && live[node.inputs[1]],
        _ => false,
    }
}
