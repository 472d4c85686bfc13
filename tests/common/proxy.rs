//! A reverse proxy with its own path.

use std::io::{BufRead, BufReader, Result, Write, copy};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::thread::spawn;

/// The path of the proxy in the browser.
pub const FRONT: &str = "/user/me/proxy/8017";

/// Starts a proxy to a port and returns its own port. If it `takes` the path, it removes the path from requests and reports that,
/// like JupyterHub's proxy; otherwise it keeps the path, like Open OnDemand's. It lives as long as the test.
pub fn proxy(to: u16, takes: bool) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    spawn(move || {
        for client in listener.incoming().flatten() {
            spawn(move || pass(client, to, takes));
        }
    });
    port
}

/// Passes on one request and its response.
fn pass(mut client: TcpStream, to: u16, takes: bool) -> Result<()> {
    let mut from = BufReader::new(client.try_clone()?);
    let mut head = String::new();
    while !head.ends_with("\r\n\r\n") {
        if from.read_line(&mut head)? == 0 {
            return Ok(());
        }
    }
    let (line, rest) = head.split_once("\r\n").unwrap_or_default();
    if !line.contains(FRONT) {
        return client.write_all(b"HTTP/1.1 404 Not Found\r\nConnection: close\r\nContent-Length: 0\r\n\r\n");
    }
    let (line, told) = match takes {
        true => (line.replacen(FRONT, "", 1), format!("X-Forwarded-Prefix: {FRONT}\r\n")),
        false => (line.to_owned(), String::new()),
    };
    let kept: String =
        rest.split_inclusive("\r\n").filter(|header| !header.starts_with("Connection: ")).collect();
    let mut server = TcpStream::connect(("127.0.0.1", to))?;
    server.write_all(format!("{line}\r\n{told}Connection: close\r\n{kept}").as_bytes())?;
    let mut up = server.try_clone()?;
    spawn(move || copy(&mut from, &mut up));
    copy(&mut server, &mut client)?;
    client.shutdown(Shutdown::Both)
}
