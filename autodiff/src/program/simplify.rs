//! Rewrites a graph into fewer operations. Values stay the same up to rounding, derivatives too.
//!
//! | pattern | becomes |
//! | --- | --- |
//! | the same operation on the same operands | one node |
//! | `1 x + 0`, `--x`, `detach` of what has no gradient | `x` |
//! | an affine function of an affine function, or of a negation; the negation of one | one affine function |
//! | `x x` | `square(x)` |
//! | `x + x` | `2 x` |
//! | `1 / sqrt(x)` | `rsqrt(x)` |
//! | a selection between equals | the value |
//! | `a b + c`, `c + a b` | `mul_add(a, b, c)` |
//! | `c - a b` | `neg_mul_add(a, b, c)` |
//! | `a b - c` | `mul_sub(a, b, c)` |
//! | `a b + constant` | `product(a, b, constant)` |
//!
//! `x (1 / y)` stays: where both are 0, the derivative of a quotient by `y` is NaN, and that of the product 0.
//!
//! Only operands that nothing else uses, and that carry no label, disappear into another operation.

use std::collections::BTreeMap;

use crate::graph::{Node, NodeId, Op};
use crate::op::Element;

type Outputs = Vec<(String, NodeId)>;

/// Applies all rules.
pub(super) fn simplify(mut nodes: Vec<Node>, mut outputs: Outputs) -> (Vec<Node>, Outputs) {
    let mut stands_for: Vec<NodeId> = (0..nodes.len()).collect();
    let mut seen: BTreeMap<Vec<NodeId>, Vec<NodeId>> = BTreeMap::new();
    for id in 0..nodes.len() {
        let mut inputs = std::mem::take(&mut nodes[id].inputs);
        inputs.iter_mut().for_each(|i| *i = stands_for[*i]);
        nodes[id].inputs = inputs;
        if nodes[id].label.is_some() {
            continue;
        }
        rewrite(&mut nodes, id);
        let same = identity(&nodes, id).or_else(|| repeated(&nodes, &mut seen, id));
        stands_for[id] = same.unwrap_or(id);
    }
    for output in &mut outputs {
        output.1 = stands_for[output.1];
    }
    let uses = uses(&nodes, &outputs);
    for id in 0..nodes.len() {
        if uses[id] > 0 {
            join(&mut nodes, &uses, id);
        }
    }
    (nodes, outputs)
}

/// How often each node is used by what the outputs need.
fn uses(nodes: &[Node], outputs: &Outputs) -> Vec<usize> {
    let mut uses = vec![0; nodes.len()];
    for &(_, id) in outputs {
        uses[id] += 1;
    }
    for id in (0..nodes.len()).rev() {
        if uses[id] > 0 {
            nodes[id].inputs.iter().for_each(|&input| uses[input] += 1);
        }
    }
    uses
}

fn element(node: &Node) -> Option<Element> {
    match node.op {
        Op::Element(element) => Some(element),
        _ => None,
    }
}

/// The operand, if the node is a function of one operand of its own shape.
fn operand<'a>(nodes: &'a [Node], node: &Node) -> Option<&'a Node> {
    let &[input] = &node.inputs[..] else {
        return None;
    };
    Some(&nodes[input]).filter(|input| input.shape == node.shape && input.label.is_none())
}

/// The node that a node equals.
fn identity(nodes: &[Node], id: NodeId) -> Option<NodeId> {
    let node = &nodes[id];
    let equals = |other: NodeId| {
        let same = nodes[other].shape == node.shape && nodes[other].active == node.active;
        same.then_some(other)
    };
    match &node.op {
        Op::Element(Element::Affine {
            scale: 1.0,
            offset: 0.0,
        }) => equals(node.inputs[0]),
        Op::Element(Element::Neg) => {
            let inner = operand(nodes, node)?;
            match element(inner)? {
                Element::Neg => equals(inner.inputs[0]),
                _ => None,
            }
        }
        Op::Element(Element::Select) if node.inputs[1] == node.inputs[2] => equals(node.inputs[1]),
        Op::Detach => equals(node.inputs[0]),
        _ => None,
    }
}

/// An earlier node that does the same; `seen` lists nodes by their operands.
fn repeated(
    nodes: &[Node],
    seen: &mut BTreeMap<Vec<NodeId>, Vec<NodeId>>,
    id: NodeId,
) -> Option<NodeId> {
    let node = &nodes[id];
    if node.inputs.is_empty() {
        return None;
    }
    let same_op = |other: &Op| match (&node.op, other) {
        (Op::Element(a), Op::Element(b)) => a == b,
        (Op::Channel(a), Op::Channel(b)) => a == b,
        (Op::SumChannels, Op::SumChannels) | (Op::Detach, Op::Detach) => true,
        (a, b) => a.same_lookup(b),
    };
    let known = seen.entry(node.inputs.clone()).or_default();
    let same = |&&other: &&NodeId| nodes[other].shape == node.shape && same_op(&nodes[other].op);
    let found = known.iter().find(same).copied();
    if found.is_none() {
        known.push(id);
    }
    found
}

/// Rules that look at a node and its operands, whoever else uses them.
fn rewrite(nodes: &mut [Node], id: NodeId) {
    let node = &nodes[id];
    let Some(outer) = element(node) else { return };
    if let [a, b] = node.inputs[..]
        && a == b
    {
        let (op, inputs) = match outer {
            Element::Mul => (Element::Square, vec![a]),
            Element::Add => {
                let twice = Element::Affine {
                    scale: 2.0,
                    offset: 0.0,
                };
                (twice, vec![a])
            }
            _ => return,
        };
        nodes[id].op = Op::Element(op);
        nodes[id].inputs = inputs;
        return;
    }
    let Some(inner) = operand(nodes, node) else {
        return;
    };
    let Some(inner_element) = element(inner) else {
        return;
    };
    let linear = |element: Element| match element {
        Element::Affine { scale, offset } => Some((scale, offset)),
        Element::Neg => Some((-1.0, 0.0)),
        _ => None,
    };
    let both_negate = outer == Element::Neg && inner_element == Element::Neg;
    let joined = match (linear(outer), linear(inner_element)) {
        (Some((scale, offset)), Some((inner_scale, inner_offset))) if !both_negate => {
            Some(Element::Affine {
                scale: scale * inner_scale,
                offset: scale * inner_offset + offset,
            })
        }
        _ if (outer, inner_element) == (Element::Recip, Element::Sqrt) => Some(Element::Rsqrt),
        _ => None,
    };
    if let Some(joined) = joined {
        let inputs = inner.inputs.clone();
        nodes[id].op = Op::Element(joined);
        nodes[id].inputs = inputs;
    }
}

/// Rules that take in an operand that nothing else uses.
fn join(nodes: &mut [Node], uses: &[usize], id: NodeId) {
    let node = &nodes[id];
    let alone = |input: NodeId, wanted: Element| {
        let found = &nodes[input];
        let plain = found.label.is_none() && found.shape == node.shape;
        (plain && uses[input] == 1 && element(found) == Some(wanted)).then_some(&found.inputs)
    };
    let Some(outer) = element(node) else { return };
    let inputs = &node.inputs;
    let joined = match outer {
        Element::Add => {
            let first = alone(inputs[0], Element::Mul).map(|ab| (ab, inputs[1]));
            let found = first.or_else(|| Some((alone(inputs[1], Element::Mul)?, inputs[0])));
            found.map(|(ab, c)| (Element::MulAdd, vec![ab[0], ab[1], c]))
        }
        Element::Sub => {
            let first = alone(inputs[0], Element::Mul)
                .map(|ab| (Element::MulSub, vec![ab[0], ab[1], inputs[1]]));
            first.or_else(|| {
                let ab = alone(inputs[1], Element::Mul)?;
                Some((Element::NegMulAdd, vec![ab[0], ab[1], inputs[0]]))
            })
        }
        Element::Affine { scale: 1.0, offset } => {
            alone(inputs[0], Element::Mul).map(|ab| (Element::Product { offset }, ab.clone()))
        }
        _ => None,
    };
    if let Some((op, inputs)) = joined {
        nodes[id].op = Op::Element(op);
        nodes[id].inputs = inputs;
    }
}
