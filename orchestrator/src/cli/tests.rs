use super::*;

/// Each visible command is under one heading of `--help` or in one group, with a line of help that fits the screen.
#[test]
fn every_command_is_in_one_place_with_a_line_of_help() {
    let command = command();
    command.clone().debug_assert();
    let visible = |command: &clap::Command| {
        let shown = command.get_subcommands().filter(|c| !c.is_hide_set());
        let mut names: Vec<String> = shown.map(|c| c.get_name().to_owned()).collect();
        names.sort_unstable();
        names
    };
    let sorted = |names: Vec<&str>| {
        let mut names: Vec<String> = names.into_iter().map(str::to_owned).collect();
        names.sort_unstable();
        names
    };
    let help = command.clone().render_long_help().to_string();
    let check = |command: &clap::Command| {
        let (name, about) = (command.get_name(), command.get_about().unwrap().to_string());
        assert!((20..=86).contains(&about.len()) && !about.contains(['\n', '{']), "{name}: {about}");
        format!("\n  {name:12}{about}\n")
    };
    let groups = GROUPS.iter().map(|(group, _)| *group);
    let top: Vec<&str> = TOP.iter().flat_map(|(_, names)| names.iter().copied()).chain(groups).collect();
    assert_eq!(visible(&command), sorted(top));
    for inner in command.get_subcommands().filter(|c| !c.is_hide_set()) {
        let line = check(inner);
        assert!(help.contains(&line), "{line}{help}");
    }
    for (group, names) in GROUPS {
        let group = command.find_subcommand(group).unwrap();
        assert_eq!(visible(group), sorted(names.to_vec()));
        group.get_subcommands().for_each(|inner| drop(check(inner)));
        assert!(help.contains(&names.join(", ")), "{help}");
    }
}

/// An old command name is an error that states the new name.
#[test]
fn a_command_that_was_moved_is_named_as_it_is_now() {
    for (old, new) in
        [("draw", "body draw"), ("merge", "cluster merge"), ("claims", "analyse --question claims")]
    {
        let refused = execute(["metasense", old, "x"].map(OsString::from).into_iter()).unwrap_err();
        assert_eq!(refused.to_string(), format!("`metasense {old}` is now `metasense {new}`"));
        assert_eq!(refused.exit() as u8, 2);
    }
}

#[test]
fn analyse_is_understood_with_a_z() {
    let matches = command().get_matches_from(["metasense", "analyze", "s.sqlite"]);
    assert_eq!(matches.subcommand_name(), Some("analyse"));
}
