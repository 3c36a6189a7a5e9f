//! [`Image`] -> bytes of a file format.
//!
//! A frame is encoded once and looked at for a blink, so the formats are set for speed before size:
//! PNG by the fast Deflate path with one filter for all rows. Formats differ in what they can hold
//! (JPEG has no alpha, WebP ends at 16383 pixels); [`Format::holds`] says so before anything is
//! rendered for nothing.

use image::ExtendedColorType;

use crate::render::Image;

pub mod animation;

/// JPEG quality, 1..=100: compression blocks do not show on smooth shading from about here on.
const JPEG_QUALITY: u8 = 90;

/// A file format of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Format {
    Png,
    Jpeg,
    /// Lossless.
    Webp,
    /// The pixels as they are: rows from the top, RGB or RGBA, 8 bits, no header.
    Raw,
}

/// Why an image does not fit a format.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unfit {
    #[error("jpeg holds no transparency: expected an opaque background or another format")]
    Alpha,
    #[error("{} holds at most {max} pixels a side, got {got}", .format.name())]
    Side { format: Format, max: u32, got: u32 },
}

/// Why there are no bytes.
#[derive(Debug, thiserror::Error)]
pub enum EncodeError {
    #[error(transparent)]
    Unfit(#[from] Unfit),
    #[error("png: {0}")]
    Png(#[from] png::EncodingError),
    #[error(transparent)]
    Other(#[from] image::ImageError),
}

impl Format {
    /// All formats, the preferred one first.
    pub const ALL: [Self; 4] = [Self::Png, Self::Jpeg, Self::Webp, Self::Raw];

    /// The name used by the API.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Jpeg => "jpeg",
            Self::Webp => "webp",
            Self::Raw => "raw",
        }
    }

    /// The media type of an encoded image.
    pub const fn media_type(self) -> &'static str {
        match self {
            Self::Png => "image/png",
            Self::Jpeg => "image/jpeg",
            Self::Webp => "image/webp",
            Self::Raw => "application/octet-stream",
        }
    }

    /// What a file of this format is called, without the dot.
    pub const fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Jpeg => "jpg",
            Self::Webp => "webp",
            Self::Raw => "raw",
        }
    }

    /// The format with this [`Format::name`].
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|f| f.name() == name)
    }

    /// The format of a file with this extension (without the dot, in any case; `jpeg` is `jpg`).
    pub fn from_extension(extension: &str) -> Option<Self> {
        let extension = extension.to_ascii_lowercase();
        Self::ALL.into_iter().find(|f| f.extension() == extension || f.name() == extension)
    }

    /// Pixels across or down at most.
    pub const fn max_side(self) -> u32 {
        match self {
            Self::Png | Self::Raw => i32::MAX as u32,
            Self::Jpeg => 65_535,
            Self::Webp => 16_383,
        }
    }

    /// Whether an image of this size, with or without alpha, can be written.
    ///
    /// # Errors
    /// [`Unfit`] with the reason.
    pub fn holds(self, width: u32, height: u32, alpha: bool) -> Result<(), Unfit> {
        let (got, max) = (width.max(height), self.max_side());
        if got > max {
            return Err(Unfit::Side { format: self, max, got });
        }
        if alpha && self == Self::Jpeg { Err(Unfit::Alpha) } else { Ok(()) }
    }
}

/// The image as a file of `format`.
///
/// # Errors
/// Where the format cannot hold the image ([`Format::holds`]).
pub fn encode(image: &Image, format: Format) -> Result<Vec<u8>, EncodeError> {
    let alpha = image.channels == 4;
    format.holds(image.width, image.height, alpha)?;
    let color = if alpha { ExtendedColorType::Rgba8 } else { ExtendedColorType::Rgb8 };
    let mut bytes = Vec::new();
    match format {
        Format::Png => encode_png(image, &mut bytes)?,
        Format::Jpeg => image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY).encode(
            &image.pixels,
            image.width,
            image.height,
            color,
        )?,
        Format::Webp => image::codecs::webp::WebPEncoder::new_lossless(&mut bytes).encode(
            &image.pixels,
            image.width,
            image.height,
            color,
        )?,
        Format::Raw => bytes.extend_from_slice(&image.pixels),
    }
    Ok(bytes)
}

fn encode_png(image: &Image, bytes: &mut Vec<u8>) -> Result<(), png::EncodingError> {
    let mut writer = png_encoder(bytes, image.width, image.height, image.channels).write_header()?;
    writer.write_image_data(&image.pixels)?;
    writer.finish()
}

/// A PNG encoder with the settings that all our PNGs share.
fn png_encoder<W: std::io::Write>(out: W, width: u32, height: u32, channels: u8) -> png::Encoder<'static, W> {
    let mut encoder = png::Encoder::new(out, width, height);
    encoder.set_color(if channels == 4 { png::ColorType::Rgba } else { png::ColorType::Rgb });
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    encoder
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Smooth in x, busy in y, so that both filters and matches are at work.
    pub fn picture(width: u32, height: u32, channels: u8) -> Image {
        let pixel = |x: u32, y: u32| [(x * 3) as u8, (y * 7 % 32) as u8, (x ^ y) as u8, (255 - x) as u8];
        let rows = (0..height).flat_map(|y| (0..width).map(move |x| pixel(x, y)));
        let pixels = rows.flat_map(|p| p.into_iter().take(channels as usize)).collect();
        Image { width, height, channels, pixels, warp: None }
    }

    fn decode_png(bytes: &[u8]) -> (png::OutputInfo, Vec<u8>) {
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        (info, pixels)
    }

    #[test]
    fn png_keeps_every_pixel_with_and_without_alpha() {
        for channels in [3, 4] {
            let image = picture(37, 19, channels);
            let (info, pixels) = decode_png(&encode(&image, Format::Png).unwrap());
            assert_eq!((info.width, info.height), (37, 19));
            assert_eq!(info.color_type, if channels == 4 { png::ColorType::Rgba } else { png::ColorType::Rgb });
            assert_eq!(pixels, image.pixels);
        }
    }

    #[test]
    fn webp_keeps_every_pixel_with_and_without_alpha() {
        for channels in [3, 4] {
            let image = picture(37, 19, channels);
            let bytes = encode(&image, Format::Webp).unwrap();
            let back = image::load_from_memory_with_format(&bytes, image::ImageFormat::WebP).unwrap();
            assert_eq!(back.color().channel_count(), channels);
            assert_eq!(back.as_bytes(), image.pixels);
        }
    }

    #[test]
    fn jpeg_keeps_smooth_pixels_nearly() {
        let mut image = picture(64, 64, 3);
        image.pixels.chunks_mut(3).for_each(|p| p.copy_from_slice(&[p[0]; 3]));
        let bytes = encode(&image, Format::Jpeg).unwrap();
        let back = image::load_from_memory_with_format(&bytes, image::ImageFormat::Jpeg).unwrap();
        let worst = back.as_bytes().iter().zip(&image.pixels).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(worst.unwrap() <= 6, "{worst:?}");
    }

    #[test]
    fn raw_is_the_pixels() {
        let image = picture(5, 4, 4);
        assert_eq!(encode(&image, Format::Raw).unwrap(), image.pixels);
    }

    #[test]
    fn what_a_format_cannot_hold_is_refused() {
        let refused = encode(&picture(4, 4, 4), Format::Jpeg).unwrap_err();
        assert!(refused.to_string().contains("transparency"), "{refused}");
        let long = Image { width: 20_000, height: 1, channels: 3, pixels: vec![0; 60_000], warp: None };
        let refused = encode(&long, Format::Webp).unwrap_err();
        assert!(refused.to_string().contains("16383"), "{refused}");
        assert!(encode(&long, Format::Png).is_ok());
    }

    #[test]
    fn names_and_extensions_lead_back_to_their_format() {
        for format in Format::ALL {
            assert_eq!(Format::from_name(format.name()), Some(format));
            assert_eq!(Format::from_extension(&format.extension().to_uppercase()), Some(format));
        }
        assert_eq!(Format::from_extension("jpeg"), Some(Format::Jpeg));
        assert_eq!(Format::from_name("PNG"), None);
    }
}
