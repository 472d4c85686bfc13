use std::sync::mpsc;

use super::*;

/// Takes nothing before a message arrives.
struct Slow(mpsc::Receiver<()>, Arc<Mutex<Vec<u8>>>);

impl Write for Slow {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let _ = self.0.recv();
        self.1.lock().unwrap().extend(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Writing twice the memory limit to a blocked reader does not block. All bytes arrive in order, also those written after the
/// file was emptied.
#[test]
fn what_is_not_taken_waits_and_arrives_in_order() {
    let (go, wait) = mpsc::channel();
    let taken = Arc::new(Mutex::new(Vec::new()));
    let mut spool = Spool::new(Slow(wait, Arc::clone(&taken)));
    let mut sent = Vec::new();
    let mut write = |spool: &mut Spool, count: u32| {
        for i in 0..count {
            let part = i.to_le_bytes().repeat(1 + i as usize % 300);
            spool.write_all(&part).unwrap();
            sent.extend(part);
        }
    };
    write(&mut spool, 15_000);
    drop(go);
    while spool.shared.locked().file.is_some() {
        std::thread::yield_now();
    }
    write(&mut spool, 100);
    spool.finish().unwrap();
    assert!(sent.len() > 2 * MEMORY);
    assert!(*taken.lock().unwrap() == sent, "{} bytes of {}", taken.lock().unwrap().len(), sent.len());
}

/// A closed reader makes the next write or `finish` fail.
#[test]
fn an_end_that_is_closed_is_an_error() {
    struct Closed;
    impl Write for Closed {
        fn write(&mut self, _: &[u8]) -> io::Result<usize> {
            Err(io::ErrorKind::BrokenPipe.into())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }
    let mut spool = Spool::new(Closed);
    let written = spool.write_all(b"rows").and_then(|()| spool.finish());
    assert_eq!(written.unwrap_err().kind(), io::ErrorKind::BrokenPipe);
}
