//! Bone, teeth, airways and eyes.

use std::sync::LazyLock;

use glam::{Vec3, Vec4};

use super::super::random::smooth;
use super::super::shape::{
    Points, above, at, below, carve, chain, coverage, ellipsoid, join, limb, meet, mirrored, mix, ring, slab, sphere, v,
};
use super::{BLUR, FAR, Parts, hu, skin};

/// Thickness of cortical bone, mm.
const CORTEX: f32 = 1.9;

/// The brain case is no thicker than this, mm.
pub const THICKEST: f32 = 9.0;
/// The face grows out of the brain case with a seam this wide, mm.
pub const SEAM: f32 = 6.0;

/// Holes in bone are rounded over this width, mm.
pub const EDGE: f32 = 2.5;

/// Paints bone and all that goes with it over `value`; the brain's cavity is `cavity` mm away, the skin
/// `skin` mm.
pub fn bones(p: Points, cavity: Vec4, skin: Vec4, parts: &Parts, value: Vec4) -> Vec4 {
    let m = mirrored(p);
    let mut bone = if parts.vault { vault(p, m, cavity) } else { Vec4::splat(FAR) };
    if parts.face {
        bone = join(bone, facial_bones(m), SEAM).max(-cavity);
    }
    if parts.openings {
        bone = carve(bone, openings(m), EDGE).min(nose_walls(m));
    }
    if parts.jaw {
        bone = bone.min(jaw(m));
    }
    if parts.spine {
        bone = bone.min(spine(m));
    }
    // Nowhere does bone show through the skin.
    let bone = bone.max(skin + 3.5);
    let mut value = value;
    if below(bone, 0.5 * BLUR).any() {
        let marrow = coverage(bone + CORTEX + 0.6, 4.0);
        let mut inside = Vec4::splat(hu::CORTICAL);
        if above(marrow, 0.0).any() {
            inside = mix(inside, hu::TRABECULAR * (1.0 + 0.25 * smooth(p / 3.0, 31)), marrow);
        }
        if below(p.z, 0.0).any() {
            let petrous = limb(m, (v(56.0, 14.0, -12.0), 8.0), (v(20.0, -6.0, -12.0), 5.0));
            inside = mix(inside, hu::PETROUS, coverage(petrous, BLUR));
        }
        value = mix(value, inside, coverage(bone, BLUR));
    }
    value = teeth(m, value);
    if parts.airways { mix(value, hu::AIR, coverage(airways(m), BLUR)) } else { value }
}

/// The brain case with its sutures.
fn vault(p: Points, m: Points, cavity: Vec4) -> Vec4 {
    // Uneven, where it can be seen.
    let seen = !below(cavity, -2.0) & below(cavity, 16.0);
    let bumps = if seen.any() { Vec4::select(seen, 0.8 * smooth(p / 18.0, 32), Vec4::ZERO) } else { Vec4::ZERO };
    let thickness = mix(4.0, 7.0, coverage(20.0 - p.z, 30.0)) + bumps;
    let temple = ellipsoid(m, v(72.0, -20.0, 10.0), v(16.0, 36.0, 34.0));
    let outside = cavity - thickness + 2.0 * coverage(temple, 12.0);
    let shell = carve(outside, cavity, 1.0);
    // Sutures are seen from outside only.
    let near = above(p.z, 0.0) & below(outside.abs(), 4.0);
    let shell = if near.any() {
        Vec4::select(near, carve(shell, sutures(p, m).max(-outside - 2.4), 1.0), shell)
    } else {
        shell
    };
    let foramen_magnum = limb(p, (v(0.0, 27.0, -70.0), 14.0), (v(0.0, 30.0, -20.0), 15.0));
    carve(shell, foramen_magnum, 3.0)
}

/// Wriggling seams between the plates: across behind the forehead, along the crown, and the lambda.
fn sutures(p: Points, m: Points) -> Vec4 {
    let wriggle = 2.6 * smooth(p / 4.0, 33) + 2.0 * smooth(p / 11.0, 34);
    let coronal = (p.y + 22.0 + 0.28 * (100.0 - p.z) + wriggle).abs();
    let sagittal = (p.x + wriggle).abs().max(-(p.y + 20.0)).max(p.y - 76.0);
    let lambdoid =
        (0.8 * (p.y - 78.0) + 0.55 * m.x - 0.1 * (p.z - 70.0) + wriggle).abs().max(p.z - 78.0).max(50.0 - p.y);
    coronal.max(12.0 - p.z).min(sagittal.max(40.0 - p.z)).min(lambdoid.max(4.0 - p.z)) - 0.7
}

/// Brow, cheekbones, upper jaw, and the processes below the skull's base.
pub fn facial_bones(m: Points) -> Vec4 {
    let brow = chain(m, &[(v(0.0, -79.0, 15.0), 6.0), (v(20.0, -80.0, 21.0), 5.0), (v(42.0, -71.0, 17.0), 4.5)]);
    let outer_rim = chain(m, &[(v(45.0, -69.0, 17.0), 5.0), (v(52.5, -60.0, 3.0), 4.8), (v(49.0, -63.0, -14.0), 5.5)]);
    let cheekbone = ellipsoid(m, v(45.0, -64.0, -21.0), v(13.0, 9.0, 9.0));
    let lower_rim =
        chain(m, &[(v(44.0, -70.0, -16.0), 4.0), (v(28.0, -79.0, -17.0), 4.0), (v(14.0, -83.0, -8.0), 3.5)]);
    let nasal = chain(m, &[(v(2.5, -81.0, 13.0), 5.0), (v(3.0, -87.0, 0.0), 4.0), (v(3.0, -94.0, -12.0), 2.8)]);
    let beside_nose =
        chain(m, &[(v(9.0, -80.0, 8.0), 4.0), (v(14.5, -82.0, -14.0), 4.5), (v(17.0, -80.0, -36.0), 6.0)]);
    let maxilla = ellipsoid(m, v(16.0, -62.0, -30.0), v(20.0, 22.0, 20.0));
    let alveolar = ellipsoid(m, v(0.0, -60.0, -46.0), v(30.0, 24.0, 9.0));
    let spine = limb(m, (v(0.0, -80.0, -39.0), 3.0), (v(0.0, -87.0, -38.0), 1.6));
    let mass = ellipsoid(m, v(0.0, -56.0, -2.0), v(50.0, 27.0, 32.0));
    let sphenoid = ellipsoid(m, v(0.0, -24.0, -6.0), v(26.0, 18.0, 14.0));
    let wing = limb(m, (v(46.0, -56.0, 0.0), 3.0), (v(40.0, -36.0, -4.0), 4.0));
    let clivus = limb(m, (v(0.0, -10.0, -8.0), 8.0), (v(0.0, 12.0, -34.0), 5.0));
    let eye = join(join(brow, outer_rim, 4.0), join(cheekbone, lower_rim, 5.0), 5.0);
    let middle = join(join(nasal, beside_nose, 3.0), join(maxilla, alveolar, 6.0), 5.0).min(spine);
    let deep = join(join(mass, sphenoid, 6.0), join(wing, clivus, 4.0), 5.0);
    join(join(eye, middle, 6.0), deep, 8.0).min(processes(m))
}

/// Zygomatic arch, mastoid, styloid and pterygoid processes, and the joint's socket.
fn processes(m: Points) -> Vec4 {
    let arch = chain(
        m,
        &[
            (v(51.0, -58.0, -22.0), 4.6),
            (v(64.0, -32.0, -19.0), 3.2),
            (v(65.0, -8.0, -15.0), 3.4),
            (v(60.0, 4.0, -12.0), 5.0),
        ],
    );
    let mastoid = limb(m, (v(50.0, 22.0, -12.0), 11.0), (v(48.0, 20.0, -34.0), 6.0));
    let petrous = limb(m, (v(54.0, 14.0, -12.0), 9.0), (v(18.0, -6.0, -12.0), 7.0));
    let styloid = limb(m, (v(46.0, 12.0, -26.0), 2.4), (v(42.0, 0.0, -54.0), 1.1));
    let pterygoid = limb(m, (v(18.0, -34.0, -16.0), 4.0), (v(20.0, -33.0, -46.0), 2.2));
    let condyle = ellipsoid(m, v(17.0, 20.0, -37.0), v(7.0, 11.0, 6.0));
    join(arch, join(mastoid, petrous, 6.0), 5.0).min(styloid).min(pterygoid).min(condyle)
}

/// Holes in the bone: eye sockets with their nerve's canal, the nose, sinuses, ear canals.
fn openings(m: Points) -> Vec4 {
    let socket = ellipsoid(m, v(30.5, -78.0, 1.5), v(17.5, 22.0, 15.5));
    let cone = limb(m, (v(29.0, -68.0, 2.0), 14.0), (v(14.0, -34.0, 4.0), 3.0));
    let fissure = limb(m, (v(24.0, -42.0, 2.0), 2.5), (v(36.0, -44.0, 10.0), 1.5));
    let pear = join(
        ellipsoid(m, v(5.0, -86.0, -30.0), v(8.0, 14.0, 7.5)),
        ellipsoid(m, v(0.0, -88.0, -21.0), v(6.5, 14.0, 9.0)),
        4.0,
    );
    let cavity = ellipsoid(m, v(0.0, -52.0, -20.0), v(13.0, 34.0, 15.0));
    let maxillary = ellipsoid(m, v(28.0, -58.0, -27.0), v(12.0, 14.0, 13.0));
    let frontal = ellipsoid(m, v(8.0, -75.5, 24.0), v(7.0, 3.0, 6.5));
    let sphenoidal = ellipsoid(m, v(8.0, -26.0, -4.0), v(7.5, 10.0, 7.5));
    let canal = limb(m, (v(76.0, 12.0, -9.0), 3.6), (v(46.0, 8.0, -9.0), 3.0));
    let cheek_nerve = limb(m, (v(27.0, -86.0, -23.0), 1.6), (v(27.0, -74.0, -21.0), 1.4));
    let face = join(socket, cone, 4.0).min(fissure).min(pear).min(cavity);
    face.min(maxillary).min(frontal).min(sphenoidal).min(canal).min(cheek_nerve)
}

/// Holes and the thin plates in them.
pub fn nose_and_openings(m: Points) -> Vec4 {
    openings(m).min(nose_walls(m))
}

/// Thin plates inside the nose: the septum, the conchae, the palate above the teeth.
fn nose_walls(m: Points) -> Vec4 {
    let septum = slab(m, v(0.0, -56.0, -17.0), v(0.9, 24.0, 17.0), 0.6);
    let palate = slab(m, v(0.0, -56.0, -38.0), v(20.0, 24.0, 2.4), 1.5);
    let concha = |z: f32, x: f32| limb(m, (v(x, -70.0, z), 1.5), (v(x, -38.0, z + 2.0), 1.5));
    septum.min(palate).min(concha(-28.0, 8.5)).min(concha(-16.0, 7.5))
}

/// The lower jaw: an arched body, the branches with two heads each.
pub fn jaw(m: Points) -> Vec4 {
    // A plate stood on edge along an arch, its middle line rising to the back.
    let arch = [v(0.0, -80.5, 0.0), v(14.0, -77.0, 0.0), v(27.0, -58.0, 0.0), v(38.0, -34.0, 0.0), v(45.0, -10.0, 0.0)];
    let flat = at(m.x, m.y, 0.0);
    let across = arch.windows(2).map(|s| limb(flat, (s[0], 0.0), (s[1], 0.0))).fold(Vec4::INFINITY, Vec4::min);
    let rise = 0.13 * (m.y + 82.0);
    let height = m.z + 83.5 - rise;
    let plate = at((across - 3.2).max(Vec4::ZERO), (height.abs() - 10.5).max(Vec4::ZERO), 0.0).length() - 3.2;
    let body = meet(plate, m.y + 14.0, 6.0);
    let chin = ellipsoid(m, v(6.0, -84.0, -93.0), v(12.0, 5.0, 6.0));
    // The branch is flat: distances across count double.
    let leaned = at((m.x - 46.5 - 0.06 * (m.z + 45.0)) * 1.9, m.y, m.z);
    let branch = chain(leaned, &[(v(0.0, -10.0, -66.0), 10.5), (v(0.0, -6.0, -46.0), 10.0), (v(0.0, 2.0, -24.0), 4.5)]);
    let muscle_head =
        chain(leaned, &[(v(0.0, -24.0, -62.0), 9.0), (v(0.0, -20.0, -44.0), 8.5), (v(0.0, -24.0, -22.0), 2.5)]);
    let joint_head = ellipsoid(m, v(50.0, 2.5, -20.0), v(9.0, 4.5, 4.5));
    let branch = join(branch, muscle_head, 5.0) * 0.6;
    let nerve = limb(m, (v(22.5, -76.0, -86.0), 1.6), (v(19.0, -66.0, -86.0), 1.4));
    carve(join(join(join(body, branch, 6.0), chin, 6.0), joint_head, 3.0), nerve, 1.5)
}

/// Vertebrae of the neck: the atlas as a ring, the others with body, arch and processes.
pub fn spine(m: Points) -> Vec4 {
    let squeezed = at(m.x * 0.85, m.y, m.z);
    let atlas = ring(squeezed, v(0.0, 29.0, -50.0), Vec3::Z, 17.5, 4.0)
        .min(ellipsoid(m, v(21.0, 22.0, -48.0), v(8.0, 10.0, 7.0)))
        .min(limb(m, (v(24.0, 24.0, -50.0), 5.0), (v(37.0, 26.0, -50.0), 3.5)));
    let dens = limb(m, (v(0.0, 15.0, -62.0), 6.0), (v(0.0, 13.0, -42.0), 3.5));
    // One vertebra every 18 mm from the second on; `middle` is the height of the second one.
    let nearest = |middle: f32| {
        let number = ((middle + 9.0 - m.z) / 18.0).floor().max(Vec4::ZERO);
        at(m.x, m.y, m.z - middle + 18.0 * number)
    };
    let q = nearest(-66.0);
    let body = slab(q, v(0.0, 16.0, 0.0), v(11.5, 8.5, 7.0), 3.0);
    let arch = ring(at(q.x * 0.8, q.y, q.z * 0.7), v(0.0, 32.0, -1.0), Vec3::Z, 12.5, 2.8);
    let joints = limb(q, (v(18.0, 26.0, 7.0), 4.5), (v(18.0, 29.0, -7.0), 4.5));
    let side = limb(q, (v(10.0, 16.0, 0.0), 3.5), (v(25.0, 18.0, -1.0), 3.0));
    let thorn = limb(nearest(-71.0), (v(0.0, 45.0, 2.0), 4.0), (v(2.5, 60.0, -2.0), 3.2));
    atlas.min(dens).min(join(body, join(arch, joints, 3.0).min(side), 2.0)).min(thorn)
}

/// A crown and where its root goes.
struct Tooth {
    crown: Vec3,
    /// Along the row.
    tangent: Vec3,
    half: Vec3,
    /// End of the root.
    root: Vec3,
}

/// The left half of both rows, from the middle to the back: widths in mm along the row.
static TEETH: LazyLock<Vec<Tooth>> = LazyLock::new(|| {
    const UPPER: [f32; 7] = [8.6, 6.8, 7.6, 7.0, 6.8, 10.0, 9.6];
    const LOWER: [f32; 7] = [5.6, 6.0, 7.0, 7.0, 7.2, 11.0, 10.4];
    let row = |widths: [f32; 7], front: f32, bend: f32, edge: f32, up: f32| {
        let mut x = 0.0;
        let mut teeth = Vec::new();
        for (index, width) in widths.into_iter().enumerate() {
            // Half a width along the arch y = front + bend x^2, the tooth, the other half.
            let advance = |x: f32, slope: f32| x + 0.5 * width / (1.0 + slope * slope).sqrt();
            x = advance(x, 2.0 * bend * x);
            let tangent = v(1.0, 2.0 * bend * x, 0.0).normalize();
            let (height, depth) = if index < 3 { (9.6, 5.6) } else { (7.6, 8.6) };
            let crown = v(x, front + bend * x * x, edge + up * 0.5 * height);
            let root = crown + v(0.0, 1.5, up * (0.5 * height + if index == 2 { 15.0 } else { 11.0 }));
            teeth.push(Tooth { crown, tangent, half: v(0.5 * width - 0.1, 0.5 * depth, 0.5 * height), root });
            x = advance(x, 2.0 * bend * x);
        }
        teeth
    };
    let mut teeth = row(UPPER, -85.0, 0.05, -63.0, 1.0);
    teeth.extend(row(LOWER, -82.5, 0.052, -63.4, -1.0));
    teeth
});

/// Paints enamel over dentine.
fn teeth(m: Points, value: Vec4) -> Vec4 {
    let beyond = (m - v(16.0, -66.0, -63.0)).abs() - v(22.0, 26.0, 26.0);
    if above(beyond.max_element(), BLUR).all() {
        return value;
    }
    let (mut crowns, mut roots) = (Vec4::INFINITY, Vec4::INFINITY);
    for tooth in TEETH.iter() {
        let q = m - tooth.crown;
        let along = q.dot(tooth.tangent);
        let out = q.dot(v(-tooth.tangent.y, tooth.tangent.x, 0.0));
        crowns = crowns.min(slab(at(along, out, q.z), Vec3::ZERO, tooth.half, 2.2));
        roots = roots.min(limb(m, (tooth.crown, 0.6 * tooth.half.x.min(3.6)), (tooth.root, 1.0)));
    }
    let value = mix(value, hu::DENTINE, coverage(roots, BLUR));
    let crown = mix(hu::ENAMEL, hu::DENTINE, coverage(crowns + 2.0, BLUR));
    mix(value, crown, coverage(crowns, 0.8 * BLUR))
}

/// Air inside the head: nose, sinuses, throat, windpipe, ear canals, the cells behind the ear.
pub fn airways(m: Points) -> Vec4 {
    let passage = ellipsoid(m, v(5.0, -54.0, -22.0), v(7.5, 33.0, 13.0));
    let conchae = limb(m, (v(8.5, -70.0, -28.0), 3.2), (v(8.5, -38.0, -26.0), 3.2)).min(limb(
        m,
        (v(7.5, -70.0, -16.0), 2.8),
        (v(7.5, -40.0, -14.0), 2.8),
    ));
    let nose = carve(passage, conchae, 1.5).max(0.0 - (m.x - 1.6));
    let nostril = limb(m, (v(6.8, -98.0, -39.5), 3.4), (v(6.0, -86.0, -27.0), 3.6));
    let maxillary = ellipsoid(m, v(28.0, -58.0, -27.0), v(11.0, 13.0, 12.0));
    let frontal = ellipsoid(m, v(8.0, -75.5, 24.0), v(6.5, 2.5, 6.0));
    let ethmoid = limb(m, (v(10.0, -68.0, 2.0), 3.6), (v(10.0, -44.0, 1.0), 4.2))
        .max((m.y * 0.16 - (m.y * 0.16).floor() - 0.5).abs() * 6.0 - 2.5);
    let sphenoidal = ellipsoid(m, v(8.0, -26.0, -4.0), v(6.8, 9.0, 6.8)).max(1.0 - m.x);
    let squeezed = at(m.x * 0.75, m.y, m.z);
    let throat = chain(
        squeezed,
        &[
            (v(0.0, -22.0, -26.0), 6.0),
            (v(0.0, -12.0, -42.0), 4.5),
            (v(0.0, -10.0, -72.0), 5.0),
            (v(0.0, -14.0, -98.0), 6.5),
            (v(0.0, -14.0, -150.0), 8.5),
        ],
    );
    let mouth = ellipsoid(m, v(0.0, -58.0, -49.0), v(19.0, 18.0, 2.4));
    let canal = limb(m, (v(84.0, 12.0, -8.0), 3.2), (v(48.0, 8.0, -9.0), 2.6));
    let behind_ear = limb(m, (v(47.0, 22.0, -13.0), 5.5), (v(47.0, 20.0, -27.0), 2.5));
    let close = below(behind_ear, 3.0);
    let cells = if close.any() {
        Vec4::select(close, behind_ear.max(0.4 - 3.0 * smooth(m / 3.6, 35)), behind_ear)
    } else {
        behind_ear
    };
    let front = nose.min(nostril).min(maxillary).min(frontal).min(ethmoid).min(sphenoidal);
    front.min(throat).min(mouth).min(canal).min(cells)
}

/// What lies between skin and bone: muscle, fat between the neck's muscles, the eyes. The skin is
/// `surface` mm away.
pub fn deep_soft_tissue(p: Points, parts: &Parts, surface: Vec4) -> Vec4 {
    let flesh = muscles(p, surface);
    if parts.orbits { eye(mirrored(p), flesh) } else { flesh }
}

fn muscles(p: Points, surface: Vec4) -> Vec4 {
    let plain = above(p.z, -5.0) | above(surface, -4.0);
    let muscle = Vec4::splat(hu::MUSCLE);
    if plain.all() {
        return muscle;
    }
    // Sheets of fat between muscles: where slow noise crosses zero.
    let strand = at(p.x / 15.0, p.y / 15.0, p.z / 40.0);
    let sheets = smooth(strand, 36).abs() * 16.0 - 0.9;
    let sheeted = mix(hu::MUSCLE, mix(hu::FAT, hu::MUSCLE, 0.25), coverage(meet(sheets, p.z + 8.0, 6.0), BLUR));
    Vec4::select(plain, muscle, sheeted)
}

/// The cone of fat that an eye lies in.
pub fn orbits(m: Points) -> Vec4 {
    limb(m, (v(31.0, -74.0, 2.0), 17.0), (v(14.0, -36.0, 4.0), 4.0))
}

/// The eyeball with its lens, nerve and muscles, in fat, among `flesh`.
fn eye(m: Points, flesh: Vec4) -> Vec4 {
    let strands = [(40.0, -66.0, 2.0), (22.0, -66.0, 2.0), (31.0, -64.0, 11.5), (31.0, -64.0, -7.5)];
    let strand = |(x, y, z): (f32, f32, f32)| limb(m, (v(x, y, z), 1.8), (v(15.0, -40.0, 4.0), 1.4));
    let nerve = limb(m, (v(28.0, -61.0, 2.0), 2.0), (v(14.0, -34.0, 4.0), 2.0));
    let muscles = strands.into_iter().map(strand).fold(nerve, Vec4::min);
    let ball = sphere(m, skin::EYE, 12.2);
    let lens = ellipsoid(m, skin::EYE - v(0.0, 7.6, 0.0), v(4.6, 2.2, 4.6));
    let value = mix(flesh, hu::FAT, coverage(orbits(m), BLUR));
    let value = mix(value, hu::MUSCLE, coverage(muscles.min(ball), BLUR));
    let value = mix(value, hu::VITREOUS, coverage(ball + 1.4, BLUR));
    mix(value, hu::LENS, coverage(lens, BLUR))
}
