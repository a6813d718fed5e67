//! Where simulation and photographs differ: effects, what a diagnosis reads, captures under known lamps.

mod criticism;
mod lamps;
mod located;
mod simulation;
