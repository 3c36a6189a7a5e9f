//! Frames -> one animated PNG.
//!
//! Frames are written as they come, so that a turntable of any length takes the memory of one
//! frame.

use std::io::Write;

use super::EncodeError;
use crate::render::Image;

/// Frames of a turntable at most: a tenth of a degree apart.
pub const MAX_FRAMES: u32 = 3600;

/// An animated PNG under construction; it loops for ever.
pub struct Animation<W: Write> {
    writer: png::Writer<W>,
}

impl<W: Write> Animation<W> {
    /// An animation of `frames` frames of `size` = (width, height) pixels with `channels` (3 or 4),
    /// each shown for `delay` = numerator / denominator seconds.
    ///
    /// # Errors
    /// For 0 frames, and where `out` fails.
    pub fn start(out: W, size: (u32, u32), channels: u8, frames: u32, delay: (u16, u16)) -> Result<Self, EncodeError> {
        let mut encoder = super::png_encoder(out, size.0, size.1, channels);
        encoder.set_animated(frames, 0)?;
        encoder.set_frame_delay(delay.0, delay.1)?;
        encoder.set_blend_op(png::BlendOp::Source)?;
        encoder.validate_sequence(true);
        Ok(Self { writer: encoder.write_header()? })
    }

    /// Adds a frame of the size and channels that were told.
    ///
    /// # Errors
    /// For a frame of another size or too many frames, and where the output fails.
    pub fn push(&mut self, frame: &Image) -> Result<(), EncodeError> {
        Ok(self.writer.write_image_data(&frame.pixels)?)
    }

    /// Ends the file.
    ///
    /// # Errors
    /// Where frames are missing, and where the output fails.
    pub fn finish(self) -> Result<(), EncodeError> {
        Ok(self.writer.finish()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::encode::tests::picture;

    #[test]
    fn an_animation_holds_its_frames_in_order() {
        let first = picture(8, 6, 3);
        let mut second = first.clone();
        second.pixels.reverse();
        let mut bytes = Vec::new();
        let mut animation = Animation::start(&mut bytes, (8, 6), 3, 2, (1, 15)).unwrap();
        animation.push(&first).unwrap();
        animation.push(&second).unwrap();
        animation.finish().unwrap();

        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        assert_eq!(reader.info().animation_control().unwrap().num_frames, 2);
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        for expected in [&first, &second] {
            reader.next_frame(&mut pixels).unwrap();
            assert_eq!(pixels, expected.pixels);
        }
    }

    #[test]
    fn an_animation_with_frames_missing_is_refused() {
        let first = picture(8, 6, 3);
        let mut animation = Animation::start(Vec::new(), (8, 6), 3, 2, (1, 15)).unwrap();
        animation.push(&first).unwrap();
        assert!(animation.finish().is_err());
    }
}
