//! Vessels full of contrast agent: drawn trunks, and branches that grow by themselves.

use glam::{Vec3, Vec4};

use super::super::random::{hash, signed};
use super::super::shape::{Points, at, limb, v};
use super::{brain, hu, skin};

/// A piece of a vessel: a limb filled to `hu`.
#[derive(Clone, Copy, Debug)]
pub struct Vessel {
    from: (Vec3, f32),
    to: (Vec3, f32),
    pub hu: f32,
}

impl Vessel {
    /// Whether it comes within `reach` mm of the plane across `axis` (0, 1, 2) at `at`.
    pub fn near_plane(&self, axis: usize, at: f32, reach: f32) -> bool {
        let (from, to) = (self.from.0[axis] - at, self.to.0[axis] - at);
        let thickest = self.from.1.max(self.to.1);
        from.min(to) < reach + thickest && from.max(to) > -reach - thickest
    }

    /// Whether it may come within `reach` mm of `p`: a ball around it does.
    pub fn near(&self, p: Vec3, reach: f32) -> bool {
        let half = 0.5 * (self.to.0 - self.from.0);
        let beyond = reach + half.length() + self.from.1.max(self.to.1);
        (self.from.0 + half - p).length_squared() < beyond * beyond
    }

    /// mm to its wall.
    pub fn distance(&self, p: Points) -> Vec4 {
        limb(p, self.from, self.to)
    }
}

/// Pieces are about this long, mm.
const PIECE: f32 = 4.0;

/// Every vessel of the head. Left and right are drawn alike and wander each in its own way.
pub fn tree() -> Vec<Vessel> {
    let mut tree = Tree { vessels: Vec::new(), seed: 0 };
    for side in [1.0, -1.0] {
        tree.carotid(side);
        tree.circle_of_willis(side);
        tree.vertebral(side);
        tree.scalp(side);
        tree.sinuses(side);
    }
    tree.midline();
    tree.vessels
}

struct Tree {
    vessels: Vec<Vessel>,
    /// Counts random decisions.
    seed: u32,
}

/// A surface to grow along, and how far below it, mm.
#[derive(Clone, Copy)]
struct Bed {
    surface: fn(Points) -> Vec4,
    depth: f32,
}

const CORTEX: Bed = Bed { surface: brain::cavity, depth: 3.5 };
const SCALP: Bed = Bed { surface: skin::surface, depth: 4.0 };
const FACE: Bed = Bed { surface: skin::surface, depth: 6.5 };

impl Bed {
    fn normal(&self, p: Vec3) -> Vec3 {
        const STEP: f32 = 1.5;
        let (first, second) = (Vec4::new(STEP, -STEP, 0.0, 0.0), Vec4::new(0.0, 0.0, STEP, -STEP));
        let across = (self.surface)(at(p.x + first, p.y + second, p.z));
        let up = (self.surface)(at(p.x, p.y, p.z + first));
        v(across.x - across.y, across.z - across.w, up.x - up.y).normalize_or(Vec3::Z)
    }

    /// Of a point above the surface, mm.
    fn height(&self, p: Vec3) -> f32 {
        (self.surface)(Points::all(p)).x
    }

    /// The point nearby that lies as deep as the bed.
    fn settle(&self, p: Vec3) -> Vec3 {
        (0..3).fold(p, |p, _| p - self.normal(p) * (self.height(p) + self.depth))
    }
}

impl Tree {
    /// The next random number in -1..=1.
    fn random(&mut self) -> f32 {
        self.seed += 1;
        signed(hash(self.seed as i32, 0, 0, 41))
    }

    /// A smooth course through points with radii (Catmull-Rom), wandering a little, on one side.
    fn course(&mut self, hu: f32, side: f32, points: &[(f32, f32, f32, f32)]) {
        let place = |&(x, y, z, r): &(f32, f32, f32, f32)| (v(side * x, y, z), r);
        let points: Vec<(Vec3, f32)> = points.iter().map(place).collect();
        let mut last = points[0];
        for i in 0..points.len() - 1 {
            let ((a, ra), (b, rb)) = (points[i], points[i + 1]);
            let before = points[i.saturating_sub(1)].0;
            let after = points[(i + 2).min(points.len() - 1)].0;
            let (leave, arrive) = ((b - before) * 0.5, (after - a) * 0.5);
            let pieces = ((b - a).length() / PIECE).ceil().max(1.0) as usize;
            for piece in 1..=pieces {
                let t = piece as f32 / pieces as f32;
                let (t2, t3) = (t * t, t * t * t);
                let mut p = a * (2.0 * t3 - 3.0 * t2 + 1.0)
                    + leave * (t3 - 2.0 * t2 + t)
                    + b * (3.0 * t2 - 2.0 * t3)
                    + arrive * (t3 - t2);
                if piece < pieces {
                    p += v(self.random(), self.random(), self.random()) * 0.45;
                }
                let next = (p, ra + (rb - ra) * t);
                self.vessels.push(Vessel { from: last, to: next, hu });
                last = next;
            }
        }
    }

    /// Grows a branch along a bed from `p` until it is too thin, forking on its way.
    fn sprout(&mut self, bed: Bed, p: Vec3, heading: Vec3, radius: f32, hu: f32) {
        const THINNEST: f32 = 0.55;
        let mut tip = (bed.settle(p), radius);
        let mut heading = heading.normalize_or(Vec3::Z);
        let mut since_fork = 0;
        while tip.1 > THINNEST {
            let normal = bed.normal(tip.0);
            let sideways = normal.cross(heading);
            heading += sideways * (0.55 * self.random());
            heading = (heading - normal * heading.dot(normal)).normalize_or(sideways);
            let next = (bed.settle(tip.0 + heading * PIECE), tip.1 * 0.974);
            // The front edge of a bed is sharp: a branch that cannot settle ends.
            if (bed.height(next.0) + bed.depth).abs() > 1.5 || next.0.x.abs() < 3.0 {
                return;
            }
            self.vessels.push(Vessel { from: tip, to: next, hu });
            tip = next;
            since_fork += 1;
            if since_fork > 4 && self.random() > 0.5 {
                since_fork = 0;
                let turn = if self.random() > 0.0 { 0.8 } else { -0.8 };
                self.sprout(bed, tip.0, heading + normal.cross(heading) * turn, tip.1 * 0.8, hu);
                tip.1 *= 0.92;
            }
        }
    }

    /// From the neck through the skull's base to the circle of Willis; the outer branch to the face.
    fn carotid(&mut self, side: f32) {
        self.course(
            hu::ARTERY,
            side,
            &[
                (25.0, 0.0, -128.0, 3.4),
                (26.0, -4.0, -96.0, 3.6),
                (28.0, 4.0, -70.0, 2.7),
                (26.0, 8.0, -36.0, 2.6),
                (24.0, 5.0, -18.0, 2.5),
                (14.0, -5.0, -12.0, 2.5),
                (9.0, -18.0, -8.0, 2.4),
                (10.0, -29.0, -2.0, 2.3),
                (10.0, -22.0, 9.0, 2.2),
            ],
        );
        self.course(
            hu::ARTERY,
            side,
            &[
                (26.0, -4.0, -96.0, 2.6),
                (34.0, -8.0, -78.0, 2.3),
                (48.0, 4.0, -50.0, 2.1),
                (61.0, 3.0, -26.0, 1.9),
                (70.0, 2.0, -8.0, 1.7),
            ],
        );
        // Around the jaw to the corner of the eye, under the skin.
        let mut facial = vec![(31.0, -8.0, -84.0, 1.5)];
        let under_skin = [
            (40.0, -26.0, -84.0, 1.5),
            (47.0, -44.0, -70.0, 1.4),
            (33.0, -74.0, -58.0, 1.2),
            (22.0, -84.0, -38.0, 1.1),
            (16.0, -86.0, -14.0, 0.9),
            (15.0, -84.0, 4.0, 0.7),
        ];
        facial.extend(under_skin.map(|(x, y, z, r)| {
            let p = FACE.settle(v(x, y, z));
            (p.x, p.y, p.z, r)
        }));
        self.course(hu::ARTERY, side, &facial);
        self.course(hu::ARTERY, side, &[(55.0, 4.0, -36.0, 1.4), (40.0, -14.0, -30.0, 1.3), (28.0, -30.0, -28.0, 1.0)]);
    }

    /// Anterior, middle and posterior cerebral arteries and what ties them together.
    fn circle_of_willis(&mut self, side: f32) {
        self.course(
            hu::ARTERY,
            side,
            &[(10.0, -22.0, 9.0, 2.0), (22.0, -25.0, 9.0, 1.9), (36.0, -24.0, 10.0, 1.7), (46.0, -20.0, 14.0, 1.5)],
        );
        self.course(
            hu::ARTERY,
            side,
            &[
                (10.0, -22.0, 9.0, 1.7),
                (3.0, -34.0, 14.0, 1.6),
                (2.0, -48.0, 26.0, 1.5),
                (2.0, -48.0, 44.0, 1.4),
                (2.0, -26.0, 60.0, 1.3),
                (2.2, 6.0, 64.0, 1.1),
                (2.2, 34.0, 62.0, 0.9),
            ],
        );
        self.course(hu::ARTERY, side, &[(2.0, -48.0, 40.0, 1.1), (2.5, -60.0, 56.0, 1.0), (3.0, -48.0, 78.0, 0.8)]);
        self.course(hu::ARTERY, side, &[(2.0, -26.0, 60.0, 1.0), (2.5, -16.0, 78.0, 0.9), (4.0, 4.0, 94.0, 0.7)]);
        self.course(
            hu::ARTERY,
            side,
            &[
                (0.0, -7.0, 3.0, 1.8),
                (14.0, -2.0, 6.0, 1.7),
                (25.0, 14.0, 10.0, 1.5),
                (22.0, 40.0, 14.0, 1.3),
                (13.0, 66.0, 20.0, 1.0),
                (6.0, 84.0, 28.0, 0.8),
            ],
        );
        self.course(hu::ARTERY, side, &[(10.0, -21.0, 6.0, 1.0), (10.0, -5.0, 5.0, 1.0)]);
        let fork = v(side * 46.0, -20.0, 14.0);
        let headings = [(-0.9, 0.5), (-0.45, 0.9), (0.1, 1.0), (0.6, 0.8), (1.0, 0.35), (0.9, -0.2)];
        for (back, up) in headings {
            self.course(hu::ARTERY, 1.0, &{
                let start = CORTEX.settle(fork + v(side * 10.0, 12.0 * back, 4.0 + 8.0 * up));
                [(fork.x, fork.y, fork.z, 1.4), (start.x, start.y, start.z, 1.25)]
            });
            self.sprout(
                CORTEX,
                fork + v(side * 10.0, 12.0 * back, 4.0 + 8.0 * up),
                v(side * 0.3, back, up),
                1.25,
                hu::ARTERY,
            );
        }
    }

    /// Up through the vertebrae, joining before the brain stem.
    fn vertebral(&mut self, side: f32) {
        self.course(
            hu::ARTERY,
            side,
            &[
                (19.0, 17.0, -128.0, 1.9),
                (19.0, 17.0, -66.0, 1.9),
                (28.0, 21.0, -52.0, 1.9),
                (22.0, 36.0, -44.0, 1.8),
                (9.0, 26.0, -38.0, 1.8),
                (0.0, 6.0, -24.0, 1.8),
            ],
        );
    }

    /// The superficial temporal artery with its branches to forehead and crown; the back of the head.
    fn scalp(&mut self, side: f32) {
        let ear = SCALP.settle(v(side * 72.0, -2.0, 0.0));
        let temple = SCALP.settle(v(side * 72.0, -8.0, 22.0));
        self.course(
            hu::ARTERY,
            1.0,
            &[(side * 70.0, 2.0, -8.0, 1.7), (ear.x, ear.y, ear.z, 1.6), (temple.x, temple.y, temple.z, 1.5)],
        );
        self.sprout(SCALP, temple, v(0.0, -1.0, 0.7), 1.35, hu::ARTERY);
        self.sprout(SCALP, temple, v(0.0, 0.25, 1.0), 1.35, hu::ARTERY);
        let nape = SCALP.settle(v(side * 34.0, 86.0, -8.0));
        self.course(
            hu::ARTERY,
            1.0,
            &[(side * 48.0, 4.0, -50.0, 1.6), (side * 50.0, 40.0, -44.0, 1.5), (nape.x, nape.y, nape.z, 1.3)],
        );
        self.sprout(SCALP, nape, v(side * 0.2, 0.2, 1.0), 1.2, hu::ARTERY);
    }

    /// Transverse and sigmoid sinus, and the jugular vein down the neck.
    fn sinuses(&mut self, side: f32) {
        let wall = |x: f32, y: f32, z: f32| CORTEX.settle(v(side * x, y, z));
        let [back, corner, front] = [wall(14.0, 90.0, 8.0), wall(48.0, 66.0, 4.0), wall(54.0, 40.0, -2.0)];
        let at = |p: Vec3, r: f32| (p.x, p.y, p.z, r);
        self.course(
            hu::VEIN,
            1.0,
            &[
                at(v(0.0, 92.0, 12.0), 3.4),
                at(back, 3.2),
                at(corner, 3.2),
                at(front, 3.2),
                (side * 46.0, 28.0, -20.0, 3.4),
                (side * 32.0, 14.0, -32.0, 3.8),
                (side * 34.0, 14.0, -60.0, 4.2),
                (side * 36.0, 10.0, -128.0, 5.0),
            ],
        );
    }

    /// The basilar artery, the anterior communicating artery and the superior sagittal sinus.
    fn midline(&mut self) {
        self.course(hu::ARTERY, 1.0, &[(0.0, 6.0, -24.0, 2.1), (0.0, -5.0, -10.0, 2.1), (0.0, -7.0, 4.0, 2.0)]);
        self.course(hu::ARTERY, 1.0, &[(-3.0, -34.0, 14.0, 1.1), (3.0, -34.0, 14.0, 1.1)]);
        let crown = [
            (-72.0, 48.0, 1.2),
            (-60.0, 74.0, 1.8),
            (-30.0, 96.0, 2.3),
            (10.0, 102.0, 2.7),
            (50.0, 92.0, 3.0),
            (80.0, 66.0, 3.2),
            (92.0, 36.0, 3.4),
        ];
        let mut sinus: Vec<_> =
            crown.iter().map(|&(y, z, r)| (CORTEX.settle(v(0.0, y, z)), r)).map(|(p, r)| (0.0, p.y, p.z, r)).collect();
        sinus.push((0.0, 92.0, 12.0, 3.4));
        self.course(hu::VEIN, 1.0, &sinus);
    }
}
