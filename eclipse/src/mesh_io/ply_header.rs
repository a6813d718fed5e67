//! The header of a PLY file.

use super::MeshParseError;

/// Longest header that is read, in bytes.
const MAX_HEADER: usize = 1 << 16;

/// What a PLY file declares.
pub(super) struct Header {
    pub encoding: Encoding,
    pub elements: Vec<Element>,
    /// Where the data starts, in bytes.
    pub length: usize,
}

#[derive(Clone, Copy, PartialEq)]
pub(super) enum Encoding {
    Ascii,
    Little,
    Big,
}

pub(super) struct Element {
    pub name: String,
    pub count: usize,
    pub properties: Vec<Property>,
}

pub(super) struct Property {
    pub name: String,
    /// The type of the count when the property is a list.
    pub list: Option<Scalar>,
    pub scalar: Scalar,
}

#[derive(Clone, Copy, PartialEq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    /// Size in a binary file, in bytes.
    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }
}

/// Parses the header of `bytes`.
pub(super) fn parse_header(bytes: &[u8]) -> Result<Header, MeshParseError> {
    let syntax = |reason: String| MeshParseError::Syntax(format!("its header {reason}"));
    let bytes = &bytes[..bytes.len().min(MAX_HEADER)];
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut start = 0;
    loop {
        let Some(length) = bytes[start..].iter().position(|&byte| byte == b'\n') else {
            return Err(syntax(match bytes.len() {
                MAX_HEADER => format!("has no end_header in its first {MAX_HEADER} bytes"),
                _ => "has no end_header".into(),
            }));
        };
        let line = String::from_utf8_lossy(&bytes[start..start + length]);
        let words: Vec<&str> = line.split_whitespace().collect();
        if start == 0 && words != ["ply"] {
            return Err(syntax("does not begin with \"ply\"".into()));
        }
        start += length + 1;
        let unknown = || {
            syntax(format!(
                "has a line that is not understood: {:?}",
                line.trim()
            ))
        };
        match words[..] {
            ["format", "ascii", _] => encoding = Some(Encoding::Ascii),
            ["format", "binary_little_endian", _] => encoding = Some(Encoding::Little),
            ["format", "binary_big_endian", _] => encoding = Some(Encoding::Big),
            ["element", name, count] => {
                let count = count.parse().map_err(|_| unknown())?;
                elements.push(Element {
                    name: name.into(),
                    count,
                    properties: Vec::new(),
                });
            }
            ["property", "list", count, scalar, name] => {
                let property = Property {
                    name: name.into(),
                    list: Some(Scalar::parse(count).ok_or_else(unknown)?),
                    scalar: Scalar::parse(scalar).ok_or_else(unknown)?,
                };
                elements
                    .last_mut()
                    .ok_or_else(unknown)?
                    .properties
                    .push(property);
            }
            ["property", scalar, name] => {
                let scalar = Scalar::parse(scalar).ok_or_else(unknown)?;
                let property = Property {
                    name: name.into(),
                    list: None,
                    scalar,
                };
                elements
                    .last_mut()
                    .ok_or_else(unknown)?
                    .properties
                    .push(property);
            }
            ["end_header"] => break,
            ["ply"] | ["comment", ..] | ["obj_info", ..] | [] => {}
            _ => return Err(unknown()),
        }
    }
    let encoding = encoding.ok_or_else(|| syntax("names no format".into()))?;
    Ok(Header {
        encoding,
        elements,
        length: start,
    })
}
