//! Tests of `guard`.

use super::*;
use crate::serve::Address;
use tokio::time::Instant;

#[test]
fn a_name_that_can_be_rebound_is_not_ours() {
    let is_ours = |host: &str| Address::default().is_ours(host);
    for host in ["localhost", "LOCALHOST:80", "127.0.0.1:8080", "[::1]:8080", "192.168.1.7:1"] {
        assert!(is_ours(host), "{host}");
    }
    for host in [
        "evil.example",
        "localhost.evil.example:80",
        "evil@127.0.0.1",
        "127.0.0.1.nip.io",
        "",
        ":80",
        "[::1",
        "0x7f.1",
    ] {
        assert!(!is_ours(host), "{host}");
    }
}

/// A connection fails after the patience if its reader takes nothing, but not if it takes a little now and then.
#[tokio::test]
async fn who_takes_nothing_is_given_up() {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    let (ours, mut theirs) = tokio::io::duplex(16);
    let patience = Duration::from_millis(300);
    let mut ours = WriteTimeout::new(ours, patience);
    let slow = tokio::spawn(async move {
        for _ in 0..8 {
            sleep(patience / 6).await;
            theirs.read_exact(&mut [0; 8]).await.unwrap();
        }
        (theirs, Instant::now())
    });
    let sent = ours.write_all(&[0; 1000]).await.unwrap_err();
    let (_open, last) = slow.await.unwrap();
    assert_eq!(sent.kind(), io::ErrorKind::TimedOut);
    assert!(last.elapsed() > patience / 2, "{:?}", last.elapsed());
}
