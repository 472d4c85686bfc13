use super::*;

#[test]
fn times_are_read_as_slurm_reads_them() {
    for (text, expected) in [
        ("30", 1800),
        ("90:30", 5430),
        ("4:00:00", 14_400),
        ("1-12", 129_600),
        ("2-01:30", 178_200),
        ("1-00:00:10", 86_410),
    ] {
        assert_eq!(seconds(text), Ok(expected), "{text}");
    }
    for text in ["", "x", "1:2:3:4", "-1", "0", "4h", "307445734561825862", "213503982334602-0"] {
        assert!(seconds(text).is_err(), "{text}");
    }
}

#[test]
fn words_are_quoted_for_a_shell() {
    assert_eq!(quoted(Path::new("/a/b.toml")), "/a/b.toml");
    assert_eq!(quoted(Path::new("/a b/it's")), r"'/a b/it'\''s'");
}
