//! Who may read and who may control: users with the printed address, and no other user of the machine. A browser keeps the reading
//! key in a cookie for this server's port; other programs send it with each request.

use std::fs::File;
use std::io::{self, Read};

use axum::extract::Request;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

use super::ServerState;
use super::address::{PathPrefix, link_with_query};

/// A secret, stored as its digest.
#[derive(Debug)]
pub struct Token(blake3::Hash);

impl Token {
    /// A new token, and its text.
    pub fn new() -> io::Result<(Self, String)> {
        let mut bytes = [0; 16];
        File::open("/dev/urandom")?.read_exact(&mut bytes)?;
        let text: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        Ok((Self::of(&text), text))
    }

    /// The token with this text.
    pub fn of(text: &str) -> Self {
        Self(blake3::hash(text.as_bytes()))
    }

    /// Compares digests in constant time.
    pub(super) fn is(&self, given: &str) -> bool {
        self.0 == blake3::hash(given.as_bytes())
    }
}

/// The token in `Authorization: Bearer TOKEN`.
pub(super) fn bearer(headers: &HeaderMap) -> Option<&str> {
    headers.get(header::AUTHORIZATION)?.to_str().ok()?.strip_prefix("Bearer ")
}

/// The response to a request without the key, or with the key in its address: the latter is redirected, and its key set as a
/// cookie.
pub(super) fn unauthorised(served: &ServerState, request: &Request) -> Option<Response> {
    let (headers, uri) = (request.headers(), request.uri());
    let reads = |given: &str| served.reading.is(given);
    let cookie = format!("metasense-{}", port(headers));
    let asked = || uri.query().unwrap_or_default().split('&');
    if let Some(key) = asked().find_map(|pair| pair.strip_prefix("key=").filter(|key| reads(key))) {
        let front = request.extensions().get::<PathPrefix>().map_or("/", |front| &front.0);
        // Lax: a link from elsewhere opens a page; a foreign page reads nothing.
        let cookie = HeaderValue::from_str(&format!("{cookie}={key}; Path={front}; HttpOnly; SameSite=Lax"));
        let cookie = cookie.expect("names, keys and paths are ASCII");
        let rest: Vec<&str> = asked().filter(|pair| !pair.starts_with("key=")).collect();
        let same = HeaderValue::from_str(&link_with_query(uri.path(), &rest.join("&")));
        let same = same.expect("addresses are ASCII");
        return Some(
            (StatusCode::SEE_OTHER, [(header::SET_COOKIE, cookie), (header::LOCATION, same)]).into_response(),
        );
    }
    let steers = |given: &str| served.steering.as_ref().is_some_and(|token| token.is(given));
    let cookies = headers.get_all(header::COOKIE).iter().filter_map(|value| value.to_str().ok());
    let mut pairs = cookies.flat_map(|value| value.split(';')).filter_map(|pair| pair.trim().split_once('='));
    let known = pairs.any(|(name, value)| name == cookie && reads(value))
        || bearer(headers).is_some_and(|given| reads(given) || steers(given));
    let why = "open the complete address that `metasense serve` printed; it contains the key. Programs send the key as \
               `Authorization: Bearer KEY`";
    (!known).then(|| (StatusCode::UNAUTHORIZED, why).into_response())
}

/// The port in the browser's address. Cookies carry it in their name, because all ports of a host share cookies.
fn port(headers: &HeaderMap) -> &str {
    let host = headers.get(header::HOST).and_then(|host| host.to_str().ok()).unwrap_or_default();
    let port = host.rsplit_once(':').map_or("80", |(_, port)| port);
    if port.bytes().all(|b| b.is_ascii_digit()) { port } else { "80" }
}
