//! Vector instructions are chosen when a program runs, not when it is compiled.
#![cfg(target_arch = "x86_64")]

use autodiff::{Graph, Sizes};

/// A fused multiply-add rounds once, two instructions round twice: the result tells which ran. A build for any x86-64 may not
/// contain a fused one outside of what is chosen at run time.
#[test]
fn a_portable_build_uses_what_the_machine_has() {
    let g = Graph::new();
    let lane = g.domain("lane");
    let (a, c) = (g.param("a", &lane, 1), g.param("c", &lane, 1));
    let program = g.compile(&[("y", &a.mul_add(&a, &c))]).unwrap();
    let n = 100;
    let mut ws = program
        .workspace::<f32>(&Sizes::new().lanes("lane", n))
        .unwrap();
    // a^2 = 1 + 2^-11 + 2^-24, whose last bit does not fit.
    let a = 1.0 + 2f32.powi(-12);
    ws.set("a", &vec![a; n]).unwrap();
    ws.set("c", &vec![-(1.0 + 2f32.powi(-11)); n]).unwrap();
    program.forward(&mut ws).unwrap();
    let present = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
    let expected = if present { 2f32.powi(-24) } else { 0.0 };
    assert_eq!(ws.output("y").unwrap(), vec![expected; n]);
}
