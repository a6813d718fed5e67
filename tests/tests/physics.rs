//! Physics with known answers: furnace, reciprocity, sampling densities, estimators against quadrature, shells, harmonics,
//! cached visibility.

#[path = "physics/estimators.rs"]
mod estimators;
#[path = "physics/furnace.rs"]
mod furnace;
#[path = "physics/harmonics.rs"]
mod harmonics;
#[path = "physics/sampling.rs"]
mod sampling;
#[path = "physics/shell.rs"]
mod shell;
#[path = "physics/visibility.rs"]
mod visibility;
