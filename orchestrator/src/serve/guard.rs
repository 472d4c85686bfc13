//! Who is answered: whoever has the key, through our own pages. A foreign page can make a browser ask us, by a name of its
//! own that it has pointed at this machine (DNS rebinding) or across sites. Neither is answered.

use std::io;
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::extract::{Request, State};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Sleep, sleep};

use super::Served;
use super::token::turned_away;

/// What every answer says to the browser: nothing from elsewhere, nothing inline, in no frame, kept nowhere.
const HEADERS: [(HeaderName, &str); 7] = [
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; form-action 'self'; \
         base-uri 'none'; frame-ancestors 'none'",
    ),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::X_FRAME_OPTIONS, "DENY"),
    (header::REFERRER_POLICY, "no-referrer"),
    (header::CACHE_CONTROL, "no-store"),
    (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
];

/// Answers a request, or says why not.
pub async fn guard(State(served): State<Arc<Served>>, request: Request, next: Next) -> Response {
    let refusal = refused(&request).map(IntoResponse::into_response);
    let mut response = match refusal.or_else(|| turned_away(&served, &request)) {
        Some(response) => response,
        None => next.run(request).await,
    };
    for (name, value) in HEADERS {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}

fn refused(request: &Request) -> Option<(StatusCode, &'static str)> {
    let steers = request.method() == Method::POST && request.uri().path().ends_with("/control");
    if ![Method::GET, Method::HEAD].contains(request.method()) && !steers {
        return Some((StatusCode::METHOD_NOT_ALLOWED, "pages can only be read"));
    }
    let headers = request.headers();
    let host = only(headers, &header::HOST);
    let named = host.filter(|host| is_ours(host));
    let target = request.uri().authority().is_none_or(|target| is_ours(target.as_str()));
    let Some(host) = named.filter(|_| target) else {
        return Some((
            StatusCode::MISDIRECTED_REQUEST,
            "use localhost or the numeric address of this machine: any other name may belong to somebody else",
        ));
    };
    let origin = headers.contains_key(header::ORIGIN);
    if origin && only(headers, &header::ORIGIN).and_then(|o| o.strip_prefix("http://")) != Some(host) {
        return Some((StatusCode::FORBIDDEN, "the request comes from a page of another origin"));
    }
    if steers && !origin {
        return Some((
            StatusCode::FORBIDDEN,
            "the request comes from no page: other programs use `metasense control`",
        ));
    }
    let fetched = |name: &'static str| only(headers, &HeaderName::from_static(name));
    if fetched("sec-fetch-site") == Some("cross-site") && fetched("sec-fetch-mode") != Some("navigate") {
        return Some((StatusCode::FORBIDDEN, "the request comes from a page of another site"));
    }
    None
}

/// A header's value, where it has one only.
fn only<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a str> {
    let mut values = headers.get_all(name).iter();
    let value = values.next()?.to_str().ok()?;
    values.next().is_none().then_some(value)
}

/// Whether a host is named in a way that no name server has a say in.
fn is_ours(host: &str) -> bool {
    let Ok(authority) = host.parse::<Authority>() else { return false };
    let name = authority.host();
    let bare = name.strip_prefix('[').and_then(|name| name.strip_suffix(']')).unwrap_or(name);
    !host.contains('@') && (name.eq_ignore_ascii_case("localhost") || bare.parse::<IpAddr>().is_ok())
}

/// A connection whose other end must take what it is sent: it is given up when nothing has been taken for so long.
pub struct Impatient<S> {
    inner: S,
    patience: Duration,
    waits: Option<Pin<Box<Sleep>>>,
}

impl<S> Impatient<S> {
    /// With so much patience.
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

impl<S: AsyncRead + Unpin> AsyncRead for Impatient<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner).poll_read(cx, buf)
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Impatient<S> {
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
