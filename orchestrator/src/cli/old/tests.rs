use super::*;

fn now(line: &str) -> String {
    let words = rewritten(line.split_whitespace().map(OsString::from)).unwrap();
    words.iter().map(|word| word.to_str().unwrap()).collect::<Vec<_>>().join(" ")
}

#[test]
fn every_old_spelling_becomes_todays() {
    for (old, new) in COMMANDS {
        assert_eq!(
            now(&format!("metasense {old} s.toml --hash a")),
            format!("metasense {new} s.toml --hash a")
        );
    }
    for (command, old, new) in OPTIONS {
        let line = |option: &str| format!("metasense {command} a {option} b c");
        assert_eq!(now(&line(old)), line(new));
        assert_eq!(now(&format!("metasense {command} a {old}=b c")), line(new));
        // of another command, or behind `--`, it is what it says
        let others = [format!("metasense query a {old} b"), format!("metasense {command} a -- {old} b")];
        others.iter().for_each(|line| assert_eq!(now(line), *line));
    }
    for line in ["metasense report --trial 3f s.sqlite", "metasense report s.sqlite --trial=3f"] {
        assert_eq!(now(line), "metasense report s.sqlite 3f");
    }
    assert_eq!(now("metasense"), "metasense");
}
