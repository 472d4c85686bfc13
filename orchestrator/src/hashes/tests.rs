use super::*;

#[test]
fn a_beginning_names_one_trial_or_says_which_ones_there_are() {
    let hashes = ["3f6a00000000aa", "3f6b00000000bb", "77aa00000000cc"];
    let find = |text: &str| position_of(text, hashes.iter().copied()).map_err(|e| e.to_string());
    assert_eq!(find("77"), Ok(2));
    assert_eq!(find("3f6b00000000bb"), Ok(1));
    assert_eq!(
        find("3f").unwrap_err(),
        "trial 3f: several hashes begin with this text: 3f6a00000000, 3f6b00000000; add digits"
    );
    assert_eq!(
        find("3f7b").unwrap_err(),
        "trial 3f7b: no hash begins with this text; the nearest is 3f6b00000000"
    );
    let those = "3f6a00000000, 3f6b00000000, 77aa00000000";
    assert_eq!(
        find("zz").unwrap_err(),
        format!("trial zz: no hash begins with this text; known trials: {those}")
    );
    let nowhere = position_of("zz", std::iter::empty()).unwrap_err().to_string();
    assert_eq!(nowhere, "trial zz: no hash begins with this text; known trials: none");
    let many: Vec<String> = (0..9).map(|i| format!("a{i}")).collect();
    let several = position_of("", many.iter().map(String::as_str)).unwrap_err().to_string();
    assert_eq!(
        several,
        "trial : several hashes begin with this text: a0, a1, a2, a3, a4 and 4 more; add digits"
    );
}
