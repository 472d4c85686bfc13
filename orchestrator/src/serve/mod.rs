//! The pages of `metasense serve`: sweeps in a browser, during and after runs. The pages read databases, and pass commands of users
//! with the token on to runs. They use CPU time only while somebody views them, and a bounded share of it.

mod address;
mod guard;
mod lobby;
mod pages;
mod source;
mod steer;
mod token;
mod trials;

use std::convert::Infallible;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use axum::extract::{Path, State};
use axum::http::{StatusCode, header};
use axum::middleware::from_fn_with_state;
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Extension, Router};
use futures_util::Stream;
use futures_util::stream::unfold;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::time::sleep;

use crate::look::wave::SCRIPT;
use crate::look::{Format, page_style};
use crate::reader::StoredTrial;
use crate::report::samples::Replayed;
pub use address::Address;
use guard::{WriteTimeout, guard};
use lobby::{ClientConnection, ConnectionLimiter, STAY};
pub use source::{DatabaseState, WatchedDatabase};
pub use token::Token;
pub use trials::Trials;

/// Maximum size of a request's head (bytes), which contains the SQL statement.
const HEAD: usize = 64 << 10;
/// Maximum time for a head, and of an idle connection.
const HEAD_TIME: Duration = Duration::from_secs(20);
/// Maximum time in which the other end accepts nothing.
const WRITE_TIME: Duration = Duration::from_secs(20);
/// Interval between keep-alive messages, which reveal closed connections.
const ALIVE: Duration = Duration::from_secs(10);
/// Maximum number of pages that follow a run; each has its own connection, and some are left for other requests.
const FOLLOWED: usize = 48;
/// Maximum number of simultaneous queries by users.
const QUESTIONS: usize = 2;

/// Two joined units.
const ICON: &str = "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 16 16\"><path d=\"M1 8 5 4 8 8 11 12 15 8 11 4 8 8 5 12z\" \
                    fill=\"#c2410c\"/></svg>";

/// State of the server.
#[derive(Debug)]
pub struct ServerState {
    sources: Vec<WatchedDatabase>,
    /// Permits reading.
    reading: Token,
    /// Permits control of runs.
    steering: Option<Token>,
    address: Address,
    followed: Arc<Semaphore>,
    questions: Arc<Semaphore>,
    /// Trials are simulated again one at a time; the last is kept.
    replays: Semaphore,
    replayed: Mutex<Option<(StoredTrial, Arc<Replayed>)>>,
}

impl ServerState {
    /// Serves sources at an address to users with the key `reading`; the token `steering` permits control of their runs.
    pub fn new(
        sources: Vec<WatchedDatabase>,
        reading: Token,
        steering: Option<Token>,
        address: Address,
    ) -> Arc<Self> {
        let (questions, replays) = (Arc::new(Semaphore::new(QUESTIONS)), Semaphore::new(1));
        let (followed, replayed) = (Arc::new(Semaphore::new(FOLLOWED)), Mutex::default());
        Arc::new(Self { sources, reading, steering, address, followed, questions, replays, replayed })
    }

    /// Stops watching, and removes all files that watching created.
    pub async fn close(&self) {
        for source in &self.sources {
            source.close().await;
        }
    }
}

/// Serves pages while it is polled.
pub async fn serve(listener: TcpListener, served: Arc<ServerState>) {
    let app = pages(Arc::clone(&served));
    let lobby = ConnectionLimiter::new();
    for number in 0.. {
        let stream = match listener.accept().await {
            Ok((stream, _)) => stream,
            Err(error) => {
                // no file descriptors are left, or the other end has closed the connection
                tracing::warn!(%error, "a connection could not be accepted");
                tokio::time::sleep(Duration::from_millis(100)).await;
                continue;
            }
        };
        let (app, served) = (app.clone(), Arc::clone(&served));
        lobby.admit(number, |guest| connection(stream, app, served, guest)).await;
    }
}

/// Serves a connection; only briefly if it does not show the key.
async fn connection(stream: TcpStream, app: Router, served: Arc<ServerState>, guest: Arc<ClientConnection>) {
    let (pages, of) = (TowerToHyperService::new(app), Arc::clone(&guest));
    let service = service_fn(move |mut request: hyper::Request<Incoming>| {
        let mut uri = request.uri().clone();
        let front = served.address.enter(&mut uri, request.headers());
        *request.uri_mut() = uri;
        request.extensions_mut().insert(front);
        request.extensions_mut().insert(Arc::clone(&of));
        pages.call(request)
    });
    let stream = TokioIo::new(WriteTimeout::new(stream, WRITE_TIME));
    let mut builder = http1::Builder::new();
    builder.timer(TokioTimer::new()).header_read_timeout(HEAD_TIME).max_buf_size(HEAD);
    let mut serving = std::pin::pin!(builder.serve_connection(stream, service));
    let ended = tokio::select! {
        ended = &mut serving => ended,
        () = sleep(STAY) => if guest.is_known() { serving.await } else { Ok(()) },
    };
    if let Err(error) = ended {
        tracing::debug!(%error, "a connection ended early");
    }
}

fn pages(served: Arc<ServerState>) -> Router {
    let asset =
        |kind: &'static str, text: String| get(move || async move { ([(header::CONTENT_TYPE, kind)], text) });
    let rows = |format: Format, kind: &'static str| {
        get(move |served, at, asked| pages::sql::file(served, at, asked, format, kind))
    };
    Router::new()
        .route("/", get(pages::home))
        .route("/style.css", asset("text/css; charset=utf-8", page_style() + include_str!("serve.css")))
        .route("/icon.svg", asset("image/svg+xml", ICON.into()))
        .route("/live.js", asset("text/javascript; charset=utf-8", include_str!("live.js").into()))
        .route("/control.js", asset("text/javascript; charset=utf-8", include_str!("control.js").into()))
        .route("/wave.js", asset("text/javascript; charset=utf-8", SCRIPT.into()))
        .route("/{source}/", get(pages::overview::page))
        .route("/{source}/trials", get(pages::trials::page))
        .route("/{source}/trial/{hash}", get(pages::trial::page))
        .route("/{source}/compare", get(pages::compare::page))
        .route("/{source}/map", get(pages::map::page))
        .route("/{source}/sql", get(pages::sql::page))
        .route("/{source}/sql.csv", rows(Format::Csv, "text/csv; charset=utf-8"))
        .route("/{source}/sql.parquet", rows(Format::Parquet, "application/vnd.apache.parquet"))
        .route("/{source}/events", get(events))
        .route("/{source}/control", post(steer::post))
        .fallback(async || PageError::NoPage)
        .with_state(Arc::clone(&served))
        .layer(from_fn_with_state(served, guard))
}

/// The file of a database that has been read at least once; for shards, the file exists only then.
async fn file_of(served: &ServerState, number: &str) -> Result<PathBuf, PageError> {
    let seen = source(served, number)?.current_state().await;
    match seen.checked {
        Some(_) => Ok(seen.db.clone()),
        None => Err(PageError::Asked("the database is still being read; try again".into())),
    }
}

/// The source with this number.
fn source<'a>(served: &'a ServerState, number: &str) -> Result<&'a WatchedDatabase, PageError> {
    number.parse::<usize>().ok().and_then(|i| served.sources.get(i)).ok_or(PageError::NoPage)
}

/// Sends the generation of the state whenever it changes. A slow client misses some, and receives the last.
async fn events(
    State(served): State<Arc<ServerState>>,
    Path(number): Path<String>,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, PageError> {
    let seen = source(&served, &number)?.watched();
    let place = Arc::clone(&served.followed).try_acquire_owned().map_err(|_| PageError::Busy)?;
    let stream = unfold((seen, None, place), |(mut seen, told, place)| async move {
        let changed = seen.wait_for(|seen| Some(seen.generation) != told);
        let generation = changed.await.ok()?.generation;
        Some((Ok(Event::default().data(generation.to_string())), (seen, Some(generation), place)))
    });
    Ok(Sse::new(stream).keep_alive(KeepAlive::new().interval(ALIVE)))
}

/// Why a request gets no page.
#[derive(Debug)]
enum PageError {
    /// No page has this address.
    NoPage,
    /// The request cannot be answered.
    Asked(String),
    /// Too many connections have shown the key.
    Busy,
}

/// Text on the page of a refusal. `guard` makes the page, because it knows the path to the first page.
#[derive(Debug, Clone)]
struct RefusalText(String);

impl IntoResponse for PageError {
    fn into_response(self) -> Response {
        let (status, why) = match self {
            Self::NoPage => (StatusCode::NOT_FOUND, "no such page".to_owned()),
            Self::Asked(why) => (StatusCode::BAD_REQUEST, why),
            Self::Busy => {
                (StatusCode::SERVICE_UNAVAILABLE, "too many pages are open: close some of them".to_owned())
            }
        };
        (status, Extension(RefusalText(why))).into_response()
    }
}
