//! A short book for whoever never saw the paper: what is recovered and why that is possible, how to photograph, how to run, how to
//! read what comes out, and what to do when it does not work.
//!
//! 1. [`the_idea`]: light is blurred away by matt things, and shadows bring it back.
//! 2. [`photographing`]: what a capture needs, and what spoils it.
//! 3. [`first_run`]: from a folder of photographs to a report, and what each part of it says.
//! 4. [`the_model`]: what is unknown, what is assumed, and how it is solved, with the paper's equations.
//! 5. [`when_it_fails`]: symptoms, causes, remedies.
//! 6. [`as_a_library`]: the same from Rust.
//!
//! What a diagnosis means has [a guide of its own](crate::criticism::guide).

#[doc = include_str!("../docs/the_idea.md")]
pub mod the_idea {}

#[doc = include_str!("../docs/photographing.md")]
pub mod photographing {}

#[doc = include_str!("../docs/first_run.md")]
pub mod first_run {}

#[doc = include_str!("../docs/the_model.md")]
pub mod the_model {}

#[doc = include_str!("../docs/when_it_fails.md")]
pub mod when_it_fails {}

#[doc = include_str!("../docs/as_a_library.md")]
pub mod as_a_library {}
