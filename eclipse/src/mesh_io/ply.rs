//! Stanford PLY, ASCII and binary of both byte orders, read raw (no axes are turned); polygons as triangles.

use glam::{Vec2, Vec3};
use render::mesh::Mesh;

use super::{
    MeshParseError,
    ply_header::{Element, Encoding, Header, Property, Scalar, parse_header},
    raw::RawMesh,
};

/// Names that programs give to the texture coordinates.
const UV_NAMES: [[&str; 2]; 4] = [
    ["u", "v"],
    ["s", "t"],
    ["texture_u", "texture_v"],
    ["texcoord_u", "texcoord_v"],
];

/// Parses the positions of a PLY file that holds points alone; `None` where it has faces.
///
/// # Errors
/// As [`parse_ply`], which wants faces.
pub fn parse_ply_points(bytes: &[u8]) -> Result<Option<Vec<Vec3>>, MeshParseError> {
    let (header, mut data) = open(bytes)?;
    let is_surface = |element: &Element| {
        matches!(element.name.as_str(), "face" | "tristrips") && element.count > 0
    };
    if header.elements.iter().any(is_surface) {
        return Ok(None);
    }
    let mut raw = RawMesh::default();
    for element in &header.elements {
        match element.name.as_str() {
            "vertex" => read_vertices(element, &mut data, &mut raw)?,
            _ => skip(element, &mut data)?,
        }
    }
    Ok(Some(raw.positions))
}

/// Parses a PLY file: elements `vertex` (x y z, optionally nx ny nz and texture coordinates) and `face`.
pub fn parse_ply(bytes: &[u8]) -> Result<Mesh, MeshParseError> {
    let (header, mut data) = open(bytes)?;
    let mut raw = RawMesh::default();
    for element in &header.elements {
        match element.name.as_str() {
            "vertex" => read_vertices(element, &mut data, &mut raw)?,
            "face" => read_faces(element, &mut data, &mut raw)?,
            "tristrips" => {
                return Err(MeshParseError::Unsupported(
                    "triangle strips (element tristrips)".into(),
                ));
            }
            _ => skip(element, &mut data)?,
        }
    }
    raw.finish()
}

/// The header, and what follows it.
fn open(bytes: &[u8]) -> Result<(Header, Data<'_>), MeshParseError> {
    let header = parse_header(bytes)?;
    let data = Data {
        bytes: &bytes[header.length..],
        encoding: header.encoding,
    };
    Ok((header, data))
}

/// Refuses a count that cannot be true before anything is stored: each row takes at least a byte.
fn check_count(element: &Element, data: &Data) -> Result<(), MeshParseError> {
    match element.count > data.bytes.len() {
        true => Err(truncated(element, 0)),
        false => Ok(()),
    }
}

fn truncated(element: &Element, row: usize) -> MeshParseError {
    let Element { name, count, .. } = element;
    MeshParseError::Syntax(format!(
        "the data ends or cannot be read at {name} {row} of {count}"
    ))
}

fn read_vertices(
    element: &Element,
    data: &mut Data,
    raw: &mut RawMesh,
) -> Result<(), MeshParseError> {
    check_count(element, data)?;
    let column = |name: &str| {
        element
            .properties
            .iter()
            .position(|property| property.name == name)
    };
    let columns = |names: &[&str]| {
        names
            .iter()
            .map(|name| column(name))
            .collect::<Option<Vec<usize>>>()
    };
    let Some(position) = columns(&["x", "y", "z"]) else {
        return Err(MeshParseError::Syntax(
            "its vertices lack a property x, y or z".into(),
        ));
    };
    let normal = columns(&["nx", "ny", "nz"]);
    let uv = UV_NAMES.iter().find_map(|names| columns(names));
    raw.room(element.count, 0)?;
    let mut row = vec![0.0; element.properties.len()];
    for index in 0..element.count {
        for (value, property) in row.iter_mut().zip(&element.properties) {
            *value = data
                .value(property)
                .ok_or_else(|| truncated(element, index))?;
        }
        let vector =
            |columns: &[usize]| Vec3::from_array([0, 1, 2].map(|axis| row[columns[axis]] as f32));
        raw.positions.push(vector(&position));
        raw.normals.extend(normal.as_deref().map(vector));
        raw.uvs.extend(
            uv.as_deref()
                .map(|uv| Vec2::new(row[uv[0]] as f32, 1.0 - row[uv[1]] as f32)),
        );
    }
    Ok(())
}

fn read_faces(element: &Element, data: &mut Data, raw: &mut RawMesh) -> Result<(), MeshParseError> {
    check_count(element, data)?;
    let mut corners = Vec::new();
    for index in 0..element.count {
        for property in &element.properties {
            if property.list.is_none()
                || !matches!(property.name.as_str(), "vertex_indices" | "vertex_index")
            {
                data.value(property)
                    .ok_or_else(|| truncated(element, index))?;
                continue;
            }
            let count = data
                .list_length(property)
                .ok_or_else(|| truncated(element, index))?;
            corners.clear();
            for _ in 0..count {
                let value = data
                    .scalar(property.scalar)
                    .ok_or_else(|| truncated(element, index))?;
                // Fractions and negative indices are as wrong as those beyond the end.
                if value < 0.0 || value.fract() != 0.0 || value > f64::from(u32::MAX) {
                    let (index, vertices) = (value as i64, raw.positions.len());
                    return Err(MeshParseError::Index {
                        face: raw.faces.len(),
                        index,
                        vertices,
                    });
                }
                corners.push(value as u32);
            }
            raw.polygon(&corners)?;
        }
    }
    Ok(())
}

fn skip(element: &Element, data: &mut Data) -> Result<(), MeshParseError> {
    check_count(element, data)?;
    for index in 0..element.count {
        for property in &element.properties {
            data.value(property)
                .ok_or_else(|| truncated(element, index))?;
        }
        if element.properties.is_empty() {
            break;
        }
    }
    Ok(())
}

/// What is left to read.
struct Data<'a> {
    bytes: &'a [u8],
    encoding: Encoding,
}

impl Data<'_> {
    /// The value of a property; lists are passed over and count as 0.
    fn value(&mut self, property: &Property) -> Option<f64> {
        if property.list.is_none() {
            return self.scalar(property.scalar);
        }
        for _ in 0..self.list_length(property)? {
            self.scalar(property.scalar)?;
        }
        Some(0.0)
    }

    /// The length of a list, at most what the remaining bytes can hold.
    fn list_length(&mut self, property: &Property) -> Option<usize> {
        let length = self.scalar(property.list?)?;
        let smallest = if self.encoding == Encoding::Ascii {
            1
        } else {
            property.scalar.size()
        };
        (length >= 0.0 && length <= (self.bytes.len() / smallest) as f64).then_some(length as usize)
    }

    fn scalar(&mut self, scalar: Scalar) -> Option<f64> {
        match self.encoding {
            Encoding::Ascii => self.word()?.parse().ok(),
            Encoding::Little => Some(match scalar {
                Scalar::I8 => i8::from_le_bytes(self.take()?).into(),
                Scalar::U8 => u8::from_le_bytes(self.take()?).into(),
                Scalar::I16 => i16::from_le_bytes(self.take()?).into(),
                Scalar::U16 => u16::from_le_bytes(self.take()?).into(),
                Scalar::I32 => i32::from_le_bytes(self.take()?).into(),
                Scalar::U32 => u32::from_le_bytes(self.take()?).into(),
                Scalar::F32 => f32::from_le_bytes(self.take()?).into(),
                Scalar::F64 => f64::from_le_bytes(self.take()?),
            }),
            Encoding::Big => Some(match scalar {
                Scalar::I8 => i8::from_be_bytes(self.take()?).into(),
                Scalar::U8 => u8::from_be_bytes(self.take()?).into(),
                Scalar::I16 => i16::from_be_bytes(self.take()?).into(),
                Scalar::U16 => u16::from_be_bytes(self.take()?).into(),
                Scalar::I32 => i32::from_be_bytes(self.take()?).into(),
                Scalar::U32 => u32::from_be_bytes(self.take()?).into(),
                Scalar::F32 => f32::from_be_bytes(self.take()?).into(),
                Scalar::F64 => f64::from_be_bytes(self.take()?),
            }),
        }
    }

    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (value, rest) = self.bytes.split_first_chunk()?;
        self.bytes = rest;
        Some(*value)
    }

    fn word(&mut self) -> Option<&str> {
        let bytes = self.bytes.trim_ascii_start();
        let length = bytes
            .iter()
            .position(u8::is_ascii_whitespace)
            .unwrap_or(bytes.len());
        let (word, rest) = bytes.split_at(length);
        self.bytes = rest;
        std::str::from_utf8(word).ok()
    }
}
