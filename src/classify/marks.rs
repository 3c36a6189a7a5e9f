//! Marks: a bit for every voxel (or cell) of a scanline, 64 a word, set where something shows.
//!
//! A transfer function is piecewise linear, so the codes that it shows are a few intervals. Whether a voxel's
//! code lies in one of them is two comparisons of bytes or shorts, which one instruction does for many
//! voxels; a table of flags would be asked voxel by voxel. A cell, over whose corners the scalar ranges from
//! low to high, shows something if that range meets an interval: two comparisons as well.
//!
//! Scanlines of the other stored order ([`super::rle`]) are columns of these, and bits are turned in blocks of 64 x 64.

use rayon::prelude::*;

use crate::simd::{self, Kernel, prefetch};
use crate::volume::gradient::Code;
use crate::volume::octree::{LEAF, leaf_of, leaves_along};
use crate::volume::scanlines::Scanlines;

/// Voxels (or cells) of a scanline that a word spans.
pub const WORD: usize = 64;

/// Words of a scanline of so many voxels (or cells).
pub const fn words(length: usize) -> usize {
    length.div_ceil(WORD)
}

/// So many words can be read from a scanline's first on past its last.
pub const MORE: usize = 4;

/// A bit for every voxel (or cell), in both orders.
#[derive(Clone, Debug, PartialEq)]
pub struct Marks {
    /// Voxels (or cells) along x, y, z.
    pub(super) dims: [usize; 3],
    /// Scanlines along x: row (y, z) at `(z * ny + y) * words(nx)`. And [`MORE`] words of none.
    pub(super) along_x: Vec<u64>,
    /// Scanlines along y: row (x, z) at `(z * nx + x) * words(ny)`. And [`MORE`] words of none.
    pub(super) along_y: Vec<u64>,
}

/// Which scanlines of a plane hold anything, a bit each.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Holding {
    /// Those along x, by y.
    pub rows: Vec<u64>,
    /// Those along y, by x.
    pub columns: Vec<u64>,
}

impl Holding {
    /// Nothing in a plane of so many voxels (or cells) along x and y.
    fn none(nx: usize, ny: usize) -> Self {
        Self { rows: vec![0; words(ny)], columns: vec![0; words(nx)] }
    }
}

/// The voxels of slice `z`, or the `CELLS` between it and the next, to be marked in both orders, which are zero. What stays so is neither
/// written nor read: memory that is read before it is written is mapped twice, and each time all threads hear of it.
struct Plane<'a, T, const CELLS: bool> {
    scanlines: Scanlines<'a, T>,
    visible: &'a VisibleCodes<T>,
    occupied: &'a [bool],
    z: usize,
    rows: &'a mut [u64],
    columns: &'a mut [u64],
}

impl<T: Code, const CELLS: bool> Kernel for Plane<'_, T, CELLS> {
    type Output = Holding;

    #[inline(always)]
    fn run(self) -> Holding {
        let Self { scanlines, visible, z, .. } = self;
        let dims @ [nx, ny, _] = scanlines.dims();
        let less = usize::from(CELLS);
        let (length, words_x) = (nx - less, words(nx - less));
        let mut occupied = OccupiedWords::new(self.occupied, dims, z);
        let mut holding = Holding::none(length, ny - less);
        let mut any = vec![0; words_x];
        for (block_row, strip) in self.rows.chunks_mut(WORD * words_x).enumerate() {
            any.fill(0);
            for (n, marks) in strip.chunks_exact_mut(words_x).enumerate() {
                let y = block_row * WORD + n;
                let (near, far) = (scanlines.row(y, z), scanlines.row(y, z + less));
                let rows = [near, far, scanlines.row(y + less, z), scanlines.row(y + less, z + less)];
                let occupied = occupied.of_row(leaf_of(y, ny));
                let mut of_row = 0;
                for (word, occupied) in occupied[..words_x].iter().enumerate() {
                    if !*occupied {
                        continue;
                    }
                    let first = word * WORD;
                    let bits =
                        if CELLS { visible.mark_cells(rows, first) } else { visible.mark_voxels(rows[0], first) };
                    if bits != 0 {
                        marks[word] = bits;
                        any[word] |= bits;
                        of_row = 1;
                    }
                }
                holding.rows[block_row] |= of_row << n;
            }
            for (word, any) in any.iter().enumerate() {
                if *any != 0 {
                    holding.columns[word] |= any;
                    let filled = holding.rows[block_row];
                    turn_block((strip, filled), [word, block_row], [length, ny - less], self.columns);
                }
            }
        }
        holding
    }
}

/// The marks that one principal axis walks.
#[derive(Clone, Copy, Debug)]
pub struct AxisMarks<'a> {
    bits: &'a [u64],
    words: usize,
    /// Words from a scanline to the next, and from a slice to the next.
    strides: [usize; 2],
}

impl<'a> AxisMarks<'a> {
    /// Scanline `j` of slice `k`, or of cells from voxel scanline `j` to `j + 1` and slice `k` to `k + 1`: bit i of the words is voxel i, or the
    /// cell between voxels i and i + 1.
    #[inline(always)]
    pub fn scanline(&self, j: usize, k: usize) -> &'a [u64] {
        &self.scanline_and_more(j, k)[..self.words]
    }

    /// The same and what follows: at least [`MORE`] words.
    #[inline(always)]
    pub fn scanline_and_more(&self, j: usize, k: usize) -> &'a [u64] {
        &self.bits[j * self.strides[0] + k * self.strides[1]..]
    }

    /// Words of a scanline.
    #[inline(always)]
    pub fn words(&self) -> usize {
        self.words
    }

    /// Asks for scanline `j` of slice `k`; there may be no such slice.
    #[inline(always)]
    pub fn prefetch(&self, j: usize, k: usize) {
        let first = j.wrapping_mul(self.strides[0]).wrapping_add(k.wrapping_mul(self.strides[1]));
        if let Some(word) = self.bits.get(first..).and_then(|bits| bits.get(..1)) {
            prefetch(word);
        }
    }
}

impl Marks {
    /// Marks the voxels whose code is `visible`, or the `CELLS` between whose corners one is, on the current rayon pool. `occupied` has a flag for
    /// each leaf of the volume's octree: false only where nothing in the leaf is to be marked. `scanlines` are those of the z axis. And gives
    /// what [`Self::holding`] would.
    pub(super) fn new<T: Code, const CELLS: bool>(
        scanlines: Scanlines<'_, T>,
        visible: &VisibleCodes<T>,
        occupied: &[bool],
    ) -> (Self, Vec<Holding>) {
        let dims @ [nx, ny, nz] = scanlines.dims().map(|n| n - usize::from(CELLS));
        let (rows, columns) = (ny * words(nx), nx * words(ny));
        let (mut along_x, mut along_y) = (vec![0; nz * rows + MORE], vec![0; nz * columns + MORE]);
        let planes = along_x.par_chunks_exact_mut(rows).zip(along_y.par_chunks_exact_mut(columns)).take(nz);
        let holding = planes.enumerate().map(|(z, (rows, columns))| {
            simd::dispatch(Plane::<_, CELLS> { scanlines, visible, occupied, z, rows, columns })
        });
        let holding = holding.collect();
        (Self { dims, along_x, along_y }, holding)
    }

    /// What is left when the scanlines along x of each plane z have gone through `reduce`, on the current rayon pool; and what that gave.
    pub(super) fn reduced<R: Send>(&self, reduce: impl Fn(usize, &mut [u64]) -> R + Sync) -> (Self, Vec<R>) {
        let Self { dims: dims @ [nx, ny, _], mut along_x, mut along_y } = self.clone();
        let (rows, columns) = (ny * words(nx), nx * words(ny));
        let planes = along_x.par_chunks_exact_mut(rows).zip(along_y.par_chunks_exact_mut(columns)).take(dims[2]);
        let given = planes.enumerate().map(|(z, (rows, columns))| {
            let given = reduce(z, rows);
            columns.fill(0);
            turn(rows, [nx, ny], columns);
            given
        });
        let given = given.collect();
        (Self { dims, along_x, along_y }, given)
    }

    /// Which scanlines hold anything, by plane z, on the current rayon pool.
    pub(super) fn holding(&self) -> Vec<Holding> {
        let [nx, ny, nz] = self.dims;
        let of_plane = |z| {
            let (mut holding, [rows, _]) = (Holding::none(nx, ny), self.plane(z));
            for (y, row) in rows.chunks_exact(words(nx)).enumerate() {
                let mut all = 0;
                for (column, bits) in holding.columns.iter_mut().zip(row) {
                    *column |= bits;
                    all |= bits;
                }
                holding.rows[y / WORD] |= u64::from(all != 0) << (y % WORD);
            }
            holding
        };
        (0..nz).into_par_iter().map(of_plane).collect()
    }

    /// What those of so many voxels (or cells) take in memory, both orders.
    pub(super) fn bytes_of([nx, ny, nz]: [usize; 3]) -> u64 {
        ((nz * (ny * words(nx) + nx * words(ny)) + 2 * MORE) * size_of::<u64>()) as u64
    }

    /// Those of the plane at z, along x and along y.
    pub(super) fn plane(&self, z: usize) -> [&[u64]; 2] {
        let [nx, ny, _] = self.dims;
        let (rows, columns) = (ny * words(nx), nx * words(ny));
        [&self.along_x[z * rows..][..rows], &self.along_y[z * columns..][..columns]]
    }

    /// Those for a principal axis (0: x, 1: y, 2: z).
    pub fn for_axis(&self, axis: usize) -> AxisMarks<'_> {
        let [nx, ny, _] = self.dims;
        match axis {
            0 => AxisMarks { bits: &self.along_y, words: words(ny), strides: [nx * words(ny), words(ny)] },
            1 => AxisMarks { bits: &self.along_x, words: words(nx), strides: [ny * words(nx), words(nx)] },
            _ => AxisMarks { bits: &self.along_x, words: words(nx), strides: [words(nx), ny * words(nx)] },
        }
    }

    /// Share that is marked, 0..=1.
    pub fn share(&self) -> f64 {
        let marked: u64 = self.along_x.iter().map(|word| u64::from(word.count_ones())).sum();
        marked as f64 / self.dims.iter().product::<usize>() as f64
    }

    /// Bytes in memory, both orders.
    pub fn bytes(&self) -> u64 {
        (size_of_val(&self.along_x[..]) + size_of_val(&self.along_y[..])) as u64
    }
}

/// Which scanlines of the slices along a principal axis hold anything.
#[derive(Clone, Debug, PartialEq)]
pub struct Shown {
    /// Words of a slice: one more than its scanlines need.
    words: usize,
    bits: Vec<u64>,
}

impl Shown {
    /// Of so many scanlines in so many slices, on the current rayon pool; `is_shown` is asked for each (j, k).
    pub(super) fn new(scanlines: usize, slices: usize, is_shown: impl Fn(usize, usize) -> bool + Sync) -> Self {
        let words = scanlines.div_ceil(WORD) + 1;
        let mut bits = vec![0; words * slices];
        bits.par_chunks_exact_mut(words).enumerate().for_each(|(k, slice)| {
            for j in 0..scanlines {
                slice[j / WORD] |= u64::from(is_shown(j, k)) << (j % WORD);
            }
        });
        Self { words, bits }
    }

    /// What it takes in memory.
    pub(super) fn bytes_of(scanlines: usize, slices: usize) -> u64 {
        ((scanlines.div_ceil(WORD) + 1) * slices * size_of::<u64>()) as u64
    }

    /// Bytes in memory.
    pub(super) fn bytes(&self) -> u64 {
        size_of_val(&self.bits[..]) as u64
    }

    /// Whether scanline `j` of slice `k` holds anything.
    #[inline(always)]
    pub fn holds(&self, j: usize, k: usize) -> bool {
        self.bits[k * self.words + j / WORD] >> (j % WORD) & 1 == 1
    }

    /// Which of the scanlines of slice `k` from `j` on hold anything, a bit each, and of 64 at most.
    #[inline(always)]
    pub fn from(&self, j: usize, count: usize, k: usize) -> u64 {
        let slice = &self.bits[k * self.words..][..self.words];
        let (word, shift) = (j / WORD, j % WORD);
        (slice[word] >> shift | slice[word + 1] << 1 << (WORD - 1 - shift)) & (u64::MAX >> (WORD - count))
    }
}

/// The codes that show something, as ascending intervals with both ends included.
#[derive(Clone, Debug, PartialEq)]
pub struct VisibleCodes<T> {
    intervals: Vec<[T; 2]>,
}

impl<T: Code> VisibleCodes<T> {
    /// From a flag for each code from 0 on.
    pub fn new(visible: impl Iterator<Item = bool>) -> Self {
        let mut intervals: Vec<[u16; 2]> = Vec::new();
        for (code, _) in (0..=u16::MAX).zip(visible).filter(|(_, visible)| *visible) {
            match intervals.last_mut() {
                Some([_, last]) if *last + 1 == code => *last = code,
                _ => intervals.push([code; 2]),
            }
        }
        Self { intervals: intervals.into_iter().map(|ends| ends.map(T::from_code)).collect() }
    }

    /// Marks the visible ones of a word's voxels: those from `first` on of the scanline `row`.
    #[inline(always)]
    pub fn mark_voxels(&self, row: &[T], first: usize) -> u64 {
        match row[first..].first_chunk() {
            Some(codes) => self.mark(codes, codes),
            None => {
                let codes = padded(&row[first..]);
                self.mark(&codes, &codes) & first_bits(row.len() - first)
            }
        }
    }

    /// Marks a word's cells, from `first` on, between four scanlines of equal length: bit i of the word is
    /// the cell between voxels `first + i` and `first + i + 1`.
    #[inline(always)]
    pub fn mark_cells(&self, rows: [&[T]; 4], first: usize) -> u64 {
        let [a, b, c, d] = rows;
        let (a, b, c, d) = (&a[first..], &b[first..], &c[first..], &d[first..]);
        match (a.first_chunk(), b.first_chunk(), c.first_chunk(), d.first_chunk()) {
            (Some(a), Some(b), Some(c), Some(d)) => self.mark_cells_between([a, b, c, d]),
            _ => {
                let whole = self.mark_cells_between([&padded(a), &padded(b), &padded(c), &padded(d)]);
                whole & first_bits(a.len() - 1)
            }
        }
    }

    #[inline(always)]
    fn mark_cells_between(&self, [a, b, c, d]: [&[T; WORD + 1]; 4]) -> u64 {
        let (mut low, mut high) = ([T::default(); WORD], [T::default(); WORD]);
        for n in 0..WORD {
            let upper = [a[n].min(a[n + 1]), b[n].min(b[n + 1]), c[n].min(c[n + 1]), d[n].min(d[n + 1])];
            low[n] = upper[0].min(upper[1]).min(upper[2].min(upper[3]));
        }
        for n in 0..WORD {
            let upper = [a[n].max(a[n + 1]), b[n].max(b[n + 1]), c[n].max(c[n + 1]), d[n].max(d[n + 1])];
            high[n] = upper[0].max(upper[1]).max(upper[2].max(upper[3]));
        }
        self.mark(&low, &high)
    }

    /// Marks the ranges, from `low` to `high`, that meet an interval.
    #[inline(always)]
    fn mark(&self, low: &[T; WORD], high: &[T; WORD]) -> u64 {
        let mut met = [0u8; WORD];
        for &[first, last] in &self.intervals {
            for n in 0..WORD {
                met[n] |= u8::from(low[n] <= last) & u8::from(high[n] >= first);
            }
        }
        let mut bits = 0;
        let (eights, _) = met.as_chunks();
        for (n, eight) in eights.iter().enumerate() {
            // The product moves bit 0 of byte i to bit 56 + i, and nothing else there.
            let gathered = u64::from_le_bytes(*eight).wrapping_mul(0x0102_0408_1020_4080) >> 56;
            bits |= gathered << (8 * n);
        }
        bits
    }
}

/// The lowest `count` bits, of at most 64.
#[inline(always)]
fn first_bits(count: usize) -> u64 {
    if count < WORD { (1 << count) - 1 } else { u64::MAX }
}

/// The codes and then zeros.
#[inline(always)]
fn padded<T: Code, const N: usize>(codes: &[T]) -> [T; N] {
    let mut padded = [T::default(); N];
    let count = codes.len().min(N);
    padded[..count].copy_from_slice(&codes[..count]);
    padded
}

/// Which words of a plane's scanlines lie in leaves that may hold something, found once for all scanlines
/// of a row of leaves.
#[derive(Debug)]
pub struct OccupiedWords<'a> {
    /// The flags of the plane's leaves, by rows of them.
    leaves: &'a [bool],
    leaves_x: usize,
    row: Option<usize>,
    words: Vec<bool>,
}

impl<'a> OccupiedWords<'a> {
    /// Of the scanlines along x of plane `z` of a volume of `dims` voxels. `occupied` has a flag for each leaf,
    /// x fastest.
    pub fn new(occupied: &'a [bool], [nx, ny, nz]: [usize; 3], z: usize) -> Self {
        let [leaves_x, leaves_y] = [leaves_along(nx), leaves_along(ny)];
        let leaves = &occupied[leaf_of(z, nz) * leaves_x * leaves_y..][..leaves_x * leaves_y];
        Self { leaves, leaves_x, row: None, words: vec![false; words(nx)] }
    }

    /// A flag for each word of the scanlines in row `row` of leaves.
    #[inline(always)]
    pub fn of_row(&mut self, row: usize) -> &[bool] {
        const LEAVES: usize = WORD / LEAF;
        if self.row != Some(row) {
            self.row = Some(row);
            let leaves = &self.leaves[row * self.leaves_x..][..self.leaves_x];
            for (word, occupied) in self.words.iter_mut().enumerate() {
                // The last leaf has the scanline's last voxel besides its own eight.
                let first = (word * LEAVES).min(leaves.len() - 1);
                *occupied = leaves[first..(word * LEAVES + LEAVES).clamp(first + 1, leaves.len())].contains(&true);
            }
        }
        &self.words
    }
}

/// Turns marks of `rows` scanlines of `length` into marks of `length` scanlines of `rows`; `turned` must be
/// all zero.
#[inline(always)]
pub fn turn(marks: &[u64], [length, rows]: [usize; 2], turned: &mut [u64]) {
    let words_x = words(length);
    for (block_row, strip) in marks.chunks(WORD * words_x).enumerate() {
        for word in 0..words_x {
            let filled = first_bits(strip.len() / words_x);
            turn_block((strip, filled), [word, block_row], [length, rows], turned);
        }
    }
}

/// Turns a word of each of up to 64 scanlines, of those of a `strip` that are `filled`.
#[inline(always)]
fn turn_block(
    (strip, mut filled): (&[u64], u64),
    [word, block_row]: [usize; 2],
    [length, rows]: [usize; 2],
    turned: &mut [u64],
) {
    let (mut block, mut any) = ([0; WORD], 0);
    while filled != 0 {
        let row = filled.trailing_zeros() as usize % WORD;
        filled &= filled - 1;
        block[row] = strip[row * words(length) + word];
        any |= block[row];
    }
    if any == 0 {
        return;
    }
    transpose(&mut block);
    let words_y = words(rows);
    let columns = turned[word * WORD * words_y..].chunks_exact_mut(words_y);
    for (column, bits) in columns.zip(block).take(length - word * WORD) {
        column[block_row] = bits;
    }
}

/// Transposes 64 x 64 bits: bit j of word i becomes bit i of word j (Hacker's Delight 7-3).
#[inline(always)]
fn transpose(block: &mut [u64; WORD]) {
    swap_quarters::<32>(block, 0x0000_0000_ffff_ffff);
    swap_quarters::<16>(block, 0x0000_ffff_0000_ffff);
    swap_quarters::<8>(block, 0x00ff_00ff_00ff_00ff);
    swap_quarters::<4>(block, 0x0f0f_0f0f_0f0f_0f0f);
    swap_quarters::<2>(block, 0x3333_3333_3333_3333);
    swap_quarters::<1>(block, 0x5555_5555_5555_5555);
}

/// Of every square of twice `WIDTH` bits on the diagonal, swaps the two quarters beside the diagonal.
#[inline(always)]
fn swap_quarters<const WIDTH: usize>(block: &mut [u64; WORD], mask: u64) {
    for square in block.chunks_exact_mut(2 * WIDTH) {
        let (upper, lower) = square.split_at_mut(WIDTH);
        for (upper, lower) in upper.iter_mut().zip(lower) {
            let swap = (*upper >> WIDTH ^ *lower) & mask;
            *lower ^= swap;
            *upper ^= swap << WIDTH;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(count: usize) -> impl Iterator<Item = u32> {
        (1..=count as u32).map(|n| n.wrapping_mul(2_654_435_761).rotate_left(n % 32) >> 8)
    }

    fn bit(words: &[u64], at: usize) -> bool {
        words[at / WORD] >> (at % WORD) & 1 == 1
    }

    fn check<T: Code + std::fmt::Debug>(visible: &[bool], length: usize) {
        let codes = |skip: usize| -> Vec<T> {
            noise(skip + length).skip(skip).map(|n| T::from_code((n % visible.len() as u32) as u16)).collect()
        };
        let rows = [0, 1000, 2000, 3000].map(codes);
        let set = VisibleCodes::<T>::new(visible.iter().copied());
        let at = |row: &Vec<T>, i: usize| usize::from(row[i].into());
        let marked: Vec<u64> = (0..words(length)).map(|word| set.mark_voxels(&rows[0], word * WORD)).collect();
        for i in 0..words(length) * WORD {
            assert_eq!(bit(&marked, i), i < length && visible[at(&rows[0], i)], "voxel {i} of {length}");
        }
        // Neighbours that differ little, so that ranges are narrow.
        let rows = rows.map(|row| row.iter().map(|code| T::from_code((*code).into() / 8)).collect::<Vec<T>>());
        let four = [0, 1, 2, 3].map(|n| rows[n].as_slice());
        let cells = length - 1;
        let marked: Vec<u64> = (0..words(cells)).map(|word| set.mark_cells(four, word * WORD)).collect();
        for i in 0..words(cells) * WORD {
            let corners = || rows.iter().flat_map(|row| [at(row, i), at(row, i + 1)]);
            let shows = i < cells && visible[corners().min().unwrap()..=corners().max().unwrap()].contains(&true);
            assert_eq!(bit(&marked, i), shows, "cell {i} of {cells}");
        }
    }

    #[test]
    fn marks_are_what_a_loop_over_voxels_and_cells_finds() {
        for length in [2, 7, 63, 64, 65, 66, 127, 128, 129, 130, 200] {
            for stride in [1, 3, 29, 600] {
                let visible = |codes: usize| (0..codes).map(|code| code % stride == stride - 1).collect::<Vec<_>>();
                check::<u8>(&visible(256), length);
                check::<u16>(&visible(700), length);
                check::<u16>(&visible(65536), length);
            }
        }
    }

    #[test]
    fn intervals_reach_to_both_ends_of_the_codes() {
        let all = VisibleCodes::<u16>::new(std::iter::repeat_n(true, 65536));
        assert_eq!(all.intervals, [[0, u16::MAX]]);
        let some = VisibleCodes::<u8>::new((0..256).map(|code| code == 0 || code == 3 || code > 253));
        assert_eq!(some.intervals, [[0, 0], [3, 3], [254, 255]]);
        assert_eq!(VisibleCodes::<u8>::new(std::iter::empty()).intervals, [[0; 2]; 0]);
    }

    #[test]
    fn turning_moves_every_bit_to_its_mirror() {
        for dims in [[1, 1], [64, 64], [65, 3], [63, 130], [128, 65], [200, 77]] {
            let [length, rows] = dims;
            let mut marks = vec![0; words(length) * rows];
            for (row, marks) in marks.chunks_exact_mut(words(length)).enumerate() {
                for (i, n) in noise(length).enumerate() {
                    marks[i / WORD] |= u64::from(n >> (row % 20) & 1) << (i % WORD);
                }
            }
            let mut turned = vec![0; words(rows) * length];
            turn(&marks, dims, &mut turned);
            for row in 0..rows {
                for i in 0..words(length) * WORD {
                    let here = bit(&marks[row * words(length)..], i);
                    assert!(i < length || !here);
                    assert!(i >= length || bit(&turned[i * words(rows)..], row) == here, "{i}, {row} of {dims:?}");
                }
            }
            let marked = |words: &[u64]| words.iter().map(|word| word.count_ones()).sum::<u32>();
            assert_eq!(marked(&turned), marked(&marks));
        }
    }

    #[test]
    fn a_word_is_occupied_if_one_of_its_leaves_is() {
        // 9 leaves along x (66 to 73 voxels) and 2 along y, the second plane of leaves.
        for nx in [66, 73] {
            for flagged in 0..18 {
                let occupied: Vec<bool> = (0..36).map(|leaf| leaf == 18 + flagged).collect();
                let mut words = OccupiedWords::new(&occupied, [nx, 12, 17], 16);
                for row in [0, 1, 1, 0] {
                    let expected = [flagged / 9 == row && flagged % 9 < 8, flagged / 9 == row && flagged % 9 == 8];
                    assert_eq!(words.of_row(row), expected);
                }
            }
        }
        // 8 leaves of 65 voxels: the last voxel is in the last leaf.
        let last: Vec<bool> = (0..8).map(|leaf| leaf == 7).collect();
        assert_eq!(OccupiedWords::new(&last, [65, 2, 2], 1).of_row(0), [true, true]);
    }
}
