use super::*;
use crate::render::{Ball, Camera, LookAt, Orbit, Projection};
use crate::volume::phantom;

/// Where the ray of final pixel coordinates meets slice `k`, in permuted voxel coordinates.
fn meets(view: &View, volume: &Volume, f: &Factorization, at: DVec2, k: usize) -> DVec2 {
    let ray = view.ray(at);
    let index_from_world = volume.world_from_index().inverse();
    let start = permuted(f.principal_axis, index_from_world.transform_point3(ray.origin));
    let along = permuted(f.principal_axis, index_from_world.transform_vector3(ray.direction));
    assert_eq!(f.reversed, along.z < 0.0);
    (start + along * ((k as f64 - start.z) / along.z)).truncate()
}

/// The same through the intermediate image.
fn meets_by_lattice(f: &Factorization, at: DVec2, k: usize) -> DVec2 {
    let Lattice { offset, scale } = f.lattice(k as f64);
    let sheared = f.sheared_from_image * at.extend(1.0);
    offset + sheared.truncate() / sheared.z * scale
}

fn orbit(step: u32, projection: Projection, fov_y: f64) -> Camera {
    Camera::Orbit(Orbit {
        projection,
        fov_y,
        azimuth: f64::from(step) * 37.0,
        elevation: f64::from(step % 7) * 25.0 - 80.0,
        roll: f64::from(step) * 5.0,
        zoom: 1.3,
        ..Orbit::default()
    })
}

#[test]
fn shear_and_warp_together_are_the_parallel_view() {
    let volume = phantom::uniform([30, 40, 50], 1.0);
    for step in 0..60 {
        let camera = orbit(step, Projection::Parallel, 30.0);
        let view = View::new(&camera, volume.centre(), volume.radius(), 200, 150).unwrap();
        let [f] = &Factorization::parts(&view, &volume).unwrap()[..] else { panic!("not one part") };
        let at = DVec2::new(f64::from(step) * 3.0, 140.0 - f64::from(step));
        let difference = meets_by_lattice(f, at, 7) - meets(&view, &volume, f, at, 7);
        assert!(difference.length() < 1e-9);
        assert!(f.slice_distance < 3f64.sqrt() + 1e-5);
    }
}

#[test]
fn all_rays_that_pass_some_voxels_have_pixels_over_them() {
    let volume = phantom::uniform([30, 40, 50], 1.0);
    for (step, projection) in (0..40).flat_map(|step| [(step, Projection::Parallel), (step, Projection::Perspective)]) {
        let view = View::new(&orbit(step, projection, 40.0), volume.centre(), volume.radius(), 60, 50).unwrap();
        let first = step as usize % 20;
        let voxels = [first..first + 7, 12..12 + first + 1, 30 - first..41];
        for f in Factorization::parts(&view, &volume).unwrap() {
            assert_eq!(f.pixels_over(&[0..0, 0..0, 0..0]), [0..0, 0..0]);
            let [us, vs] = f.pixels_over(&voxels);
            let [i, j, k] = PERMUTATIONS[f.principal_axis].map(|axis| voxels[axis].clone());
            let [mut met, mut beside] = [0; 2];
            for (u, v) in (0..f.size[0]).flat_map(|u| (0..f.size[1]).map(move |v| (u, v))) {
                let meets = k.clone().any(|k| {
                    let at = f.voxel_from_sheared(u as f64, v as f64, k as f64);
                    let within =
                        |at: f64, voxels: &Range<usize>| at >= voxels.start as f64 - 1.0 && at <= voxels.end as f64;
                    within(at.x, &i) && within(at.y, &j)
                });
                let told = us.contains(&u) && vs.contains(&v);
                assert!(told || !meets, "{projection:?} {step}: pixel ({u}, {v}) is not among {us:?}, {vs:?}");
                (met, beside) = (met + usize::from(meets), beside + usize::from(!told));
            }
            assert!(met > 0 && beside > 0, "{projection:?} {step}: {met} of {:?} meet them, {us:?}, {vs:?}", f.size);
        }
    }
}

/// Where the volume is in the way of a final pixel's ray: first and last slice position.
fn crossing(view: &View, volume: &Volume, axis: usize, at: DVec2) -> Option<[f64; 2]> {
    let last = permuted(axis, DVec3::from_array(volume.dims().map(|n| (n - 1) as f64)));
    let ray = view.ray(at);
    let index_from_world = volume.world_from_index().inverse();
    let start = permuted(axis, index_from_world.transform_point3(ray.origin));
    let along = permuted(axis, index_from_world.transform_vector3(ray.direction));
    let (mut enter, mut leave) = (0f64, f64::INFINITY);
    for n in 0..3 {
        let ends = [-start[n], last[n] - start[n]].map(|d| d / along[n]);
        (enter, leave) = (enter.max(ends[0].min(ends[1])), leave.min(ends[0].max(ends[1])));
    }
    (enter < leave).then(|| [enter, leave].map(|t| start.z + along.z * t))
}

/// Checks the parts of a picture: every pixel that sees the volume has one, which leads it to where its
/// ray meets the slices, within the intermediate image. Gives the number of parts.
fn check_parts(camera: &Camera, volume: &Volume) -> usize {
    let (width, height) = (61, 47);
    let view = View::new(camera, volume.centre(), volume.radius(), width, height).unwrap();
    let parts = Factorization::parts(&view, volume).unwrap();
    for n in 0..width * height {
        let at = DVec2::new(f64::from(n % width) + 0.5, f64::from(n / width) + 0.5);
        let mut owners = parts.iter().filter(|f| parts.len() == 1 || f.owns(at));
        let Some(f) = owners.next() else {
            assert!(crossing(&view, volume, 2, at).is_none(), "{camera:?}: nobody owns {at}");
            continue;
        };
        assert!(owners.next().is_none(), "{camera:?}: several own {at}");
        let Some([enter, leave]) = crossing(&view, volume, f.principal_axis, at) else { continue };
        let sheared = f.sheared_from_image * at.extend(1.0);
        let position = sheared.truncate() / sheared.z;
        assert!(sheared.z > 0.0);
        for n in 0..2 {
            assert!(position[n] >= f.extent[0][n] - 1e-6 && position[n] <= f.extent[1][n] + 1e-6);
            assert!(f.extent[0][n] >= 0.0 && f.extent[1][n] < (f.size[n] - 1) as f64);
        }
        for k in f.slices.clone() {
            let difference = meets_by_lattice(f, at, k) - meets(&view, volume, f, at, k);
            // An eye at 10^6 voxels costs six digits.
            assert!(difference.length() < 1e-7, "{camera:?} {at} {k}: {difference}");
        }
        // No slice that the ray crosses is left out.
        let crossed = enter.min(leave).ceil() as usize..=enter.max(leave).floor() as usize;
        for k in crossed.filter(|&k| k as f64 != enter) {
            assert!(f.slices.contains(&k), "{camera:?} {at}: slice {k} of {:?}", f.slices);
        }
    }
    parts.len()
}

#[test]
fn shear_scale_and_warp_together_are_the_perspective_view() {
    let volume = phantom::uniform([30, 40, 50], 1.0);
    for step in 0..60 {
        let fov_y = [1e-3, 10.0, 30.0, 60.0, 100.0, 150.0][step as usize % 6];
        check_parts(&orbit(step, Projection::Perspective, fov_y), &volume);
    }
}

#[test]
fn an_eye_in_or_near_the_volume_has_parts_that_cover_what_it_sees() {
    let volume = phantom::uniform([30, 40, 50], 1.0);
    let eyes = [
        [15.0, 20.0, 25.0],
        [14.3, 21.7, 0.0],
        [0.0, 0.0, 0.0],
        [29.0, 39.0, 49.0],
        [31.0, 20.0, 20.0],
        [-1e-9, 10.0, 10.0],
        [15.0, 50.0, 48.9],
        [-20.0, 20.0, 60.0],
        [7.0, 3.0, 49.0],
    ];
    for eye in eyes {
        for fov_y in [1.0, 40.0, 90.0, 150.0, 175.0] {
            for target in [volume.centre() + 0.5, DVec3::ZERO, DVec3::new(29.0, 30.0, -90.0)] {
                let camera = Camera::LookAt(LookAt {
                    projection: Projection::Perspective,
                    position: eye.into(),
                    target: target + 1e-3,
                    up: DVec3::new(0.1, 0.2, 0.9),
                    view_height: None,
                    fov_y,
                });
                check_parts(&camera, &volume);
            }
        }
    }
}

#[test]
fn pictures_are_split_where_one_axis_will_not_do() {
    let volume = phantom::uniform([50, 50, 50], 1.0);
    let parts = |azimuth: f64, fov_y: f64| {
        let orbit = Orbit { projection: Projection::Perspective, azimuth, fov_y, ..Orbit::default() };
        check_parts(&Camera::Orbit(orbit), &volume)
    };
    assert_eq!(parts(0.0, 60.0), 1);
    assert_eq!(parts(45.0, 10.0), 1);
    assert_eq!(parts(45.0, 60.0), 2);
    let inside = Camera::LookAt(LookAt {
        projection: Projection::Perspective,
        position: volume.centre(),
        target: volume.centre() + DVec3::ONE,
        up: DVec3::Z,
        view_height: None,
        fov_y: 150.0,
    });
    assert_eq!(check_parts(&inside, &volume), 6);
}

#[test]
fn the_front_slice_has_scale_one_and_lies_on_the_lattice() {
    let volume = phantom::uniform([30, 40, 50], 1.0);
    for azimuth in [0.0, 10.0, 95.0, 180.0, 275.0] {
        let orbit = Orbit { projection: Projection::Perspective, azimuth, ..Orbit::default() };
        let view = View::new(&Camera::Orbit(orbit), volume.centre(), volume.radius(), 100, 100).unwrap();
        let [f] = &Factorization::parts(&view, &volume).unwrap()[..] else { panic!("not one part") };
        let front = if f.reversed { f.dims[2] - 1 } else { 0 };
        assert_eq!(f.lattice(front as f64).scale, 1.0);
        assert_eq!(f.lattice(front as f64).offset, f.lattice(front as f64).offset.round());
        assert!((0..f.dims[2]).all(|k| f.lattice(k as f64).scale >= 1.0));
    }
}

#[test]
fn rays_that_meet_a_shape_are_among_those_told_for_it() {
    let volume = phantom::uniform([30, 40, 50], 1.0);
    let ball = Clip { halves: vec![], balls: vec![Ball::new(volume.centre() + DVec3::new(4.0, -6.0, 9.0), 8.0)] };
    let corners = |n: u32| DVec3::new(f64::from(n & 1), f64::from(n >> 1 & 1), f64::from(n >> 2)) * 12.0;
    let points: Vec<_> = (0..8).map(|n| volume.centre() + corners(n)).collect();
    let hull = Clip::hull(&points).unwrap();
    let mut seen = 0;
    for step in 0..24 {
        for (projection, fov_y) in [(Projection::Parallel, 30.0), (Projection::Perspective, 50.0)] {
            let view = View::new(&orbit(step, projection, fov_y), volume.centre(), volume.radius(), 100, 75).unwrap();
            for f in &Factorization::parts(&view, &volume).unwrap() {
                let shapes = [&ball, &hull].map(|shape| shape.told_by(f.world_from_voxel(&volume)));
                for shape in &shapes {
                    let (told, [width, height]) = (f.pixels_that_meet([shape].into_iter()), f.size);
                    let (mut met, mut among) = (0, 0);
                    for (v, told) in told.iter().enumerate() {
                        among += told.len();
                        for u in 0..width {
                            let ends = [f.start, f.layers() as f64].map(|at| f.along(at));
                            let [from, to] = ends.map(|k| f.voxel_from_sheared(u as f64, v as f64, k));
                            let [enter, leave] = shape.span(from, to - from, [0.0, 1.0]);
                            if enter < leave {
                                met += 1;
                                assert!(told.contains(&u), "pixel ({u}, {v}) of {told:?}, {projection:?} {step}");
                            }
                        }
                    }
                    seen += met;
                    assert!(among < 3 * met + height, "{among} for {met}, {projection:?} {step}");
                }
            }
        }
    }
    assert!(seen > 10_000, "{seen}");
}
