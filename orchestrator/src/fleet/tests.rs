use std::cell::Cell;

use super::*;

/// A process that the system holds in an uninterruptible wait is killed in vain: after the limit it counts as ended.
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

/// One that can be is waited for, and one that ends by itself is not killed.
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
