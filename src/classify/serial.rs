//! Run-length encodings as bytes, for keeping them across restarts.
//!
//! The kernel indexes by what the encodings say, so what is read back is checked in full: every
//! count before memory is taken for it, every run and every code afterwards.

use std::io::{self, Read, Write};

use super::cells::{self, CellRuns};
use super::rle::{LONGEST_RUN, Plane, RunLengthVolume, WORD};
use crate::volume::Volume;
use crate::volume::gradient::NO_NORMAL;

/// Written first in the machine's own byte order, in which all numbers follow.
const BYTE_ORDER: u32 = 0x0102_0304;

/// Writes all planes.
pub(super) fn write(encoding: &RunLengthVolume, out: &mut impl Write) -> io::Result<()> {
    out.write_all(bytemuck::bytes_of(&BYTE_ORDER))?;
    out.write_all(bytemuck::bytes_of(&encoding.dims.map(|n| n as u32)))?;
    for plane in encoding.along_x.iter().chain(&encoding.along_y) {
        let counts = [plane.rows.len() as u32, plane.runs.len() as u32, plane.voxels.len() as u32];
        out.write_all(bytemuck::bytes_of(&counts))?;
        out.write_all(bytemuck::cast_slice(&plane.rows))?;
        out.write_all(bytemuck::cast_slice(&plane.runs))?;
        out.write_all(bytemuck::cast_slice(&plane.voxels))?;
        out.write_all(&plane.factors)?;
    }
    Ok(())
}

/// Reads and checks all planes.
pub(super) fn read(volume: &Volume, with_factors: bool, input: &mut impl Read) -> io::Result<RunLengthVolume> {
    let dims @ [nx, ny, nz] = volume.dims();
    expect(read_value::<u32>(input)? == BYTE_ORDER, "another byte order")?;
    expect(read_value::<[u32; 3]>(input)? == dims.map(|n| n as u32), "other dimensions")?;
    let last_code = volume.code_range().1;
    let mut planes = |length: usize, rows: usize| -> io::Result<Vec<Plane>> {
        (0..nz).map(|_| read_plane(input, length, rows, last_code, with_factors)).collect()
    };
    Ok(RunLengthVolume::new(dims, planes(nx, ny)?, planes(ny, nx)?))
}

/// Writes the runs of cells.
pub(super) fn write_cells(cells: &CellRuns, out: &mut impl Write) -> io::Result<()> {
    out.write_all(bytemuck::bytes_of(&BYTE_ORDER))?;
    out.write_all(bytemuck::bytes_of(&cells.dims.map(|n| n as u32)))?;
    out.write_all(bytemuck::cast_slice(&cells.along_x))?;
    out.write_all(bytemuck::cast_slice(&cells.along_y))
}

/// Reads and checks the runs of cells.
pub(super) fn read_cells(volume: &Volume, input: &mut impl Read) -> io::Result<CellRuns> {
    let dims @ [nx, ny, nz] = volume.dims().map(|n| n - 1);
    expect(read_value::<u32>(input)? == BYTE_ORDER, "another byte order")?;
    expect(read_value::<[u32; 3]>(input)? == dims.map(|n| n as u32), "other dimensions")?;
    let mut read = |cells: usize, rows: usize| -> io::Result<Vec<u64>> {
        let words: Vec<u64> = read_values(input, cells::words(cells) * rows)?;
        let past_end = if cells.is_multiple_of(cells::WORD) { 0 } else { u64::MAX << (cells % cells::WORD) };
        let last = words.chunks_exact(cells::words(cells)).map(|row| row[row.len() - 1]);
        expect(last.fold(0, |all, word| all | word) & past_end == 0, "cells past the end of a scanline")?;
        Ok(words)
    };
    Ok(CellRuns { dims, along_x: read(nx, ny * nz)?, along_y: read(ny, nx * nz)? })
}

fn read_plane(
    input: &mut impl Read,
    length: usize,
    rows: usize,
    last_code: u16,
    with_factors: bool,
) -> io::Result<Plane> {
    let [row_count, run_count, voxel_count] = read_value::<[u32; 3]>(input)?.map(|n| n as usize);
    expect(row_count == rows + 1, "a wrong number of rows")?;
    expect(run_count <= voxel_count && voxel_count <= length * rows, "more runs or voxels than fit")?;
    let plane = Plane {
        rows: read_values(input, row_count)?,
        runs: read_values(input, run_count)?,
        voxels: read_values(input, voxel_count)?,
        factors: read_values(input, if with_factors { voxel_count } else { 0 })?,
    };
    check_plane(&plane, length, last_code)?;
    Ok(plane)
}

/// What the kernel relies on: rows partition runs and voxels, runs ascend without overlap, stay in
/// their row and in one word, and cover as many voxels as their row has.
fn check_plane(plane: &Plane, length: usize, last_code: u16) -> io::Result<()> {
    let ends = [plane.runs.len() as u32, plane.voxels.len() as u32];
    expect(plane.rows[0] == [0, 0] && plane.rows[plane.rows.len() - 1] == ends, "rows that do not cover the plane")?;
    for pair in plane.rows.windows(2) {
        let ([run, voxel], [run_end, voxel_end]) = (pair[0], pair[1]);
        let sound = run <= run_end && voxel <= voxel_end && run_end <= ends[0] && voxel_end <= ends[1];
        expect(sound, "rows out of order")?;
        let (mut next, mut covered) = (0, 0);
        for run in &plane.runs[run as usize..run_end as usize] {
            let (start, count) = (usize::from(run.start), usize::from(run.length));
            let end = start + count;
            let one_word = (1..=LONGEST_RUN).contains(&count) && start / WORD == (end - 1) / WORD;
            expect(one_word && start >= next && end <= length, "a wrong run")?;
            (next, covered) = (end, covered + count);
        }
        expect(covered == (voxel_end - voxel) as usize, "runs that do not match their voxels")?;
    }
    expect(plane.voxels.iter().all(|v| v.code <= last_code && v.normal <= NO_NORMAL), "a wrong voxel")
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
