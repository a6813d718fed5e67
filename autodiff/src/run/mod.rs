//! Running a program: bindings, blocks, the forward, tangent and reverse passes.

mod block;
mod chunk;
mod contract;
mod contract_kernel;
mod driver;
mod linear;
mod lookup;
mod matmul;
mod modes;
mod passes;
mod rows;
mod segments;
mod sizes;
mod workspace;

pub use modes::Engine;
pub use sizes::Sizes;
pub use workspace::Workspace;
