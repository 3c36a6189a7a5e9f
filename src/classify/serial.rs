//! Run-length encodings as bytes, for keeping them across restarts.
//!
//! The kernel indexes by what the encodings say, so what is read back is checked in full: every
//! count before memory is taken for it, every mark and every code afterwards.

use std::io::{self, Read, Write};
use std::sync::Arc;

use super::marks::{MORE, Marks, WORD, words};
use super::rle::{Plane, RunLengthVolume, Voxel};
use super::visible::Visible;
use crate::volume::Volume;
use crate::volume::gradient::NO_NORMAL;

/// Written first in the machine's own byte order, in which all numbers follow. The last byte is the format's version.
const BYTE_ORDER: u32 = 0x0102_0305;

/// Writes all planes.
pub(super) fn write(encoding: &RunLengthVolume, out: &mut impl Write) -> io::Result<()> {
    out.write_all(bytemuck::bytes_of(&BYTE_ORDER))?;
    out.write_all(bytemuck::bytes_of(&encoding.dims.map(|n| n as u32)))?;
    for (order, planes) in [&encoding.along_x, &encoding.along_y].into_iter().enumerate() {
        for (z, plane) in planes.iter().enumerate() {
            out.write_all(bytemuck::cast_slice(encoding.visible.plane(z)[order]))?;
            out.write_all(bytemuck::cast_slice(plane.stored()))?;
            out.write_all(plane.factors())?;
        }
    }
    Ok(())
}

/// Reads and checks all planes.
pub(super) fn read(volume: &Volume, with_factors: bool, input: &mut impl Read) -> io::Result<RunLengthVolume> {
    let dims @ [nx, ny, nz] = volume.dims();
    expect(read_value::<u32>(input)? == BYTE_ORDER, "another byte order or format")?;
    expect(read_value::<[u32; 3]>(input)? == dims.map(|n| n as u32), "other dimensions")?;
    let last_code = volume.code_range().1;
    let mut order = |length: usize, rows: usize| -> io::Result<(Vec<u64>, Vec<Plane>)> {
        let mut marks = Vec::with_capacity(nz * rows * words(length) + MORE);
        let plane = |_| read_plane(input, (length, rows), &mut marks, last_code, with_factors);
        let planes = (0..nz).map(plane).collect::<io::Result<_>>()?;
        marks.extend([0; MORE]);
        Ok((marks, planes))
    };
    let ((marks_x, along_x), (marks_y, along_y)) = (order(nx, ny)?, order(ny, nx)?);
    let visible = Arc::new(Visible::of(Marks { dims, along_x: marks_x, along_y: marks_y }));
    Ok(RunLengthVolume { dims, visible, along_x, along_y })
}

/// Writes the runs of cells.
pub(super) fn write_cells(cells: &Visible, out: &mut impl Write) -> io::Result<()> {
    let cells = cells.marks();
    out.write_all(bytemuck::bytes_of(&BYTE_ORDER))?;
    out.write_all(bytemuck::bytes_of(&cells.dims.map(|n| n as u32)))?;
    for order in [&cells.along_x, &cells.along_y] {
        out.write_all(bytemuck::cast_slice(&order[..order.len() - MORE]))?;
    }
    Ok(())
}

/// Reads and checks the runs of cells.
pub(super) fn read_cells(volume: &Volume, input: &mut impl Read) -> io::Result<Visible> {
    let dims @ [nx, ny, nz] = volume.dims().map(|n| n - 1);
    expect(read_value::<u32>(input)? == BYTE_ORDER, "another byte order or format")?;
    expect(read_value::<[u32; 3]>(input)? == dims.map(|n| n as u32), "other dimensions")?;
    let mut order = |length: usize, rows: usize| -> io::Result<Vec<u64>> {
        let mut marks = read_marks(input, length, rows)?;
        marks.extend([0; MORE]);
        Ok(marks)
    };
    Ok(Visible::of(Marks { dims, along_x: order(nx, ny * nz)?, along_y: order(ny, nx * nz)? }))
}

/// Reads marks of so many scanlines of a length, and checks that none is past the end of a scanline.
fn read_marks(input: &mut impl Read, length: usize, rows: usize) -> io::Result<Vec<u64>> {
    let marks: Vec<u64> = read_values(input, words(length) * rows)?;
    let past_end = if length.is_multiple_of(WORD) { 0 } else { u64::MAX << (length % WORD) };
    let last = marks.chunks_exact(words(length)).map(|row| row[row.len() - 1]);
    expect(last.fold(0, |all, word| all | word) & past_end == 0, "marks past the end of a scanline")?;
    Ok(marks)
}

/// Reads a plane of so many scanlines of a length, and appends its marks to those before.
fn read_plane(
    input: &mut impl Read,
    (length, rows): (usize, usize),
    marks: &mut Vec<u64>,
    last_code: u16,
    with_factors: bool,
) -> io::Result<Plane> {
    let of_plane = read_marks(input, length, rows)?;
    let mut plane = Plane::of_marks(&of_plane, words(length));
    marks.extend(of_plane);
    let voxels: Vec<Voxel> = read_values(input, plane.count())?;
    expect(voxels.iter().all(|v| v.code <= last_code && v.normal <= NO_NORMAL), "a wrong voxel")?;
    let factors = read_values(input, if with_factors { plane.count() } else { 0 })?;
    plane.fill(&voxels, factors);
    Ok(plane)
}

fn read_value<T: bytemuck::Pod>(input: &mut impl Read) -> io::Result<T> {
    let mut value = T::zeroed();
    input.read_exact(bytemuck::bytes_of_mut(&mut value))?;
    Ok(value)
}

fn read_values<T: bytemuck::Pod>(input: &mut impl Read, count: usize) -> io::Result<Vec<T>> {
    let mut values = vec![T::zeroed(); count];
    input.read_exact(bytemuck::cast_slice_mut(&mut values))?;
    Ok(values)
}

fn expect(holds: bool, found: &str) -> io::Result<()> {
    if holds { Ok(()) } else { Err(io::Error::new(io::ErrorKind::InvalidData, format!("the encodings have {found}"))) }
}
