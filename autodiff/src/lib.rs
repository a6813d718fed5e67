//! Vectorised-tape automatic differentiation.
