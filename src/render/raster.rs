//! Meshes in a view: which triangle each pixel's ray meets first, and how it is lit.
//!
//! With a triangle's corners told in the pixels' homogeneous coordinates (Olano and Greer 1997), the place where a pixel's ray
//! passes its plane has barycentric coordinates that are linear in the pixel's, in perspective too. So nothing is clipped
//! where a triangle reaches behind the eye. An edge's function is the cross product of its ends, whose sign
//! alone turns with their order: of two triangles that share an edge each pixel is exactly one's.
//!
//! Like the client's own scene (`depth`), meshes end the volume's rays, and their picture is behind it.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec2, DVec3};
use rayon::prelude::*;

use super::depth::SceneDepth;
use super::lighting::{AxialDepth, lit};
use super::view::Rays;
use super::{Cancel, Image, RenderError, Settings, View};
use crate::mesh::Mesh;
use crate::volume::Volume;

/// Rows that one job fills.
const BAND_HEIGHT: usize = 16;

/// A mesh in the world.
#[derive(Clone, Debug)]
pub struct Solid {
    pub mesh: Arc<Mesh>,
    /// World mm from the mesh's own; with an inverse.
    pub world_from_mesh: DAffine3,
    /// Red, green, blue, 0..=1; under the frame's lights, where it has any.
    pub color: [f32; 3],
}

/// What a view sees of meshes.
#[derive(Debug)]
pub struct Drawn {
    /// Of the meshes, and of what ended the view's rays before: the nearer of both.
    pub depth: SceneDepth,
    /// Over the background: transparent where that is.
    pub picture: Image,
}

/// Draws `solids` as `view` sees them, lit and faded as the settings say for `volume`. Neither clip regions nor near and far planes cut
/// them; what ends the view's rays ([`View::depth`]) hides what of them is behind it.
///
/// # Errors
/// [`RenderError::Cancelled`].
pub fn draw(
    solids: &[Solid],
    view: &View,
    volume: &Volume,
    settings: &Settings,
    cancel: &Cancel,
) -> Result<Drawn, RenderError> {
    let (width, height) = view.size();
    let size = [width as usize, height as usize];
    let placed: Vec<_> = solids.iter().map(|solid| Placed::new(solid, view)).collect();
    let mut visible = vec![];
    for (solid, placed) in placed.iter().enumerate() {
        if cancel.is_cancelled() {
            return Err(RenderError::Cancelled);
        }
        visible.extend(placed.rows(size).into_iter().map(|(triangle, rows)| (solid as u32, triangle, rows)));
    }
    let cue = settings.depth_cueing.map(|cueing| (cueing, AxialDepth::new(view, volume)));
    let shade = |hit: &Hit, at: DVec2| {
        let ray = view.ray(at);
        let (placed, solid) = (&placed[hit.solid as usize], &solids[hit.solid as usize]);
        let mut color = DVec3::from_array(solid.color.map(f64::from));
        if let Some(shading) = &settings.shading {
            color = lit(color, placed.normal(hit), -ray.direction, shading, 1.0);
        }
        if let Some((cueing, depth)) = &cue {
            let point = ray.origin + ray.direction * hit.distance;
            color *= cueing.front * (-cueing.density * depth.of(point)).exp();
        }
        color.to_array().map(|component| (component.clamp(0.0, 1.0) * 255.0).round() as u8)
    };
    let channels = settings.background.channels();
    let ground = settings.background.behind().to_array().map(|component| (component * 255.0).round() as u8);
    let mut distances = match view.depth() {
        Some(scene) => scene.distances(),
        None => vec![f32::INFINITY; size[0] * size[1]],
    };
    let mut pixels = ground[..channels].repeat(size[0] * size[1]);
    let rows = size[0] * BAND_HEIGHT;
    let out = distances.par_chunks_mut(rows).zip(pixels.par_chunks_mut(rows * channels));
    out.enumerate().try_for_each(|(band, (distances, pixels))| {
        let first = band * BAND_HEIGHT;
        let rows = [first as u32, (first + distances.len() / size[0] - 1) as u32];
        let mut hits: Vec<Option<Hit>> = vec![None; distances.len()];
        for &(solid, triangle, _) in visible.iter().filter(|(.., [top, bottom])| *top <= rows[1] && *bottom >= rows[0])
        {
            if cancel.is_cancelled() {
                return Err(RenderError::Cancelled);
            }
            placed[solid as usize].fill(view, (solid, triangle), first, size[0], &mut hits);
        }
        let out = distances.iter_mut().zip(pixels.chunks_exact_mut(channels));
        for (n, (hit, (distance, pixel))) in hits.iter().zip(out).enumerate() {
            let Some(hit) = hit.as_ref().filter(|hit| hit.distance as f32 <= *distance) else { continue };
            *distance = hit.distance as f32;
            pixel[..3].copy_from_slice(&shade(hit, centre(n % size[0], first + n / size[0])));
            if let Some(alpha) = pixel.get_mut(3) {
                *alpha = u8::MAX;
            }
        }
        Ok(())
    })?;
    let picture = Image { width, height, channels: channels as u8, pixels, warp: None };
    Ok(Drawn { depth: SceneDepth::new(view, distances), picture })
}

fn centre(x: usize, y: usize) -> DVec2 {
    DVec2::new(x as f64 + 0.5, y as f64 + 0.5)
}

/// The nearest place that a pixel's ray meets so far.
#[derive(Clone, Copy, Debug)]
struct Hit {
    /// mm along the ray.
    distance: f64,
    solid: u32,
    triangle: u32,
    /// Shares of the corners.
    shares: DVec3,
}

/// A solid as a view has it.
struct Placed<'a> {
    solid: &'a Solid,
    /// Vertices, world mm.
    world: Vec<DVec3>,
    /// The same in homogeneous pixel coordinates; the last is above 0 in front of the eye.
    pixels: Vec<DVec3>,
    world_from_normal: DMat3,
}

impl<'a> Placed<'a> {
    fn new(solid: &'a Solid, view: &View) -> Self {
        let place = |position: &glam::Vec3| solid.world_from_mesh.transform_point3(position.as_dvec3());
        let world: Vec<_> = solid.mesh.positions().par_iter().map(place).collect();
        let pixels = match *view.rays() {
            Rays::Parallel { corner, dx, dy, direction } => {
                let inverse = DMat3::from_cols(dx, dy, direction).inverse();
                let pixel = |point: &DVec3| (inverse * (*point - corner)).truncate().extend(1.0);
                world.par_iter().map(pixel).collect()
            }
            Rays::Perspective { eye, corner, dx, dy } => {
                let inverse = DMat3::from_cols(dx, dy, corner).inverse();
                world.par_iter().map(|point| inverse * (*point - eye)).collect()
            }
        };
        let world_from_normal = solid.world_from_mesh.matrix3.inverse().transpose();
        Self { solid, world, pixels, world_from_normal }
    }

    fn corners(&self, triangle: u32) -> [usize; 3] {
        self.solid.mesh.triangles()[triangle as usize].map(|vertex| vertex as usize)
    }

    /// The triangles that may cover the centres of pixels, with the first and the last of their rows.
    fn rows(&self, [width, height]: [usize; 2]) -> Vec<(u32, [u32; 2])> {
        let rows = |triangle: u32| {
            let [columns, rows] = self.extent(triangle, [width, height])?;
            (columns[0] <= columns[1] && rows[0] <= rows[1]).then_some((triangle, rows.map(|row| row as u32)))
        };
        (0..self.solid.mesh.triangles().len() as u32).into_par_iter().filter_map(rows).collect()
    }

    /// See [`extent`].
    fn extent(&self, triangle: u32, size: [usize; 2]) -> Option<[[usize; 2]; 2]> {
        extent(self.corners(triangle).map(|vertex| self.pixels[vertex]), size)
    }

    /// Draws a triangle into the hits of rows of `width` pixels from `first` on.
    fn fill(&self, view: &View, (solid, triangle): (u32, u32), first: usize, width: usize, hits: &mut [Option<Hit>]) {
        let height = first + hits.len() / width;
        let Some([columns, rows]) = self.extent(triangle, [width, height]) else { return };
        let vertices = self.corners(triangle);
        let [a, b, c] = vertices.map(|vertex| self.pixels[vertex]);
        let edges = [b.cross(c), c.cross(a), a.cross(b)];
        let volume = a.dot(edges[0]);
        if volume == 0.0 || !volume.is_finite() {
            return;
        }
        // Either side is seen.
        let edges = edges.map(|edge| edge * volume.signum());
        for y in rows[0].max(first)..=rows[1] {
            for x in columns[0]..=columns[1] {
                let at = centre(x, y);
                let shares = DVec3::from_array(edges.map(|edge| edge.x * at.x + edge.y * at.y + edge.z));
                if !(0..3).all(|n| shares[n] > 0.0 || shares[n] == 0.0 && owns(edges[n])) {
                    continue;
                }
                let sum = shares.element_sum();
                if sum <= 0.0 {
                    continue;
                }
                let shares = shares / sum;
                let point = (0..3).map(|n| self.world[vertices[n]] * shares[n]).sum::<DVec3>();
                let ray = view.ray(at);
                let distance = (point - ray.origin).dot(ray.direction);
                let hit = &mut hits[(y - first) * width + x];
                if hit.is_none_or(|hit| distance < hit.distance) {
                    *hit = Some(Hit { distance, solid, triangle, shares });
                }
            }
        }
    }

    /// Across the surface, world; zero where the mesh does not say.
    fn normal(&self, hit: &Hit) -> DVec3 {
        let normals = self.solid.mesh.normals();
        let corners = self.corners(hit.triangle);
        let normal = (0..3).map(|n| normals[corners[n]].as_dvec3() * hit.shares[n]).sum::<DVec3>();
        self.world_from_normal * normal
    }
}

/// The first and the last column and row whose centres a triangle may cover, the last before the first where there are none; `None`
/// where all of it is behind the eye. `corners` are homogeneous pixel coordinates.
fn extent(corners: [DVec3; 3], size: [usize; 2]) -> Option<[[usize; 2]; 2]> {
    let is_in_front = |corner: &DVec3| corner.z > 0.0;
    if !corners.iter().any(is_in_front) {
        return None;
    }
    let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    for from in corners.into_iter().filter(is_in_front) {
        let at = from.truncate() / from.z;
        (low, high) = (low.min(at), high.max(at));
        // An edge to behind the eye is seen to run to infinity, towards where it passes the eye's plane.
        for to in corners.into_iter().filter(|corner| !is_in_front(corner)) {
            let towards = to.truncate() * from.z - from.truncate() * to.z;
            low = DVec2::select(towards.cmplt(DVec2::ZERO), DVec2::NEG_INFINITY, low);
            high = DVec2::select(towards.cmpgt(DVec2::ZERO), DVec2::INFINITY, high);
        }
    }
    // A pixel more on either side, for what rounding does.
    let span = |axis: usize| {
        let (first, last) = ((low[axis] - 1.5).ceil().max(0.0), (high[axis] + 0.5).floor());
        if last < 0.0 || first > (size[axis] - 1) as f64 || first.is_nan() || last.is_nan() {
            return [1, 0];
        }
        [first as usize, (last as usize).min(size[axis] - 1)]
    };
    Some([span(0), span(1)])
}

/// Whether pixels on an edge are of the triangle that lies to this side of it.
fn owns(edge: DVec3) -> bool {
    edge.x > 0.0 || edge.x == 0.0 && edge.y > 0.0
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SIZE: [usize; 2] = [60, 50];

    fn corner() -> impl Strategy<Value = DVec3> {
        ([-90.0..150.0f64, -90.0..150.0], -3.0..3.0f64).prop_map(|([x, y], z)| DVec3::new(x * z.abs(), y * z.abs(), z))
    }

    proptest! {
        /// Whatever is in front of the eye and in the picture is within the extent, though corners are behind it.
        #[test]
        fn what_is_seen_of_a_triangle_is_within_its_extent(
            seen in [0.0..SIZE[0] as f64, 0.0..SIZE[1] as f64], z in 1e-3..3.0f64, others in [corner(), corner()],
            shares in [0.0..0.45, 0.0..0.45],
        ) {
            // The third corner is where it makes the triangle hold what is seen.
            let point = DVec3::new(seen[0], seen[1], 1.0) * z;
            let [a, b] = shares;
            let third = (point - others[0] * a - others[1] * b) / (1.0 - a - b);
            let [columns, rows] = extent([others[0], others[1], third], SIZE).expect("some of it is in front of the eye");
            let [x, y] = seen.map(|at| at as usize);
            prop_assert!((columns[0]..=columns[1]).contains(&x), "{x} of {columns:?}");
            prop_assert!((rows[0]..=rows[1]).contains(&y), "{y} of {rows:?}");
        }
    }

    #[test]
    fn a_triangle_that_passes_the_eye_on_one_side_is_not_looked_for_on_the_other() {
        // From the picture's left to far behind the eye, further to the left.
        let corners = [DVec3::new(10.0, 20.0, 1.0), DVec3::new(12.0, 30.0, 1.0), DVec3::new(-500.0, -25.0, -1.0)];
        let [columns, _] = extent(corners, SIZE).unwrap();
        assert_eq!(columns, [0, 12]);
        assert_eq!(extent([DVec3::NEG_Z; 3], SIZE), None);
    }
}
