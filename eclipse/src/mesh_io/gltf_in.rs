//! Reading glTF 2.0: every triangle of the default scene, node transforms applied, turned from y up to z up.

use base64::{Engine, prelude::BASE64_STANDARD};
use glam::{Mat3, Mat4, Vec2, Vec3};
use gltf::{
    Document, Node, Primitive, Semantic, buffer,
    json::{
        Path, Root,
        validation::{self, Validate},
    },
    mesh::Mode,
};
use render::mesh::Mesh;

use super::{
    MAX_FILE, MeshParseError,
    gltf_accessor::Buffers,
    raw::{Origins, RawMesh},
};

/// Most values in the JSON of a file, by the brackets and commas before them: a node takes three bytes there, and a hundred times as
/// many once it is read. The JSON's length says less, since buffers may be embedded in it.
const MAX_VALUES: usize = 1 << 22;
/// Faults of a file that are told, where it is many.
const TOLD: usize = 20;
/// Deepest nesting of nodes that is followed.
const MAX_DEPTH: usize = 256;
/// How the names of extensions begin that only concern looks, and that can be done without.
const DISPENSABLE: [&str; 4] = [
    "KHR_materials_",
    "KHR_texture_",
    "KHR_lights_",
    "EXT_texture_",
];
/// Positions, normals and texture coordinates as integers, which are read like floats.
const QUANTIZATION: &str = "KHR_mesh_quantization";
/// A mesh at many places, which the node that shows it lists.
const INSTANCING: &str = "EXT_mesh_gpu_instancing";

/// Parses a self-contained glTF file, binary or JSON (buffers embedded as data URIs).
pub fn parse_glb(bytes: &[u8]) -> Result<Mesh, MeshParseError> {
    parse_gltf(bytes, &mut nothing_else)
}

/// Fetches the buffer of this relative path, of at most so many bytes.
pub type Load<'a> = dyn FnMut(&str, u64) -> Result<Vec<u8>, String> + 'a;

/// No other file, for what must be self-contained.
pub(super) fn nothing_else(uri: &str, _most: u64) -> Result<Vec<u8>, String> {
    Err(format!(
        "its buffer {uri:?} is another file, but a self-contained one is expected"
    ))
}

/// Parses a glTF file, binary or JSON; `load` fetches the buffers that it names by relative path, of at most so many bytes.
///
/// # Errors
/// [`MeshParseError`]; among others for buffers of more than [`MAX_FILE`] bytes together, however small the file that names
/// them again and again.
pub fn parse_gltf(bytes: &[u8], load: &mut Load<'_>) -> Result<Mesh, MeshParseError> {
    let (document, buffers) = open(bytes, load)?;
    Ok(mesh_of(&document, buffers)?.0)
}

/// The checked document and its buffers.
pub(super) fn open(bytes: &[u8], load: &mut Load) -> Result<(Document, Buffers), MeshParseError> {
    let (json, blob) = split_glb(bytes)?;
    let mut root = Root::from_slice(json).map_err(|error| syntax(format!("its JSON: {error}")))?;
    root.extensions_required.retain(|name| {
        let only_looks = DISPENSABLE.iter().any(|prefix| name.starts_with(prefix));
        !only_looks && name != QUANTIZATION
    });
    // Whether it is required or not: the object is where its instances are.
    if root.extensions_used.iter().any(|name| name == INSTANCING) {
        return Err(MeshParseError::NotInPlace {
            what: format!("has instances ({INSTANCING})"),
            remedy: "make them real (in Blender: Object, Apply, Make Instances Real)",
        });
    }
    // Else the library would call a sound file invalid.
    if let Some(name) = root.extensions_required.first() {
        let what = format!("the extension {}", name.escape_debug());
        return Err(MeshParseError::Unsupported(what));
    }
    // The library's validation indexes these unchecked.
    let primitives = root.meshes.iter().flat_map(|mesh| &mesh.primitives);
    let mut accessors = primitives.flat_map(|primitive| primitive.attributes.values());
    if let Some(index) = accessors.find(|index| index.value() >= root.accessors.len()) {
        return Err(syntax(format!(
            "a mesh names accessor {index}, which does not exist"
        )));
    }
    validate(&root)?;
    let document = Document::from_json_without_validation(root);
    let buffers = fetch_all(&document, blob, load, MAX_FILE)?;
    Ok((document, buffers))
}

/// The library's own checks, which take an accessor without data for an error: by the format it holds zeros.
fn validate(root: &Root) -> Result<(), MeshParseError> {
    let (mut told, mut faults) = (Vec::new(), 0);
    root.validate(root, Path::new, &mut |path, error| {
        let path = path();
        let no_data = error == validation::Error::Missing
            && path.as_str().starts_with("accessors[")
            && path.as_str().ends_with("].bufferView");
        if no_data {
            return;
        }
        faults += 1;
        if told.len() < TOLD {
            told.push(format!("{path}: {error}"));
        }
    });
    if faults > told.len() {
        told.push(format!("and {} more", faults - TOLD));
    }
    match told.is_empty() {
        true => Ok(()),
        false => Err(syntax(format!("invalid glTF: {}", told.join("; ")))),
    }
}

/// The triangles of the default scene, and which vertices of its primitives they have.
pub(super) fn mesh_of(
    document: &Document,
    buffers: Buffers,
) -> Result<(Mesh, Origins), MeshParseError> {
    let mut reader = Reader {
        buffers,
        visited: vec![false; document.nodes().count()],
        raw: RawMesh::default(),
    };
    let mut bare = Vec::new();
    match document
        .default_scene()
        .or_else(|| document.scenes().next())
    {
        Some(scene) => scene
            .nodes()
            .try_for_each(|node| reader.node(&node, Mat4::IDENTITY, 0, &mut bare))?,
        // A file without scenes is a library: its meshes are taken as they are.
        None => document.meshes().try_for_each(|mesh| {
            mesh.primitives()
                .try_for_each(|primitive| reader.primitive(&primitive, Mat4::IDENTITY, &mut bare))
        })?,
    }
    let mut raw = reader.raw;
    // Attributes that some primitive lacks cannot be kept for a mesh with one array each.
    let [no_normals, no_uvs] = [0, 1].map(|kind| bare.iter().any(|lacks: &[bool; 2]| lacks[kind]));
    if no_normals {
        raw.normals.clear();
    }
    if no_uvs {
        raw.uvs.clear();
    }
    raw.finish_with_origins()
}

pub(super) fn syntax(reason: String) -> MeshParseError {
    // Names may be of any characters, and messages are one line.
    MeshParseError::Syntax(reason.replace(char::is_control, "\u{fffd}"))
}

/// The JSON and the binary chunk of a GLB file; other files are all JSON. That of more than [`MAX_VALUES`] is refused.
pub(super) fn split_glb(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), MeshParseError> {
    let parts = split(bytes)?;
    let before_values = parts.0.iter().filter(|byte| b"{[,".contains(byte));
    match before_values.count() > MAX_VALUES {
        true => Err(MeshParseError::TooLarge {
            what: "values in its JSON",
            most: MAX_VALUES as u64,
        }),
        false => Ok(parts),
    }
}

fn split(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), MeshParseError> {
    let Some(body) = bytes.strip_prefix(b"glTF") else {
        return Ok((bytes, None));
    };
    let word = |bytes: &[u8], at: usize| -> Option<u32> {
        Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
    };
    if word(body, 0) != Some(2) {
        return Err(MeshParseError::Unsupported(
            "a version of binary glTF other than 2".into(),
        ));
    }
    let declared = word(body, 4).unwrap_or(0) as usize;
    if declared > bytes.len() {
        return Err(syntax(format!(
            "it declares {declared} bytes but has {}",
            bytes.len()
        )));
    }
    let (mut json, mut blob) = (None, None);
    let mut rest = body.get(8..).unwrap_or_default();
    while let (Some(length), Some(kind)) = (word(rest, 0), word(rest, 4)) {
        let Some(chunk) = rest.get(8..8 + length as usize) else {
            return Err(syntax("a chunk of it ends early".into()));
        };
        match &kind.to_le_bytes() {
            b"JSON" => json = json.or(Some(chunk)),
            b"BIN\0" => blob = blob.or(Some(chunk)),
            _ => {}
        }
        rest = &rest[8 + length as usize..];
    }
    Ok((
        json.ok_or_else(|| syntax("it has no JSON chunk".into()))?,
        blob,
    ))
}

/// All buffers, of at most `most` bytes together: a file of a few kilobytes may name one of gigabytes a thousand times.
fn fetch_all(
    document: &Document,
    blob: Option<&[u8]>,
    load: &mut Load,
    most: u64,
) -> Result<Buffers, MeshParseError> {
    let mut left = most;
    let mut buffers = Vec::new();
    for buffer in document.buffers() {
        let rest = |length: usize| {
            left.checked_sub(length as u64)
                .ok_or(MeshParseError::TooLarge {
                    what: "bytes of buffers",
                    most,
                })
        };
        // What is declared is refused before it is read.
        rest(buffer.length())?;
        let data = fetch(&buffer, blob, load, left)?;
        left = rest(data.len())?;
        buffers.push(data);
    }
    Ok(Buffers(buffers))
}

/// The bytes of a buffer, of a file at most `left` of them.
fn fetch(
    buffer: &buffer::Buffer,
    blob: Option<&[u8]>,
    load: &mut Load,
    left: u64,
) -> Result<Vec<u8>, MeshParseError> {
    let data = match buffer.source() {
        // The format has one binary chunk, for the first buffer.
        buffer::Source::Bin if buffer.index() > 0 => {
            return Err(syntax(format!(
                "its buffer {} has no `uri`, which only the first may do without",
                buffer.index()
            )));
        }
        buffer::Source::Bin => blob
            .ok_or_else(|| syntax("it has no binary chunk".into()))?
            .to_vec(),
        buffer::Source::Uri(uri) => match uri.strip_prefix("data:") {
            Some(data) => {
                let encoded = data
                    .split_once(";base64,")
                    .map_or("", |(_, encoded)| encoded);
                BASE64_STANDARD
                    .decode(encoded)
                    .map_err(|error| syntax(format!("an embedded buffer: {error}")))?
            }
            None => load(&percent_decoded(uri), left).map_err(syntax)?,
        },
    };
    if data.len() < buffer.length() {
        return Err(syntax(format!(
            "a buffer has {} bytes where {} are declared",
            data.len(),
            buffer.length()
        )));
    }
    Ok(data)
}

/// `%20` and its like as the characters they stand for.
fn percent_decoded(uri: &str) -> String {
    let mut bytes = Vec::new();
    let mut rest = uri.as_bytes();
    while let [first, tail @ ..] = rest {
        let hex = tail.get(..2).and_then(|hex| std::str::from_utf8(hex).ok());
        let decoded = hex
            .filter(|_| *first == b'%')
            .and_then(|hex| u8::from_str_radix(hex, 16).ok());
        bytes.push(decoded.unwrap_or(*first));
        rest = if decoded.is_some() { &tail[2..] } else { tail };
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

struct Reader {
    buffers: Buffers,
    visited: Vec<bool>,
    raw: RawMesh,
}

impl Reader {
    fn node(
        &mut self,
        node: &Node,
        parent: Mat4,
        depth: usize,
        bare: &mut Vec<[bool; 2]>,
    ) -> Result<(), MeshParseError> {
        // The format demands a tree; a cycle would never end.
        if std::mem::replace(&mut self.visited[node.index()], true) || depth > MAX_DEPTH {
            return Err(syntax(format!(
                "its node {} has two parents, or is nested too deeply",
                node.index()
            )));
        }
        if node.mesh().is_some() && node.skin().is_some() {
            return Err(MeshParseError::NotInPlace {
                what: format!("is moved by bones (its node {} has a skin)", node.index()),
                remedy: "apply the pose (in Blender: Object, Convert, Mesh)",
            });
        }
        let world = parent * Mat4::from_cols_array_2d(&node.transform().matrix());
        for primitive in node.mesh().iter().flat_map(|mesh| mesh.primitives()) {
            self.primitive(&primitive, world, bare)?;
        }
        node.children()
            .try_for_each(|child| self.node(&child, world, depth + 1, bare))
    }

    /// Appends a primitive; `bare` gains whether it lacks normals and texture coordinates.
    fn primitive(
        &mut self,
        primitive: &Primitive,
        world: Mat4,
        bare: &mut Vec<[bool; 2]>,
    ) -> Result<(), MeshParseError> {
        let mode = primitive.mode();
        let Some(positions) = primitive.get(&Semantic::Positions) else {
            return Ok(());
        };
        if !matches!(
            mode,
            Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan
        ) {
            return Ok(());
        }
        let base = self.raw.positions.len();
        let count = positions.count();
        let corners = primitive.indices().map_or(count, |indices| indices.count());
        let faces = match mode {
            Mode::Triangles => corners / 3,
            _ => corners.saturating_sub(2),
        };
        // Nodes and primitives may share their data, so that a small file can ask for any number of faces.
        for accessor in [Some(&positions), primitive.indices().as_ref()]
            .into_iter()
            .flatten()
        {
            self.buffers.check(accessor)?;
        }
        self.raw.room(count, faces)?;
        let positions = self.buffers.floats::<3>(&positions)?;
        let indices = match primitive.indices() {
            Some(accessor) => self.buffers.indices(&accessor)?,
            None => (0..count as u32).collect(),
        };
        let normals = primitive.get(&Semantic::Normals);
        let uvs = primitive.get(&Semantic::TexCoords(0));
        for other in [&normals, &uvs].into_iter().flatten() {
            let other = other.count();
            if other != count {
                return Err(syntax(format!(
                    "a mesh has {count} positions but {other} normals or texture coordinates"
                )));
            }
        }
        let normals = normals
            .map(|accessor| self.buffers.floats::<3>(&accessor))
            .transpose()?;
        let uvs = uvs
            .map(|accessor| self.buffers.floats::<2>(&accessor))
            .transpose()?;
        let linear = Mat3::from_mat4(world);
        // The cofactor matrix: the inverse transpose up to a positive scale, and defined for singular transforms too.
        let cofactor = Mat3::from_cols(
            linear.y_axis.cross(linear.z_axis),
            linear.z_axis.cross(linear.x_axis),
            linear.x_axis.cross(linear.y_axis),
        );
        let mirrored = linear.determinant() < 0.0;
        let sign = if mirrored { -1.0 } else { 1.0 };
        bare.push([normals.is_none(), uvs.is_none()]);
        self.raw.positions.extend(
            positions
                .iter()
                .map(|&p| z_up(world.transform_point3(p.into()))),
        );
        self.raw.normals.extend(
            normals
                .iter()
                .flatten()
                .map(|&n| z_up(sign * (cofactor * Vec3::from(n)))),
        );
        self.raw
            .uvs
            .extend(uvs.iter().flatten().map(|&uv| Vec2::from(uv)));
        let triangles: Vec<[u32; 3]> = match mode {
            Mode::Triangles => indices.as_chunks::<3>().0.to_vec(),
            Mode::TriangleFan => indices
                .windows(2)
                .skip(1)
                .map(|pair| [indices[0], pair[0], pair[1]])
                .collect(),
            // Every second triangle of a strip is wound the other way.
            _ => indices
                .windows(3)
                .enumerate()
                .map(|(i, t)| {
                    if i % 2 == 0 {
                        [t[0], t[1], t[2]]
                    } else {
                        [t[1], t[0], t[2]]
                    }
                })
                .collect(),
        };
        for [a, b, c] in triangles {
            let face = if mirrored { [a, c, b] } else { [a, b, c] };
            if let Some(&index) = face.iter().find(|&&index| index as usize >= count) {
                let face = self.raw.faces.len();
                return Err(MeshParseError::Index {
                    face,
                    index: index.into(),
                    vertices: count,
                });
            }
            self.raw.faces.push(face.map(|index| index + base as u32));
        }
        Ok(())
    }
}

/// From glTF's y up to z up: (x, y, z) here is (x, z, −y) there.
fn z_up(v: Vec3) -> Vec3 {
    Vec3::new(v.x, -v.z, v.y)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn document(json: &str) -> Document {
        Document::from_json(Root::from_slice(json.as_bytes()).unwrap()).unwrap()
    }

    fn message<T>(result: Result<T, MeshParseError>) -> String {
        result.err().expect("a file that is refused").to_string()
    }

    #[test]
    fn only_the_first_buffer_is_the_binary_chunk() {
        let json = r#"{"asset":{"version":"2.0"},"buffers":[{"byteLength":4},{"byteLength":4}]}"#;
        let found = fetch_all(&document(json), Some(b"four"), &mut nothing_else, 100);
        let found = message(found);
        assert!(found.contains("its buffer 1 has no `uri`"), "{found}");
    }

    #[test]
    fn one_file_that_is_named_many_times_counts_as_often() {
        let buffer = r#"{"byteLength":30,"uri":"large.bin"}"#;
        let json = format!(
            r#"{{"asset":{{"version":"2.0"}},"buffers":[{buffer},{buffer},{buffer},{buffer}]}}"#
        );
        let mut asked = Vec::new();
        let mut load = |_: &str, most: u64| {
            asked.push(most);
            Ok(vec![0; 40])
        };
        let found = message(fetch_all(&document(&json), None, &mut load, 100));
        // The third would have room by what it declares, were the file no longer than that.
        assert_eq!(asked, [100, 60]);
        assert!(
            found.contains("has more than 100 bytes of buffers"),
            "{found}"
        );

        let json = r#"{"asset":{"version":"2.0"},"buffers":[{"byteLength":5,"uri":"small.bin"}]}"#;
        let found = fetch_all(&document(json), None, &mut |_, _| Ok(vec![0; 7]), 6);
        assert!(message(found).contains("has more than 6 bytes of buffers"));
        let found = fetch_all(&document(json), None, &mut |_, _| Ok(vec![0; 7]), 7).unwrap();
        assert_eq!(found.0, [[0; 7]]);
    }
}
