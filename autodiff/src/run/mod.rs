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
mod hessian;
mod inspect;
mod lane;
mod linear;
mod lookup;
mod matmul;
mod memory;
mod modes;
mod passes;
mod plan;
mod replay;
mod rows;
mod segments;
mod sinks;
mod sizes;
mod tangent;
mod tile_kernel;
mod tiles;
mod value;
mod workspace;

pub use inspect::NonFinite;
pub use memory::Memory;
pub use modes::Engine;
pub use sizes::Sizes;
pub(crate) use value::OPERANDS;
pub use workspace::Workspace;
