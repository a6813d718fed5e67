//! What all else stands on: who may know of whom, gradients, physics with known answers, files that were written before.

mod checkpoint;
mod fuzz_seeds;
mod gradients;
mod layering;
mod physics;
