use super::*;

#[test]
fn the_queue_is_read() {
    let job = |job: &str, merge: &str| Job {
        scheduler: "slurm".into(),
        job: job.into(),
        merge_job: Some(merge.into()),
        shards: 4,
        offset: 0,
    };
    let (one, two) = (job("7", "8"), job("9", "10"));
    let mut queue = Queue::default();
    queue.add_slurm("7|3|RUNNING|None\n7|4|PENDING|Resources\n8|N/A|PENDING|Dependency\n", &[&one, &two]);
    assert_eq!(queue.shards, HashMap::from([(3, "running".into()), (4, "pending (Resources)".into())]));
    assert_eq!(queue.jobs, ["7", "8"]);
    let further = Job { offset: 1000, ..one.clone() };
    let mut queue = Queue::default();
    queue.add_slurm("7|3|RUNNING|None\n", &[&further]);
    assert_eq!(queue.shards, HashMap::from([(1003, "running".into())]));
    let mut queue = Queue::default();
    let text = r#"{"7": [{"id": 1, "state": "finished"}, {"id": 2, "state": "running", "worker": 1}],
                       "8": [{"id": 0, "state": "waiting"}], "9": [{"id": 1, "state": "canceled"}]}"#;
    queue.add_hq(serde_json::from_str::<Value>(text).unwrap().as_object().unwrap(), &[&one, &two]);
    assert_eq!(queue.shards, HashMap::from([(2, "running".into())]));
    assert_eq!(queue.jobs, ["7", "8"]);
}
