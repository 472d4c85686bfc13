//! Commands with options, exit codes and views, from the program; its tests, from the heads of their files.

use clap::ValueEnum;
use metasense::analysis::Question;
use metasense::cli::{GROUPS, TOP, command};
use metasense::exit::EXIT_CODES;
use metasense::reader::Reader;
use metasense::store::Store;
use metasense_schemas::database::VIEWS;

use super::table;

/// Headings and groups with their commands, built so that they contain their full usage.
fn groups() -> impl Iterator<Item = (String, Vec<clap::Command>)> {
    let mut program = command();
    program.build();
    let all = |of: &clap::Command, names: &[&str]| -> Vec<clap::Command> {
        names.iter().map(|name| of.find_subcommand(name).unwrap().clone()).collect()
    };
    let mut found: Vec<_> =
        TOP.iter().map(|(heading, names)| ((*heading).to_owned(), all(&program, names))).collect();
    for (group, names) in GROUPS {
        let group = program.find_subcommand(group).unwrap();
        found.push((line(group.get_about()), all(group, names)));
    }
    found.into_iter()
}

fn usage(command: &clap::Command) -> String {
    let text = command.clone().render_usage().to_string();
    let text = text.trim_start_matches("Usage: ").split_whitespace().collect::<Vec<_>>().join(" ");
    text.replace(" [OPTIONS]", "")
}

/// A help text on one line; its paragraphs become sentences.
fn line(text: Option<&clap::builder::StyledStr>) -> String {
    let text = text.map(ToString::to_string).unwrap_or_default();
    let paragraphs = text.split("\n\n").map(|p| p.split_whitespace().collect::<Vec<_>>().join(" "));
    paragraphs.reduce(|all, next| format!("{}. {next}", all.trim_end_matches('.'))).unwrap_or_default()
}

pub fn commands() -> String {
    let mut rows = Vec::new();
    for (heading, commands) in groups() {
        rows.push(vec![format!("**{heading}**"), String::new()]);
        rows.extend(commands.iter().map(|c| vec![format!("`{}`", usage(c)), line(c.get_about())]));
    }
    table(&["command", "does"], rows)
}

pub fn options() -> String {
    let mut text = String::new();
    for command in groups().flat_map(|(_, commands)| commands) {
        text += &format!("### {}\n\n", command.get_name());
        add_options(&command, &mut text);
    }
    text
}

fn add_options(command: &clap::Command, text: &mut String) {
    let about = line(command.get_long_about().or(command.get_about()));
    *text += &format!("`{}`: {about}{}\n\n", usage(command), if about.ends_with('.') { "" } else { "." });
    let shown = |a: &&clap::Arg| !a.is_hide_set() && !matches!(a.get_id().as_str(), "help" | "version");
    let rows: Vec<_> = command.get_arguments().filter(shown).map(option).collect();
    if !rows.is_empty() {
        *text += &table(&["argument", "means"], rows);
        *text += "\n";
    }
    for inner in command.get_subcommands().filter(|c| !c.is_hide_set() && c.get_name() != "help") {
        add_options(inner, text);
    }
}

fn option(arg: &clap::Arg) -> Vec<String> {
    let values: Vec<String> = match arg.get_possible_values() {
        values if values.is_empty() => Vec::new(),
        _ if arg.is_hide_possible_values_set() || !arg.get_action().takes_values() => Vec::new(),
        values => values.iter().filter(|v| !v.is_hide_set()).map(|v| format!("`{}`", v.get_name())).collect(),
    };
    let defaults: Vec<String> = arg
        .get_default_values()
        .iter()
        .filter(|_| arg.get_action().takes_values())
        .map(|value| format!("`{}`", value.to_string_lossy()))
        .collect();
    let mut means = line(arg.get_long_help().or(arg.get_help()));
    if !means.is_empty() && !means.ends_with('.') {
        means.push('.');
    }
    if !values.is_empty() {
        means += &format!(" Values: {}.", values.join(", "));
    }
    if !defaults.is_empty() && !means.to_lowercase().contains("by default") {
        means += &format!(" Default: {}.", defaults.join(", "));
    }
    vec![format!("`{}`", arg.to_string().replace("...", "…")), means]
}

/// Questions of `analyse`.
pub fn questions() -> String {
    let rows = Question::all().iter().filter_map(ValueEnum::to_possible_value);
    table(
        &["`--question`", "answers"],
        rows.map(|value| vec![format!("`{}`", value.get_name()), line(value.get_help())]),
    )
}

pub fn exit_codes() -> String {
    let mut rows: Vec<Vec<String>> = Vec::new();
    for text in EXIT_CODES.lines().skip(1).map(str::trim) {
        match text.split_once("  ") {
            Some((code, means)) if code.parse::<u8>().is_ok() => {
                rows.push(vec![code.to_owned(), means.trim().to_owned()]);
            }
            _ => *rows.last_mut().unwrap().last_mut().unwrap() += &format!(" {text}"),
        }
    }
    table(&["code", "means"], rows)
}

/// Views with the columns of a database of this version.
pub fn views() -> String {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let rows = runtime.block_on(async {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("views.sqlite");
        Store::open(&file).await.unwrap().close().await.unwrap();
        let mut reader = Reader::open(&file).await.unwrap();
        let mut rows = Vec::new();
        for (view, means) in VIEWS.iter() {
            let sql = format!("SELECT name FROM pragma_table_info('{view}')");
            let columns = reader.query::<metasense::look::Table>(&sql).await.unwrap();
            let columns: Vec<String> =
                columns.rows.iter().map(|row| format!("`{}`", row[0].as_str().unwrap())).collect();
            rows.push(vec![format!("`{view}`"), means.clone(), columns.join(", ")]);
        }
        reader.close().await;
        rows
    });
    table(&["view", "a row is", "columns"], rows)
}

/// The files of end-to-end tests with the first paragraph of each.
pub fn tests() -> String {
    let mut rows = Vec::new();
    for entry in std::fs::read_dir(super::root().join("tests")).unwrap() {
        let file = entry.unwrap().file_name().into_string().unwrap();
        if !file.ends_with(".rs") || matches!(&*file, "program.rs" | "bench.rs") {
            continue;
        }
        let text = super::read(&format!("tests/{file}"));
        let head = text.lines().map_while(|line| line.strip_prefix("//!")).map(str::trim);
        let head = head.take_while(|line| !line.is_empty()).collect::<Vec<_>>().join(" ");
        rows.push(vec![format!("[{file}]({file})"), head]);
    }
    rows.sort();
    table(&["file", "property"], rows)
}
