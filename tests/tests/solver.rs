//! The solver on captures whose answer is known.

mod finer_model;
mod joint;
mod paper;
mod recovery;
mod uncertainty;
