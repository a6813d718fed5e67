//! Wavefront OBJ: `v`, `vt`, `vn` and `f`, read raw (no axes are turned), polygons as triangles; all else is passed over.

use std::collections::HashMap;

use glam::{Vec2, Vec3};
use render::mesh::Mesh;

use super::{MAX_VERTICES, MeshParseError, raw::RawMesh};

/// Parses an OBJ file; all its objects and groups become one mesh.
pub fn parse_obj(bytes: &[u8]) -> Result<Mesh, MeshParseError> {
    let text = String::from_utf8_lossy(bytes);
    let mut obj = Obj::default();
    let mut lines = text.lines().enumerate();
    while let Some((number, line)) = lines.next() {
        let syntax =
            |reason: String| MeshParseError::Syntax(format!("line {}: {reason}", number + 1));
        let mut joined = String::new();
        let mut line = without_comment(line);
        // A backslash at the end continues a line, but not a comment: that may be the path of a folder.
        while let Some(start) = line.trim_end().strip_suffix('\\') {
            joined.push_str(start);
            joined.push(' ');
            line = lines.next().map_or("", |(_, next)| without_comment(next));
        }
        joined.push_str(line);
        let mut words = joined.split_whitespace();
        match words.next() {
            Some("v") => {
                let position = Vec3::from_array(numbers(words).map_err(syntax)?);
                push(&mut obj.positions, position, "vertices", MAX_VERTICES)?;
            }
            Some("vn") => {
                let normal = Vec3::from_array(numbers(words).map_err(syntax)?);
                push(&mut obj.normals, normal, "normals", MAX_VERTICES)?;
            }
            Some("vt") => {
                let [u] = numbers(words.clone()).map_err(syntax)?;
                // One-dimensional textures have no v.
                let v = numbers(words).map_or(0.0, |[_, v]| v);
                let uv = Vec2::new(u, 1.0 - v);
                push(&mut obj.uvs, uv, "texture coordinates", MAX_VERTICES)?;
            }
            Some("f") => obj.face(words, syntax)?,
            _ => {}
        }
    }
    if obj.raw.faces.is_empty() {
        // Only vertices of faces become vertices of the mesh: those of the file say more.
        let vertices = obj.positions.len();
        return Err(MeshParseError::NoFaces { vertices });
    }
    obj.raw.finish()
}

/// Adds to `values`, which are refused beyond `most`: those that no face names count nowhere else.
fn push<T>(
    values: &mut Vec<T>,
    value: T,
    what: &'static str,
    most: usize,
) -> Result<(), MeshParseError> {
    if values.len() >= most {
        let most = most as u64;
        return Err(MeshParseError::TooLarge { what, most });
    }
    values.push(value);
    Ok(())
}

fn without_comment(line: &str) -> &str {
    line.split('#').next().unwrap_or_default()
}

/// The first `N` words as numbers. NaN and infinity pass: the mesh's check counts them.
fn numbers<'a, const N: usize>(
    mut words: impl Iterator<Item = &'a str>,
) -> Result<[f32; N], String> {
    let mut values = [0.0; N];
    for value in &mut values {
        let word = words
            .next()
            .ok_or_else(|| format!("{N} numbers are expected"))?;
        *value = word
            .parse()
            .map_err(|_| format!("{word:?} is not a number"))?;
    }
    Ok(values)
}

/// OBJ indexes positions, texture coordinates and normals separately; a mesh has one index for all.
#[derive(Default)]
struct Obj {
    positions: Vec<Vec3>,
    uvs: Vec<Vec2>,
    normals: Vec<Vec3>,
    vertices: HashMap<[Option<usize>; 3], u32>,
    raw: RawMesh,
}

impl Obj {
    fn face<'a>(
        &mut self,
        words: impl Iterator<Item = &'a str>,
        syntax: impl Fn(String) -> MeshParseError,
    ) -> Result<(), MeshParseError> {
        let counts = [self.positions.len(), self.uvs.len(), self.normals.len()];
        let mut corners = Vec::new();
        for word in words {
            let mut corner = [None; 3];
            for ((slot, part), count) in corner.iter_mut().zip(word.split('/')).zip(counts) {
                if part.is_empty() {
                    continue;
                }
                let index: i64 = part
                    .parse()
                    .map_err(|_| syntax(format!("{word:?} is not a vertex of a face")))?;
                // Positive indices count from 1, negative ones back from the latest.
                let from_zero = if index < 0 {
                    count as i64 + index
                } else {
                    index - 1
                };
                if !(0..count as i64).contains(&from_zero) {
                    let face = self.raw.faces.len();
                    return Err(MeshParseError::Index {
                        face,
                        index,
                        vertices: count,
                    });
                }
                *slot = Some(from_zero as usize);
            }
            if corner[0].is_none() {
                return Err(syntax(format!("{word:?} names no vertex")));
            }
            corners.push(self.vertex(corner)?);
        }
        if corners.len() < 3 {
            return Err(syntax("a face needs three vertices".into()));
        }
        self.raw.polygon(&corners)
    }

    fn vertex(&mut self, corner: [Option<usize>; 3]) -> Result<u32, MeshParseError> {
        if let Some(&vertex) = self.vertices.get(&corner) {
            return Ok(vertex);
        }
        self.raw.room(1, 0)?;
        let vertex = self.raw.positions.len() as u32;
        // Normals and UVs fall short of one a vertex, and are dropped, when any corner lacks them.
        self.raw
            .positions
            .extend(corner[0].map(|index| self.positions[index]));
        self.raw.uvs.extend(corner[1].map(|index| self.uvs[index]));
        self.raw
            .normals
            .extend(corner[2].map(|index| self.normals[index]));
        self.vertices.insert(corner, vertex);
        Ok(vertex)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_no_face_names_is_refused_beyond_the_most_as_well() {
        let mut values = vec![0.0; 2];
        push(&mut values, 1.0, "normals", 3).unwrap();
        let error = push(&mut values, 1.0, "normals", 3).unwrap_err();
        assert_eq!(values.len(), 3);
        assert!(
            error.to_string().contains("has more than 3 normals"),
            "{error}"
        );
    }
}
