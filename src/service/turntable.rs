//! The turntable: frames around the vertical axis in one answer.
//!
//! The frames go out as they are made, in whatever the client accepts: an animated PNG, a zip of pictures, or a
//! multipart stream, of which each part tells how far it is. The whole is never in memory: the next frame is begun when the one
//! before is on its way. Each takes its turn in the queue like a request of its own, and a client that leaves
//! ends the work in the middle of a frame.

use std::hash::{BuildHasher, RandomState};
use std::io::{self, Write};
use std::sync::{Arc, Mutex, PoisonError};

use axum::body::{Body, Bytes};
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, RawQuery, Request, State};
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};
use futures_util::stream;
use tokio::sync::mpsc;
use zip::write::{SimpleFileOptions, StreamWriter};
use zip::{CompressionMethod, ZipWriter};

use super::error::Problem;
use super::frames::{Asked, Made, read_json};
use super::render_pool::Ticket;
use super::request::RenderRequest;
use super::store::LoadedVolume;
use super::{App, negotiate};
use crate::encode::Format;
use crate::encode::animation::Animation;
use crate::render::Image;

/// Frames unless told: ten degrees apart.
const DEFAULT_FRAMES: u32 = 36;

/// Frames that an animation shows in a second, unless told and at most.
const DEFAULT_RATE: u32 = 15;
const MAX_RATE: u32 = 100;

/// What frames are packed into.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Container {
    Animation,
    Zip,
    Multipart,
}

impl Container {
    const ALL: [Self; 3] = [Self::Animation, Self::Zip, Self::Multipart];

    const fn media_type(self) -> &'static str {
        match self {
            Self::Animation => "image/apng",
            Self::Zip => "application/zip",
            Self::Multipart => "multipart/mixed",
        }
    }
}

/// How many frames, and how fast an animation shows them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Turn {
    frames: u32,
    rate: u32,
}

impl Turn {
    fn read(query: &str, max_frames: u32) -> Result<Self, Problem> {
        let (mut frames, mut rate) = (None, None);
        for (name, text) in form_urlencoded::parse(query.as_bytes()) {
            let (value, most) = match &*name {
                "frames" => (&mut frames, max_frames),
                "frames_per_second" => (&mut rate, MAX_RATE),
                _ => {
                    let expected = "unknown parameter; expected frames or frames_per_second";
                    return Err(Problem::refused(format!("/{name}"), expected));
                }
            };
            let number = text.parse().ok().filter(|number| value.is_none() && (1..=most).contains(number));
            let expected = format!("expected one whole number from 1 to {most}, got {text:?}");
            *value = Some(number.ok_or_else(|| Problem::refused(format!("/{name}"), expected))?);
        }
        Ok(Self { frames: frames.unwrap_or(DEFAULT_FRAMES.min(max_frames)), rate: rate.unwrap_or(DEFAULT_RATE) })
    }
}

/// `POST /v1/volumes/{id}/turntable`
pub async fn from_body(
    State(app): State<Arc<App>>,
    id: Result<Path<String>, PathRejection>,
    RawQuery(query): RawQuery,
    request: Request,
) -> Result<Response, Problem> {
    let Path(id) = id?;
    let volume = app.store.loaded(&id)?;
    let turn = Turn::read(query.as_deref().unwrap_or_default(), app.config.image.max_frames.get())?;
    let headers = request.headers().clone();
    let body = read_json(&app, request).await?;
    let request = RenderRequest::from_body(&body)?;
    let offered = Container::ALL.map(Container::media_type);
    let container = negotiate::choose(&headers, &offered).map(|at| Container::ALL[at]).ok_or(Problem::NotAcceptable)?;
    let format = match (container, request.format()) {
        (Container::Animation, None | Some(Format::Png)) => Format::Raw,
        (Container::Animation, Some(_)) => {
            return Err(Problem::refused("/image/format", "expected png, which is what an animation holds"));
        }
        (_, format) => format.unwrap_or(Format::Png),
    };
    request.is_final()?;
    let table = Turntable { app, id, volume, request, format, turn };
    // What one frame is refused for, all are.
    table.frame(0)?;
    let ticket = table.app.pool.admit()?;
    let packing = Packing::new(container, format, turn);
    let content_type = packing.content_type();
    let (sender, receiver) = mpsc::channel(1);
    tokio::spawn(table.produce(packing, ticket, sender));
    let chunks = stream::unfold(receiver, async |mut receiver| receiver.recv().await.map(|chunk| (chunk, receiver)));
    let mut response = Body::from_stream(chunks).into_response();
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, content_type);
    headers.insert(header::VARY, HeaderValue::from_static("Accept"));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    Ok(response)
}

/// What is turned.
struct Turntable {
    app: Arc<App>,
    id: String,
    volume: Arc<LoadedVolume>,
    request: RenderRequest,
    format: Format,
    turn: Turn,
}

impl Turntable {
    fn frame(&self, number: u32) -> Result<Asked, Problem> {
        let request = self.request.turned(360.0 * f64::from(number) / f64::from(self.turn.frames))?;
        Asked::new(&self.app, self.id.clone(), Arc::clone(&self.volume), request, self.format)
    }

    /// Makes and sends frame after frame, until all are out or the client has left.
    async fn produce(self, packing: Packing, ticket: Ticket, sender: mpsc::Sender<io::Result<Bytes>>) {
        tokio::select! {
            outcome = self.send_all(packing, ticket, &sender) => if let Err(problem) = outcome {
                tracing::warn!(volume = self.id, ?problem, "a turntable ends early");
                // The head is out; all that is left is to break the connection.
                let _ = sender.send(Err(io::Error::other("a frame could not be made"))).await;
            },
            () = sender.closed() => {}
        }
    }

    async fn send_all(
        &self,
        mut packing: Packing,
        first: Ticket,
        sender: &mpsc::Sender<io::Result<Bytes>>,
    ) -> Result<(), Problem> {
        let mut first = Some(first);
        for number in 0..self.turn.frames {
            let ticket = match first.take() {
                Some(ticket) => ticket,
                None => self.app.pool.place().await?,
            };
            let made = self.frame(number)?.made(&self.app, ticket.clone()).await?;
            let packed = ticket.run(move |_| packing.push(number, made).map(|chunk| (packing, chunk))).await?.0;
            let (same, chunk) = packed.map_err(|error| failed(&error))?;
            packing = same;
            if sender.send(Ok(chunk)).await.is_err() {
                return Ok(());
            }
        }
        let end = packing.finish().map_err(|error| failed(&error))?;
        let _ = sender.send(Ok(end)).await;
        Ok(())
    }
}

fn failed(error: &io::Error) -> Problem {
    tracing::error!(%error, "a turntable's frame could not be packed");
    Problem::Internal("a frame could not be packed")
}

/// A container under construction.
struct Packing {
    writer: Writer,
    out: Chunk,
    format: Format,
    turn: Turn,
}

enum Writer {
    /// Begun with the first frame, which tells the size.
    Animation(Option<Animation<Chunk>>),
    Zip(Box<ZipWriter<StreamWriter<Chunk>>>),
    Multipart {
        boundary: String,
    },
}

impl Packing {
    fn new(container: Container, format: Format, turn: Turn) -> Self {
        let out = Chunk::default();
        let writer = match container {
            Container::Animation => Writer::Animation(None),
            Container::Zip => Writer::Zip(Box::new(ZipWriter::new_stream(out.clone()))),
            // 128 random bits, which no picture holds by chance.
            Container::Multipart => {
                let random = || RandomState::new().hash_one(0);
                Writer::Multipart { boundary: format!("frame-{:016x}{:016x}", random(), random()) }
            }
        };
        Self { writer, out, format, turn }
    }

    fn content_type(&self) -> HeaderValue {
        match &self.writer {
            Writer::Animation(_) => HeaderValue::from_static(Container::Animation.media_type()),
            Writer::Zip(_) => HeaderValue::from_static(Container::Zip.media_type()),
            Writer::Multipart { boundary } => {
                let text = format!("{}; boundary={boundary}", Container::Multipart.media_type());
                HeaderValue::from_str(&text).expect("visible ASCII")
            }
        }
    }

    /// Adds a frame; gives the bytes that are ready.
    fn push(&mut self, number: u32, made: Made) -> io::Result<Bytes> {
        match &mut self.writer {
            Writer::Animation(animation) => {
                let [width, height, channels] = made.size;
                let channels = channels as u8;
                let animation = match animation {
                    Some(animation) => animation,
                    None => {
                        let delay = (1, self.turn.rate as u16);
                        let begun =
                            Animation::start(self.out.clone(), (width, height), channels, self.turn.frames, delay);
                        animation.insert(begun.map_err(io::Error::other)?)
                    }
                };
                let image = Image { width, height, channels, pixels: made.bytes, warp: None };
                animation.push(&image).map_err(io::Error::other)?;
            }
            Writer::Zip(zip) => {
                // Pictures are compressed already.
                let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
                zip.start_file(format!("{number:04}.{}", self.format.extension()), options)?;
                zip.write_all(&made.bytes)?;
            }
            Writer::Multipart { boundary } => {
                let (media_type, length) = (self.format.media_type(), made.bytes.len());
                let (number, frames) = (number + 1, self.turn.frames);
                write!(
                    self.out,
                    "--{boundary}\r\nContent-Type: {media_type}\r\nContent-Length: {length}\r\nX-Frame: {number}/{frames}\r\n\r\n"
                )?;
                self.out.write_all(&made.bytes)?;
                self.out.write_all(b"\r\n")?;
            }
        }
        Ok(self.out.take())
    }

    /// The last bytes.
    fn finish(mut self) -> io::Result<Bytes> {
        match self.writer {
            Writer::Animation(animation) => {
                animation.expect("there is a frame").finish().map_err(io::Error::other)?;
            }
            Writer::Zip(zip) => drop(zip.finish()?),
            Writer::Multipart { boundary } => write!(self.out, "--{boundary}--\r\n")?,
        }
        Ok(self.out.take())
    }
}

/// Bytes that a writer has written and nobody has taken. Clones share them.
#[derive(Clone, Debug, Default)]
struct Chunk(Arc<Mutex<Vec<u8>>>);

impl Chunk {
    fn take(&self) -> Bytes {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner)).into()
    }
}

impl Write for Chunk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_and_rate_are_whole_numbers_in_range() {
        assert_eq!(Turn::read("", 3600).unwrap(), Turn { frames: 36, rate: 15 });
        assert_eq!(Turn::read("frames=3&frames_per_second=100", 3600).unwrap(), Turn { frames: 3, rate: 100 });
        for bad in [
            "frames=0",
            "frames=3601",
            "frames=",
            "frames=1.5",
            "frames=2&frames=2",
            "frame=2",
            "frames_per_second=101",
        ] {
            assert!(matches!(Turn::read(bad, 3600), Err(Problem::Refused(_))), "{bad}");
        }
    }
}
