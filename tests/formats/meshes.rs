//! Meshes of every format: a square of two triangles, written here byte by byte, and what becomes of files that lie.

use glam::Vec3;
use proptest::prelude::*;
use shearwarp::mesh::formats::{MeshFormat, read, sniff};
use shearwarp::mesh::{Mesh, MeshError};

const CORNERS: [[f32; 3]; 4] = [[0.0, 0.0, 5.0], [2.0, 0.0, 5.0], [2.0, 3.0, 5.0], [0.0, 3.0, 5.0]];
const TRIANGLES: [[usize; 3]; 2] = [[0, 1, 2], [0, 2, 3]];

fn stl() -> Vec<u8> {
    let mut bytes = vec![b' '; 80];
    bytes.extend(2u32.to_le_bytes());
    for corners in TRIANGLES {
        bytes.extend([0; 12]);
        bytes.extend(corners.iter().flat_map(|n| CORNERS[*n]).flat_map(f32::to_le_bytes));
        bytes.extend([0; 2]);
    }
    bytes
}

fn stl_as_text() -> Vec<u8> {
    let mut text = "solid square\n".to_owned();
    for corners in TRIANGLES {
        text += "facet normal 0 0 1\nouter loop\n";
        for [x, y, z] in corners.map(|n| CORNERS[n]) {
            text += &format!("vertex {x} {y} {z}\n");
        }
        text += "endloop\nendfacet\n";
    }
    (text + "endsolid square\n").into_bytes()
}

/// One polygon of four corners, with a normal, texture and material that nobody has.
fn obj() -> Vec<u8> {
    let vertices: String = CORNERS.iter().map(|[x, y, z]| format!("v {x} {y} {z}\n")).collect();
    format!("# square\nmtllib none.mtl\n{vertices}vn 0 0 2\nvt 0 0\nusemtl none\nf 1/1/1 2/1/1 3/1/1 4/1/1\n")
        .into_bytes()
}

fn ply_header(format: &str, faces: usize) -> String {
    format!(
        "ply\nformat {format} 1.0\ncomment a square\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\n\
         element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
    )
}

fn ply_as_text() -> Vec<u8> {
    let vertices: String = CORNERS.iter().map(|[x, y, z]| format!("{x} {y} {z} 200\n")).collect();
    (ply_header("ascii", 1) + &vertices + "4 0 1 2 3\n").into_bytes()
}

fn ply() -> Vec<u8> {
    let mut bytes = ply_header("binary_big_endian", 2).into_bytes();
    for corner in CORNERS {
        bytes.extend(corner.iter().flat_map(|n| n.to_be_bytes()).chain([200]));
    }
    for corners in TRIANGLES {
        bytes.extend([3].into_iter().chain(corners.iter().flat_map(|n| (*n as i32).to_be_bytes())));
    }
    bytes
}

/// A binary glTF of these nodes, of which the first is the scene's; mesh 0 is the square.
fn glb(nodes: &str, uri: &str) -> Vec<u8> {
    glb_of_nodes("0", nodes, uri)
}

fn glb_of_nodes(of_scene: &str, nodes: &str, uri: &str) -> Vec<u8> {
    let mut binary: Vec<u8> = CORNERS.iter().flatten().flat_map(|n| n.to_le_bytes()).collect();
    binary.extend(TRIANGLES.iter().flatten().flat_map(|n| (*n as u16).to_le_bytes()));
    let length = binary.len();
    let mut json = format!(
        r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [{of_scene}]}}], "nodes": [{nodes}],
        "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}, "indices": 1}}]}}],
        "buffers": [{{{uri}"byteLength": {length}}}],
        "bufferViews": [{{"buffer": 0, "byteLength": 48}}, {{"buffer": 0, "byteOffset": 48, "byteLength": 12}}],
        "accessors": [
            {{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 5], "max": [2, 3, 5]}},
            {{"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"}}
        ]}}"#
    )
    .into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let chunk = |kind: &[u8; 4], data: &[u8]| [&(data.len() as u32).to_le_bytes()[..], kind, data].concat();
    let chunks = [chunk(b"JSON", &json), chunk(b"BIN\0", &binary)].concat();
    [b"glTF", &2u32.to_le_bytes()[..], &(12 + chunks.len() as u32).to_le_bytes(), &chunks].concat()
}

fn files() -> Vec<(MeshFormat, Vec<u8>)> {
    vec![
        (MeshFormat::Stl, stl()),
        (MeshFormat::Stl, stl_as_text()),
        (MeshFormat::Obj, obj()),
        (MeshFormat::Ply, ply_as_text()),
        (MeshFormat::Ply, ply()),
        (MeshFormat::Glb, glb(r#"{"mesh": 0}"#, "")),
    ]
}

/// Triangles as places.
fn places(mesh: &Mesh) -> Vec<[[f32; 3]; 3]> {
    mesh.triangles().iter().map(|corners| corners.map(|n| mesh.positions()[n as usize].to_array())).collect()
}

#[test]
fn every_format_has_the_square() {
    for (format, bytes) in files() {
        assert_eq!(sniff(&bytes), format);
        let mesh = read(format, &bytes).unwrap_or_else(|error| panic!("{format:?}: {error}"));
        assert_eq!(places(&mesh), TRIANGLES.map(|corners| corners.map(|n| CORNERS[n])), "{format:?}");
        assert!(mesh.normals().iter().all(|normal| normal.normalize() == Vec3::Z), "{format:?}: {:?}", mesh.normals());
        let own_corners = if format == MeshFormat::Stl { 6 } else { 4 };
        assert_eq!(mesh.positions().len(), own_corners, "{format:?}");
    }
}

#[test]
fn the_nodes_of_a_scene_have_poses() {
    // Twice as large and moved along x; its child is turned about x, y up to z.
    let nodes = r#"{"scale": [2, 2, 2], "translation": [10, 0, 0], "children": [1]}, {"mesh": 0, "rotation": [0.70710678, 0, 0, 0.70710678]}"#;
    let mesh = read(MeshFormat::Glb, &glb(nodes, "")).unwrap();
    let third = mesh.positions()[2];
    assert!((third - Vec3::new(14.0, -10.0, 6.0)).length() < 1e-4, "{third}");
    for (nodes, uri, detail) in [
        (r#"{"mesh": 0, "children": [0]}"#, "", "one parent"),
        (r#"{"mesh": 0}"#, r#""uri": "/etc/passwd", "#, "within the file"),
    ] {
        let refused = read(MeshFormat::Glb, &glb(nodes, uri)).unwrap_err().to_string();
        assert!(refused.contains(detail), "{refused}");
    }
}

#[test]
fn what_is_no_mesh_is_said_to_be_none() {
    let text = |text: &str| text.as_bytes().to_vec();
    let lying = [stl()[..80].to_vec(), u32::MAX.to_le_bytes().to_vec(), stl()[84..].to_vec()].concat();
    for (format, bytes) in [
        (MeshFormat::Stl, lying),
        (MeshFormat::Ply, text("plyplay")),
        (MeshFormat::Obj, text("v 1 2\n")),
        (MeshFormat::Glb, text("glTF")),
        (MeshFormat::Glb, stl()),
    ] {
        let refused = read(format, &bytes).unwrap_err();
        assert!(matches!(refused, MeshError::Malformed { .. }), "{format:?}: {refused}");
    }
    // Numbers that no file of this size holds are refused before memory is taken: elements, and one accessor that many nodes share.
    let count = 30_000_000;
    let lying = [ply_header("binary_little_endian", count).as_bytes(), &[0; 52]].concat();
    let many = read(MeshFormat::Ply, &lying).unwrap_err();
    assert_eq!(many, MeshError::TooMany { what: "vertices", limit: Mesh::MAX_VERTICES, got: count + 4 });
    let nodes = vec![r#"{"mesh": 0}"#; 750_001].join(", ");
    let all: Vec<_> = (0..750_001).map(|n| n.to_string()).collect();
    let shared = glb_of_nodes(&all.join(", "), &nodes, "");
    assert!(matches!(read(MeshFormat::Glb, &shared), Err(MeshError::TooMany { .. })));
    assert_eq!(read(MeshFormat::Obj, b"# nothing\n").unwrap_err(), MeshError::Empty);
    assert_eq!(
        read(MeshFormat::Obj, b"v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n").unwrap_err(),
        MeshError::NotFinite { vertex: 2 }
    );
}

proptest! {
    #[test]
    fn files_that_end_early_or_are_damaged_are_read_or_refused(
        which in 0..6usize, end in 0.0..1.0, damage in prop::collection::vec((0.0..1.0, any::<u8>()), 0..6),
    ) {
        let (format, mut bytes) = files().swap_remove(which);
        for (at, value) in damage {
            let at = (at * bytes.len() as f64) as usize;
            bytes[at] = value;
        }
        let cut = &bytes[..(end * bytes.len() as f64) as usize];
        // A panic would end the test.
        let _ = (read(format, cut), read(format, &bytes), read(sniff(&bytes), &bytes));
    }
}
