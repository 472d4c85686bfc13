use super::*;

/// Different files of one name have a copy each, a file that is named twice has one; the quotes of a name do not matter.
#[test]
fn a_spec_refers_to_the_copies_of_its_files() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let [first, second] = ["1", "2"].map(|day| {
        std::fs::create_dir(at(day)).unwrap();
        let file = at(day).join("forces.npy");
        std::fs::write(&file, day).unwrap();
        file.display().to_string()
    });
    let head = format!("# day 1: {first}\n[stimuli.recorded]\n");
    let text = format!("{head}files = ['{first}', \"{second}\", \"{first}\"]\n");
    write_spec_files(folder.path(), "s", &["s".into()], &text).unwrap();
    let read = |name: &str| std::fs::read_to_string(at(name)).unwrap();
    let files = r#"files = ["s-forces.npy", "s-forces-2.npy", "s-forces.npy"]"#;
    assert_eq!(read("s.toml"), format!("{head}{files}\n"));
    assert_eq!(["s-forces.npy", "s-forces-2.npy"].map(read), ["1", "2"]);
}

/// The copy of a file does not get the name of another spec.
#[test]
fn a_copy_leaves_the_names_of_specs() {
    let folder = tempfile::tempdir().unwrap();
    let specs = ["a", "a-b"].map(String::from);
    assert_eq!(free_name(folder.path(), &specs, "a-b.toml"), "a-b-2.toml");
    assert_eq!(free_name(folder.path(), &specs, "a-c.toml"), "a-c.toml");
}
