//! Which requests are answered: those with the key, from our own pages. A foreign page can make a browser send requests, by a name
//! that it has pointed at this machine (DNS rebinding) or across sites; these are refused.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{Html, IntoResponse, Redirect, Response};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Sleep, sleep};

use super::address::path_to_root;
use super::lobby::ClientConnection;
use super::token::unauthorised;
use super::{PageError, RefusalText, ServerState, pages};

/// Headers of every response: nothing foreign, nothing inline, no frames, no caches.
const HEADERS: [(HeaderName, &str); 7] = [
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; form-action 'self'; \
         base-uri 'none'; frame-ancestors 'none'",
    ),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::X_FRAME_OPTIONS, "DENY"),
    (header::REFERRER_POLICY, "no-referrer"),
    (header::CACHE_CONTROL, "no-store"),
    (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
];

/// Answers a request, or returns why it is refused.
pub async fn guard(State(served): State<Arc<ServerState>>, request: Request, next: Next) -> Response {
    let uri = request.uri();
    let (base, up) = (served.address.base(), path_to_root(uri.path()));
    let refusal = match uri.path() == base {
        true => {
            let query = uri.query().map_or(String::new(), |query| format!("?{query}"));
            Some(Redirect::to(&format!("{base}/{query}")).into_response())
        }
        false => refused(&served, &request).map(IntoResponse::into_response),
    };
    let no_place = || {
        let guest = request.extensions().get::<Arc<ClientConnection>>();
        guest.is_some_and(|guest| !guest.take_place()).then(|| PageError::Busy.into_response())
    };
    let mut response = match refusal.or_else(|| unauthorised(&served, &request)).or_else(no_place) {
        Some(mut response) => {
            response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
            response
        }
        None => next.run(request).await,
    };
    if let Some(RefusalText(why)) = response.extensions_mut().remove() {
        let page = pages::refusal(&up, &why);
        response = (response.status(), Html(page)).into_response();
    }
    for (name, value) in HEADERS {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}

fn refused(served: &ServerState, request: &Request) -> Option<(StatusCode, &'static str)> {
    let steers = request.method() == Method::POST && request.uri().path().ends_with("/control");
    if ![Method::GET, Method::HEAD].contains(request.method()) && !steers {
        return Some((StatusCode::METHOD_NOT_ALLOWED, "method not allowed: pages only accept GET and HEAD"));
    }
    let headers = request.headers();
    let host = only(headers, &header::HOST);
    let named = host.filter(|host| served.address.is_ours(host));
    let target = request.uri().authority().is_none_or(|target| served.address.is_ours(target.as_str()));
    let Some(host) = named.filter(|_| target) else {
        return Some((
            StatusCode::MISDIRECTED_REQUEST,
            "use localhost or the numeric address of this machine: any other name may belong to somebody else. The name of a proxy is \
             given by --proxy",
        ));
    };
    let origin = headers.contains_key(header::ORIGIN);
    if origin && !only(headers, &header::ORIGIN).is_some_and(|origin| served.address.is_own(origin, host)) {
        return Some((StatusCode::FORBIDDEN, "the request comes from a page of another origin"));
    }
    if steers && !origin {
        return Some((
            StatusCode::FORBIDDEN,
            "the request does not come from a page: use `metasense control` in other programs",
        ));
    }
    let fetched = |name: &'static str| only(headers, &HeaderName::from_static(name));
    if fetched("sec-fetch-site") == Some("cross-site") && fetched("sec-fetch-mode") != Some("navigate") {
        return Some((StatusCode::FORBIDDEN, "the request comes from a page of another site"));
    }
    None
}

/// The value of a header that occurs once.
fn only<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a str> {
    let mut values = headers.get_all(name).iter();
    let value = values.next()?.to_str().ok()?;
    values.next().is_none().then_some(value)
}

/// A connection that fails with `TimedOut` if its other end accepts nothing for the time `patience`.
pub struct WriteTimeout<S> {
    inner: S,
    patience: Duration,
    waits: Option<Pin<Box<Sleep>>>,
}

impl<S> WriteTimeout<S> {
    pub fn new(inner: S, patience: Duration) -> Self {
        Self { inner, patience, waits: None }
    }

    fn until<T>(&mut self, cx: &mut Context<'_>, poll: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        if poll.is_ready() {
            self.waits = None;
            return poll;
        }
        let patience = self.patience;
        let waits = self.waits.get_or_insert_with(|| Box::pin(sleep(patience)));
        match waits.as_mut().poll(cx) {
            Poll::Ready(()) => Poll::Ready(Err(io::ErrorKind::TimedOut.into())),
            Poll::Pending => Poll::Pending,
        }
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for WriteTimeout<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner).poll_read(cx, buf)
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for WriteTimeout<S> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let poll = Pin::new(&mut self.inner).poll_write(cx, bytes);
        self.until(cx, poll)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let poll = Pin::new(&mut self.inner).poll_flush(cx);
        self.until(cx, poll)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let poll = Pin::new(&mut self.inner).poll_shutdown(cx);
        self.until(cx, poll)
    }
}

#[cfg(test)]
mod tests;
