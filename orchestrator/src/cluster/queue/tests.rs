use super::*;

/// A kill within a line loses only that line, and the next line starts anew. A job whose id was recorded later is one job. The
/// error for an invalid line contains its number.
#[test]
fn notes_are_read_up_to_where_they_were_written() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(JOBS);
    let intent = r#"{"scheduler":"slurm","name":"s.1","shards":2}"#;
    let job = r#"{"scheduler":"slurm","job":"7","name":"s.1","cluster":"gpu","shards":2}"#;
    let read = |text: &[u8]| {
        std::fs::write(&file, text).unwrap();
        jobs(folder.path())
    };
    // a process forked by another test holds the lock until its exec
    let open = || {
        let opened = (0..500).find_map(|_| {
            let notes = Notes::open(folder.path()).ok();
            if notes.is_none() {
                std::thread::sleep(std::time::Duration::from_millis(10));
            }
            notes
        });
        opened.expect("the lock is free within seconds")
    };
    let numbers = |jobs: Vec<Job>| jobs.into_iter().map(|job| job.job).collect::<Vec<_>>();
    assert_eq!(numbers(read(format!("{intent}\n{job}\n").as_bytes()).unwrap()), ["7"]);
    let torn: [&[u8]; 4] = [&job.as_bytes()[..20], b"\0\0\0\0", b"\xff\xfe", b"  "];
    for rest in torn {
        let text = [intent.as_bytes(), b"\n", rest].concat();
        assert_eq!(numbers(read(&text).unwrap()), [""], "{rest:?}");
        let mut notes = open();
        notes.note(&serde_json::from_str(job).unwrap()).unwrap();
        assert_eq!(numbers(jobs(folder.path()).unwrap()), ["7"], "{rest:?}");
    }
    // complete except for the line end
    assert_eq!(numbers(read(job.as_bytes()).unwrap()), ["7"]);
    let other: Job = serde_json::from_str(&job.replace('7', "8").replace("s.1", "s.2")).unwrap();
    open().note(&other).unwrap();
    assert_eq!(numbers(jobs(folder.path()).unwrap()), ["7", "8"]);
    for damaged in [&b"{\"sched\n"[..], b"\0\0\n", b"\xff\n"] {
        let text = [job.as_bytes(), b"\n\n", damaged, job.as_bytes(), b"\n"].concat();
        let error = read(&text).unwrap_err().to_string();
        assert!(error.contains("jobs.jsonl:3: "), "{error}");
    }
}
