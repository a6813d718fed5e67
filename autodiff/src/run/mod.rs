//! Running a program: bindings, blocks, the forward, tangent and reverse passes.

mod adjoint;
mod assemble;
mod block;
mod chunk;
mod contract;
mod contract_kernel;
mod corners;
mod dense;
mod driver;
mod linear;
mod lookup;
mod matmul;
mod modes;
mod passes;
mod replay;
mod rows;
mod segments;
mod sinks;
mod sizes;
mod tangent;
mod value;
mod workspace;

pub use modes::Engine;
pub use sizes::Sizes;
pub use workspace::Workspace;
