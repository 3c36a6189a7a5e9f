use super::*;

/// Share of the voxels inside the head (denser than air) that lie in a range of Hounsfield units.
fn share(head: &Volume, range: std::ops::Range<f64>) -> f64 {
    let value = |index: usize| head.value_of_code(f64::from(head.scalars().code(index)));
    let inside: Vec<f64> = (0..head.scalars().len()).map(value).filter(|&v| v > -500.0).collect();
    inside.iter().filter(|v| range.contains(v)).count() as f64 / inside.len() as f64
}

/// Hounsfield units at a point in mm, of the nearest voxel.
fn at(head: &Volume, p: Vec3) -> f64 {
    let index = ((p - origin()) / SPACING).round().to_array().map(|c| c as usize);
    let code = head.scalars().code((index[2] * DIMS[1] + index[1]) * DIMS[0] + index[0]);
    head.value_of_code(f64::from(code))
}

#[test]
fn the_head_has_the_materials_of_a_head() {
    let head = head();
    let air = (0..head.scalars().len()).filter(|&i| head.scalars().code(i) < 124).count();
    let air = air as f64 / head.scalars().len() as f64;
    assert!((0.3..0.7).contains(&air), "air {air}");
    let expected = [
        ("fat", -140.0..-60.0, 0.01..0.15),
        ("soft tissue and brain", 0.0..80.0, 0.5..0.85),
        ("contrast agent and the edges of bone", 150.0..350.0, 0.005..0.06),
        ("spongy bone", 400.0..800.0, 0.02..0.15),
        ("cortical bone", 900.0..1700.0, 0.02..0.15),
        ("teeth", 1900.0..2600.0, 0.0001..0.01),
    ];
    for (material, range, bounds) in expected {
        let share = share(&head, range);
        assert!(bounds.contains(&share), "{material}: {share}");
    }
    let (low, high) = head.value_range();
    assert!(low < -1000.0 && (2000.0..3072.0).contains(&high), "{low} to {high}");
}

#[test]
fn the_head_is_the_same_with_any_number_of_threads() {
    let on_threads = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap().install(head);
    assert_eq!(on_threads(1), on_threads(3));
}

#[test]
fn leaving_out_parts_that_do_not_reach_a_block_changes_no_voxel() {
    let vessels = vessels::tree();
    let vessels: Vec<&Vessel> = vessels.iter().collect();
    let everything = Near { parts: Parts::ALL, vessels: vessels.clone() };
    let blocks = DIMS.map(|n| n / SMALL_BLOCK);
    let mut differing = 0;
    // A few hundred blocks all over the volume.
    let chosen = (0..blocks.iter().product::<usize>()).step_by(97);
    for block in chosen.clone() {
        let [i, j, k] = [block % blocks[0], block / blocks[0] % blocks[1], block / blocks[0] / blocks[1]];
        let corner = origin() + SPACING * SMALL_BLOCK as f32 * v(i as f32, j as f32, k as f32);
        let near = Near::to_block(corner, SMALL_BLOCK, None, &vessels);
        for row in 0..SMALL_BLOCK.pow(2) {
            let points = row_of_points(corner, row % SMALL_BLOCK, row / SMALL_BLOCK);
            let difference = (near.values(points) - everything.values(points)).abs();
            differing += above(difference, 0.01).bitmask().count_ones();
        }
    }
    assert_eq!(differing, 0, "of {} voxels", chosen.count() * SMALL_BLOCK.pow(3));
}

#[test]
fn the_head_is_upright_and_faces_the_camera_at_azimuth_zero() {
    let head = head();
    assert!(head.centre().length() < 1e-3, "{}", head.centre());
    // The nose stands out to the front (-y) at eye level and below; behind it, nothing does.
    let foremost = |x: f32, z: f32| (-120..0).find(|&y| at(&head, v(x, y as f32, z)) > -500.0).unwrap_or(0);
    assert!(foremost(0.0, -30.0) < foremost(40.0, -30.0) - 15, "the nose stands out from the cheek");
    assert!(foremost(0.0, -30.0) < foremost(0.0, 30.0) - 10, "and from the forehead");
    // Neck below, nothing above; skull above, airway below.
    assert!(at(&head, v(0.0, 40.0, -123.0)) > -200.0);
    assert!(at(&head, v(0.0, 0.0, 123.0)) < -900.0);
    let densest = |x: f32| (0..120).map(|z| at(&head, v(x, 0.0, z as f32))).fold(f64::MIN, f64::max);
    assert!(densest(0.0) > 900.0, "bone under the crown");
    assert!(at(&head, v(0.0, -13.0, -86.0)) < -500.0, "air in the throat");
    // Both eyes are where they should be.
    for x in [-31.0, 31.0] {
        assert!((-30.0..60.0).contains(&at(&head, v(x, -70.0, 2.0))));
    }
}
