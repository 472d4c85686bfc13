use super::*;

#[test]
fn what_is_no_shard_is_refused() {
    for text in ["", "3", "0/3", "4/3", "1/0", "-1/3", "1/3/5", "1/1000000"] {
        assert_eq!(text.parse::<Shard>(), Err(ShardError(text.into())), "{text}");
    }
    assert_eq!("3/10".parse::<Shard>().unwrap().to_string(), "3/10");
}

#[test]
fn numbers_are_written_in_runs() {
    assert_eq!(ranges(&[1, 2, 3, 7, 9, 10]), "1-3,7,9-10");
    assert_eq!(ranges(&[]), "");
}
