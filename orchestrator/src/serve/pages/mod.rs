//! The pages, and the parts that they share.

pub mod compare;
pub mod map;
pub mod overview;
pub mod sql;
pub mod trial;
pub mod trials;

use std::sync::Arc;

use axum::extract::{self, FromRequestParts, State};
use axum::http::request::Parts;
use axum::response::{Html, IntoResponse, Redirect, Response};
use maud::{Markup, html};
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::{DatabaseState, PageError, ServerState, source};
use crate::exit::chain;
use crate::look::{Encoded, document};
use crate::store::StoreError;

/// Pages of a database, by address and name.
const TABS: [(&str, &str); 5] =
    [("", "Overview"), ("trials", "Trials"), ("map", "Sweep map"), ("compare", "Compare"), ("sql", "SQL")];

/// The tab of a trial's page.
const TRIAL: &str = "trial";

/// The first page: the only database, or a list of all.
pub async fn home(State(served): State<Arc<ServerState>>) -> Response {
    if served.sources.len() == 1 {
        return Redirect::to("./0/").into_response();
    }
    let list = html! {
        ul { @for (i, source) in served.sources.iter().enumerate() { li { a href=(format!("{i}/")) { (source.name) } } } }
    };
    Html(bare(("", served.steering.is_some()), "Databases", &list)).into_response()
}

/// A page outside databases. `up`: path from it to the first page; `steers`: whether runs can be controlled.
fn bare((up, steers): (&str, bool), title: &str, content: &Markup) -> String {
    let content = html! { body { main id="main" { h1 { (title) } (content) } } };
    document(&format!("{title} – metasense"), &head(up, steers), &content)
}

pub(super) fn refusal(up: &str, why: &str) -> String {
    let content = html! { p { (why) } p { a href=(format!("./{up}")) { "Back to the start" } } };
    bare((up, false), "No such page, or no answer", &content)
}

fn head(up: &str, steers: bool) -> Markup {
    html! {
        link rel="stylesheet" href={ (up) "style.css" };
        link rel="icon" type="image/svg+xml" href={ (up) "icon.svg" };
        script src={ (up) "live.js" } defer {}
        script src={ (up) "wave.js" } defer {}
        @if steers { script src={ (up) "control.js" } defer {} }
    }
}

/// A page of a database. An empty `tab` is the overview, `TRIAL` a trial's page, one folder further down. `live`: the generation
/// that the page shows, if the page updates itself.
fn framed(
    served: &ServerState,
    number: &str,
    tab: &str,
    title: &str,
    live: Option<u64>,
    content: &Markup,
) -> Result<Html<String>, PageError> {
    let name = &source(served, number)?.name;
    let own = if tab == TRIAL { "../" } else { "" };
    let up = format!("{own}../");
    let events = live.map(|_| format!("{own}events"));
    let body = html! {
        body data-events=[events] data-generation=[live] {
            a class="skip" href="#main" { "Skip to content" }
            header {
                @if served.sources.len() > 1 { a class="all" href=(up) { "All databases" } }
                b { (name) }
                nav aria-label="Pages" {
                    @for (address, text) in TABS {
                        a href=(format!("./{own}{address}")) aria-current=[(address == tab).then_some("page")] { (text) }
                    }
                }
                @if live.is_some() { button type="button" id="hold" aria-pressed="false" hidden { "Pause updates" } }
            }
            main id="main" tabindex="-1" { h1 { (title) } (content) }
        }
    };
    Ok(Html(document(&format!("{title} – {name}"), &head(&up, served.steering.is_some()), &body)))
}

/// A part of a page that is replaced after changes.
fn live(id: &str, content: &Markup) -> Markup {
    html! { section id=(id) data-live { (content) } }
}

/// Why data are missing.
fn trouble(seen: &DatabaseState) -> Markup {
    html! {
        @if let Some(why) = &seen.read_error { p class="trouble" role="alert" { (why) } }
        @else if seen.checked.is_none() { p class="quiet" { "The database is being read …" } }
        @else if seen.trials.rows.is_empty() && seen.progress.trials[0] > 0 { p class="quiet" { "Its trials are being read …" } }
    }
}

/// Path to the page of a trial, from all pages of a database except those of trials.
fn to_trial(number: &str, hash: &str) -> String {
    format!("../{number}/trial/{}", Encoded(hash))
}

/// Links from columns that name trials.
fn trial_links(number: &str) -> impl Fn(&str, &Value) -> Option<String> {
    move |column, value| match column {
        "hash" | "trial" => value.as_str().filter(|hash| !hash.is_empty()).map(|hash| to_trial(number, hash)),
        _ => None,
    }
}

/// The query string of a request; an invalid one is refused with a page.
pub(super) struct Query<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequestParts<S> for Query<T> {
    type Rejection = PageError;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, PageError> {
        let query = extract::Query::try_from_uri(&parts.uri);
        query.map(|query| Self(query.0)).map_err(|e| PageError::Asked(e.body_text()))
    }
}

impl From<StoreError> for PageError {
    fn from(error: StoreError) -> Self {
        Self::Asked(chain(&error))
    }
}

/// A query string of the pairs with values.
fn query(pairs: &[(&str, &str)]) -> String {
    let pairs = pairs.iter().filter(|(_, value)| !value.is_empty());
    let pairs: Vec<String> = pairs.map(|(key, value)| format!("{key}={}", Encoded(value))).collect();
    format!("?{}", pairs.join("&"))
}
