//! Pages behind proxies with a path and a name, and for users with the key while others hold connections.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use metasense::serve::{Address, Token};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use crate::common::proxy::{FRONT, proxy};
use crate::common::{Bench, TINY};
use crate::serve::{Server, begun, status};

/// The proxy's host name in browsers.
const NAME: &str = "hub.example.org";

/// The response to a request through a proxy.
async fn ask(proxy: u16, method: &str, address: &str, more: &str) -> String {
    assert!(address.starts_with(FRONT), "{address} leads out of the proxy");
    let host = if more.contains("Host: ") { String::new() } else { format!("Host: {NAME}\r\n") };
    let mut stream = TcpStream::connect(("127.0.0.1", proxy)).await.unwrap();
    let request = format!("{method} {address} HTTP/1.1\r\n{host}{more}\r\n");
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).await.unwrap();
    answer
}

/// The address to which a link on a page leads.
fn resolved(page: &str, link: &str) -> String {
    let (path, _) = page.split_once('?').unwrap_or((page, ""));
    if link.starts_with('?') {
        return format!("{path}{link}");
    }
    assert!(!link.starts_with("//") && !link.contains("://"), "{page}: {link} leads elsewhere");
    let (link, query) = link.split_once('?').map_or((link, String::new()), |(l, q)| (l, format!("?{q}")));
    if link.starts_with('/') {
        return format!("{link}{query}");
    }
    let mut parts: Vec<&str> = path.split('/').collect();
    parts.pop();
    for part in link.split('/') {
        match part {
            "." => {}
            ".." => assert!(parts.len() > 1 && parts.pop().is_some(), "{page}: {link} is above the root"),
            part => parts.push(part),
        }
    }
    let folder = if link.ends_with("..") || link.ends_with('.') { "/" } else { "" };
    format!("{}{folder}{query}", parts.join("/"))
}

fn header<'a>(answer: &'a str, name: &str) -> Option<&'a str> {
    answer.split("\r\n\r\n").next()?.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(": "))
}

/// From the address with the key, every link of every page leads to a page, behind both kinds of proxies. Deep links keep their
/// path, and foreign pages get no answer.
#[tokio::test(flavor = "multi_thread")]
async fn behind_a_proxy_every_link_stays_behind_it() {
    let bench = Bench::new();
    let mut dbs = Vec::new();
    for name in ["a", "b"] {
        let (store, _) = begun(&bench.path(&format!("{name}.sqlite"))).await;
        store.close().await.unwrap();
        dbs.push(bench.path(&format!("{name}.sqlite")));
    }
    for takes in [true, false] {
        let path = if takes { "" } else { FRONT };
        let address = Address::new(&[format!("https://{NAME}{path}/")]).unwrap();
        let (token, text) = Token::new().unwrap();
        let server = Server::at(&dbs, Some(token), address).await;
        let proxy = proxy(server.port, takes);
        for (asked, to) in [
            ("/?key=key", "/"),
            ("/0/?key=key", "/0/"),
            ("/1/trials?q=K%3D2&key=key&sort=-seed", "/1/trials?q=K%3D2&sort=-seed"),
            ("/0/trial/abc?key=key&replay=1", "/0/trial/abc?replay=1"),
        ] {
            let asked = format!("{FRONT}{asked}");
            let answer = ask(proxy, "GET", &asked, "").await;
            assert_eq!(status(&answer), 303, "{asked}: {answer}");
            assert_eq!(resolved(&asked, header(&answer, "location").unwrap()), format!("{FRONT}{to}"));
            let cookie = header(&answer, "set-cookie").unwrap();
            assert!(cookie.contains(&format!("; Path={FRONT}/;")), "{cookie}");
        }
        let cookie = "Cookie: metasense-80=key\r\n";
        let mut known: BTreeSet<String> = BTreeSet::from([format!("{FRONT}/")]);
        let mut open: Vec<String> = known.iter().cloned().collect();
        let mut controls = 0;
        while let Some(page) = open.pop() {
            let answer = ask(proxy, "GET", &page, cookie).await;
            assert_eq!(status(&answer), 200, "{page}: {answer}");
            for (n, part) in answer.split(['\u{22}']).enumerate().skip(1).step_by(2) {
                let before = answer.split('\u{22}').nth(n - 1).unwrap_or_default();
                let of = |name: &str| before.ends_with(&format!(" {name}="));
                let link = part.split('#').next().unwrap_or_default().replace("&amp;", "&");
                if of("data-control") {
                    controls += 1;
                    let request = format!(
                        "Origin: https://{NAME}\r\nAuthorization: Bearer {text}\r\nContent-Length: 0\r\n"
                    );
                    let control = resolved(&page, &link);
                    let answer = ask(proxy, "POST", &control, &request).await;
                    assert_eq!(status(&answer), 400, "{control}: {answer}");
                } else if of("data-events") {
                    assert!(resolved(&page, &link).starts_with(FRONT), "{page}: {link}");
                } else if (of("href") || of("src")) && !link.is_empty() && !link.starts_with("data:") {
                    let to = resolved(&page, &link);
                    // SQL pages and sorted lists are numerous and alike
                    if !to.contains('?') && known.insert(to.clone()) {
                        open.push(to);
                    }
                }
            }
        }
        assert!(known.len() >= 20 && controls >= 4, "{controls} {known:?}");
        let ours = format!("{FRONT}/0/");
        for (more, expected) in [
            ("Origin: https://hub.example.org\r\n", 200),
            ("Origin: https://hub.example.org.evil.example\r\n", 403),
            ("Origin: https://evil.example\r\n", 403),
            ("Origin: null\r\n", 403),
            ("Sec-Fetch-Site: cross-site\r\nSec-Fetch-Mode: no-cors\r\n", 403),
            ("Host: evil.example\r\n", 421),
        ] {
            let answer = ask(proxy, "GET", &ours, &format!("{cookie}{more}")).await;
            assert_eq!(status(&answer), expected, "{more}: {answer}");
        }
        // without the slash it is also the first page
        if !takes {
            let answer = ask(proxy, "GET", &format!("{FRONT}?key=key"), "").await;
            assert_eq!(header(&answer, "location"), Some(&*format!("{FRONT}/?key=key")));
        }
        server.served.close().await;
    }
}

#[test]
fn a_path_or_a_name_that_is_none_is_refused() {
    let bench = Bench::new();
    bench.file("s.toml", TINY);
    bench.output(&["run", "s.toml", "--db", "s.sqlite"]);
    for wrong in [
        ["--listen", "host"],
        ["--listen", "127.0.0.1:port"],
        ["--proxy", "hub.example.org"],
        ["--proxy", "https://*/"],
        ["--proxy", "https://user@hub.example.org/"],
        ["--proxy", "https:///node/8017"],
        ["--proxy", "https://hub.example.org/a b"],
        ["--proxy", "https://hub.example.org/a;Domain=x"],
        ["--proxy", "https://hub.example.org/a?b"],
    ] {
        let output = bench.metasense(&["serve", "s.sqlite", wrong[0], wrong[1]]);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && said.contains(wrong[0]), "{wrong:?}: {said}");
    }
}

/// Six hundred connections without the key, half silent and half slow, which reconnect when closed: every request with the key is
/// answered at once.
#[tokio::test(flavor = "multi_thread")]
async fn connections_without_the_key_keep_nobody_out() {
    let bench = Bench::new();
    let (store, _) = begun(&bench.path("run.sqlite")).await;
    store.close().await.unwrap();
    let server = Server::at(&[bench.path("run.sqlite")], None, Address::default()).await;
    let port = server.port;
    let held = Arc::new(AtomicUsize::new(0));
    let mut others = tokio::task::JoinSet::new();
    for n in 0..600 {
        let held = Arc::clone(&held);
        others.spawn(async move {
            loop {
                let Ok(mut stream) = TcpStream::connect(("127.0.0.1", port)).await else { continue };
                held.fetch_add(1, Ordering::Relaxed);
                if n % 2 == 0 {
                    let mut bytes = [0; 16];
                    let _ = stream.read(&mut bytes).await;
                    continue;
                }
                for byte in "GET /0/ HTTP/1.1\r\nHost: localhost\r\n".bytes() {
                    if stream.write_all(&[byte]).await.is_err() {
                        break;
                    }
                    tokio::time::sleep(Duration::from_millis(200)).await;
                }
            }
        });
    }
    while held.load(Ordering::Relaxed) < 600 {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    let mut took = Vec::new();
    for _ in 0..5 {
        let asked = Instant::now();
        let (status, answer) = server.get("/0/").await;
        assert_eq!(status, 200, "{answer}");
        took.push(asked.elapsed());
    }
    took.sort_unstable();
    println!("pages were there after {took:?}");
    assert!(took[took.len() / 2] < Duration::from_secs(1), "{took:?}");
    others.shutdown().await;
    server.served.close().await;
}

/// Pages that follow a run leave connections for others.
#[tokio::test(flavor = "multi_thread")]
async fn open_pages_leave_room_for_another() {
    let bench = Bench::new();
    let (store, _) = begun(&bench.path("run.sqlite")).await;
    store.close().await.unwrap();
    let server = Server::at(&[bench.path("run.sqlite")], None, Address::default()).await;
    let mut open = Vec::new();
    let mut refused = 0;
    for _ in 0..60 {
        let mut stream = server.connect().await;
        let request = "GET /0/events HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer key\r\n\r\n";
        stream.write_all(request.as_bytes()).await.unwrap();
        let mut bytes = [0; 1024];
        let read = stream.read(&mut bytes).await.unwrap();
        match status(&String::from_utf8_lossy(&bytes[..read])) {
            200 => open.push(stream),
            503 => refused += 1,
            other => panic!("{other}"),
        }
    }
    assert!(open.len() >= 32 && refused > 0, "{} open, {refused} refused", open.len());
    assert_eq!(server.get("/0/").await.0, 200);
    drop(open);
    server.served.close().await;
}
