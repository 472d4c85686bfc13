use super::*;

#[test]
fn hosts_are_read_with_their_places() {
    let place = |host: &str| Some(host.to_owned());
    let read = places("# three machines\nn1\n  n2 2 # large\n\nme@n3\n");
    assert_eq!(read, Ok(vec![place("n1"), place("n2"), place("n2"), place("me@n3")]));
    for text in ["n1 0", "n1 x", "n1 1 1", "-oProxyCommand=x", "n1 2000"] {
        assert!(places(text).is_err_and(|e| e.starts_with("1: ")), "{text}");
    }
}

/// A script replaces the shards: it records its arguments and exits as the test requires.
#[tokio::test]
async fn shards_that_die_are_begun_again_and_a_machine_that_is_unfit_gets_no_more() {
    let folder = tempfile::tempdir().unwrap();
    let how = LaunchConfig { folder: folder.path().to_owned(), shards: 9, options: Vec::new(), grace: 10.0 };
    let said = std::cell::RefCell::new(Vec::new());
    let run = async |script: &str, which: &[u32]| {
        said.borrow_mut().clear();
        let _ = std::fs::remove_file(folder.path().join("calls"));
        let head = format!("cd {}; echo $1 >> calls\n", quoted(folder.path()));
        std::fs::write(folder.path().join("shard.sh"), head + script).unwrap();
        let mut signals = Signals::new().unwrap();
        let ended =
            super::run(&[None, None], which, &how, &mut signals, |line| said.borrow_mut().push(line)).await;
        let mut calls: Vec<u32> = std::fs::read_to_string(folder.path().join("calls"))
            .unwrap()
            .lines()
            .map(|line| line.parse().unwrap())
            .collect();
        calls.sort_unstable();
        (ended, calls)
    };
    let (ended, calls) = run("exit 0", &[1, 2, 3, 7]).await;
    assert_eq!((ended, calls), (ShardsOutcome::default(), vec![1, 2, 3, 7]));
    let (ended, calls) = run("[ $1 = 2 ] && kill -9 $$; [ $1 = 3 ] && exit 3; exit 1", &[1, 2, 3]).await;
    assert_eq!(ended, ShardsOutcome { unfinished: vec![2, 3], failed: true, ..ShardsOutcome::default() });
    assert_eq!(calls, [1, 2, 2, 2, 3]);
    // whatever an output contains, the shard's last message and the name of the file are printed
    std::fs::write(folder.path().join("shard-1-of-9.out"), "of an earlier attempt\n").unwrap();
    let script = "printf 'first\\n\\377\\000last words\\n\\n' >> shard-$1-of-9.out; kill -9 $$";
    run(script, &[1]).await;
    let told = |words: &str| said.borrow().iter().filter(|line| line.contains(words)).count();
    assert_eq!((told("last words"), told("shard-1-of-9.out"), told("signal")), (3, 3, 3), "{said:?}");
    run("echo of the script >&2; exit 126", &[1]).await;
    assert_eq!((told("of the script"), told("126")), (3, 3), "{said:?}");
    let script = "printf 'error: first\\n  because: second\\nthe end\\n' >> shard-$1-of-9.out; exit 3";
    run(script, &[4]).await;
    assert_eq!(told("error: first because: second ("), 1, "{said:?}");
    run("exit 3", &[2]).await;
    assert_eq!(told("is empty"), 1, "{said:?}");
    let (ended, calls) = run("exit 5", &[1, 2, 3, 4]).await;
    assert_eq!(
        ended,
        ShardsOutcome { unfinished: vec![1, 2, 3, 4], deserted: true, ..ShardsOutcome::default() }
    );
    assert_eq!(calls, [1, 2]);
}
