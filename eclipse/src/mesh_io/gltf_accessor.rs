//! Values in the buffers of a glTF file, every access checked.

use gltf::{
    Accessor,
    accessor::{DataType, Dimensions},
    buffer::View,
};

use super::MeshParseError;

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
        let normalized = accessor.normalized();
        // The least signed integer has no counterpart: it stands for −1 as the next one does.
        let integer = |value: f32, most: f32| match normalized {
            true => (value / most).max(-1.0),
            false => value,
        };
        let element = |bytes: &[u8]| {
            let mut values = [0.0; N];
            let size = bytes.len() / N;
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
            .ok_or_else(|| MeshParseError::Syntax("positions, normals or texture coordinates are of another type than the format asks".into()))
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

    /// The bytes of each element, checked against the buffer.
    fn elements<'a>(
        &'a self,
        accessor: &Accessor<'a>,
    ) -> Result<impl Iterator<Item = &'a [u8]>, MeshParseError> {
        if accessor.sparse().is_some() {
            return Err(MeshParseError::Unsupported("sparse accessors".into()));
        }
        let view = accessor
            .view()
            .ok_or_else(|| MeshParseError::Unsupported("accessors without data".into()))?;
        let (size, count) = (accessor.size(), accessor.count());
        let stride = view.stride().unwrap_or(size);
        let outside = || {
            MeshParseError::Syntax(format!(
                "accessor {} reaches beyond its buffer",
                accessor.index()
            ))
        };
        let bytes = self.view(&view)?;
        let bytes = bytes.get(accessor.offset()..).ok_or_else(outside)?;
        let needed = count
            .checked_sub(1)
            .and_then(|last| last.checked_mul(stride)?.checked_add(size));
        if stride < size
            || needed.is_some_and(|needed| needed > bytes.len())
            || (count > 0 && needed.is_none())
        {
            return Err(outside());
        }
        Ok((0..count).map(move |index| &bytes[index * stride..index * stride + size]))
    }
}
