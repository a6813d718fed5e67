//! Values in the buffers of a glTF file, every access checked.

use gltf::{
    Accessor,
    accessor::{DataType, Dimensions},
    buffer::View,
};

use super::{MAX_VERTICES, MeshParseError};

/// An element of an accessor without data, of which the largest is a matrix of 16 floats.
const ZEROS: &[u8] = &[0; 64];

/// The buffers of a file, in its order.
pub(super) struct Buffers(pub Vec<Vec<u8>>);

impl Buffers {
    /// Vertex indices.
    pub fn indices(&self, accessor: &Accessor) -> Result<Vec<u32>, MeshParseError> {
        let element = |bytes: &[u8]| match (accessor.data_type(), bytes) {
            (DataType::U8, &[a]) => Some(a.into()),
            (DataType::U16, &[a, b]) => Some(u16::from_le_bytes([a, b]).into()),
            (DataType::U32, &[a, b, c, d]) => Some(u32::from_le_bytes([a, b, c, d])),
            _ => None,
        };
        self.elements(accessor)?
            .map(element)
            .collect::<Option<_>>()
            .ok_or_else(|| {
                MeshParseError::Syntax("its face indices are not unsigned integers".into())
            })
    }

    /// Vectors of `N` floats; integers of 8 and 16 bits are such floats as well, normalised or as they are.
    pub fn floats<const N: usize>(
        &self,
        accessor: &Accessor,
    ) -> Result<Vec<[f32; N]>, MeshParseError> {
        let fits = matches!(
            (accessor.dimensions(), N),
            (Dimensions::Scalar, 1) | (Dimensions::Vec2, 2) | (Dimensions::Vec3, 3)
        );
        self.vectors(accessor, fits)
    }

    /// Colours, whose opacity is left out where they have one.
    pub fn colors(&self, accessor: &Accessor) -> Result<Vec<[f32; 3]>, MeshParseError> {
        let fits = matches!(accessor.dimensions(), Dimensions::Vec3 | Dimensions::Vec4);
        self.vectors(accessor, fits)
    }

    /// The first `N` values of each element, if the type `fits`: then it has so many at least.
    fn vectors<const N: usize>(
        &self,
        accessor: &Accessor,
        fits: bool,
    ) -> Result<Vec<[f32; N]>, MeshParseError> {
        let normalized = accessor.normalized();
        // The least signed integer has no counterpart: it stands for −1 as the next one does.
        let integer = |value: f32, most: f32| match normalized {
            true => (value / most).max(-1.0),
            false => value,
        };
        let element = |bytes: &[u8]| {
            let mut values = [0.0; N];
            let size = accessor.data_type().size();
            for (value, bytes) in values.iter_mut().zip(bytes.chunks_exact(size)) {
                *value = match (accessor.data_type(), bytes) {
                    (DataType::F32, &[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]),
                    (DataType::U8, &[a]) => integer(f32::from(a), 255.0),
                    (DataType::I8, &[a]) => integer(f32::from(a as i8), 127.0),
                    (DataType::U16, &[a, b]) => {
                        integer(f32::from(u16::from_le_bytes([a, b])), 65535.0)
                    }
                    (DataType::I16, &[a, b]) => {
                        integer(f32::from(i16::from_le_bytes([a, b])), 32767.0)
                    }
                    _ => return None,
                };
            }
            Some(values)
        };
        let elements = self.elements(accessor)?;
        fits.then(|| elements.map(element).collect::<Option<_>>())
            .flatten()
            .ok_or_else(|| MeshParseError::Syntax("positions, normals, texture coordinates or colours are of another type than the format asks".into()))
    }

    /// The bytes of a view.
    pub fn view(&self, view: &View) -> Result<&[u8], MeshParseError> {
        let end = view.offset().checked_add(view.length());
        end.and_then(|end| self.0[view.buffer().index()].get(view.offset()..end))
            .ok_or_else(|| {
                MeshParseError::Syntax(format!("view {} reaches beyond its buffer", view.index()))
            })
    }

    /// Refuses an accessor that its buffer does not hold, before anything is stored for it.
    pub fn check(&self, accessor: &Accessor) -> Result<(), MeshParseError> {
        self.elements(accessor).map(drop)
    }

    /// The bytes of each element, checked against the buffers; zeros where an accessor has no data.
    fn elements<'a>(
        &'a self,
        accessor: &Accessor<'a>,
    ) -> Result<impl Iterator<Item = &'a [u8]>, MeshParseError> {
        let (size, count) = (accessor.size(), accessor.count());
        let stored = match accessor.view() {
            Some(view) => {
                let stride = view.stride().unwrap_or(size);
                let bytes = self.held(accessor, &view, accessor.offset(), [stride, size], count)?;
                Some((bytes, stride))
            }
            // No buffer bounds how many these may be.
            None if count > MAX_VERTICES => {
                return Err(MeshParseError::TooLarge {
                    what: "values without data",
                    most: MAX_VERTICES as u64,
                });
            }
            None => None,
        };
        let mut changed = self.changed(accessor)?.into_iter().peekable();
        Ok((0..count).map(move |index| {
            match (changed.next_if(|(place, _)| *place == index), stored) {
                (Some((_, bytes)), _) => bytes,
                (None, Some((bytes, stride))) => &bytes[index * stride..][..size],
                (None, None) => &ZEROS[..size],
            }
        }))
    }

    /// The elements that a sparse accessor replaces: their places, ascending, and their bytes.
    fn changed<'a>(
        &'a self,
        accessor: &Accessor<'a>,
    ) -> Result<Vec<(usize, &'a [u8])>, MeshParseError> {
        let Some(sparse) = accessor.sparse() else {
            return Ok(Vec::new());
        };
        let (count, size) = (sparse.count(), accessor.size());
        let (places, values) = (sparse.indices(), sparse.values());
        let width = places.index_type().size();
        let held = |view: View<'a>, offset: usize, size: usize| {
            self.held(accessor, &view, offset, [size, size], count)
        };
        let place_bytes = held(places.view(), places.offset(), width)?;
        let bytes = held(values.view(), values.offset(), size)?;
        let place = |bytes: &[u8]| {
            let low_last = bytes.iter().rev();
            low_last.fold(0, |place: usize, &byte| place << 8 | usize::from(byte))
        };
        let pairs = place_bytes.chunks_exact(width).map(place);
        let changed: Vec<_> = pairs.zip(bytes.chunks_exact(size)).take(count).collect();
        let ascending = changed.windows(2).all(|pair| pair[0].0 < pair[1].0);
        if !ascending
            || changed
                .last()
                .is_some_and(|last| last.0 >= accessor.count())
        {
            return Err(MeshParseError::Syntax(format!(
                "accessor {} replaces elements that it does not have, or not in their order",
                accessor.index()
            )));
        }
        Ok(changed)
    }

    /// The bytes of `view` from `offset` on, which must hold `count` elements of `size` bytes, `stride` apart.
    fn held(
        &self,
        accessor: &Accessor,
        view: &View,
        offset: usize,
        [stride, size]: [usize; 2],
        count: usize,
    ) -> Result<&[u8], MeshParseError> {
        let bytes = self.view(view)?.get(offset..);
        let needed = match count.checked_sub(1) {
            None => Some(0),
            Some(last) => last
                .checked_mul(stride)
                .and_then(|start| start.checked_add(size)),
        };
        bytes
            .filter(|bytes| stride >= size && needed.is_some_and(|needed| needed <= bytes.len()))
            .ok_or_else(|| {
                MeshParseError::Syntax(format!(
                    "accessor {} reaches beyond its buffer",
                    accessor.index()
                ))
            })
    }
}
