//! Bytes -> [`Mesh`]: STL, OBJ, PLY and binary glTF.
//!
//! What says how a surface looks (colours, materials, textures) is not read, and neither is any other file that one of these names.
//! Numbers are taken as they are, as mm in the patient's space; whoever means something else gives the mesh a pose.

use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};

use glam::{Mat4, Vec3};
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{Property, PropertyAccess, PropertyAccessResult};

use super::{Mesh, MeshError};

/// A file format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeshFormat {
    /// Text or binary; triangles are flat.
    Stl,
    /// Polygons with more than three corners are cut into triangles.
    Obj,
    /// The same; text or binary.
    Ply,
    /// glTF 2.0, binary, with all that it needs in the file: the meshes of its scene, at the poses of their nodes.
    Glb,
}

impl MeshFormat {
    /// Every one.
    pub const ALL: [Self; 4] = [Self::Stl, Self::Obj, Self::Ply, Self::Glb];

    /// The name used by the API.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Stl => "stl",
            Self::Obj => "obj",
            Self::Ply => "ply",
            Self::Glb => "glb",
        }
    }

    /// The media type (PLY has none of its own; this is what it is called).
    pub const fn media_type(self) -> &'static str {
        match self {
            Self::Stl => "model/stl",
            Self::Obj => "model/obj",
            Self::Ply => "model/ply",
            Self::Glb => "model/gltf-binary",
        }
    }
}

/// The format that bytes look like: STL, where they look like none of the others.
pub fn sniff(bytes: &[u8]) -> MeshFormat {
    let has_line = |start: &str| {
        std::str::from_utf8(bytes).is_ok_and(|text| text.lines().any(|line| line.trim_start().starts_with(start)))
    };
    if bytes.starts_with(b"glTF") {
        MeshFormat::Glb
    } else if bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r") {
        MeshFormat::Ply
    } else if !bytes.starts_with(b"solid") && has_line("v ") {
        MeshFormat::Obj
    } else {
        MeshFormat::Stl
    }
}

/// Reads a mesh.
///
/// # Errors
/// Where the bytes are no sound mesh of this format. A reader that panics on them counts as one that says so.
pub fn read(format: MeshFormat, bytes: &[u8]) -> Result<Mesh, MeshError> {
    let reading = || match format {
        MeshFormat::Stl => stl(bytes),
        MeshFormat::Obj => obj(bytes),
        MeshFormat::Ply => ply(bytes),
        MeshFormat::Glb => glb(bytes),
    };
    let outcome = catch_unwind(AssertUnwindSafe(reading));
    let found = outcome.unwrap_or_else(|_| Err(Failure::Read("the file cannot be read".into())));
    let Parts { positions, normals, triangles } = found.map_err(|failure| match failure {
        Failure::Read(detail) => MeshError::Malformed { format: format.name(), detail },
        Failure::Mesh(error) => error,
    })?;
    Mesh::new(positions, normals, triangles)
}

/// What a file holds.
#[derive(Default)]
struct Parts {
    positions: Vec<Vec3>,
    /// Empty, or as many.
    normals: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
}

enum Failure {
    Read(String),
    Mesh(MeshError),
}

/// What a crate says.
impl<E: std::error::Error> From<E> for Failure {
    fn from(error: E) -> Self {
        Self::Read(error.to_string())
    }
}

impl Parts {
    /// A convex polygon, as a fan.
    fn add_polygon(&mut self, corners: &[u32]) -> Result<(), Failure> {
        for pair in corners.windows(2).skip(1) {
            self.triangles.push([corners[0], pair[0], pair[1]]);
        }
        self.room(0, 0)
    }

    /// Whether so many more may be, before memory is taken for them.
    fn room(&self, vertices: usize, triangles: usize) -> Result<(), Failure> {
        Mesh::room(self.positions.len() + vertices, self.triangles.len() + triangles).map_err(Failure::Mesh)
    }
}

/// Triangles keep corners of their own, so that each is flat. A file's normals are often zero; the corners tell them too.
fn stl(bytes: &[u8]) -> Result<Parts, Failure> {
    let mut parts = Parts::default();
    let mut cursor = Cursor::new(bytes);
    for triangle in stl_io::create_stl_reader(&mut cursor)? {
        let first = parts.positions.len() as u32;
        parts.positions.extend(triangle?.vertices.map(|vertex| Vec3::from(vertex.0)));
        parts.add_polygon(&[first, first + 1, first + 2])?;
    }
    Ok(parts)
}

fn obj(bytes: &[u8]) -> Result<Parts, Failure> {
    // Polygons as they are: a fan is made of each here. What is not a surface is left out.
    let options =
        tobj::LoadOptions { single_index: true, ignore_points: true, ignore_lines: true, ..Default::default() };
    let no_materials = |_: &std::path::Path| Ok(Default::default());
    let (models, _) = tobj::load_obj_buf(&mut Cursor::new(bytes), &options, no_materials)?;
    let mut parts = Parts::default();
    let with_normals = models.iter().all(|model| model.mesh.normals.len() == model.mesh.positions.len());
    for tobj::Model { mesh, .. } in models {
        let first = parts.positions.len() as u32;
        let vectors = |numbers: &[f32]| numbers.chunks_exact(3).map(Vec3::from_slice).collect::<Vec<_>>();
        parts.positions.extend(vectors(&mesh.positions));
        if with_normals {
            parts.normals.extend(vectors(&mesh.normals));
        }
        let corners: Vec<u32> = mesh.indices.iter().map(|index| first.saturating_add(*index)).collect();
        let mut rest = &corners[..];
        // No counts: triangles all.
        let counts = if mesh.face_arities.is_empty() { vec![3; corners.len() / 3] } else { mesh.face_arities };
        for count in counts {
            let (polygon, others) = rest.split_at_checked(count as usize).unwrap_or((rest, &[]));
            parts.add_polygon(polygon)?;
            rest = others;
        }
    }
    Ok(parts)
}

/// An element of a PLY file: a vertex, a face, or one that is of no use here.
#[derive(Default)]
struct Element {
    position: Vec3,
    normal: Vec3,
    corners: Vec<u32>,
}

impl PropertyAccess for Element {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        let place = match name {
            "x" => &mut self.position.x,
            "y" => &mut self.position.y,
            "z" => &mut self.position.z,
            "nx" => &mut self.normal.x,
            "ny" => &mut self.normal.y,
            "nz" => &mut self.normal.z,
            "vertex_indices" | "vertex_index" => {
                let Some(corners) = property.to_u32_list() else { return PropertyAccessResult::UnsupportedType };
                self.corners = corners;
                return PropertyAccessResult::Set;
            }
            _ => return PropertyAccessResult::Ignored,
        };
        let Some(number) = property.to_f32_lossy() else { return PropertyAccessResult::UnsupportedType };
        *place = number;
        PropertyAccessResult::Set
    }
}

fn ply(bytes: &[u8]) -> Result<Parts, Failure> {
    let parser = Parser::<Element>::new();
    let mut reader = Reader::new(Cursor::new(bytes));
    let header = parser.read_header(&mut reader)?;
    let mut parts = Parts::default();
    for (name, element) in &header.elements {
        // Of whatever kind they are, each takes memory.
        parts.room(element.count, 0)?;
        let elements = parser.read_payload_for_element(&mut reader, element, &header)?;
        match name.as_str() {
            "vertex" => {
                parts.positions = elements.iter().map(|vertex| vertex.position).collect();
                if element.properties.contains_key("nx") {
                    parts.normals = elements.iter().map(|vertex| vertex.normal).collect();
                }
            }
            "face" => elements.iter().try_for_each(|face| parts.add_polygon(&face.corners))?,
            _ => {}
        }
    }
    Ok(parts)
}

fn glb(bytes: &[u8]) -> Result<Parts, Failure> {
    let gltf = gltf::Gltf::from_slice(bytes)?;
    let blob = gltf.blob.as_deref();
    let scene = gltf.default_scene().or_else(|| gltf.scenes().next());
    let scene = scene.ok_or_else(|| Failure::Read("expected a scene".into()))?;
    let mut parts = Parts::default();
    let mut with_normals = true;
    let mut nodes: Vec<_> = scene.nodes().map(|node| (node, Mat4::IDENTITY)).collect();
    // Of a forest each is met once; what is no forest may have no end.
    let mut left = gltf.nodes().len();
    while let Some((node, parent)) = nodes.pop() {
        left = left.checked_sub(1).ok_or_else(|| Failure::Read("expected nodes with one parent each".into()))?;
        let pose = parent * Mat4::from_cols_array_2d(&node.transform().matrix());
        nodes.extend(node.children().map(|child| (child, pose)));
        for primitive in node.mesh().iter().flat_map(gltf::Mesh::primitives) {
            if primitive.mode() != gltf::mesh::Mode::Triangles {
                let detail = format!("expected triangles, got {:?}", primitive.mode());
                return Err(Failure::Read(detail));
            }
            // Any number of primitives may share an accessor, and one may stand for any number of zeros.
            let vertices = primitive.get(&gltf::Semantic::Positions).map_or(0, |accessor| accessor.count());
            let corners = primitive.indices().map_or(vertices, |accessor| accessor.count());
            parts.room(vertices, corners / 3)?;
            let reader = primitive.reader(|buffer| match buffer.source() {
                gltf::buffer::Source::Bin => blob,
                gltf::buffer::Source::Uri(_) => None,
            });
            let positions = reader.read_positions();
            let positions = positions.ok_or_else(|| Failure::Read("expected positions within the file".into()))?;
            let first = parts.positions.len() as u32;
            parts.positions.extend(positions.map(|position| pose.transform_point3(position.into())));
            let added = parts.positions.len() - first as usize;
            match reader.read_normals() {
                Some(normals) => {
                    let turn = glam::Mat3::from_mat4(pose).inverse().transpose();
                    parts.normals.extend(normals.map(|normal| turn * Vec3::from(normal)).take(added));
                }
                None => with_normals = false,
            }
            let corners: Vec<u32> = match reader.read_indices() {
                Some(indices) => indices.into_u32().map(|index| first.saturating_add(index)).collect(),
                None => (first..first + added as u32).collect(),
            };
            parts.triangles.extend(corners.chunks_exact(3).map(|corners| [corners[0], corners[1], corners[2]]));
        }
    }
    if !with_normals || parts.normals.len() != parts.positions.len() {
        parts.normals.clear();
    }
    Ok(parts)
}
