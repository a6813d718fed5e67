//! Runs of elementwise operations on a tile of lanes, whose values stay in L1 and registers.
//!
//! A loop per operation over a whole block would go to L2 for every operand. Here a short list of instructions runs over
//! [`TILE`] elements before it goes on to the next: values that only the run itself reads never leave the tile.

use super::arithmetic::{
    Add, Affine, Div, Fifth, Mul, MulAdd, MulSub, Neg, NegMulAdd, Product, Recip, Square, Sub,
};
use super::kernel::{operands, term};
use super::smooth::{Acos, Atan2, Cos, Exp, Ln, Pow, Rsqrt, Sigmoid, Sin, Softplus, Sqrt};
use super::switch::{Abs, Clamp, Less, LessEqual, Max, Min, Relu, Select};
use super::{Element, Primitive, element::with_primitive};
use crate::real::{Fma, Real};

/// Elements of a tile: four AVX-512 registers of `f32`, so that the choice of the instruction costs little.
pub(crate) const TILE: usize = 64;

/// A value of a run on a tile.
pub(crate) type Row<R> = [R; TILE];

/// Evaluates an operation: row `out` from rows `x`, all of which come before it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Instruction {
    pub element: Element,
    pub out: u32,
    /// Operands; absent ones repeat the first.
    pub x: [u32; 3],
}

/// Passes the adjoint of an operation's result on to one operand, or to the first two.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pull {
    pub of: Instruction,
    pub operand: u8,
    /// Whether the operand's adjoint has been written before.
    pub add: bool,
    /// For the first operand: whether the second one's adjoint, which is passed on along with it, has been written before.
    pub both: Option<bool>,
}

/// Reads a row of a tile from, or writes it to, one of several arrays.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Transfer {
    pub row: u32,
    /// Which array.
    pub array: u32,
    /// Offset of the first lane in the array.
    pub offset: usize,
}

/// Reads a tile, or what is left of the block. What lies beyond is computed on and never stored.
#[inline(always)]
pub(crate) fn load<R: Real>(row: &mut Row<R>, source: &[R]) {
    match source.first_chunk::<TILE>() {
        Some(whole) => *row = *whole,
        None => row[..source.len()].copy_from_slice(source),
    }
}

/// Writes a tile, or what is left of the block.
#[inline(always)]
pub(crate) fn store<R: Real>(target: &mut [R], row: &Row<R>) {
    let len = target.len();
    match target.first_chunk_mut::<TILE>() {
        Some(whole) => *whole = *row,
        None => target.copy_from_slice(&row[..len]),
    }
}

/// Executes an instruction.
#[inline(always)]
pub(crate) fn evaluate<R: Real, F: Fma>(instruction: &Instruction, rows: &mut [Row<R>]) {
    let (before, rest) = rows.split_at_mut(instruction.out as usize);
    let [x0, x1, x2] = instruction.x.map(|x| &before[x as usize]);
    let y = &mut rest[0];
    with_primitive!(instruction.element, |p, N| {
        evaluate_row::<R, F, _, N>(p, x0, x1, x2, y)
    });
}

#[inline(always)]
fn evaluate_row<R: Real, F: Fma, P: Primitive<N>, const N: usize>(
    primitive: P,
    x0: &Row<R>,
    x1: &Row<R>,
    x2: &Row<R>,
    y: &mut Row<R>,
) {
    for i in 0..TILE {
        y[i] = primitive.eval::<R, F>(operands(x0[i], x1[i], x2[i]));
    }
}

/// Passes an adjoint on to one operand, or to the first two.
#[inline(always)]
pub(crate) fn pass<R: Real, F: Fma>(pull: &Pull, values: &[Row<R>], adjoints: &mut [Row<R>]) {
    let Instruction { element, out, x } = pull.of;
    let y = &values[out as usize];
    let (before, rest) = adjoints.split_at_mut(out as usize);
    let source = &rest[0];
    let rows = x;
    let [x0, x1, x2] = x.map(|x| &values[x as usize]);
    if let Some(second) = pull.both {
        let Ok([t0, t1]) = before.get_disjoint_mut([rows[0] as usize, rows[1] as usize]) else {
            return;
        };
        with_primitive!(element, |p, N| {
            match (pull.add, second) {
                _ if N < 2 => {}
                (false, false) => {
                    pass_both::<R, F, _, N, false, false>(p, x0, x1, x2, y, source, t0, t1)
                }
                (false, true) => {
                    pass_both::<R, F, _, N, false, true>(p, x0, x1, x2, y, source, t0, t1)
                }
                (true, false) => {
                    pass_both::<R, F, _, N, true, false>(p, x0, x1, x2, y, source, t0, t1)
                }
                (true, true) => {
                    pass_both::<R, F, _, N, true, true>(p, x0, x1, x2, y, source, t0, t1)
                }
            }
        });
        return;
    }
    let target = &mut before[rows[pull.operand as usize] as usize];
    with_primitive!(element, |p, N| {
        match pull.operand {
            0 => pass_row::<R, F, _, N, 0>(p, x0, x1, x2, y, source, target, pull.add),
            1 if N > 1 => pass_row::<R, F, _, N, 1>(p, x0, x1, x2, y, source, target, pull.add),
            _ if N > 2 => pass_row::<R, F, _, N, 2>(p, x0, x1, x2, y, source, target, pull.add),
            _ => {}
        }
    });
}

/// Both operands at once: what they share is loaded and computed once.
#[inline(always)]
fn pass_both<
    R: Real,
    F: Fma,
    P: Primitive<N>,
    const N: usize,
    const ADD0: bool,
    const ADD1: bool,
>(
    primitive: P,
    x0: &Row<R>,
    x1: &Row<R>,
    x2: &Row<R>,
    y: &Row<R>,
    source: &Row<R>,
    t0: &mut Row<R>,
    t1: &mut Row<R>,
) {
    for i in 0..TILE {
        let x = operands(x0[i], x1[i], x2[i]);
        let first = term::<R, F, P, N, 0>(primitive, x, y[i], source[i]);
        let second = term::<R, F, P, N, 1>(primitive, x, y[i], source[i]);
        t0[i] = if ADD0 { t0[i] + first } else { first };
        t1[i] = if ADD1 { t1[i] + second } else { second };
    }
}

#[inline(always)]
fn pass_row<R: Real, F: Fma, P: Primitive<N>, const N: usize, const I: usize>(
    primitive: P,
    x0: &Row<R>,
    x1: &Row<R>,
    x2: &Row<R>,
    y: &Row<R>,
    source: &Row<R>,
    target: &mut Row<R>,
    add: bool,
) {
    if add {
        for i in 0..TILE {
            let x = operands(x0[i], x1[i], x2[i]);
            target[i] = target[i] + term::<R, F, P, N, I>(primitive, x, y[i], source[i]);
        }
    } else {
        for i in 0..TILE {
            let x = operands(x0[i], x1[i], x2[i]);
            target[i] = term::<R, F, P, N, I>(primitive, x, y[i], source[i]);
        }
    }
}
