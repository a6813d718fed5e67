//! Arrays that start on a cache line.

use crate::real::Real;

/// Bytes of a cache line, and of the widest vector register in use.
const LINE: usize = 64;

/// A fixed-length array whose first element starts a cache line, so that vector loads never straddle two.
#[derive(Clone, Debug, Default)]
pub(crate) struct Buffer<R> {
    storage: Vec<R>,
    start: usize,
    len: usize,
}

impl<R: Real> Buffer<R> {
    /// An array of zeros.
    pub fn zeros(len: usize) -> Self {
        let padding = LINE / size_of::<R>();
        let storage = vec![R::default(); if len == 0 { 0 } else { len + padding }];
        let start = if len == 0 {
            0
        } else {
            storage.as_ptr().align_offset(LINE).min(padding)
        };
        Buffer {
            storage,
            start,
            len,
        }
    }

    /// Makes this an array of `len` elements: zeros, unless the length was right already. Memory is kept where it suffices.
    pub fn ensure(&mut self, len: usize) {
        if self.len == len {
            return;
        }
        if self.start + len <= self.storage.len() {
            self.len = len;
            self.as_mut_slice().fill(R::default());
        } else {
            *self = Buffer::zeros(len);
        }
    }

    /// Makes this an array of at least `len` elements, of unspecified contents if it had to grow.
    pub fn grow(&mut self, len: usize) {
        if self.len < len {
            *self = Buffer::zeros(len);
        }
    }

    #[inline(always)]
    pub fn as_slice(&self) -> &[R] {
        &self.storage[self.start..self.start + self.len]
    }

    #[inline(always)]
    pub fn as_mut_slice(&mut self) -> &mut [R] {
        &mut self.storage[self.start..self.start + self.len]
    }

    /// Heap bytes of an array of `len` elements.
    pub fn bytes_for(len: usize) -> usize {
        match len {
            0 => 0,
            len => len.saturating_mul(size_of::<R>()).saturating_add(LINE),
        }
    }

    /// Heap bytes held.
    pub fn bytes(&self) -> usize {
        self.storage.len() * size_of::<R>()
    }
}
