//! Perspective by shear and warp: scaled slices, parts by principal axis, eyes in and near the volume.

use glam::{DMat4, DVec2, DVec3};
use proptest::prelude::*;
use shearwarp::classify::{GradientPoint, TransferFunction};
use shearwarp::render::{
    Algorithm, Background, Camera, DepthCueing, Image, Light, LookAt, Lookup, OpacityCorrection, Orbit, Preintegration,
    Projection, Quality, Settings, Shading, SlabTable, View,
};
use shearwarp::volume::{ImportReport, Placement, ScalarType, Scalars, Volume};

use crate::scenes::{ANGLES, Prepared, chord, medium, plain, same_bits, transfer};

fn volume(dims: [usize; 3], spacing: [f64; 3], code: impl Fn(DVec3) -> f64) -> Volume {
    let codes = (0..dims.iter().product()).map(|index: usize| {
        let at = [index % dims[0], index / dims[0] % dims[1], index / (dims[0] * dims[1])];
        code(DVec3::from_array(at.map(|i| i as f64))).round() as u8
    });
    let report = ImportReport::plain("test", ScalarType::U8);
    let placement = Placement::from_spacing(spacing.into());
    Volume::new(dims, placement, Scalars::U8(codes.collect()), (1.0, 0.0), report).unwrap()
}

/// Smooth lumps with empty space between them, some of them cut by the volume's sides.
fn lumps(dims: [usize; 3], spacing: [f64; 3]) -> Volume {
    volume(dims, spacing, |at| {
        let [x, y, z] = (at * DVec3::new(0.19, 0.23, 0.21) + 1.1).to_array();
        (x.sin() * y.sin() * z.sin()).max(0.0) * 255.0
    })
}

fn solid() -> TransferFunction {
    transfer(&[(0.0, 0.0), (60.0, 0.0), (90.0, 0.4), (255.0, 0.9)])
}

fn with_gradient_opacity() -> TransferFunction {
    let points = [(0.0, 0.0), (4.0, 0.1), (30.0, 1.0)].map(|(value, opacity)| GradientPoint { value, opacity });
    TransferFunction { gradient_opacity: points.to_vec(), ..solid() }
}

fn lit(algorithm: Algorithm) -> Settings {
    let side = Light::Directional { direction: (1.0, -2.0, 0.5).into(), intensity: 0.7, shadows: false };
    Settings {
        shading: Some(Shading { lights: vec![Light::Headlight, side], ..Shading::default() }),
        early_ray_termination: 0.98,
        ..plain(algorithm)
    }
}

/// Every kind of frame there is.
fn all_settings() -> Vec<Settings> {
    let cueing = Some(DepthCueing { front: 1.2, density: 0.7 });
    let options = |lookup, opacity_correction, samples_per_voxel| Preintegration {
        lookup,
        opacity_correction,
        samples_per_voxel,
        ..Preintegration::of(Quality::Standard)
    };
    let slabs = |preintegration| Settings { preintegration, ..plain(Algorithm::Preintegrated) };
    vec![
        lit(Algorithm::Classified),
        Settings { depth_cueing: cueing, ..plain(Algorithm::Classified) },
        lit(Algorithm::Preintegrated),
        slabs(options(Lookup::Nearest, OpacityCorrection::Off, 1)),
        slabs(options(Lookup::Bilinear, OpacityCorrection::Lookup, 3)),
        slabs(Preintegration {
            table: SlabTable::OneDimensional,
            ..options(Lookup::Bilinear, OpacityCorrection::View, 1)
        }),
        Settings {
            depth_cueing: cueing,
            shading: Some(Shading::default()),
            ..slabs(options(Lookup::Bilinear, OpacityCorrection::View, 2))
        },
    ]
}

fn orbit((azimuth, elevation): (f64, f64), fov_y: f64) -> Camera {
    let projection = Projection::Perspective;
    Camera::Orbit(Orbit { projection, azimuth, elevation, roll: 7.0, zoom: 1.2, fov_y, ..Orbit::default() })
}

/// From a point, told in radii from the centre, along a direction.
fn within(scene: &Prepared, from: [f64; 3], along: [f64; 3], fov_y: f64) -> Camera {
    let position = scene.prepared.volume().centre() + DVec3::from(from) * scene.prepared.volume().radius();
    let (target, up) = (position + DVec3::from(along), DVec3::new(0.1, 0.2, 0.9));
    Camera::LookAt(LookAt { projection: Projection::Perspective, position, target, up, view_height: None, fov_y })
}

/// Cameras along every axis from both sides, near ones and wide ones, some within the volume.
fn cameras(scene: &Prepared) -> Vec<Camera> {
    let near = [
        ([0.0, 0.0, 0.0], [1.0, 0.8, 0.6], 100.0),
        ([0.2, 0.1, -0.15], [-1.0, 0.1, 0.2], 150.0),
        ([-0.9, 0.1, 0.05], [1.0, 0.0, 0.0], 90.0),
        ([0.7, -0.8, 0.5], [-1.0, 0.9, -0.8], 140.0),
    ];
    let near = near.map(|(from, along, fov_y)| within(scene, from, along, fov_y));
    ANGLES.map(|angles| orbit(angles, 40.0)).into_iter().chain(near).collect()
}

#[test]
fn skipping_encodings_buffers_and_threads_change_no_bit_in_perspective() {
    for function in [solid(), with_gradient_opacity()] {
        let scene = Prepared::new(lumps([140, 37, 45], [1.0, 1.5, 0.8]), function, 0.004);
        for camera in cameras(&scene) {
            for settings in all_settings() {
                let frame = same_bits(&scene, &scene.view(&camera, 47, 40), &settings);
                assert!(frame.pixels.iter().any(|&p| p > 0), "an empty picture by {camera:?}");
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 32, ..ProptestConfig::default() })]

    #[test]
    fn any_volume_eye_and_function_render_as_their_twins(
        dims in prop::array::uniform3(2usize..60),
        codes in prop::collection::vec(any::<u8>(), 97),
        from in prop::array::uniform3(-1.5f64..1.5),
        along in prop::array::uniform3(-1.0f64..1.0),
        fov_y in 1.0f64..160.0,
        low in 0.0f64..200.0,
        opacity in 0.05f64..1.0,
        termination in 0.5f32..=1.0,
        which in 0usize..7,
    ) {
        let scalars = (0..dims.iter().product()).map(|at: usize| codes[at / 5 % 97]).collect();
        let report = ImportReport::plain("test", ScalarType::U8);
        let placement = Placement::from_spacing([1.0, 0.7, 1.6].into());
        let volume = Volume::new(dims, placement, Scalars::U8(scalars), (1.0, 0.0), report).unwrap();
        let function = transfer(&[(low, 0.0), (low + 20.0, opacity), (255.0, opacity / 2.0)]);
        let scene = Prepared::new(volume, function, 0.01);
        let camera = within(&scene, from, along.map(|a| a + 1e-3), fov_y);
        let settings = Settings { early_ray_termination: termination, ..all_settings()[which].clone() };
        same_bits(&scene, &scene.view(&camera, 47, 40), &settings);
    }
}

const OPACITY: f64 = 0.03;

/// The alphas of a uniform medium of extinction `-ln(1 - OPACITY)` per mm between which a pixel's must lie.
/// As under parallel projection two things separate the slices' sum from the integral: a ray that enters or
/// leaves through a side has up to half a slab more or less at each end, and the warp blends rays of
/// intermediate pixels less than `reach` final pixels away.
fn alphas(view: &View, volume: &Volume, at: DVec2, reach: f64) -> [f64; 2] {
    let offsets = (-2..=2).flat_map(|x| (-2..=2).map(move |y| DVec2::new(f64::from(x), f64::from(y)) / 2.0));
    let chords: Vec<_> = offsets.map(|offset| chord(view, volume, at + offset * reach)).collect();
    let lengths = chords.iter().map(|chord| chord.length);
    let (shortest, longest) = (lengths.clone().fold(f64::INFINITY, f64::min), lengths.fold(0.0, f64::max));
    // One axis serves as long as no ray moves by more than two voxels a slice.
    let index_from_world = volume.world_from_index().inverse();
    let along = index_from_world.transform_vector3(view.ray(at).direction).abs();
    let steps = along.to_array().map(|a| 1.0 / a).into_iter().filter(|step| *step < 2.01 / along.max_element());
    let end = if longest > 0.0 { steps.fold(0.0, f64::max) } else { 0.0 };
    let opacity = |length: f64| 1.0 - (1.0 - OPACITY).powf(length.max(0.0));
    [opacity(shortest - end), opacity(longest + end)]
}

fn assert_uniform(scene: &Prepared, camera: &Camera, algorithm: Algorithm, reach: f64) {
    let view = scene.view(camera, 48, 48);
    let frame = scene.frame(&view, &plain(algorithm));
    let mut solid = 0;
    for (n, pixel) in frame.pixels.chunks_exact(4).enumerate() {
        let at = DVec2::new((n % 48) as f64 + 0.5, (n / 48) as f64 + 0.5);
        let [low, high] = alphas(&view, scene.prepared.volume(), at, reach);
        let alpha = f64::from(pixel[3]) / 255.0;
        // One step of 8 bits for rounding.
        let range = low - 1.0 / 255.0..=high + 1.0 / 255.0;
        assert!(range.contains(&alpha), "{algorithm:?} {camera:?} {at}: {alpha} is not in {range:?}");
        solid += usize::from(low > 0.0);
    }
    assert!(solid > 100, "{algorithm:?} {camera:?}: only {solid} pixels were tested inside");
}

#[test]
fn a_uniform_box_has_its_closed_form_to_a_slab_and_a_voxel() {
    let scene = Prepared::new(volume([40, 48, 36], [1.0, 1.2, 1.5], |_| 9.0), medium(OPACITY, 1.0), 0.0);
    let radius = scene.prepared.volume().radius();
    for n in 0..50 {
        let elevation = (1.0 - 2.0 * (f64::from(n) + 0.5) / 50.0).asin().to_degrees();
        let camera = orbit((f64::from(n) * 137.508, elevation), 30.0);
        // The largest a voxel of 1.5 mm comes to be, pixels: its diagonal, at the front of the bounding sphere.
        let half = 15f64.to_radians();
        let reach = 1.5 * 2f64.sqrt() * 1.2 * 24.0 / (half.tan() * (radius / half.sin() - radius));
        for algorithm in [Algorithm::Classified, Algorithm::Preintegrated] {
            assert_uniform(&scene, &camera, algorithm, reach);
        }
    }
}

/// The first interval is what lies between the eye and the first slice in front of it.
#[test]
fn an_eye_in_a_uniform_box_sees_what_is_in_front_of_it() {
    let scene = Prepared::new(volume([40, 48, 36], [1.0, 1.2, 1.5], |_| 9.0), medium(OPACITY, 1.0), 0.0);
    for (from, along) in [
        ([0.0, 0.0, 0.0], [1.0, 0.0, 0.0]),
        ([0.1, -0.2, 0.11], [0.3, 1.0, 0.7]),
        ([-0.31, 0.12, -0.2], [-0.2, 0.1, 1.0]),
        ([0.3, 0.3, 0.3], [-1.0, -1.0, -1.0]),
    ] {
        for fov_y in [20.0f64, 100.0, 150.0] {
            // Intermediate pixels are finer than voxels or than final pixels.
            let reach = (24.0 / (fov_y.to_radians() / 2.0).tan() / 20.0).max(1.0) * 2f64.sqrt();
            for algorithm in [Algorithm::Classified, Algorithm::Preintegrated] {
                assert_uniform(&scene, &within(&scene, from, along, fov_y), algorithm, reach);
            }
        }
    }
}

/// The largest difference of any channel, and the mean one.
fn differences(a: &Image, b: &Image) -> (u8, f64) {
    let differences: Vec<u8> = a.pixels.iter().zip(&b.pixels).map(|(a, b)| a.abs_diff(*b)).collect();
    let sum: f64 = differences.iter().map(|d| f64::from(*d)).sum();
    (*differences.iter().max().unwrap(), sum / differences.len() as f64)
}

fn over_black(settings: Settings) -> Settings {
    Settings { background: Background::Opaque([0.0; 3]), early_ray_termination: 0.9999, ..settings }
}

/// The frame and what it approximates.
fn frame_and_truth(scene: &Prepared, view: &View, settings: &Settings) -> [Image; 2] {
    let truth = Settings { algorithm: Algorithm::Raycast, sample_distance: 0.1, ..settings.clone() };
    [scene.frame(view, settings), scene.frame(view, &truth)]
}

/// The principal axis of a pixel's ray in a picture of parts, and its order of slices.
fn part(view: &View, volume: &Volume, x: u32, y: u32) -> (usize, bool) {
    let ray = view.ray(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
    let along = volume.world_from_index().inverse().transform_vector3(ray.direction);
    let axis = (0..3).max_by(|&a, &b| along[a].abs().total_cmp(&along[b].abs())).unwrap();
    (axis, along[axis] < 0.0)
}

/// A frame's error (against the ray caster) may differ from part to part, but does not jump: from a pixel to
/// its right neighbour it changes across joints about as much as it does elsewhere.
#[test]
fn wide_views_from_within_are_the_ray_casters_and_have_no_seams() {
    let scene = Prepared::new(lumps([60, 50, 55], [1.0, 1.1, 0.9]), solid(), 0.0);
    for (algorithm, shading) in [
        (Algorithm::Preintegrated, None),
        (Algorithm::Preintegrated, Some(Shading::default())),
        (Algorithm::Classified, None),
        (Algorithm::Classified, Some(Shading::default())),
    ] {
        for (from, along, fov_y) in [
            ([-0.15, -0.2, -0.2], [1.0, 1.1, 0.9], 150.0),
            ([0.0, 0.05, 0.1], [-1.0, 0.4, 0.1], 110.0),
            ([-1.1, -1.0, 0.3], [1.0, 1.0, -0.2], 80.0),
        ] {
            let view = scene.view(&within(&scene, from, along, fov_y), 128, 96);
            let settings = over_black(Settings { shading: shading.clone(), ..plain(algorithm) });
            let [frame, truth] = frame_and_truth(&scene, &view, &settings);
            let (_, mean) = differences(&frame, &truth);
            let error = |x: u32, y: u32| {
                let at = ((y * 128 + x) * 3) as usize;
                [0, 1, 2].map(|channel| f64::from(frame.pixels[at + channel]) - f64::from(truth.pixels[at + channel]))
            };
            let (mut at_joints, mut elsewhere) = ((0.0, 0), (0.0, 0));
            for (x, y) in (0..127).flat_map(|x| (0..96).map(move |y| (x, y))) {
                let jump: f64 = error(x, y).iter().zip(error(x + 1, y)).map(|(a, b)| (a - b).abs()).sum::<f64>() / 3.0;
                let volume = scene.prepared.volume();
                let joint = part(&view, volume, x, y) != part(&view, volume, x + 1, y);
                let (sum, count) = if joint { &mut at_joints } else { &mut elsewhere };
                (*sum, *count) = (*sum + jump, *count + 1);
            }
            assert!(at_joints.1 > 20, "no joint in the picture");
            let (at_joints, elsewhere) = (at_joints.0 / f64::from(at_joints.1), elsewhere.0 / f64::from(elsewhere.1));
            let what = format!("{algorithm:?} {} {fov_y}", shading.is_some());
            let exact = algorithm == Algorithm::Preintegrated && shading.is_none();
            let (near, flush) = if exact { (4.0, 2.5) } else { (12.0, 5.0) };
            assert!(mean < near, "{what}: {mean} from the ray caster");
            assert!(at_joints < elsewhere + flush, "{what}: {at_joints} across joints, {elsewhere} elsewhere");
        }
    }
}

/// In `high` the largest step of a frame's error across a joint is 2, what the rounding of the frame's two pixels
/// adds included.
#[test]
fn high_has_no_step_across_joints() {
    let scene = Prepared::new(lumps([60, 50, 55], [1.0, 1.1, 0.9]), solid(), 0.0);
    let volume = scene.prepared.volume();
    for ((from, along, fov_y), shading) in [
        ([-0.15, -0.2, -0.2], [1.0, 1.1, 0.9], 150.0),
        ([0.0, 0.05, 0.1], [-1.0, 0.4, 0.1], 110.0),
        ([-1.1, -1.0, 0.3], [1.0, 1.0, -0.2], 80.0),
    ]
    .into_iter()
    .flat_map(|place| [(place, None), (place, Some(Shading::default()))])
    {
        let view = scene.view(&within(&scene, from, along, fov_y), 128, 96);
        let high = Settings::new(Algorithm::Preintegrated, Quality::High);
        let lit = shading.is_some();
        let settings = over_black(Settings { shading, ..high });
        let frame = scene.frame(&view, &settings);
        let exact = Settings { algorithm: Algorithm::Raycast, sample_distance: 0.1, ..settings };
        let truth = scene.rays(&view, &exact);
        let error = |x: u32, y: u32, channel: u32| {
            let at = (y * 128 + x) as usize;
            f32::from(frame.pixels[at * 3 + channel as usize]) - truth[at][channel as usize] * 255.0
        };
        let right = (0..127).flat_map(|x| (0..96).map(move |y| ((x, y), (x + 1, y))));
        let down = (0..128).flat_map(|x| (0..95).map(move |y| ((x, y), (x, y + 1))));
        let joints = right.chain(down).filter(|&(a, b)| part(&view, volume, a.0, a.1) != part(&view, volume, b.0, b.1));
        let steps: Vec<f32> = joints
            .flat_map(|(a, b)| (0..3).map(move |c| (a, b, c)))
            .map(|(a, b, c)| (error(a.0, a.1, c) - error(b.0, b.1, c)).abs())
            .collect();
        assert!(steps.len() > 60, "no joint in the picture");
        let largest = steps.iter().copied().fold(0.0, f32::max);
        println!("{fov_y}, lit: {lit}: a step of {largest}");
        assert!(largest <= 2.0, "{fov_y}, lit: {lit}: a step of {largest}");
    }
}

/// A field of view of almost nothing, from almost infinitely far away. What is seen stays off the volume's
/// sides, along which rays of the two differ in length.
#[test]
fn a_tiny_field_of_view_is_a_parallel_projection() {
    let dims = [60, 50, 55];
    let last = DVec3::from_array(dims.map(|n| (n - 1) as f64));
    let inner = volume(dims, [1.0, 1.1, 0.9], |at| {
        let [x, y, z] = (at * DVec3::new(0.19, 0.23, 0.21) + 1.1).to_array();
        let border = at.min(last - at).min_element();
        if border < 3.0 { 0.0 } else { (x.sin() * y.sin() * z.sin()).max(0.0) * 255.0 }
    });
    let scene = Prepared::new(inner, solid(), 0.0);
    for (azimuth, elevation) in ANGLES {
        let camera = |projection| {
            Camera::Orbit(Orbit { projection, azimuth, elevation, fov_y: 0.01, roll: 3.0, ..Orbit::default() })
        };
        for algorithm in [Algorithm::Classified, Algorithm::Preintegrated] {
            let [a, b] = [Projection::Parallel, Projection::Perspective]
                .map(|projection| scene.frame(&scene.view(&camera(projection), 90, 80), &over_black(plain(algorithm))));
            let (largest, mean) = differences(&a, &b);
            assert!(largest <= 3 && mean < 0.1, "{algorithm:?} {azimuth} {elevation}: {largest} at most, mean {mean}");
        }
    }
}

/// Slices have the pixels of the whole picture in any part of it.
#[test]
fn an_off_centre_projection_is_a_cut_of_the_whole() {
    let scene = Prepared::new(lumps([60, 50, 55], [1.0, 1.1, 0.9]), solid(), 0.0);
    let (centre, radius) = (scene.prepared.volume().centre(), scene.prepared.volume().radius());
    let eye = centre + DVec3::new(0.5, -2.5, 0.8) * radius;
    let view = glam::dcamera::rh::view::look_at_mat4(eye, centre, DVec3::Z);
    let frustum = |left: f64, right: f64| {
        let (near, far, top) = (1.0, 1000.0, 0.4);
        DMat4::from_cols_array_2d(&[
            [2.0 * near / (right - left), 0.0, 0.0, 0.0],
            [0.0, near / top, 0.0, 0.0],
            [(right + left) / (right - left), 0.0, (far + near) / (near - far), -1.0],
            [0.0, 0.0, 2.0 * far * near / (near - far), 0.0],
        ])
    };
    for algorithm in [Algorithm::Classified, Algorithm::Preintegrated] {
        let frame = |left, right, width| {
            let camera = Camera::Matrices { view, projection: frustum(left, right) };
            scene.frame(&scene.view(&camera, width, 80), &over_black(lit(algorithm)))
        };
        let (whole, cut) = (frame(-0.4, 0.4, 80), frame(-0.4, -0.1, 30));
        let rows = whole.pixels.chunks_exact(80 * 3).zip(cut.pixels.chunks_exact(30 * 3));
        let largest = rows.flat_map(|(whole, cut)| whole.iter().zip(cut).map(|(a, b)| a.abs_diff(*b))).max().unwrap();
        assert!(cut.pixels.iter().any(|&p| p > 60) && largest <= 2, "{algorithm:?}: {largest}");
    }
}

#[test]
fn near_and_far_planes_and_depth_cueing_are_the_ray_casters_in_perspective() {
    let scene = Prepared::new(lumps([60, 50, 55], [1.0, 1.1, 0.9]), solid(), 0.0);
    let (centre, radius) = (scene.prepared.volume().centre(), scene.prepared.volume().radius());
    let eye = centre + DVec3::new(0.8, -2.2, 0.9) * radius;
    let view = glam::dcamera::rh::view::look_at_mat4(eye, centre, DVec3::Z);
    let distance = eye.distance(centre);
    let frustum = |near: f64, far: f64| {
        DMat4::from_cols_array_2d(&[
            [2.5, 0.0, 0.0, 0.0],
            [0.0, 2.5, 0.0, 0.0],
            [0.0, 0.0, (far + near) / (near - far), -1.0],
            [0.0, 0.0, 2.0 * far * near / (near - far), 0.0],
        ])
    };
    let full = frustum(1.0, 1000.0);
    let cut = frustum(distance - 0.3 * radius, distance + 0.2 * radius);
    let cueing = Some(DepthCueing { front: 1.0, density: 2.0 });
    for algorithm in [Algorithm::Classified, Algorithm::Preintegrated] {
        let errors = [(full, None), (cut, None), (full, cueing)].map(|(projection, depth_cueing)| {
            let view = scene.view(&Camera::Matrices { view, projection }, 80, 80);
            let settings = over_black(Settings { depth_cueing, ..plain(algorithm) });
            let [frame, truth] = frame_and_truth(&scene, &view, &settings);
            (differences(&frame, &truth).1, frame)
        });
        let [(plain, whole), (clipped, cut), (cued, faded)] = errors;
        assert!(differences(&whole, &cut).1 > 5.0 && differences(&whole, &faded).1 > 5.0);
        assert!(clipped < plain + 0.7 && cued < plain + 0.5, "{algorithm:?}: {plain}, {clipped} cut, {cued} cued");
    }
}
