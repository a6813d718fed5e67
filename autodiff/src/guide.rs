//! Guides: how to think about gradients of estimators, and how to come from other engines.

#[doc = include_str!("../docs/detaching.md")]
pub mod detaching {}

#[doc = include_str!("../docs/migration.md")]
pub mod migration {}
