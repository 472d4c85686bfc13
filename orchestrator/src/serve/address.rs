//! How browsers reach the pages: by which host names, and behind which path of a proxy. Links are relative and therefore work
//! behind any path that a proxy removes; a path that it leaves is removed here.

use axum::http::uri::{Authority, PathAndQuery};
use axum::http::{HeaderMap, HeaderName, Uri};

/// Host names and path of proxies.
#[derive(Debug, Default)]
pub struct Address {
    base: String,
    names: Vec<String>,
}

/// The path before a request's own path, with a trailing slash.
#[derive(Debug, Clone)]
pub struct PathPrefix(pub String);

impl Address {
    /// Reads the addresses of proxies: their host names, and their common path.
    ///
    /// # Errors
    /// An invalid address, with the required form; or different paths.
    pub fn new(proxies: &[String]) -> Result<Self, String> {
        let mut own = Self::default();
        for proxy in proxies {
            let wrong = |what| format!("--proxy {proxy}: {what}");
            let parts = ["https://", "http://"].iter().find_map(|scheme| proxy.strip_prefix(scheme));
            let at = parts.map(|rest| rest.split_at(rest.find('/').unwrap_or(rest.len())));
            let named = at.and_then(|(at, path)| Some((at.parse::<Authority>().ok()?, path)));
            let harmless = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte);
            let named = named.filter(|(at, path)| {
                let is_name = !at.host().is_empty() && at.host().bytes().all(harmless);
                is_name && !at.as_str().contains('@') && (path.is_empty() || is_path(path))
            });
            let Some((at, path)) = named else {
                return Err(wrong(
                    "must be the address in the browser, such as https://hub.example.org/node/HOST/8017/",
                ));
            };
            let base = path.trim_end_matches('/');
            if !own.names.is_empty() && own.base != base {
                return Err(wrong("has another path than the first --proxy; start a second `serve` for it"));
            }
            (own.base, own.names) = (base.to_owned(), [own.names, vec![at.host().to_owned()]].concat());
        }
        Ok(own)
    }

    /// The path of the proxies, without a trailing slash.
    pub fn base(&self) -> &str {
        &self.base
    }

    /// Removes the proxies' path from a URI. Returns the path that was removed here, or that the proxy reports to have removed.
    pub(super) fn enter(&self, uri: &mut Uri, headers: &HeaderMap) -> PathPrefix {
        let within = uri.path_and_query().and_then(|path| path.as_str().strip_prefix(&self.base));
        let within = within.filter(|path| !self.base.is_empty() && path.starts_with('/'));
        if let Some(path) = within.and_then(|path| path.parse::<PathAndQuery>().ok()) {
            let mut parts = uri.clone().into_parts();
            parts.path_and_query = Some(path);
            if let Ok(own) = Uri::from_parts(parts) {
                *uri = own;
                return PathPrefix(format!("{}/", self.base));
            }
        }
        let told = headers.get(HeaderName::from_static("x-forwarded-prefix"));
        let told = told.and_then(|path| path.to_str().ok()).filter(|path| is_path(path));
        PathPrefix(told.map_or("/".into(), |path| format!("{}/", path.trim_end_matches('/'))))
    }

    /// Whether a host is a proxy's name, localhost or an IP address, which do not depend on name servers.
    pub(super) fn is_ours(&self, host: &str) -> bool {
        let Ok(authority) = host.parse::<Authority>() else { return false };
        let name = authority.host();
        let bare = name.strip_prefix('[').and_then(|name| name.strip_suffix(']')).unwrap_or(name);
        let known = || name.eq_ignore_ascii_case("localhost") || bare.parse::<std::net::IpAddr>().is_ok();
        !host.contains('@') && (self.is_named(name) || known())
    }

    /// Whether `origin` is one of our pages, reached by `host`. A proxy may use TLS and may have replaced the host.
    pub(super) fn is_own(&self, origin: &str, host: &str) -> bool {
        let named = origin.strip_prefix("https://").or_else(|| origin.strip_prefix("http://"));
        let named = named.and_then(|at| at.parse::<Authority>().ok());
        origin.strip_prefix("http://") == Some(host) || named.is_some_and(|at| self.is_named(at.host()))
    }

    fn is_named(&self, name: &str) -> bool {
        self.names.iter().any(|own| own.eq_ignore_ascii_case(name))
    }
}

/// Whether `text` is a path of harmless characters.
fn is_path(text: &str) -> bool {
    let harmless = |byte: u8| byte.is_ascii_alphanumeric() || b"/-._~%@:+".contains(&byte);
    text.starts_with('/') && text.bytes().all(harmless)
}

/// Relative path from a page to the first page.
pub(super) fn path_to_root(path: &str) -> String {
    "../".repeat(path.matches('/').count().saturating_sub(1))
}

/// Relative link to the same page with another query.
pub(super) fn link_with_query(path: &str, query: &str) -> String {
    let last = path.rsplit('/').next().unwrap_or_default();
    if query.is_empty() { format!("./{last}") } else { format!("./{last}?{query}") }
}
