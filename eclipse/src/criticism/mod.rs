//! Model criticism: where a simulation and its recording differ, what physics was left out, and the proof.

pub mod axes;
pub mod baselines;
pub mod bounded;
pub mod certainty;
pub mod chain;
pub mod compete;
pub mod confined;
pub mod confirm;
pub mod dark;
pub mod detectable;
pub mod diagnose;
pub mod diagnosis;
pub mod effects;
pub mod film;
pub mod fit;
pub mod formation;
pub mod frame_numbers;
pub mod given;
pub mod glossy;
pub mod gram;
pub mod horizon;
pub mod lamps;
pub mod light;
pub mod linear;
pub mod linearise;
pub mod locate;
pub mod maps;
pub mod neighbours;
pub mod nuisance;
pub mod nulls;
pub mod observe;
pub mod oracle;
pub mod page;
pub mod plot;
pub mod precision;
pub mod quantum;
pub mod reduce;
pub mod refit;
pub mod scatter;
pub mod scene;
pub mod score;
pub mod sealed;
pub mod sentence;
pub mod separate;
pub mod shadow_edges;
pub mod silhouette;
pub mod simulation;
pub mod split;
pub mod spots;
pub mod statistics;
pub mod stretch;
pub mod study;
pub mod study_scores;
pub mod tables;
pub mod told;
pub mod transport;
pub mod verdict;

#[doc = include_str!("guide.md")]
pub mod guide {}

pub use diagnose::{DiagnoseError, Options, Outcome, chosen, diagnose, light_of};
pub use diagnosis::{Diagnosis, Verdict};
pub use simulation::Simulation;
