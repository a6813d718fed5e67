//! What the reverse pass of a phase has to recompute.

use super::lane::Function;
use crate::graph::Op;
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
