//! A reconstruction on disk.

pub mod atomic;
