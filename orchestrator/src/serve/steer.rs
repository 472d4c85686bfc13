//! Control of runs by pages: one command, posted with the printed token, is passed on to the run that holds the database.

use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body, to_bytes};
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode};
use maud::{Markup, html};

use super::token::bearer;
use super::{ServerState, source};
use crate::control::{Command, WORKERS_MAX, ask};
use crate::exit::chain;

/// Maximum length of a command (bytes), and maximum time for its arrival.
const LINE: usize = 1 << 10;
const ASKING: Duration = Duration::from_secs(5);

/// Passes on a command, and answers with its result.
pub async fn post(
    State(served): State<Arc<ServerState>>,
    Path(at): Path<String>,
    headers: HeaderMap,
    body: Body,
) -> Result<String, (StatusCode, String)> {
    let refuse = |status: StatusCode, why: &str| Err((status, why.to_owned()));
    if !served.steering.as_ref().zip(bearer(&headers)).is_some_and(|(token, given)| token.is(given)) {
        let why = "needs the token of the address that `metasense serve` printed";
        return refuse(StatusCode::UNAUTHORIZED, why);
    }
    let Some(db) = source(&served, &at).ok().and_then(|source| source.db.as_ref()) else {
        return refuse(StatusCode::NOT_FOUND, "no such database, or it is a folder of shards");
    };
    let bytes = match tokio::time::timeout(ASKING, to_bytes(body, LINE)).await {
        Ok(Ok(bytes)) => bytes,
        Ok(Err(_)) => return refuse(StatusCode::PAYLOAD_TOO_LARGE, "the command is too long"),
        Err(_) => return refuse(StatusCode::REQUEST_TIMEOUT, "the command did not arrive"),
    };
    let command = String::from_utf8_lossy(&bytes).parse::<Command>();
    let command = command.map_err(|e| (StatusCode::BAD_REQUEST, e.to_string()))?;
    match ask(db, &command).await {
        Ok(said) if said.done => Ok(said.text),
        Ok(said) => refuse(StatusCode::CONFLICT, &format!("refused: {}", said.text)),
        Err(error) => refuse(StatusCode::CONFLICT, &chain(&error)),
    }
}

/// Controls of a run, visible with the token: buttons with their commands, and `more`. `control`: path that accepts commands.
fn panel(
    served: &ServerState,
    (at, control): (&str, &str),
    title: &str,
    buttons: &[(String, &str)],
    more: &Markup,
) -> Markup {
    let steers = served.steering.is_some() && source(served, at).is_ok_and(|source| source.db.is_some());
    html! {
        @if steers {
            section id="control" data-control=(control) aria-labelledby="steer" hidden {
                h2 id="steer" { (title) }
                p class="quiet" data-state {}
                div class="line" {
                    form class="line" { @for (line, text) in buttons { button value=(line) { (text) } } }
                    (more)
                }
                p role="status" {}
            }
        }
    }
}

pub fn of_run(served: &ServerState, at: &str) -> Markup {
    let buttons = [
        ("pause", "Pause the run"),
        ("resume", "Resume the run"),
        ("stop", "Stop the run"),
        ("reload", "Reload the spec"),
    ];
    let workers = html! {
        form class="line" {
            label { "Workers " input name="count" type="number" min="1" max=(WORKERS_MAX) required; }
            button value="workers" { "Set" }
        }
    };
    let buttons = buttons.map(|(line, text)| (line.to_owned(), text));
    panel(served, (at, "control"), "Control the run", &buttons, &workers)
}

/// Controls of a trial that is not done.
pub fn of_trial(served: &ServerState, at: &str, hash: &str) -> Markup {
    let buttons =
        [(format!("next {hash}"), "Run this trial next"), (format!("cancel {hash}"), "Cancel this trial")];
    panel(served, (at, "../control"), "Control this trial", &buttons, &html! {})
}
