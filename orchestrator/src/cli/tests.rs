use super::*;

/// Each command that people may call stands in one group of `--help`, with one line of help that fits the screen.
#[test]
fn every_command_is_in_one_group_with_a_line_of_help() {
    let command = command();
    command.clone().debug_assert();
    let grouped: Vec<&str> = GROUPS.iter().flat_map(|(_, names)| names.iter().copied()).collect();
    let mut visible: Vec<&str> =
        command.get_subcommands().filter(|c| !c.is_hide_set()).map(clap::Command::get_name).collect();
    let mut sorted = grouped.clone();
    sorted.sort_unstable();
    visible.sort_unstable();
    assert_eq!(sorted, visible);
    let help = command.clone().render_long_help().to_string();
    for name in grouped {
        let about = command.find_subcommand(name).unwrap().get_about().unwrap().to_string();
        assert!((20..=86).contains(&about.len()) && !about.contains(['\n', '{']), "{name}: {about}");
        assert!(help.contains(&format!("\n  {name:10}{about}\n")), "{name}:\n{help}");
    }
}

#[test]
fn analyse_is_understood_with_a_z() {
    let matches = command().get_matches_from(["metasense", "analyze", "s.sqlite"]);
    assert_eq!(matches.subcommand_name(), Some("analyse"));
}
