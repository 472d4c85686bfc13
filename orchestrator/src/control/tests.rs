use super::*;
use crate::store::Store;

async fn request(listener: &Listener) -> Request {
    listener.next().await.unwrap()
}

#[test]
fn a_line_is_the_command_that_it_was_made_of() {
    let hash = || "3f6a-0b".to_owned();
    for command in [
        Command::State,
        Command::Pause,
        Command::Resume,
        Command::Stop,
        Command::Cancel { hash: hash() },
        Command::Next { hash: hash() },
        Command::Workers { count: 7 },
        Command::Reload,
    ] {
        assert_eq!(command.to_string().parse(), Ok(command));
    }
    for line in [
        "",
        "Pause",
        "pause now",
        "cancel",
        "cancel a b",
        "cancel a;b",
        "workers 0",
        "workers 1025",
        "workers x",
    ] {
        let error = line.parse::<Command>().unwrap_err();
        assert!(error.to_string().contains("workers N"), "{line}: {error}");
    }
}

/// Commands arrive and are answered until the listener ends. A long path and the socket of a killed run do no harm; silent,
/// oversized and vanished clients are ignored.
#[tokio::test]
async fn a_run_is_asked_by_its_database() {
    let folder = tempfile::tempdir().unwrap();
    let deep = folder.path().join("a folder with a long name ".repeat(6));
    std::fs::create_dir(&deep).unwrap();
    let db = deep.join("s.sqlite");
    assert!(matches!(ask(&db, &Command::Pause).await, Err(ControlError::NoDatabase { .. })));
    File::create(&db).unwrap();
    assert!(matches!(ask(&db, &Command::Pause).await, Err(ControlError::NoRun { .. })));
    // left by a killed run
    let (_folder, left, file) = address(&db).unwrap();
    drop(std::os::unix::net::UnixListener::bind(left).unwrap());
    assert!(matches!(ask(&db, &Command::Pause).await, Err(ControlError::NoRun { .. })));
    let store = Store::open(&db).await.unwrap();
    let deaf = ask(&db, &Command::Pause).await;
    assert!(matches!(deaf, Err(ControlError::NotListening { .. })), "{deaf:?}");
    assert_eq!(run_of(&db).await, None);
    let listener = Listener::new(&db).unwrap();
    assert_eq!(run_of(&db).await, Some(std::process::id()));
    assert_eq!(file.metadata().unwrap().permissions().mode() & 0o777, 0o600);

    let (_held, address, _) = address(&db).unwrap();
    let connect = || UnixStream::connect(&address);
    let _silent = connect().await.unwrap();
    for words in ["sing\n".to_owned(), "x".repeat(100_000)] {
        let mut stream = connect().await.unwrap();
        let _ = stream.write_all(words.as_bytes()).await;
        let mut answer = String::new();
        let _ = stream.read_to_string(&mut answer).await;
        assert!(answer.starts_with("refused unknown command ") || words.len() > 100, "{answer}");
    }
    let mut gone = connect().await.unwrap();
    gone.write_all(b"stop\n").await.unwrap();
    let asked = request(&listener).await;
    drop(gone);
    let Request { command: Command::Stop, mut answer } = asked else { panic!("{asked:?}") };
    timeout(ASKING, answer.closed()).await.expect("its asker has gone");

    let said = Reply { done: true, text: "goes to\nthe next".into() };
    let answering = async {
        let Request { command, answer } = request(&listener).await;
        assert_eq!(command, Command::Next { hash: "ab".into() });
        answer.send(said.clone()).unwrap();
    };
    let command = Command::Next { hash: "ab".into() };
    let (heard, ()) = tokio::join!(ask(&db, &command), answering);
    assert_eq!(heard.unwrap(), said);
    // the run is busy
    let late = ask_within(Duration::from_millis(100), &db, &Command::State).await.unwrap_err();
    let pid = std::process::id().to_string();
    assert!(matches!(late, ControlError::NoAnswer { .. }) && late.to_string().contains(&pid), "{late}");
    drop(request(&listener).await);
    let ending = async { drop((request(&listener).await, listener)) };
    let command = Command::State;
    let (heard, ()) = tokio::join!(ask(&db, &command), ending);
    assert_eq!(heard.unwrap(), Reply::refused("the run has ended"));
    assert!(!file.exists());
    store.close().await.unwrap();

    // a name that is too long has its own error
    let long = deep.join("s".repeat(120));
    File::create(&long).unwrap();
    let why = Listener::new(&long).map(drop).unwrap_err().to_string();
    assert!(
        why.starts_with("the name of the database is ") && why.ends_with(" bytes too long for a socket"),
        "{why}"
    );
    assert!(matches!(ask(&long, &Command::Pause).await, Err(ControlError::Io { .. })));
}
