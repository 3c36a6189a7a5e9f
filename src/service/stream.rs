//! The stream: requests in, frames out, over one WebSocket (docs/stream.md).
//!
//! Whoever drags asks for more views than can be rendered, and wants the newest. So a stream keeps one
//! request, the newest, and one frame in the making:
//!
//! - While requests keep coming, frames have the quality of movement (`draft` unless told). Once none
//!   has come for half as long again as the last one took to follow the one before ([`rest`]), the same view is refined quality by
//!   quality up to the request's own (`high` unless told), or at once where that one lately took less than [`QUICK`].
//! - A new request drops a refinement in the middle of its work. A frame of movement is worth more
//!   finished than dropped, for the next would take as long: it is dropped only where it is
//!   slow ([`SLOW`]), and never twice in a row, so that something always arrives.
//! - At most [`WINDOW`] frames are on their way that the client has not acknowledged. Until it does
//!   nothing is rendered for it: a slow line gets fewer frames, not later ones.
//! - Each stream has one job at a time in the queue that all wait in, first come, first served; so those that
//!   are busy take turns.

use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::extract::rejection::PathRejection;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade, close_code};
use axum::extract::{Path, State};
use axum::http::{HeaderMap, header};
use axum::response::Response;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};

use super::error::{Problem, ProblemBody};
use super::frames::{Asked, Made};
use super::request::{RenderRequest, json};
use super::store::LoadedVolume;
use super::{App, metrics};
use crate::encode::Format;
use crate::render::Quality;

/// Frames on their way at most: one that the client shows, and one that follows it.
const WINDOW: u64 = 2;

/// Without a request for so long the client rests, at the least: pointers of fast screens leave less than that between two events.
const LEAST_REST: Duration = Duration::from_millis(20);

/// And at the most: more than they leave on a slow screen, of 30 frames/s.
const MOST_REST: Duration = Duration::from_millis(40);

/// A refinement that takes less comes without coarser ones before it, which would only keep it waiting.
const QUICK: Duration = Duration::from_millis(150);

/// A frame of movement that takes longer may be dropped for a newer one.
const SLOW: Duration = Duration::from_millis(100);

/// Between two signs of life that are asked for; a client that gives none in twice the time is gone.
const PING: Duration = Duration::from_secs(20);

/// Streams that are open, and the end of them.
#[derive(Debug)]
pub struct Streams {
    places: Arc<Semaphore>,
    limit: usize,
    closing: watch::Sender<bool>,
}

impl Streams {
    /// None, and so many at most.
    pub fn new(limit: usize) -> Self {
        let limit = limit.min(u32::MAX as usize).min(Semaphore::MAX_PERMITS);
        Self { places: Arc::new(Semaphore::new(limit)), limit, closing: watch::Sender::new(false) }
    }

    /// Streams that are open.
    pub fn open(&self) -> usize {
        self.limit - self.places.available_permits()
    }

    /// Asks every stream to say goodbye; done when all have.
    pub async fn close(&self) {
        self.closing.send_replace(true);
        // An error: the semaphore was closed, which nobody does.
        let _ = self.places.acquire_many(self.limit as u32).await;
    }

    fn enter(&self, retry_after: u64) -> Result<Place, Problem> {
        let place = Arc::clone(&self.places).try_acquire_owned();
        let held = place.map_err(|_| Problem::TooManyStreams { limit: self.limit, retry_after })?;
        Ok(Place { _held: held, closing: self.closing.subscribe() })
    }
}

/// One of the streams that may be open.
struct Place {
    _held: OwnedSemaphorePermit,
    closing: watch::Receiver<bool>,
}

/// `GET /v1/volumes/{id}/stream`
pub async fn open(
    State(app): State<Arc<App>>,
    id: Result<Path<String>, PathRejection>,
    headers: HeaderMap,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Result<Response, Problem> {
    let Path(id) = id?;
    let volume = app.store.loaded(&id)?;
    let upgrade = upgrade?;
    of_this_origin(&headers)?;
    let place = app.streams.enter(app.config.render.retry_after_seconds.get())?;
    let limit = app.config.http.max_body_bytes.get();
    let upgrade = upgrade.max_message_size(limit).max_frame_size(limit);
    Ok(upgrade.on_upgrade(move |socket| Session::new(app, id, volume).run(socket, place)))
}

/// Browsers ask no server before a page of any origin opens a WebSocket to it; so the server looks.
fn of_this_origin(headers: &HeaderMap) -> Result<(), Problem> {
    let Some(origin) = headers.get(header::ORIGIN) else { return Ok(()) };
    let authority = origin.as_bytes().splitn(3, |&byte| byte == b'/').nth(2);
    if authority.is_some() && authority == headers.get(header::HOST).map(|host| host.as_bytes()) {
        Ok(())
    } else {
        Err(Problem::ForeignOrigin(String::from_utf8_lossy(origin.as_bytes()).into_owned()))
    }
}

/// What comes with a request, or without one.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Told {
    /// Quality of frames while requests keep coming, from now on.
    moving: Option<Quality>,
    /// The newest frame that the client has.
    ack: Option<u64>,
}

/// What stands before a frame's bytes.
#[derive(Serialize)]
struct Header {
    /// Of the frame, from 1.
    sequence: u64,
    /// The request that it answers, by number, from 1.
    request: u64,
    quality: &'static str,
    /// True where no better one of this request follows.
    last: bool,
    format: &'static str,
    width: u32,
    height: u32,
    channels: u32,
    /// As in X-Image-Warp.
    #[serde(skip_serializing_if = "Option::is_none")]
    warp: Option<[f64; 9]>,
    algorithm: &'static str,
    /// Milliseconds by stage, as in Server-Timing.
    timing: Map<String, Value>,
}

/// In place of a frame.
#[derive(Serialize)]
struct Refusal {
    /// The last request that was taken; 0 before the first.
    request: u64,
    error: ProblemBody,
}

/// A frame that is due or in the making.
#[derive(Clone)]
struct Step {
    request: u64,
    quality: Quality,
    /// True for frames of movement.
    moving: bool,
    last: bool,
}

/// What became of a frame.
type Outcome = Result<(Asked, Made), Problem>;

/// A frame in the making. To drop it is to cancel it.
struct Making {
    step: Step,
    begun: Instant,
    frame: Pin<Box<dyn Future<Output = Outcome> + Send>>,
}

/// One client.
struct Session {
    app: Arc<App>,
    id: String,
    volume: Arc<LoadedVolume>,
    /// The newest request, and how many there were.
    document: Value,
    requests: u64,
    arrived: Instant,
    /// The client rests without another one for so long.
    rest: Duration,
    moving: Quality,
    /// Qualities that the newest request is still to be rendered at, the next one last.
    due: Vec<Quality>,
    /// The quality of the last frame that no better one followed, and what it took.
    refined: Option<(Quality, Duration)>,
    making: Option<Making>,
    /// A slow frame was dropped, and none has arrived since.
    dropped: bool,
    sent: u64,
    acknowledged: u64,
}

impl Session {
    fn new(app: Arc<App>, id: String, volume: Arc<LoadedVolume>) -> Self {
        Self {
            app,
            id,
            volume,
            document: Value::Object(Map::new()),
            requests: 0,
            arrived: Instant::now(),
            rest: MOST_REST,
            moving: Quality::Draft,
            due: vec![],
            refined: None,
            making: None,
            dropped: false,
            sent: 0,
            acknowledged: 0,
        }
    }

    async fn run(mut self, mut socket: WebSocket, mut place: Place) {
        let opened = Instant::now();
        let mut heard = opened;
        let mut ping = tokio::time::interval(PING);
        ping.reset();
        loop {
            self.begin();
            let refine = self.refine_at();
            let answer = tokio::select! {
                message = socket.recv() => {
                    heard = Instant::now();
                    match message {
                        Some(Ok(Message::Text(text))) => match self.hear(text.as_bytes()) {
                            Ok(()) => None,
                            Err(problem) => Some(self.refusal(&problem)),
                        },
                        Some(Ok(Message::Binary(_))) => {
                            Some(goodbye(close_code::UNSUPPORTED, "expected text messages"))
                        }
                        Some(Ok(Message::Ping(_) | Message::Pong(_))) => None,
                        Some(Ok(Message::Close(_)) | Err(_)) | None => break,
                    }
                }
                outcome = made(&mut self.making) => Some(self.answer(outcome)),
                () = tokio::time::sleep_until(refine.unwrap_or(opened).into()), if refine.is_some() => None,
                _ = ping.tick() => {
                    if heard.elapsed() > 2 * PING {
                        break;
                    }
                    Some(Message::Ping(vec![].into()))
                }
                _ = place.closing.wait_for(|closing| *closing) => {
                    Some(goodbye(close_code::AWAY, "the service is shutting down"))
                }
            };
            if let Some(answer) = answer {
                let is_last = matches!(answer, Message::Close(_));
                // Writes that stand still end by the connection's own timeout.
                if socket.send(answer).await.is_err() || is_last {
                    break;
                }
            }
        }
        let seconds = opened.elapsed().as_secs_f64();
        tracing::info!(volume = self.id, requests = self.requests, frames = self.sent, seconds, "stream ended");
    }

    /// Takes a message: whole or not at all.
    fn hear(&mut self, text: &[u8]) -> Result<(), Problem> {
        let Value::Object(mut members) = json::parse(text)? else {
            return Err(Problem::Malformed("expected an object with request, patch, moving or ack".into()));
        };
        let (request, patch) = (members.remove("request"), members.remove("patch"));
        let told: Told = json::read(Value::Object(members)).map_err(|field| Problem::Refused(vec![field]))?;
        let document = match (request, patch) {
            (None, None) => None,
            (Some(request), None) => Some(request),
            (None, Some(patch)) => {
                let mut document = self.document.clone();
                json_patch::merge(&mut document, &patch);
                Some(document)
            }
            (Some(_), Some(_)) => return Err(Problem::refused("/patch", "expected a request or a patch, got both")),
        };
        let moving = told.moving.unwrap_or(self.moving);
        if let Some(document) = document {
            let due = qualities(&document, moving);
            // It is read as it stands and resolved at each quality now, so that a refusal comes at once and changes nothing.
            RenderRequest::from_document(document.clone(), None)?;
            due.iter().try_for_each(|quality| self.asked(&document, *quality).map(drop))?;
            self.take(document, due);
        }
        self.moving = moving;
        if let Some(ack) = told.ack {
            self.acknowledged = self.acknowledged.max(ack.min(self.sent));
        }
        Ok(())
    }

    /// Makes a request the newest.
    fn take(&mut self, document: Value, due: Vec<Quality>) {
        self.rest = rest(self.arrived.elapsed());
        (self.document, self.due, self.arrived) = (document, due, Instant::now());
        self.requests += 1;
        let Some(making) = &self.making else { return };
        let slow = making.begun.elapsed() > SLOW && !self.dropped;
        if !making.step.moving || slow {
            self.dropped |= making.step.moving;
            self.making = None;
        }
    }

    fn asked(&self, document: &Value, quality: Quality) -> Result<Asked, Problem> {
        let request = RenderRequest::from_document(document.clone(), Some(quality))?;
        let format = request.format().unwrap_or(Format::Png);
        Asked::new(&self.app, self.id.clone(), Arc::clone(&self.volume), request, format)
    }

    /// The next frame, if there is room for it on the line.
    fn next(&self) -> Option<Step> {
        if self.making.is_some() || self.sent - self.acknowledged >= WINDOW {
            return None;
        }
        let &next = self.due.last()?;
        let moving = qualities(&self.document, self.moving).pop() == Some(next);
        let quality = if moving { next } else { refinement(&self.due, self.refined)? };
        Some(Step { request: self.requests, quality, moving, last: self.due.first() == Some(&quality) })
    }

    /// When the next frame is to be begun, where it is to wait for rest.
    fn refine_at(&self) -> Option<Instant> {
        self.next().map(|_| self.arrived + self.rest)
    }

    /// Begins the next frame, if its time has come.
    fn begin(&mut self) {
        let Some(step) = self.next().filter(|step| step.moving || self.arrived.elapsed() >= self.rest) else { return };
        // It, and what is not as good.
        self.due.retain(|quality| *quality > step.quality);
        let (app, asked) = (Arc::clone(&self.app), self.asked(&self.document, step.quality));
        let frame = Box::pin(async move {
            let asked = asked?;
            let made = asked.made(&app, app.pool.place().await?).await?;
            Ok((asked, made))
        });
        self.making = Some(Making { step, begun: Instant::now(), frame });
    }

    /// The message for a frame that is made, or could not be.
    fn answer(&mut self, outcome: Outcome) -> Message {
        let Making { step, begun, .. } = self.making.take().expect("something was made");
        self.dropped = false;
        match outcome {
            Ok((asked, made)) => {
                if step.last && !step.moving {
                    self.refined = Some((step.quality, begun.elapsed()));
                }
                self.sent += 1;
                metrics::streamed();
                frame(self.sent, &step, &asked, &made)
            }
            Err(problem) => {
                if step.request == self.requests {
                    self.due.clear();
                }
                self.refusal(&problem)
            }
        }
    }

    fn refusal(&self, problem: &Problem) -> Message {
        let refusal = Refusal { request: self.requests, error: problem.body() };
        Message::Text(serde_json::to_string(&refusal).expect("strings and numbers").into())
    }
}

/// How long a client rests once it sends nothing more, by the time between its last two requests.
fn rest(between: Duration) -> Duration {
    (between + between / 2).clamp(LEAST_REST, MOST_REST)
}

/// Which of the qualities that are due, the next one last, follows in rest, by what the last one to be the best took.
fn refinement(due: &[Quality], refined: Option<(Quality, Duration)>) -> Option<Quality> {
    let &best = due.first()?;
    let quick = refined.is_some_and(|(quality, took)| quality == best && took < QUICK);
    if quick { Some(best) } else { due.last().copied() }
}

/// The qualities that a request is rendered at, the first one last: that of movement, then each better one up
/// to its own. `classified` and `fast-classification` have no `high`.
fn qualities(document: &Value, moving: Quality) -> Vec<Quality> {
    const ALL: [Quality; 3] = [Quality::High, Quality::Standard, Quality::Draft];
    let own = document.get("quality").and_then(Value::as_str);
    let of_voxels = matches!(document["algorithm"].as_str(), Some("classified" | "fast-classification"));
    let best = if of_voxels { Quality::Standard } else { Quality::High };
    let resting = match own {
        // A name that is none is refused where the request is read.
        Some(name) => ALL.into_iter().find(|quality| quality.name() == name).unwrap_or(best),
        None => best,
    };
    let moving = moving.min(resting);
    ALL.into_iter().filter(|quality| (moving..=resting).contains(quality)).collect()
}

/// The frame in the making, once it is made.
async fn made(making: &mut Option<Making>) -> Outcome {
    match making {
        Some(making) => making.frame.as_mut().await,
        None => std::future::pending().await,
    }
}

/// A header's length as 32 bits, little endian; the header; the frame.
fn frame(sequence: u64, step: &Step, asked: &Asked, made: &Made) -> Message {
    let [width, height, channels] = made.size;
    let timing = asked.stages(made).into_iter();
    let header = Header {
        sequence,
        request: step.request,
        quality: step.quality.name(),
        last: step.last,
        format: asked.format().name(),
        width,
        height,
        channels,
        warp: made.warp,
        algorithm: asked.algorithm(),
        timing: timing.map(|(stage, took)| (stage.to_owned(), milliseconds(took).into())).collect(),
    };
    let header = serde_json::to_vec(&header).expect("strings and numbers");
    let mut message = Vec::with_capacity(size_of::<u32>() + header.len() + made.bytes.len());
    message.extend_from_slice(&(header.len() as u32).to_le_bytes());
    message.extend_from_slice(&header);
    message.extend_from_slice(&made.bytes);
    Message::Binary(message.into())
}

/// To a thousandth.
fn milliseconds(duration: Duration) -> f64 {
    duration.as_micros() as f64 / 1000.0
}

fn goodbye(code: u16, reason: &'static str) -> Message {
    Message::Close(Some(CloseFrame { code, reason: reason.into() }))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn movement_comes_first_and_the_requests_own_quality_last() {
        use Quality::{Draft, High, Standard};
        for (document, moving, due) in [
            (json!({}), Draft, vec![High, Standard, Draft]),
            (json!({}), Standard, vec![High, Standard]),
            (json!({}), High, vec![High]),
            (json!({"quality": "standard"}), Draft, vec![Standard, Draft]),
            (json!({"quality": "draft"}), Standard, vec![Draft]),
            (json!({"algorithm": "classified"}), Draft, vec![Standard, Draft]),
            (json!({"algorithm": "raycast", "quality": "high"}), High, vec![High]),
        ] {
            assert_eq!(qualities(&document, moving), due, "{document} {moving:?}");
        }
    }

    #[test]
    fn who_sends_requests_faster_rests_sooner() {
        for (between, expected) in [(0, 20), (8, 20), (16, 24), (20, 30), (33, 40), (5000, 40)] {
            assert_eq!(rest(Duration::from_millis(between)), Duration::from_millis(expected), "{between}");
        }
    }

    #[test]
    fn the_best_quality_comes_at_once_where_it_is_quick() {
        let due = [Quality::High, Quality::Standard];
        let after = |quality, ms| refinement(&due, Some((quality, Duration::from_millis(ms))));
        assert_eq!(refinement(&due, None), Some(Quality::Standard));
        assert_eq!(after(Quality::High, 149), Some(Quality::High));
        assert_eq!(after(Quality::High, 150), Some(Quality::Standard));
        assert_eq!(after(Quality::Standard, 10), Some(Quality::Standard), "another quality's time says nothing");
        assert_eq!(refinement(&[], None), None);
    }

    #[test]
    fn pages_of_other_origins_are_refused() {
        let allowed = |origin: Option<&str>, host: &str| {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, host.parse().unwrap());
            origin.map(|origin| headers.insert(header::ORIGIN, origin.parse().unwrap()));
            of_this_origin(&headers).is_ok()
        };
        assert!(allowed(None, "127.0.0.1:8080"));
        assert!(allowed(Some("http://127.0.0.1:8080"), "127.0.0.1:8080"));
        assert!(allowed(Some("https://scans.example"), "scans.example"));
        for foreign in ["http://evil.example", "null", "http://127.0.0.1:8081", "http://127.0.0.1:8080.evil.example"] {
            assert!(!allowed(Some(foreign), "127.0.0.1:8080"), "{foreign}");
        }
    }
}
