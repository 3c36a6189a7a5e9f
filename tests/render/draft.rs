//! Coarser levels show what the volume shows, where it shows it.

use shearwarp::render::{Algorithm, Camera, Image, Orbit};
use shearwarp::volume::{phantom, pyramid};

use crate::scenes::{Prepared, plain, transfer};

const SIDE: u32 = 240;

/// The first and the last column of every row that is at least half opaque.
fn silhouette(image: &Image) -> Vec<Option<(usize, usize)>> {
    let rows = image.pixels.chunks_exact(SIDE as usize * 4);
    rows.map(|row| {
        let opaque = |pixel: &[u8]| pixel[3] > 127;
        let columns = || row.chunks_exact(4);
        columns().position(opaque).zip(columns().rposition(opaque))
    })
    .collect()
}

#[test]
fn a_ball_near_a_face_keeps_its_silhouette_to_two_pixels() {
    for n in [40, 41] {
        // Not in the middle, where any lattice that keeps the box is right.
        let (centre, radius) = ([0.3, 0.35, 0.6].map(|share| share * (n - 1) as f64), 0.25 * n as f64);
        let ball = phantom::from_fn([n; 3], [1.0; 3], |i, j, k| {
            let distance = [i, j, k].into_iter().zip(centre).map(|(at, c)| (at as f64 - c).powi(2)).sum::<f64>().sqrt();
            1000.0 * (0.5 + (radius - distance) / 8.0).clamp(0.0, 1.0)
        });
        let transfer = transfer(&[(0.0, 0.0), (499.0, 0.0), (501.0, 1.0), (1000.0, 1.0)]);
        let coarse = Prepared::new(pyramid::coarser(&ball), transfer.clone(), 0.0);
        let fine = Prepared::new(ball, transfer, 0.0);
        for (azimuth, elevation) in [(0.0, 0.0), (90.0, 0.0), (25.0, 10.0)] {
            let camera = Camera::Orbit(Orbit { azimuth, elevation, zoom: 1.6, ..Orbit::default() });
            let view = fine.view(&camera, SIDE, SIDE);
            let voxel = f64::from(SIDE) * 1.6 / (2.0 * fine.prepared.volume().radius());
            let [fine, coarse] =
                [&fine, &coarse].map(|scene| silhouette(&scene.frame(&view, &plain(Algorithm::Raycast))));
            let mut rows = 0;
            for (fine, coarse) in fine.into_iter().zip(coarse) {
                let (Some(fine), Some(coarse)) = (fine, coarse) else { continue };
                // Where the outline is steep: elsewhere a hair up or down is many columns.
                if fine.1 - fine.0 > (1.7 * radius * voxel) as usize {
                    for (fine, coarse) in [(fine.0, coarse.0), (fine.1, coarse.1)] {
                        let off = fine.abs_diff(coarse);
                        assert!(off <= 2, "{off} pixels at {azimuth} {elevation}, of {voxel} a voxel");
                    }
                    rows += 1;
                }
            }
            assert!(rows > 10, "{rows} rows at {azimuth} {elevation}");
        }
    }
}
