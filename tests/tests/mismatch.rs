//! Where simulation and photographs differ: effects, what a diagnosis reads and what it leaves, captures under known lamps.

mod criticism;
mod diagnosed;
mod effects_found;
mod lamps;
mod located;
mod simulation;
