//! What every format's header comes down to, and the voxels that it promises.
//!
//! The one place where memory is taken for voxels. In order: the dimensions are checked against the
//! [`Limits`], the promised size against the bytes that are there (where that is known), then the
//! scalars are read straight into an array of their own type. Where the length is not known the
//! array doubles as bytes come, capped at the promise, so that a lying header costs no more than
//! twice what its sender really sent, and what follows the promised bytes is never read.

use std::io::{self, BufRead, Read};

use bytemuck::Pod;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::decode::{DecodeError, Limits};
use super::narrow::{Narrowed, narrow_wide};
use super::source::{Source, read_error};
use super::{Colors, ImportReport, Placement, ScalarType, Scalars, Volume, VolumeError};

/// Byte order of multi-byte scalars.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Endian {
    Little,
    Big,
}

impl Endian {
    const NATIVE: Self = if cfg!(target_endian = "big") { Self::Big } else { Self::Little };
}

/// A parsed header: what to read, and what it means.
#[derive(Clone, Debug)]
pub(super) struct Header {
    /// Name for errors and the report.
    pub format: &'static str,
    /// Voxels along i, j, k as the file says.
    pub dims: [u64; 3],
    pub scalar_type: ScalarType,
    pub endian: Endian,
    pub placement: Placement,
    /// (slope, intercept) of value = intercept + slope * stored; the slope may be negative.
    pub rescale: (f64, f64),
    /// Scalars of all volumes that stand together for one voxel; the first is taken.
    pub interleaved: u64,
    /// Components of each voxel, of 8 bits where they are several: 1, 3 (red, green, blue) or 4 (and alpha).
    pub components: u64,
    /// Volumes that follow the first one.
    pub following: u64,
    /// True where the data are the last bytes of the file, wherever they begin.
    pub at_end: bool,
}

impl Header {
    /// Reads the voxels from where `source` stands.
    pub(super) fn read_voxels(&self, mut source: Source<'_>, limits: &Limits) -> Result<Volume, DecodeError> {
        let (dims, count) = self.checked_dims(limits)?;
        // No overflow: `checked_dims` bounds the voxels, interleaved ones included, by MAX_VOXELS.
        let expected = count as u64 * self.interleaved * self.components * self.scalar_type.size() as u64;
        if self.at_end {
            self.skip_to_last(&mut source, expected)?;
        }
        if let Some(got) = source.left().filter(|&got| got < expected) {
            return Err(DecodeError::Truncated { expected, got });
        }
        let volume = if self.components == 1 {
            let narrowed = self.read_scalars(&mut source, count)?;
            self.volume(dims, narrowed)?
        } else {
            let (format, scalar_type) = (self.format, self.scalar_type);
            if scalar_type != ScalarType::U8 {
                let message = format!("{format}: expected colours of 8 bits, got {}", scalar_type.name());
                return Err(DecodeError::Unsupported(message));
            }
            let report = ImportReport { volumes_left_out: self.following, ..ImportReport::plain(format, scalar_type) };
            Volume::of_colors(dims, self.placement, self.read_colors(&mut source, count)?, report)?
        };
        if self.following == 0 {
            source.check_end()?;
        }
        Ok(volume)
    }

    /// Reads `count` voxels of three or four components.
    fn read_colors(&self, source: &mut Source<'_>, count: usize) -> Result<Colors, DecodeError> {
        if self.components == 4 {
            return Ok(Colors { voxels: self.read_typed(source, count)?, has_alpha: true });
        }
        let voxels: Vec<[u8; 3]> = self.read_typed(source, count)?;
        let with_luminance = |&[r, g, b]: &[u8; 3]| [r, g, b, Colors::luminance([r, g, b])];
        Ok(Colors { voxels: voxels.par_iter().map(with_luminance).collect(), has_alpha: false })
    }

    /// The dimensions, and their product, once both are within bounds.
    fn checked_dims(&self, limits: &Limits) -> Result<([usize; 3], usize), DecodeError> {
        /// Keeps sizes in bytes within 64 bits.
        const MAX_VOXELS: u64 = 1 << 56;
        let [nx, ny, nz] = self.dims;
        let limit = limits.max_voxels.min(MAX_VOXELS);
        let voxels = nx.checked_mul(ny).and_then(|n| n.checked_mul(nz));
        let voxels = voxels.and_then(|n| n.checked_mul(self.interleaved)).and_then(|n| n.checked_mul(self.components));
        if voxels.is_none_or(|voxels| voxels > limit) {
            let of_each = match self.interleaved * self.components {
                1 => String::new(),
                n => format!(" of {n} scalars"),
            };
            return Err(DecodeError::TooLarge { dims: format!("{nx} x {ny} x {nz}{of_each}"), limit });
        }
        let dims = self.dims.map(|n| usize::try_from(n).unwrap_or(usize::MAX));
        if dims.iter().any(|n| !(2..=Volume::MAX_DIMENSION).contains(n)) {
            return Err(VolumeError::Dimensions { dims }.into());
        }
        Ok((dims, dims.iter().product()))
    }

    /// Moves to where the data begin that end with the file.
    fn skip_to_last(&self, source: &mut Source<'_>, first: u64) -> Result<(), DecodeError> {
        let format = self.format;
        let Some(left) = source.left() else {
            let message = format!("{format}: data counted from the end are read from uncompressed files only");
            return Err(DecodeError::Unsupported(message));
        };
        let expected = first.saturating_mul(self.following.saturating_add(1));
        match left.checked_sub(expected) {
            Some(before) => source.skip(before),
            None => Err(DecodeError::Truncated { expected, got: left }),
        }
    }

    /// Reads `count` voxels and narrows them.
    fn read_scalars(&self, source: &mut Source<'_>, count: usize) -> Result<Narrowed, DecodeError> {
        Ok(match self.scalar_type {
            ScalarType::U8 => Narrowed::exact(Scalars::U8(self.read_typed(source, count)?), 0.0),
            ScalarType::U16 => from_the_smallest(self.read_typed(source, count)?, 0.0),
            // Flipping the sign bit adds 128 (32768) modulo 256 (65536): signed order becomes code order.
            ScalarType::I8 => {
                let mut codes: Vec<u8> = self.read_typed(source, count)?;
                codes.par_iter_mut().for_each(|code| *code ^= 0x80);
                Narrowed::exact(Scalars::U8(codes), f64::from(i8::MIN))
            }
            ScalarType::I16 => {
                let mut codes: Vec<u16> = self.read_typed(source, count)?;
                codes.par_iter_mut().for_each(|code| *code ^= 0x8000);
                from_the_smallest(codes, f64::from(i16::MIN))
            }
            ScalarType::U32 => narrow_wide(&self.read_typed::<u32>(source, count)?),
            ScalarType::I32 => narrow_wide(&self.read_typed::<i32>(source, count)?),
            ScalarType::F32 => narrow_wide(&self.read_typed::<f32>(source, count)?),
            ScalarType::F64 => narrow_wide(&self.read_typed::<f64>(source, count)?),
        })
    }

    /// Reads `count` scalars in native byte order.
    fn read_typed<T: Pod + Send + Sync>(&self, source: &mut Source<'_>, count: usize) -> Result<Vec<T>, DecodeError> {
        let at_once = source.left().is_some();
        let mut scalars: Vec<T> = if self.interleaved == 1 {
            read_growing(source, count, at_once)?
        } else {
            let period = self.interleaved as usize * size_of::<T>();
            read_growing(FirstOfEach { input: source, keep: size_of::<T>(), period }, count, at_once)?
        };
        if self.endian != Endian::NATIVE && self.scalar_type.size() > 1 {
            let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut scalars);
            let swap = |chunk: &mut [u8]| chunk.chunks_exact_mut(size_of::<T>()).for_each(<[u8]>::reverse);
            bytes.par_chunks_mut(1 << 20).for_each(swap);
        }
        Ok(scalars)
    }

    /// Joins the file's own rescale with that of the narrowing.
    fn volume(&self, dims: [usize; 3], narrowed: Narrowed) -> Result<Volume, DecodeError> {
        let (file_slope, file_intercept) = self.rescale;
        let upright = if file_slope < 0.0 { narrowed.flipped() } else { narrowed };
        let Narrowed { scalars, slope, intercept, non_finite, quantized } = upright;
        let slope = slope * file_slope;
        let intercept = file_intercept + intercept * file_slope;
        let highest = intercept + slope * scalars.max_code();
        if !highest.is_finite() {
            let message = format!("{}: expected finite values, got a range up to {highest}", self.format);
            return Err(DecodeError::Malformed(message));
        }
        let volumes_left_out = self.following.saturating_add(self.interleaved - 1);
        let report = ImportReport {
            scalar_type: self.scalar_type,
            non_finite,
            quantized,
            volumes_left_out,
            format: self.format,
        };
        Ok(Volume::new(dims, self.placement, scalars, (slope, intercept), report)?)
    }
}

/// Codes counted from the smallest: tables over codes begin where the volume's values do. (Hounsfield
/// units from -1024 on as signed 16 bits would leave their first 31744 entries unused.)
fn from_the_smallest(mut codes: Vec<u16>, intercept: f64) -> Narrowed {
    let smallest = codes.par_chunks(1 << 16).filter_map(|chunk| chunk.iter().copied().min()).min().unwrap_or(0);
    if smallest > 0 {
        codes.par_iter_mut().for_each(|code| *code -= smallest);
    }
    Narrowed::exact(Scalars::U16(codes), intercept + f64::from(smallest))
}

/// The placement whose steps along i, j, k are the columns of `steps` (LPS mm).
pub(super) fn placement_from_steps(steps: DMat3, origin: DVec3) -> Placement {
    let columns = [steps.x_axis, steps.y_axis, steps.z_axis];
    let spacing = DVec3::from_array(columns.map(DVec3::length));
    let direction = DMat3::from_cols(columns[0] / spacing.x, columns[1] / spacing.y, columns[2] / spacing.z);
    Placement { spacing, direction, origin }
}

/// Reads exactly `count` scalars into memory that is taken at once, or grows as bytes come.
fn read_growing<T: Pod>(mut input: impl Read, count: usize, at_once: bool) -> Result<Vec<T>, DecodeError> {
    /// Scalars before the first doubling.
    const FIRST: usize = 1 << 16;
    let mut scalars: Vec<T> = Vec::new();
    let mut filled = 0;
    let expected = count * size_of::<T>();
    while filled < expected {
        if filled == scalars.len() * size_of::<T>() {
            let grown = if at_once { count } else { (2 * scalars.len()).clamp(FIRST.min(count), count) };
            let out_of_memory = |_| read_error(io::ErrorKind::OutOfMemory.into());
            scalars.try_reserve_exact(grown - scalars.len()).map_err(out_of_memory)?;
            scalars.resize(grown, T::zeroed());
        }
        let ended = match input.read(&mut bytemuck::cast_slice_mut(&mut scalars)[filled..]) {
            Ok(got) => {
                filled += got;
                got == 0
            }
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => true,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => false,
            Err(error) => return Err(read_error(error)),
        };
        if ended {
            return Err(DecodeError::Truncated { expected: expected as u64, got: filled as u64 });
        }
    }
    Ok(scalars)
}

/// The first `keep` bytes of every `period`: one volume out of several that are interleaved.
struct FirstOfEach<R> {
    input: R,
    keep: usize,
    period: usize,
}

impl<R: BufRead> Read for FirstOfEach<R> {
    /// Fills whole scalars only, which is what [`read_growing`] asks for.
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        /// Bytes per call, so that a stream that ends early is told about where it ended.
        const MOST: usize = 1 << 16;
        let whole = buffer.len().min(MOST) / self.keep * self.keep;
        for scalar in buffer[..whole].chunks_exact_mut(self.keep) {
            self.input.read_exact(scalar)?;
            let mut others = self.period - self.keep;
            while others > 0 {
                let got = self.input.fill_buf()?.len().min(others);
                if got == 0 {
                    return Err(io::ErrorKind::UnexpectedEof.into());
                }
                self.input.consume(got);
                others -= got;
            }
        }
        Ok(whole)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Remembers how much memory each read was offered.
    struct Watched<R> {
        input: R,
        most_offered: usize,
    }

    impl<R: Read> Read for Watched<R> {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            self.most_offered = self.most_offered.max(buffer.len());
            self.input.read(buffer)
        }
    }

    #[test]
    fn memory_grows_with_what_comes_and_not_with_what_was_promised() {
        let sent = 1 << 20;
        let mut watched = Watched { input: io::repeat(7).take(sent), most_offered: 0 };
        let result = read_growing::<u16>(&mut watched, 1 << 40, false);
        assert!(matches!(result, Err(DecodeError::Truncated { expected, got }) if expected == 2 << 40 && got == sent));
        assert!(watched.most_offered as u64 <= 2 * sent, "{} bytes for {sent}", watched.most_offered);
    }

    #[test]
    fn every_count_is_read_to_the_end_and_no_further() {
        for count in [1, 2, (1 << 16) - 1, 1 << 16, (1 << 16) + 1, 300_000] {
            for at_once in [false, true] {
                let mut endless = io::repeat(1);
                let scalars = read_growing::<u16>(&mut endless, count, at_once).unwrap();
                assert_eq!(scalars, vec![0x0101; count]);
            }
        }
    }

    #[test]
    fn sixteen_bit_codes_count_from_the_smallest() {
        let hounsfield = [-1024, 3071, 0, -1000].map(|value: i16| value as u16 ^ 0x8000);
        let narrowed = from_the_smallest(hounsfield.to_vec(), f64::from(i16::MIN));
        assert_eq!(narrowed, Narrowed::exact(Scalars::U16(vec![0, 4095, 1024, 24]), -1024.0));
        assert_eq!(from_the_smallest(vec![], 0.0).intercept, 0.0);
    }

    #[test]
    fn the_first_of_each_group_is_taken() {
        let bytes: Vec<u8> = (0..24).collect();
        let first = FirstOfEach { input: bytes.as_slice(), keep: 2, period: 6 };
        assert_eq!(
            bytemuck::cast_slice::<u16, u8>(&read_growing::<u16>(first, 4, false).unwrap()),
            [0, 1, 6, 7, 12, 13, 18, 19]
        );
        let short = FirstOfEach { input: &bytes[..23], keep: 2, period: 6 };
        assert!(matches!(read_growing::<u16>(short, 4, false), Err(DecodeError::Truncated { expected: 8, .. })));
    }
}
