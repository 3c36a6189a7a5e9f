//! From a volume's scanlines to the run-length encoded volume.
//!
//! Encoding begins with the marks of the [visible voxels](crate::classify::visible), less those of which a gradient
//! opacity leaves nothing, and computes the normals of the marked voxels, eight at a time. The voxels are dealt out to both orders in one
//! pass: walked along x, the next voxel of a column follows the one before, so that each column only
//! needs to know its next place. Planes are independent and spread over the pool.

use std::sync::Arc;

use rayon::prelude::*;

use super::{Plane, RunLengthVolume, Voxel};
use crate::classify::marks::{WORD, words};
use crate::classify::tables::CodeTables;
use crate::classify::transfer::TransferFunction;
use crate::classify::visible::Visible;
use crate::simd::{self, Kernel};
use crate::volume::PreparedVolume;
use crate::volume::gradient::{BLOCK, Code, GradientFrame, Gradients, magnitudes, normals};
use crate::volume::scanlines::{AnyScanlines, Scanlines};

const _: () = assert!(BLOCK == 8, "a block's marks are a byte");

/// [`RunLengthVolume::encode`].
pub fn encode(
    prepared: &PreparedVolume,
    tables: &CodeTables,
    transfer: &TransferFunction,
    visible: &Arc<Visible>,
) -> RunLengthVolume {
    let volume = prepared.volume();
    let frame = GradientFrame::new(volume.placement(), volume.rescale().0);
    match prepared.scanlines(2) {
        AnyScanlines::U8(scanlines) => Encoder::new(scanlines, &frame, tables, transfer, visible).encode(),
        AnyScanlines::U16(scanlines) => Encoder::new(scanlines, &frame, tables, transfer, visible).encode(),
    }
}

/// What all planes of an encoding share.
struct Encoder<'a, T> {
    scanlines: Scanlines<'a, T>,
    gradients: Gradients<'a, T>,
    tables: &'a CodeTables,
    /// Where opacity depends on the gradient.
    transfer: Option<&'a TransferFunction>,
    visible: &'a Arc<Visible>,
}

impl<'a, T: Code> Encoder<'a, T> {
    fn new(
        scanlines: Scanlines<'a, T>,
        frame: &GradientFrame,
        tables: &'a CodeTables,
        transfer: &'a TransferFunction,
        visible: &'a Arc<Visible>,
    ) -> Self {
        Self {
            scanlines,
            gradients: Gradients::new(scanlines, frame),
            tables,
            transfer: Some(transfer).filter(|transfer| !transfer.gradient_opacity.is_empty()),
            visible,
        }
    }

    fn encode(&self) -> RunLengthVolume {
        let dims @ [_, _, nz] = self.scanlines.dims();
        let (visible, factors) = match self.transfer {
            None => (Arc::clone(self.visible), vec![]),
            Some(transfer) => {
                let reduce = |z, marked: &mut [u64]| simd::dispatch(ReducePlane { encoder: self, transfer, z, marked });
                let (visible, factors) = self.visible.reduced(reduce);
                (Arc::new(visible), factors)
            }
        };
        let plane = |z| {
            let factors = factors.get(z).map(Vec::as_slice);
            simd::dispatch(EncodePlane { encoder: self, marks: visible.plane(z), factors, z })
        };
        let (along_x, along_y) = (0..nz).into_par_iter().map(plane).unzip();
        RunLengthVolume { dims, visible, along_x, along_y }
    }
}

/// The plane at `z`, whose marked voxels' gradient opacities are to be found (255 = 1, by `y * nx + x`, of others anything) and those that these
/// make transparent to be no longer marked.
struct ReducePlane<'a, T> {
    encoder: &'a Encoder<'a, T>,
    transfer: &'a TransferFunction,
    z: usize,
    marked: &'a mut [u64],
}

/// Both orders of the plane at `z`, to be encoded.
struct EncodePlane<'a, T> {
    encoder: &'a Encoder<'a, T>,
    /// By scanlines along x and along y.
    marks: [&'a [u64]; 2],
    /// Gradient opacities by `y * nx + x`, where they play a part.
    factors: Option<&'a [u8]>,
    z: usize,
}

impl<T: Code> Kernel for EncodePlane<'_, T> {
    type Output = (Plane, Plane);

    #[inline(always)]
    fn run(self) -> (Plane, Plane) {
        let [nx, ny, _] = self.encoder.scanlines.dims();
        let [rows, columns] = self.marks;
        let mut along_x = Plane::of_marks(rows, words(nx));
        let mut along_y = Plane::of_marks(columns, words(ny));
        self.deal(&mut along_x, &mut along_y);
        if let Some(factors) = self.factors {
            along_x.gather(rows, words(nx), |y, x| factors[y * nx + x]);
            along_y.gather(columns, words(ny), |x, y| factors[y * nx + x]);
        }
        (along_x, along_y)
    }
}

impl<T: Code> Kernel for ReducePlane<'_, T> {
    type Output = Vec<u8>;

    #[inline(always)]
    fn run(self) -> Vec<u8> {
        let Self { encoder: Encoder { scanlines, gradients, tables, .. }, transfer, z, marked } = self;
        let [nx, ny, _] = scanlines.dims();
        let mut factors = vec![0; nx * ny];
        let visible = marked.to_vec();
        let visible = visible.chunks_exact(words(nx));
        let rows = visible.zip(marked.chunks_exact_mut(words(nx))).zip(factors.chunks_exact_mut(nx));
        for (y, ((visible, marked), factors)) in rows.enumerate() {
            let row = scanlines.row(y, z);
            for block in Blocks::new(visible) {
                let magnitudes = magnitudes(&gradients.block::<BLOCK>(y, z, block.first));
                for n in block.voxels() {
                    let at = block.first + n;
                    let factor = (transfer.gradient_factor(magnitudes[n].into()) * 255.0).round() as u8;
                    let tau = tables.extinction[usize::from(row[at].into())];
                    factors[at] = factor;
                    marked[at / WORD] &= !(u64::from(!tables.is_visible(tau, factor)) << (at % WORD));
                }
            }
        }
        factors
    }
}

impl<T: Code> EncodePlane<'_, T> {
    /// Deals out the marked voxels.
    #[inline(always)]
    fn deal(&self, along_x: &mut Plane, along_y: &mut Plane) {
        let Encoder { scanlines, gradients, .. } = self.encoder;
        let [nx, _, _] = scanlines.dims();
        let mut next = 0;
        let mut places = along_y.rows.clone();
        for (y, marked) in self.marks[0].chunks_exact(words(nx)).enumerate() {
            let row = scanlines.row(y, self.z);
            for block in Blocks::new(marked) {
                let normals = normals(&gradients.block::<BLOCK>(y, self.z, block.first));
                for n in block.voxels() {
                    let x = block.first + n;
                    let voxel = Voxel { code: row[x].into(), normal: normals[n] };
                    along_x.voxels[next] = voxel;
                    next += 1;
                    along_y.voxels[places[x] as usize] = voxel;
                    places[x] += 1;
                }
            }
        }
    }
}

impl Plane {
    /// Fills in the factors of voxels that are marked in rows of so many words, by row and position in it.
    fn gather(&mut self, marks: &[u64], words: usize, factor: impl Fn(usize, usize) -> u8) {
        let mut factors = Vec::with_capacity(self.count());
        for (row, marked) in marks.chunks_exact(words).enumerate() {
            for block in Blocks::new(marked) {
                factors.extend(block.voxels().map(|n| factor(row, block.first + n)));
            }
        }
        self.factors = factors;
    }
}

/// The blocks of a scanline in which voxels are marked.
struct Blocks<'a> {
    words: &'a [u64],
    word: usize,
    bits: u64,
}

/// Up to eight voxels of a scanline.
#[derive(Clone, Copy)]
struct Block {
    first: usize,
    marked: u8,
}

impl<'a> Blocks<'a> {
    #[inline(always)]
    fn new(words: &'a [u64]) -> Self {
        Self { words, word: 0, bits: words[0] }
    }
}

impl Iterator for Blocks<'_> {
    type Item = Block;

    #[inline(always)]
    fn next(&mut self) -> Option<Block> {
        while self.bits == 0 {
            self.word += 1;
            self.bits = *self.words.get(self.word)?;
        }
        let shift = self.bits.trailing_zeros() as usize / BLOCK * BLOCK;
        let marked = (self.bits >> shift) as u8;
        self.bits &= !(0xff << shift);
        Some(Block { first: self.word * WORD + shift, marked })
    }
}

impl Block {
    /// The marked voxels, counted from the block's first.
    #[inline(always)]
    fn voxels(self) -> impl Iterator<Item = usize> {
        let mut marked = self.marked;
        std::iter::from_fn(move || {
            let n = marked.trailing_zeros() as usize;
            marked &= marked.wrapping_sub(1);
            (n < BLOCK).then_some(n)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::classify::summed_area::{SummedAreaTable, octree_for};
    use crate::classify::{Color, ControlPoint, GradientPoint};
    use crate::volume::gradient::encode_normal;
    use crate::volume::{ImportReport, Placement, ScalarType, Scalars, Volume};

    /// Lumps with empty space between them, and noise.
    fn volume(dims: [usize; 3], wide: bool) -> Volume {
        let codes = (0..dims.iter().product()).map(|index: usize| {
            let at = [index % dims[0], index / dims[0] % dims[1], index / (dims[0] * dims[1])];
            let [x, y, z] = at.map(|at| at as f64 * 0.3);
            let lump = (x.sin() * (y * 1.1).sin() * (z * 0.9 + 1.0).sin()).max(0.0) * 200.0;
            lump as u16 + (index * 31 % 7) as u16
        });
        let scalars = if wide {
            Scalars::U16(codes.map(|c| 9 * c).collect())
        } else {
            Scalars::U8(codes.map(|c| c as u8).collect())
        };
        let slope = if wide { 1.0 / 9.0 } else { 1.0 };
        let report = ImportReport::plain("test", ScalarType::U8);
        Volume::new(dims, Placement::from_spacing([1.0, 0.7, 1.6].into()), scalars, (slope, 0.0), report).unwrap()
    }

    fn transfer(gradient_opacity: &[(f64, f64)]) -> TransferFunction {
        let points = [(0.0, 0.0), (30.0, 0.0), (40.0, 0.5), (60.0, 0.0), (90.0, 0.0), (120.0, 0.9)];
        let point = |(value, opacity)| ControlPoint { value, opacity, color: Color([1.0; 3]) };
        TransferFunction {
            points: points.map(point).to_vec(),
            opacity_distance: None,
            gradient_opacity: gradient_opacity
                .iter()
                .map(|&(value, opacity)| GradientPoint { value, opacity })
                .collect(),
        }
    }

    /// What the encoding must hold of voxel `at`, found without marks, blocks or leaves.
    fn plain(
        prepared: &PreparedVolume,
        tables: &CodeTables,
        transfer: &TransferFunction,
        at: [usize; 3],
    ) -> Option<(Voxel, u8)> {
        let volume = prepared.volume();
        let [nx, ny, _] = volume.dims();
        let code = volume.scalars().code((at[2] * ny + at[1]) * nx + at[0]);
        let frame = GradientFrame::new(volume.placement(), volume.rescale().0);
        let block = match prepared.scanlines(2) {
            AnyScanlines::U8(scanlines) => Gradients::new(scanlines, &frame).block::<1>(at[1], at[2], at[0]),
            AnyScanlines::U16(scanlines) => Gradients::new(scanlines, &frame).block::<1>(at[1], at[2], at[0]),
        };
        let factor = (transfer.gradient_factor(magnitudes(&block)[0].into()) * 255.0).round() as u8;
        let voxel = Voxel { code, normal: encode_normal(block[0][0], block[1][0], block[2][0]) };
        tables.is_visible(tables.extinction[usize::from(code)], factor).then_some((voxel, factor))
    }

    #[test]
    fn every_axis_has_the_voxels_that_a_plain_loop_finds() {
        for dims in [[2, 3, 2], [65, 64, 5], [64, 9, 66], [130, 67, 3]] {
            for wide in [false, true] {
                for transfer in [transfer(&[]), transfer(&[(0.0, 0.0), (20.0, 0.05), (60.0, 1.0)])] {
                    let prepared = PreparedVolume::build(volume(dims, wide));
                    check(&prepared, &transfer);
                }
            }
        }
    }

    fn check(prepared: &PreparedVolume, transfer: &TransferFunction) {
        let tables = CodeTables::new(prepared.volume(), transfer, 0.01);
        let octree = octree_for(prepared, transfer);
        let summed_area = SummedAreaTable::new(&tables, transfer, octree);
        let occupied = octree.occupied_leaves(|range| summed_area.is_transparent(range));
        let visible = Arc::new(Visible::new(prepared, &tables, &occupied));
        let encoding = RunLengthVolume::encode(prepared, &tables, transfer, &visible);
        let mut filled = 0;
        for axis in 0..3 {
            let (axes, dims) = match prepared.scanlines(axis) {
                AnyScanlines::U8(scanlines) => (scanlines.axes(), scanlines.dims()),
                AnyScanlines::U16(scanlines) => (scanlines.axes(), scanlines.dims()),
            };
            let of_axis = encoding.for_axis(axis);
            for (j, k) in (0..dims[2]).flat_map(|k| (0..dims[1]).map(move |j| (j, k))) {
                let scanline = of_axis.scanline(j, k);
                let mut found = vec![None; dims[0]];
                let ends = [0, 1].map(|next| scanline.plane.rows[scanline.row + next] as usize);
                let mut stored = scanline.plane.voxels[ends[0]..ends[1]].iter();
                for (i, found) in found.iter_mut().enumerate() {
                    let (marks, at) = (scanline.marks()[i / WORD], i % WORD);
                    if marks >> at & 1 == 1 {
                        let ((voxels, factors), before) = (scanline.word(i / WORD), marks & ((1 << at) - 1));
                        let before = before.count_ones() as usize;
                        assert_eq!(stored.next(), Some(&voxels[before]), "a voxel for each mark");
                        *found = Some((voxels[before], *factors.get(before).unwrap_or(&255)));
                    }
                }
                assert!(stored.next().is_none(), "voxels that are not marked");
                let past_end = scanline.marks().len() * WORD - dims[0];
                assert!(
                    scanline.marks()[dims[0] / WORD..].iter().all(|word| word.leading_zeros() as usize >= past_end)
                );
                let expected = |i: usize| {
                    let mut at = [0; 3];
                    for (axis, index) in axes.into_iter().zip([i, j, k]) {
                        at[axis] = index;
                    }
                    plain(prepared, &tables, transfer, at)
                };
                for (i, found) in found.iter().enumerate() {
                    assert_eq!(*found, expected(i), "{i} {j} {k} along {axis} of {dims:?}");
                }
                filled += usize::from(ends[0] != ends[1]);
            }
        }
        let scanlines = prepared.volume().dims().iter().product::<usize>();
        assert!(scanlines < 100 || filled > 0, "an empty encoding tests nothing");
    }

    #[test]
    fn blocks_cover_exactly_the_marks() {
        let words = [0, 1, u64::MAX, 1 << 63, 0xf0f0_0000_ffff_0001, !1, 0];
        let mut covered = [0; 7];
        for block in Blocks::new(&words) {
            for at in block.voxels().map(|n| block.first + n) {
                assert_eq!(covered[at / WORD] >> (at % WORD) & 1, 0, "twice");
                covered[at / WORD] |= 1 << (at % WORD);
            }
        }
        assert_eq!(covered, words);
    }
}
