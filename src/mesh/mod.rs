//! Meshes: opaque surfaces of triangles that stand in a volume's space.

pub mod formats;

use glam::{Vec3, Vec3A};

/// Triangles with a normal at each corner. Sound: every number is finite, every index names a vertex.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    positions: Vec<Vec3>,
    /// One for each position; of any length, zero where there is none.
    normals: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
}

/// Why there is no mesh.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MeshError {
    /// The file is not what it says it is.
    #[error("{format}: {detail}")]
    Malformed { format: &'static str, detail: String },
    #[error("expected at least one triangle, got none")]
    Empty,
    #[error("expected at most {limit} {what}, got {got} or more")]
    TooMany { what: &'static str, limit: usize, got: usize },
    #[error("triangle {triangle} names vertex {vertex}, and there are {vertices}")]
    NoSuchVertex { triangle: usize, vertex: u32, vertices: usize },
    #[error("vertex {vertex} is not at a finite place")]
    NotFinite { vertex: usize },
}

impl Mesh {
    /// Triangles at most.
    pub const MAX_TRIANGLES: usize = 1_000_000;
    /// Vertices at most: each triangle may have its own.
    pub const MAX_VERTICES: usize = 3 * Self::MAX_TRIANGLES;

    /// From positions (mm), normals (empty: each vertex gets the mean of its triangles' by their areas) and triangles.
    ///
    /// # Errors
    /// Where that is not a sound mesh with at least one triangle.
    ///
    /// # Panics
    /// With normals, but not one for each position.
    pub fn new(positions: Vec<Vec3>, normals: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Result<Self, MeshError> {
        assert!(normals.is_empty() || normals.len() == positions.len(), "a normal for each position");
        if triangles.is_empty() {
            return Err(MeshError::Empty);
        }
        Self::room(positions.len(), triangles.len())?;
        let vertices = positions.len();
        for (triangle, corners) in triangles.iter().enumerate() {
            if let Some(&vertex) = corners.iter().find(|vertex| **vertex as usize >= vertices) {
                return Err(MeshError::NoSuchVertex { triangle, vertex, vertices });
            }
        }
        let is_finite = |(position, normal): (&Vec3, Option<&Vec3>)| {
            position.is_finite() && normal.is_none_or(|normal| normal.is_finite())
        };
        if let Some(vertex) = (0..vertices).find(|&n| !is_finite((&positions[n], normals.get(n)))) {
            return Err(MeshError::NotFinite { vertex });
        }
        let mut mesh = Self { positions, normals, triangles };
        if mesh.normals.is_empty() {
            mesh.normals = mesh.mean_normals();
        }
        Ok(mesh)
    }

    /// Whether so many vertices and triangles may be: of a mesh, and of all in one frame.
    ///
    /// # Errors
    /// [`MeshError::TooMany`].
    pub fn room(vertices: usize, triangles: usize) -> Result<(), MeshError> {
        let counts = [("vertices", Self::MAX_VERTICES, vertices), ("triangles", Self::MAX_TRIANGLES, triangles)];
        match counts.into_iter().find(|(_, limit, got)| got > limit) {
            Some((what, limit, got)) => Err(MeshError::TooMany { what, limit, got }),
            None => Ok(()),
        }
    }

    /// mm, in the mesh's own space.
    pub fn positions(&self) -> &[Vec3] {
        &self.positions
    }

    /// One for each position; of any length, zero where there is none.
    pub fn normals(&self) -> &[Vec3] {
        &self.normals
    }

    /// Which positions, counted from 0.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// The smallest box along the axes that holds it: its least and its greatest corner.
    pub fn bounds(&self) -> [Vec3; 2] {
        let fold = |first: f32, of: fn(Vec3, Vec3) -> Vec3| {
            self.positions.iter().fold(Vec3::splat(first), |all, position| of(all, *position))
        };
        [fold(f32::INFINITY, Vec3::min), fold(f32::NEG_INFINITY, Vec3::max)]
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> u64 {
        (size_of_val(&*self.positions) + size_of_val(&*self.normals) + size_of_val(&*self.triangles)) as u64
    }

    /// A cross product is as long as twice the triangle's area.
    fn mean_normals(&self) -> Vec<Vec3> {
        let mut normals = vec![Vec3A::ZERO; self.positions.len()];
        for corners in &self.triangles {
            let [a, b, c] = corners.map(|vertex| Vec3A::from(self.positions[vertex as usize]));
            let normal = (b - a).cross(c - a);
            // Corners that are very far apart have none.
            if normal.is_finite() {
                corners.iter().for_each(|vertex| normals[*vertex as usize] += normal);
            }
        }
        let unit = |normal: Vec3A| Vec3::from(normal.normalize_or_zero());
        normals.into_iter().map(unit).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: [Vec3; 4] = [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y];

    #[test]
    fn what_is_no_mesh_is_refused() {
        let made = |positions: &[Vec3], triangles: &[[u32; 3]]| {
            Mesh::new(positions.to_vec(), vec![], triangles.to_vec()).unwrap_err()
        };
        assert_eq!(made(&SQUARE, &[]), MeshError::Empty);
        let wrong = MeshError::NoSuchVertex { triangle: 1, vertex: 4, vertices: 4 };
        assert_eq!(made(&SQUARE, &[[0, 1, 2], [0, 4, 1]]), wrong);
        assert_eq!(made(&[Vec3::X, Vec3::NAN, Vec3::Y], &[[0, 1, 2]]), MeshError::NotFinite { vertex: 1 });
        let many = vec![[0, 1, 2]; Mesh::MAX_TRIANGLES + 1];
        let too_many = MeshError::TooMany { what: "triangles", limit: Mesh::MAX_TRIANGLES, got: many.len() };
        assert_eq!(made(&SQUARE, &many), too_many);
    }

    #[test]
    fn vertices_without_normals_get_their_triangles() {
        // A square, and at one of its edges a wall of half its size.
        let positions = [&SQUARE[..], &[Vec3::new(0.0, 0.0, 1.0)]].concat();
        let mesh = Mesh::new(positions, vec![], vec![[0, 1, 2], [0, 2, 3], [0, 4, 1]]).unwrap();
        let normals = mesh.normals();
        assert_eq!((normals[2], normals[3], normals[4]), (Vec3::Z, Vec3::Z, Vec3::Y));
        assert!((normals[0] - Vec3::new(0.0, 1.0, 2.0).normalize()).length() < 1e-6);
        assert_eq!(mesh.bounds(), [Vec3::ZERO, Vec3::ONE]);
        // Far apart, and all in one place.
        let far = [Vec3::X * 3e38, Vec3::Y * 3e38, Vec3::ZERO].to_vec();
        assert!(Mesh::new(far, vec![], vec![[0, 1, 2]]).unwrap().normals().iter().all(|n| n.is_finite()));
        assert_eq!(Mesh::new(vec![Vec3::X; 3], vec![], vec![[0, 1, 2]]).unwrap().normals()[0], Vec3::ZERO);
    }
}
