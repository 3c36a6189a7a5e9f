//! The outside: the form of the head, the face, the ears, and the layers under the skin.

use glam::{Vec3, Vec4};

use super::super::shape::{
    Points, above, at, below, carve, chain, coverage, ellipsoid, join, limb, meet, mirrored, mix, ring, sphere, v,
};
use super::{BLUR, hu};

/// Thickness of the skin, mm.
const SKIN: f32 = 2.2;

/// Thickness of the fat under the skin, mm: thin over the skull, thicker below.
fn fat(p: Points) -> Vec4 {
    mix(2.2, 5.0, coverage(p.z - 10.0, 60.0))
}

/// How deep skin and fat reach within some mm of `p`, their blurred edge included, mm.
pub fn depth(p: Points) -> Vec4 {
    SKIN + fat(p) + 0.5 + 0.5 * BLUR
}

/// Distance to the skin, mm.
pub fn surface(p: Points) -> Vec4 {
    surface_over(p, scalp(p))
}

/// The same where the distance to the [`scalp`] is known.
pub fn surface_over(p: Points, scalp: Vec4) -> Vec4 {
    let m = mirrored(p);
    let mut d = join(scalp, neck(p), 24.0);
    if (below(p.y, 55.0) & below(p.z, 50.0)).all() {
        d = join(d, jaws(m), 22.0);
        if (below(p.y, -30.0) & below(p.z, 45.0)).all() {
            d = eyes(m, d);
            d = nose(m, d);
            d = mouth(m, d);
        }
    }
    let beside = above(m.x, 55.0) & !below(p.y, -45.0) & below(p.y, 70.0);
    if beside.any() { Vec4::select(beside, ear(m, d), d) } else { d }
}

/// The upper head, from brow to nape: a narrower front and a broader back.
pub fn scalp(p: Points) -> Vec4 {
    let front = ellipsoid(p, v(0.0, -20.0, 38.0), v(65.0, 68.0, 70.0));
    let back = ellipsoid(p, v(0.0, 28.0, 40.0), v(75.0, 76.0, 73.0));
    let nape = ellipsoid(p, v(0.0, 40.0, -4.0), v(58.0, 54.0, 40.0));
    join(join(front, back, 36.0), nape, 24.0)
}

fn neck(p: Points) -> Vec4 {
    // Broader than deep, leaning forward on its way up.
    let squeezed = at(p.x * 0.94, p.y, p.z);
    chain(squeezed, &[(v(0.0, 26.0, -150.0), 60.0), (v(0.0, 22.0, -70.0), 53.0), (v(0.0, 20.0, -20.0), 52.0)])
}

/// Cheeks, jaw and chin.
fn jaws(m: Points) -> Vec4 {
    let midface = ellipsoid(m, v(0.0, -38.0, -14.0), v(60.0, 46.0, 46.0));
    let cheek = ellipsoid(m, v(38.0, -56.0, -24.0), v(22.0, 20.0, 20.0));
    let muzzle = ellipsoid(m, v(0.0, -58.0, -52.0), v(36.0, 36.0, 32.0));
    let side = ellipsoid(m, v(48.0, -18.0, -24.0), v(21.5, 43.0, 42.0));
    let jaw = chain(m, &[(v(48.0, 2.0, -46.0), 11.0), (v(43.0, -20.0, -70.0), 14.0), (v(18.0, -68.0, -88.0), 14.0)]);
    let floor = ellipsoid(m, v(0.0, -36.0, -74.0), v(44.0, 42.0, 22.0));
    let chin = ellipsoid(m, v(0.0, -80.0, -88.0), v(17.0, 14.0, 14.0));
    let face = join(join(join(midface, cheek, 18.0), muzzle, 24.0), side, 20.0);
    join(join(face, join(jaw, floor, 16.0), 22.0), chin, 14.0)
}

/// Brow ridge, eye sockets, and closed lids over the eyeballs.
fn eyes(m: Points, head: Vec4) -> Vec4 {
    let brow = chain(m, &[(v(9.0, -83.0, 15.0), 5.5), (v(26.0, -81.0, 20.0), 5.5), (v(45.0, -67.0, 13.0), 5.0)]);
    let socket = ellipsoid(m, v(30.5, -90.0, 2.0), v(17.0, 14.0, 11.5));
    let ball = sphere(m, EYE, 13.4);
    let d = carve(join(head, brow, 13.0), socket, 12.0);
    let d = join(d, ball, 3.5);
    // The crease above the lid and the slit between the lids, on the ball's surface.
    let q = m - EYE;
    let bow = 0.012 * (m.x - 31.0) * (m.x - 31.0);
    let slit = meet((q.z + 4.5 - bow).abs() - 0.5, (m.x - 31.5).abs() - 13.0, 2.0);
    let crease = meet((q.z - 6.5 + bow).abs() - 0.5, (m.x - 31.0).abs() - 14.0, 3.0);
    let skin_deep = (d + 1.2).abs() - 1.6;
    let in_front = m.y + 66.0;
    let groove = slit.min(crease + 0.3).max(skin_deep).max(in_front);
    carve(d, groove, 1.6)
}

/// Middle of the left eyeball.
pub const EYE: Vec3 = v(31.0, -72.5, 2.0);

fn nose(m: Points, head: Vec4) -> Vec4 {
    let bridge = chain(m, &[(v(0.0, -85.0, 9.0), 6.0), (v(0.0, -94.0, -8.0), 6.5), (v(0.0, -105.0, -27.0), 7.0)]);
    let tip = sphere(m, v(0.0, -105.5, -30.0), 8.4);
    let side = limb(m, (v(5.0, -84.0, -2.0), 8.0), (v(10.0, -90.0, -28.0), 9.0));
    let wing = ellipsoid(m, v(11.5, -94.0, -33.0), v(6.5, 9.5, 6.5));
    let columella = limb(m, (v(0.0, -103.0, -35.0), 3.2), (v(0.0, -91.0, -40.0), 4.0));
    let d = join(head, side, 16.0);
    let d = join(d, join(bridge, tip, 8.0), 6.0);
    let d = join(join(d, wing, 4.0), columella, 4.0);
    let nostril = limb(m, (v(6.8, -98.0, -39.5), 3.6), (v(6.0, -90.0, -26.0), 3.6));
    carve(d, nostril, 2.5)
}

/// Lips with the slit between them, the groove above and the fold below.
fn mouth(m: Points, head: Vec4) -> Vec4 {
    let upper = chain(m, &[(v(0.0, -92.5, -54.2), 3.4), (v(5.5, -92.6, -53.4), 4.0), (v(24.0, -80.5, -58.6), 2.2)]);
    let lower = chain(m, &[(v(0.0, -91.2, -64.2), 5.4), (v(11.0, -88.8, -63.2), 4.8), (v(23.5, -80.5, -59.4), 2.0)]);
    let d = join(join(head, upper, 6.0), lower, 6.0);
    let slit = chain(m, &[(v(0.0, -97.4, -58.8), 1.3), (v(8.0, -95.6, -58.2), 1.3), (v(21.0, -89.5, -59.6), 0.9)]);
    let philtrum = limb(m, (v(0.0, -96.5, -42.0), 2.6), (v(0.0, -98.0, -51.0), 3.2));
    let fold = limb(m, (v(0.0, -96.0, -72.5), 5.0), (v(12.0, -92.0, -72.5), 4.0));
    let d = carve(d, slit, 2.0);
    carve(carve(d, philtrum, 3.0), fold, 7.0)
}

/// The left ear: a tilted shell with rim, hollow, lobe and the canal's entrance.
fn ear(m: Points, head: Vec4) -> Vec4 {
    // Ear coordinates: a to the front along the shell, b outwards, c up.
    let q = m - v(74.0, 14.0, 0.0);
    let (a, b, c) = (-0.86 * q.y + -0.5 * q.x, 0.86 * q.x - 0.5 * q.y, q.z + 0.2 * q.y);
    let e = at(a, b, c);
    let shell = ellipsoid(e, v(-8.0, 4.0, 2.0), v(17.0, 4.5, 30.0));
    let squashed = at(a * 1.75, b, c);
    let helix = ring(squashed, v(-14.0, 6.5, 5.0), Vec3::Y, 24.5, 3.0);
    let helix = meet(helix, -20.0 - c, 6.0);
    let antihelix = chain(e, &[(v(-10.0, 7.0, 18.0), 2.4), (v(-13.0, 7.5, 2.0), 2.8), (v(-6.0, 6.5, -13.0), 2.8)]);
    let lobe = ellipsoid(e, v(-3.0, 4.0, -25.0), v(8.0, 4.0, 8.0));
    let tragus = ellipsoid(e, v(4.5, 6.0, -5.0), v(3.5, 4.0, 6.0));
    let concha = ellipsoid(e, v(-3.0, 8.0, -2.0), v(7.5, 7.0, 12.0));
    let d = join(join(shell, helix, 3.0), lobe, 6.0);
    let d = join(d, antihelix, 2.5);
    let d = join(head, d, 7.0);
    join(carve(d, concha, 3.0), tragus, 3.0)
}

/// Covers the flesh, `value`, with fat and skin, given the distances to the skin's `surface` and to the
/// [`scalp`].
pub fn layers(p: Points, surface: Vec4, scalp: Vec4, value: Vec4) -> Vec4 {
    // Cartilage in place of fat in the ears.
    let in_ear = above(p.x.abs(), 76.0) & !below(p.y, -5.0) & below(p.y, 50.0) & above(scalp, 1.0);
    let fat = mix(hu::FAT, value, coverage(surface + SKIN + fat(p), BLUR));
    let value = Vec4::select(in_ear, Vec4::splat(hu::CARTILAGE), fat);
    mix(hu::SKIN, value, coverage(surface + SKIN, BLUR))
}
