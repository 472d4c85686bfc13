use std::cell::Cell;

use super::*;

/// A process in an uninterruptible wait ignores the kill: after the limit it counts as ended.
#[tokio::test]
async fn a_process_that_cannot_be_killed_is_not_waited_for() {
    let (kill, mut killed) = oneshot::channel();
    let asked = Cell::new(0);
    kill.send(()).unwrap();
    let never = std::future::pending::<()>();
    let count = || asked.set(asked.get() + 1);
    assert_eq!(end(never, &mut killed, count, Duration::from_millis(20)).await, None);
    assert_eq!(asked.get(), 1);
}

/// A process that can be killed is waited for; a process that ends by itself is not killed.
#[tokio::test]
async fn a_process_ends_by_itself_or_by_the_kill() {
    for by_itself in [true, false] {
        let mut child = Command::new("sleep").arg(if by_itself { "0" } else { "1000" }).spawn().unwrap();
        let pid = Pid::from_raw(child.id().unwrap() as i32).unwrap();
        let (kill, mut killed) = oneshot::channel();
        let kill = if by_itself { Some(kill) } else { kill.send(()).map_or(None, |()| None) };
        let stop = || kill_process(pid, Signal::KILL).unwrap();
        let status = end(child.wait(), &mut killed, stop, UNKILLABLE).await.unwrap().unwrap();
        assert_eq!(
            (status.success(), status.signal()),
            if by_itself { (true, None) } else { (false, Some(9)) }
        );
        drop(kill);
    }
}

/// Invalid text, a very long unterminated line and too many lines are all read; what is forwarded is text of bounded length.
#[tokio::test]
async fn whatever_a_worker_writes_is_read_and_bounded() {
    let worker = WorkerId { slot: 0, generation: 1 };
    let read = async |bytes: &[u8]| {
        let (out, mut heard) = tokio::sync::mpsc::channel(2 * LINES);
        let out_of_memory = pass_on(worker, bytes, out).await;
        let mut lines = Vec::new();
        while let Ok((_, ProcessEvent::Line(line))) = heard.try_recv() {
            lines.push(line);
        }
        (lines, out_of_memory)
    };
    let (lines, out_of_memory) =
        read(b"first\n\xff\xfe\x00 \x1b[2J\nmemory allocation of 9 bytes failed\r\nlast").await;
    assert_eq!(lines[0], "first");
    assert!(lines[1].contains('\u{fffd}') && !lines[1].contains(char::is_control), "{lines:?}");
    assert_eq!((&*lines[3], lines.len(), out_of_memory), ("last", 4, true));
    let (lines, _) = read(&[vec![b'x'; 10_000_000], b"\nnext\n".to_vec()].concat()).await;
    assert_eq!(lines.iter().map(String::len).collect::<Vec<_>>(), [LINE, 4]);
    let (lines, out_of_memory) =
        read(&[b"x\n".repeat(100_000), b"memory allocation of ".to_vec()].concat()).await;
    assert_eq!((lines.len(), out_of_memory), (LINES, true));
}
