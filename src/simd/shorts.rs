//! Pixels of four 16-bit numbers, four at once: what voxels of a table are shaded, resampled and blended by.
//!
//! Numbers are fractions in units of 1 / [`UNIT`], and products are rounded to the nearest one. A register holds four
//! pixels, where it held two of 32 bits, and all of a step is one instruction for the four. The steps are told twice, as
//! those of [`wide`](super::wide) are: plainly, and in AVX2's own terms, with the same bits.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(test)]
mod tests;

use super::masks::Masks;
use super::wide::Portable;

/// 1.
pub const UNIT: i16 = i16::MAX;

/// Red, green, blue and opacity, or what is made into them, in units of 1 / [`UNIT`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C, align(8))]
pub struct Short(pub [i16; 4]);

/// Pixels of a register.
pub const FOUR: usize = 4;

/// A light's factor on a colour and its addend, which are at most twice [`UNIT`], in units of 2 / [`UNIT`].
pub type ShortLight = [i16; 2];

/// Weights of the voxel before a pixel and the one after it, of the upper and of the lower scanline.
#[derive(Clone, Copy, Debug)]
pub struct ShortWeights {
    pub upper: [i16; 2],
    pub lower: [i16; 2],
}

/// Entries along either side of a table of slabs, the last one twice: positions have eight bits before the point.
pub const SLAB_ENTRIES: usize = 257;

/// Bits of a position on the axis of a table of slabs behind the point.
pub const POSITION_BITS: u32 = 7;

/// Slabs by `front * SLAB_ENTRIES + back`: premultiplied colour and opacity.
pub type ShortSlabs = [Short; SLAB_ENTRIES * SLAB_ENTRIES];

/// Components of a [`Short`] that is a sample of what slabs are told by: a light and a position on the axis of a table of slabs. Before it is looked up on that
/// axis the latter is a scalar.
pub const FACTOR: usize = 0;
/// See [`FACTOR`].
pub const ADDEND: usize = 1;
/// See [`FACTOR`].
pub const POSITION: usize = 2;

/// A way to take four pixels through a step. Implementations are `#[inline(always)]`.
pub trait Shorts: Masks {
    /// Resamples the five voxels around four pixels of the `upper` and, if it is asked for, of the `lower` scanline, and blends what
    /// comes of it behind those pixels that are set in the lowest bits of `touched`. Gives the mask of those that are more opaque than
    /// `limit` then.
    fn blend<const LOWER: bool>(
        pixels: &mut [Short; FOUR],
        rows: [&[Short; FOUR + 1]; 2],
        weights: &ShortWeights,
        limit: i16,
        touched: u64,
    ) -> u64;

    /// Lights premultiplied colours and opacities and leaves them where the lowest bits of `marked` are set; elsewhere is nothing. Those of
    /// which something is left are where they are to be or, if they are `PACKED`, one after the other.
    fn shade<const PACKED: bool>(entries: [Short; FOUR], lights: [ShortLight; FOUR], marked: u64) -> [Short; FOUR];

    /// Takes from lights what is lacking of the one that casts shadows, in 255ths of it; `in_shadow` are those without.
    fn darken(lights: [ShortLight; FOUR], in_shadow: [ShortLight; FOUR], lacking: [u8; FOUR]) -> [ShortLight; FOUR];

    /// Samples of four voxels: their lights, and their scalars, which are a power of two for each code above a first one.
    fn voxels(codes: [u16; FOUR], lights: [ShortLight; FOUR], scalars: Scalars, out: &mut [Short; FOUR]);

    /// Between the five numbers around four pixels of the upper and of the lower scanline, `fractions` along them and down: `a + (b - a) f`, so that
    /// what lies between equal numbers is equal.
    fn between(rows: [&[Short; FOUR + 1]; 2], fractions: [i16; 2], out: &mut [Short; FOUR]);

    /// Puts positions in place of scalars.
    fn place(samples: &mut [Short; FOUR], positions: &Positions);

    /// Looks up the slabs between four samples in front and four behind: between the four entries around two positions, and with `LIT` lit by the mean of two
    /// lights. Blends them behind those pixels that are set in the lowest bits of `touched`. Gives the mask of those that are more opaque than
    /// `limit` then.
    fn blend_slabs<const LIT: bool>(
        table: &ShortSlabs,
        samples: [&[Short; FOUR]; 2],
        pixels: &mut [Short; FOUR],
        limit: i16,
        touched: u64,
    ) -> u64;
}

/// Scalars of fifteen bits by code.
#[derive(Clone, Copy, Debug)]
pub struct Scalars {
    /// The code of scalar 0.
    pub first_code: u16,
    /// From a code to the next there are so many scalars, as a power of two.
    pub shift: u32,
}

impl Scalars {
    /// The scalar of a code.
    #[inline(always)]
    pub fn of(self, code: u16) -> i16 {
        (code.wrapping_sub(self.first_code) << self.shift) as i16
    }
}

/// Positions on the axis of a table by scalar of fifteen bits.
pub type Positions = [i16; 1 << 15];

/// The product of two fractions.
#[inline(always)]
fn times(a: i16, b: i16) -> i16 {
    ((i32::from(a) * i32::from(b) + (1 << 14)) >> 15) as i16
}

impl Short {
    /// Nothing.
    pub const CLEAR: Self = Self([0; 4]);

    /// A part of it.
    #[inline(always)]
    pub fn times(self, part: i16) -> Self {
        Self(self.0.map(|component| times(component, part)))
    }

    /// The sum, at most 1.
    #[inline(always)]
    pub fn plus(self, other: Self) -> Self {
        let mut sum = self;
        for (sum, other) in sum.0.iter_mut().zip(other.0) {
            *sum = sum.saturating_add(other);
        }
        sum
    }

    /// Between two voxels of the upper and two of the lower scanline.
    #[inline(always)]
    pub fn resampled<const LOWER: bool>(weights: &ShortWeights, upper: [Self; 2], lower: [Self; 2]) -> Self {
        let above = upper[0].times(weights.upper[0]).plus(upper[1].times(weights.upper[1]));
        if LOWER { above.plus(lower[0].times(weights.lower[0]).plus(lower[1].times(weights.lower[1]))) } else { above }
    }

    /// Lit, at most as bright as it is opaque.
    #[inline(always)]
    pub fn lit(self, [factor, addend]: ShortLight) -> Self {
        let mut lit = self;
        let opacity = self.0[3];
        for component in &mut lit.0[..3] {
            let half = times(*component, factor).saturating_add(times(opacity, addend));
            *component = half.saturating_add(half).min(opacity);
        }
        lit
    }

    /// A part of the way to another.
    #[inline(always)]
    pub fn towards(self, other: Self, part: i16) -> Self {
        let mut between = self;
        for (a, b) in between.0.iter_mut().zip(other.0) {
            *a += times(b - *a, part);
        }
        between
    }

    /// Between two of the upper and two of the lower scanline: first down, then along.
    #[inline(always)]
    pub fn between(upper: [Self; 2], lower: [Self; 2], [along, down]: [i16; 2]) -> Self {
        upper[0].towards(lower[0], down).towards(upper[1].towards(lower[1], down), along)
    }

    /// With the position in place of the scalar.
    #[inline(always)]
    pub fn placed(mut self, positions: &Positions) -> Self {
        self.0[POSITION] = positions[self.0[POSITION] as usize % positions.len()];
        self
    }

    /// The slab between this sample and the one behind it.
    #[inline(always)]
    pub fn slab<const LIT: bool>(self, table: &ShortSlabs, back: Self) -> Self {
        let position = |sample: Self| {
            let position = sample.0[POSITION] as u16;
            let below = (1 << POSITION_BITS) - 1;
            (
                usize::from(position >> POSITION_BITS) % (SLAB_ENTRIES - 1),
                ((position & below) << (15 - POSITION_BITS)) as i16,
            )
        };
        let ((front_entry, front_part), (back_entry, back_part)) = (position(self), position(back));
        let at = front_entry * SLAB_ENTRIES + back_entry;
        let near = table[at].towards(table[at + SLAB_ENTRIES], front_part);
        let far = table[at + 1].towards(table[at + SLAB_ENTRIES + 1], front_part);
        let slab = near.towards(far, back_part);
        if LIT {
            slab.lit([FACTOR, ADDEND].map(|n| ((i32::from(self.0[n]) + i32::from(back.0[n]) + 1) >> 1) as i16))
        } else {
            slab
        }
    }

    /// A sample behind it.
    #[inline(always)]
    pub fn over(self, sample: Self) -> Self {
        self.plus(sample.times(UNIT - self.0[3]))
    }
}

impl Shorts for Portable {
    #[inline(always)]
    fn blend<const LOWER: bool>(
        pixels: &mut [Short; FOUR],
        [upper, lower]: [&[Short; FOUR + 1]; 2],
        weights: &ShortWeights,
        limit: i16,
        touched: u64,
    ) -> u64 {
        let mut samples = [Short::CLEAR; FOUR];
        for (n, sample) in samples.iter_mut().enumerate() {
            *sample = Short::resampled::<LOWER>(weights, [upper[n], upper[n + 1]], [lower[n], lower[n + 1]]);
        }
        over(pixels, samples, limit, touched)
    }

    #[inline(always)]
    fn shade<const PACKED: bool>(entries: [Short; FOUR], lights: [ShortLight; FOUR], marked: u64) -> [Short; FOUR] {
        let mut shaded = [Short::CLEAR; FOUR];
        let mut next = 0;
        for (n, shaded) in shaded.iter_mut().enumerate() {
            if marked >> n & 1 == 1 {
                let from = if PACKED { next } else { n };
                *shaded = entries[from].lit(lights[from]);
                next += 1;
            }
        }
        shaded
    }

    #[inline(always)]
    fn darken(
        mut lights: [ShortLight; FOUR],
        in_shadow: [ShortLight; FOUR],
        lacking: [u8; FOUR],
    ) -> [ShortLight; FOUR] {
        for n in 0..FOUR {
            lights[n] = darkened(lights[n], in_shadow[n], lacking[n]);
        }
        lights
    }

    #[inline(always)]
    fn voxels(codes: [u16; FOUR], lights: [ShortLight; FOUR], scalars: Scalars, out: &mut [Short; FOUR]) {
        for n in 0..FOUR {
            let [factor, addend] = lights[n];
            out[n] = Short([factor, addend, scalars.of(codes[n]), 0]);
        }
    }

    #[inline(always)]
    fn between([upper, lower]: [&[Short; FOUR + 1]; 2], fractions: [i16; 2], out: &mut [Short; FOUR]) {
        for (n, out) in out.iter_mut().enumerate() {
            *out = Short::between([upper[n], upper[n + 1]], [lower[n], lower[n + 1]], fractions);
        }
    }

    #[inline(always)]
    fn place(samples: &mut [Short; FOUR], positions: &Positions) {
        for sample in samples {
            *sample = sample.placed(positions);
        }
    }

    #[inline(always)]
    fn blend_slabs<const LIT: bool>(
        table: &ShortSlabs,
        [front, back]: [&[Short; FOUR]; 2],
        pixels: &mut [Short; FOUR],
        limit: i16,
        touched: u64,
    ) -> u64 {
        let mut slabs = [Short::CLEAR; FOUR];
        for n in 0..FOUR {
            slabs[n] = front[n].slab::<LIT>(table, back[n]);
        }
        over(pixels, slabs, limit, touched)
    }
}

/// What is left of a light that lacks so many 255ths of what it has more than `in_shadow`.
#[inline(always)]
pub fn darkened(light: ShortLight, in_shadow: ShortLight, lacking: u8) -> ShortLight {
    // 255 becomes all 15 bits.
    let part = i16::from(lacking) << 7 | i16::from(lacking) >> 1;
    [0, 1].map(|n| light[n] + times(in_shadow[n] - light[n], part))
}

/// Blends samples behind those pixels that are touched; gives which are opaque.
#[inline(always)]
fn over(pixels: &mut [Short; FOUR], samples: [Short; FOUR], limit: i16, touched: u64) -> u64 {
    let mut opaque = 0;
    for (n, (pixel, sample)) in pixels.iter_mut().zip(samples).enumerate() {
        if touched >> n & 1 == 1 {
            *pixel = pixel.over(sample);
        }
        opaque |= u64::from(pixel.0[3] > limit) << n;
    }
    opaque
}
