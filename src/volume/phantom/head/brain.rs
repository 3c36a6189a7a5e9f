//! What the skull holds: the cavity, the brain's folds, its ventricles.

use glam::Vec4;

use super::super::random::smooth;
use super::super::shape::{Points, below, chain, coverage, ellipsoid, join, meet, mirrored, mix, v};
use super::{BLUR, hu, skin};

/// Scalp and bone together, mm.
const COVER: f32 = 13.0;

/// Distance to the inside of the skull, mm: the scalp's form, further in, on a base of three steps.
pub fn cavity(p: Points) -> Vec4 {
    cavity_under(p, skin::scalp(p))
}

/// The same where the distance to the [`skin::scalp`] is known.
pub fn cavity_under(p: Points, scalp: Vec4) -> Vec4 {
    let m = mirrored(p);
    // The floor falls from the roofs of the eye sockets to the back.
    let front = 14.0 - 0.2 * (p.y + 30.0) - p.z;
    let temples = ellipsoid(m, v(36.0, -14.0, 4.0), v(25.0, 29.0, 22.0));
    let back = ellipsoid(p, v(0.0, 52.0, -4.0), v(52.0, 44.0, 33.0));
    let base = join(front, join(temples, back, 8.0), 12.0);
    meet(scalp + COVER, base, 8.0)
}

/// Hounsfield units inside the cavity, whose wall is `cavity` mm away.
pub fn value(p: Points, cavity: Vec4) -> Vec4 {
    let m = mirrored(p);
    // The sheets of dura between the hemispheres and over the cerebellum.
    let tent = p.z - (8.0 + 0.35 * (60.0 - p.y).min(Vec4::splat(30.0)) - 0.12 * m.x);
    let below_tent = meet(tent, 8.0 - p.y, 6.0);
    let falx = m.x.max(24.0 - p.z + 0.2 * (p.y.abs() - 20.0));
    let under = below(below_tent, 0.0);
    let matter = if under.all() { Vec4::ZERO } else { cerebrum(p, m, cavity) };
    let matter = if under.any() { Vec4::select(under, cerebellum(p, m), matter) } else { matter };
    // Fluid around everything, in the fissures and in the ventricles.
    let matter = mix(matter, hu::FLUID, coverage(falx - 1.4, BLUR));
    let matter = mix(matter, hu::FLUID, coverage(below_tent.abs() - 1.2, BLUR));
    // The ventricles lie deep.
    let deep = below(cavity, -10.0);
    let matter = if deep.any() {
        Vec4::select(deep, mix(matter, hu::FLUID, coverage(ventricles(m), BLUR)), matter)
    } else {
        matter
    };
    mix(matter, hu::FLUID, coverage(-cavity - 2.0, BLUR))
}

/// Folded grey matter around white matter, with grey cores.
fn cerebrum(p: Points, m: Points, cavity: Vec4) -> Vec4 {
    let fold = smooth(p / 13.0, 21) + 0.45 * smooth(p / 6.5, 22);
    // Where the noise crosses zero runs a furrow, deeper ones where it crosses steeply.
    let depth = -cavity;
    let furrow = fold.abs() * 11.0 + 0.12 * depth;
    let cores = ellipsoid(m, v(20.0, -6.0, 20.0), v(10.0, 22.0, 11.0));
    let white = coverage(6.5 - furrow.min(depth - 1.0), 4.0);
    let matter = mix(hu::GREY_MATTER, hu::WHITE_MATTER, white);
    let matter = mix(matter, hu::GREY_MATTER, coverage(cores, BLUR));
    mix(matter, hu::FLUID, coverage(furrow - 2.6, BLUR))
}

/// Thin leaves, and the brain stem in front of them.
fn cerebellum(p: Points, m: Points) -> Vec4 {
    let leaf = (p.z + 0.004 * (p.y - 40.0) * (p.y - 40.0) + 3.0 * smooth(p / 16.0, 23)) / 4.2;
    let leaf = (leaf - leaf.floor() - 0.5).abs();
    let matter = mix(hu::FLUID + 12.0, hu::GREY_MATTER, (leaf * 4.0).min(Vec4::ONE));
    let core = ellipsoid(m, v(12.0, 46.0, -8.0), v(20.0, 18.0, 10.0));
    let stem = chain(p, &[(v(0.0, 2.0, 6.0), 14.0), (v(0.0, 8.0, -12.0), 14.0), (v(0.0, 26.0, -44.0), 8.0)]);
    mix(matter, hu::WHITE_MATTER, coverage(core.min(stem), BLUR))
}

/// The lateral ventricles' horns, the third and the fourth ventricle.
fn ventricles(m: Points) -> Vec4 {
    let lateral = chain(
        m,
        &[
            (v(9.0, -38.0, 30.0), 3.5),
            (v(8.0, -14.0, 38.0), 5.0),
            (v(14.0, 22.0, 38.0), 5.5),
            (v(26.0, 36.0, 26.0), 6.5),
            (v(33.0, 14.0, 6.0), 3.5),
            (v(32.0, -8.0, 2.0), 2.5),
        ],
    );
    let occipital = chain(m, &[(v(26.0, 36.0, 26.0), 5.0), (v(20.0, 62.0, 22.0), 2.5)]);
    let third = ellipsoid(m, v(0.0, 0.0, 20.0), v(2.5, 14.0, 10.0));
    let fourth = ellipsoid(m, v(0.0, 26.0, -10.0), v(6.0, 5.0, 10.0));
    lateral.min(occipital).min(third).min(fourth)
}
