//! Guides: how to think about gradients of estimators, how to come from other engines, and how fast this one is.

#[doc = include_str!("../docs/detaching.md")]
pub mod detaching {}

#[doc = include_str!("../docs/migration.md")]
pub mod migration {}

#[doc = include_str!("../docs/speed.md")]
pub mod speed {}
