//! The pages of `metasense serve`: a sweep in a browser, while it runs and afterwards. They read databases, and pass commands of
//! whoever has the token on to their runs. They cost CPU time only while somebody looks, and a bounded part of it.

mod guard;
mod pages;
mod source;
mod steer;
mod token;
mod trials;

use std::convert::Infallible;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use axum::Router;
use axum::extract::{Path, State};
use axum::http::{StatusCode, header};
use axum::middleware::from_fn_with_state;
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{Html, IntoResponse, Response};
use axum::routing::{get, post};
use futures_util::Stream;
use futures_util::stream::unfold;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use maud::html;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;

use crate::look::of_page;
use crate::look::wave::SCRIPT;
use crate::report::samples::Replayed;
use crate::store::Stored;
use guard::{Impatient, guard};
pub use source::{Seen, Source};
pub use token::Token;
pub use trials::Trials;

/// Connections at a time; more wait.
const CONNECTIONS: usize = 64;
/// The longest head of a request (bytes): a statement of SQL is part of it.
const HEAD: usize = 64 << 10;
/// The time a head may take, and a connection be idle.
const HEAD_TIME: Duration = Duration::from_secs(20);
/// The time in which the other end must take something of what it is sent.
const WRITE_TIME: Duration = Duration::from_secs(20);
/// Between two signs of life where nothing happens: a connection that is gone shows by them.
const ALIVE: Duration = Duration::from_secs(10);
/// Questions of people to databases at a time.
const QUESTIONS: usize = 2;

/// Two units and what joins them.
const ICON: &str = "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 16 16\"><path d=\"M1 8 5 4 8 8 11 12 15 8 11 4 8 8 5 12z\" \
                    fill=\"#c2410c\"/></svg>";

/// What is served.
#[derive(Debug)]
pub struct Served {
    sources: Vec<Source>,
    /// Whoever knows it may read.
    reading: Token,
    /// Whoever knows it may steer runs.
    steering: Option<Token>,
    questions: Semaphore,
    /// Trials are simulated again one at a time; the last one is kept, with what it is of.
    replays: Semaphore,
    replayed: Mutex<Option<(Stored, Arc<Replayed>)>>,
}

impl Served {
    /// To serve these, to whoever has the key to `reading`; with a token for `steering`, their runs may be steered.
    pub fn new(sources: Vec<Source>, reading: Token, steering: Option<Token>) -> Arc<Self> {
        let (questions, replays) = (Semaphore::new(QUESTIONS), Semaphore::new(1));
        Arc::new(Self { sources, reading, steering, questions, replays, replayed: Mutex::default() })
    }

    /// Ends all watching, and leaves no file behind that was not there before.
    pub async fn close(&self) {
        for source in &self.sources {
            source.close().await;
        }
    }
}

/// Serves pages for as long as it is polled.
pub async fn serve(listener: TcpListener, served: Arc<Served>) {
    let app = pages(served);
    let room = Arc::new(Semaphore::new(CONNECTIONS));
    loop {
        let place = Arc::clone(&room).acquire_owned().await.expect("it is never closed");
        let stream = match listener.accept().await {
            Ok((stream, _)) => stream,
            Err(error) => {
                // out of files, or the other end was gone before we looked
                tracing::warn!(%error, "a connection could not be accepted");
                tokio::time::sleep(Duration::from_millis(100)).await;
                continue;
            }
        };
        let service = TowerToHyperService::new(app.clone());
        tokio::spawn(async move {
            let stream = TokioIo::new(Impatient::new(stream, WRITE_TIME));
            let mut connection = http1::Builder::new();
            connection.timer(TokioTimer::new()).header_read_timeout(HEAD_TIME).max_buf_size(HEAD);
            if let Err(error) = connection.serve_connection(stream, service).await {
                tracing::debug!(%error, "a connection ended early");
            }
            drop(place);
        });
    }
}

fn pages(served: Arc<Served>) -> Router {
    let asset =
        |kind: &'static str, text: String| get(move || async move { ([(header::CONTENT_TYPE, kind)], text) });
    Router::new()
        .route("/", get(pages::home))
        .route("/style.css", asset("text/css; charset=utf-8", of_page() + include_str!("serve.css")))
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
        .route("/{source}/sql.csv", get(pages::sql::csv))
        .route("/{source}/sql.parquet", get(pages::sql::parquet))
        .route("/{source}/events", get(events))
        .route("/{source}/control", post(steer::post))
        .fallback(async || Refusal::NoPage)
        .with_state(Arc::clone(&served))
        .layer(from_fn_with_state(served, guard))
}

/// The file of a database, once it has been looked at: that of shards is made then.
async fn file_of(served: &Served, number: &str) -> Result<PathBuf, Refusal> {
    let seen = source(served, number)?.now().await;
    match seen.checked {
        Some(_) => Ok(seen.db.clone()),
        None => Err(Refusal::Asked("the database is still being read; try again".into())),
    }
}

/// A database by its number.
fn source<'a>(served: &'a Served, number: &str) -> Result<&'a Source, Refusal> {
    number.parse::<usize>().ok().and_then(|i| served.sources.get(i)).ok_or(Refusal::NoPage)
}

/// Says the generation of what is seen whenever it changes. Who is slow misses some, and is told the last.
async fn events(
    State(served): State<Arc<Served>>,
    Path(number): Path<String>,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, Refusal> {
    let seen = source(&served, &number)?.watched();
    let stream = unfold((seen, None), |(mut seen, told)| async move {
        let changed = seen.wait_for(|seen| Some(seen.generation) != told);
        let generation = changed.await.ok()?.generation;
        Some((Ok(Event::default().data(generation.to_string())), (seen, Some(generation))))
    });
    Ok(Sse::new(stream).keep_alive(KeepAlive::new().interval(ALIVE)))
}

/// Why there is no page.
#[derive(Debug)]
enum Refusal {
    /// None of this name.
    NoPage,
    /// What was asked cannot be.
    Asked(String),
}

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        let (status, why) = match self {
            Self::NoPage => (StatusCode::NOT_FOUND, "there is no such page".to_owned()),
            Self::Asked(why) => (StatusCode::BAD_REQUEST, why),
        };
        (
            status,
            Html(pages::bare(
                false,
                "No such page, or no answer",
                &html! { p { (why) } p { a href="/" { "Back to the start" } } },
            )),
        )
            .into_response()
    }
}
