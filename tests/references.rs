//! The documents: generated blocks agree with the program and the committed rows, links have targets, README is short.
//!
//! A block is between `<!-- generated: NAME -->` and `<!-- end -->`. To write all blocks again: `METASENSE_UPDATE=1 cargo test -p
//! metasense --test program -- references::`.

mod authors;
mod bodies;
mod brains;
mod casts;
mod claims;
mod deviations;
mod elbow_law;
mod map;
mod program;
mod results;
mod rows;
mod spec;
mod tasks;

mod who_senses;

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::common::skip;

/// Paths of all documents from the project's root: Markdown outside hidden and build folders.
fn documents() -> Vec<String> {
    let (mut found, mut folders) = (Vec::new(), vec![PathBuf::new()]);
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(root().join(&folder)).unwrap() {
            let entry = entry.unwrap();
            let name = entry.file_name().into_string().unwrap();
            let path = folder.join(&name);
            if entry.file_type().unwrap().is_dir() {
                if !name.starts_with('.') && name != "target" && path != Path::new("results/committed") {
                    folders.push(path);
                }
            } else if name.ends_with(".md") {
                found.push(path.into_os_string().into_string().unwrap());
            }
        }
    }
    found
}

type Render = fn() -> String;

/// Names of blocks with their renderers.
const BLOCKS: &[(&str, Render)] = &[
    ("spec keys", spec::keys),
    ("records keys", spec::records),
    ("specs", spec::files),
    ("search limits", spec::search_limits),
    ("commands", program::commands),
    ("options", program::options),
    ("questions", program::questions),
    ("exit codes", program::exit_codes),
    ("views", program::views),
    ("tests", program::tests),
    ("quickstart", results::quickstart),
    ("quickstart casts", casts::quickstart_casts),
    ("evening casts", casts::evening_casts),
    ("findings", results::findings),
    ("who senses", who_senses::all),
    ("casts", casts::casts),
    ("relaxing", casts::relaxing),
    ("bands", casts::bands),
    ("transfer", casts::transfer),
    ("transfer networks", casts::transfer_networks),
    ("transfer recorded", casts::transfer_recorded),
    ("real scale", casts::real_scale),
    ("why", bodies::why),
    ("why correlated", bodies::why_correlated),
    ("families", bodies::families),
    ("families sensors", bodies::families_sensors),
    ("pressed", bodies::pressed),
    ("filtered", bodies::filtered),
    ("external bodies", bodies::external),
    ("designs", bodies::designs),
    ("race", bodies::race),
    ("memory", bodies::memory),
    ("warm starts", bodies::warm_starts),
    ("brains", brains::brains),
    ("linear bodies", brains::linear_bodies),
    ("placed", brains::placed),
    ("elbow law asked", elbow_law::asked),
    ("four forces map", map::four_forces),
    ("four forces map network", map::four_forces_network),
    ("eight forces map", map::eight_forces),
    ("disc map", map::discs),
    ("random bodies map", map::random_bodies),
    ("blows map", map::blows),
    ("size map", map::sizes),
    ("size map network", map::sizes_network),
    ("protocol map", map::protocols),
    ("claims", claims::claims),
    ("claims on the test set", claims::on_the_test_set),
    ("sensors", brains::sensors),
    ("paper protocol", claims::paper_protocol),
    ("paper protocol, blows", claims::paper_protocol_blows),
    ("paper protocol, four forces", claims::paper_protocol_four_forces),
    ("evaluate", claims::evaluate),
    ("protocols", claims::protocols),
    ("downhill", claims::downhill),
    ("authors", authors::gains),
    ("authors casts", authors::casts),
    ("authors discs", authors::discs),
    ("tasks", tasks::tasks),
    ("tasks transfer", tasks::transfer),
    ("tasks decoded", tasks::decoded),
    ("position", tasks::position),
    ("capacity", tasks::capacity),
    ("deviations", deviations::deviations),
    ("deviations of other figures", deviations::other_figures),
];

const BEGIN: &str = "<!-- generated: ";
const END: &str = "<!-- end -->";

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_owned()
}

fn read(document: &str) -> String {
    std::fs::read_to_string(root().join(document)).unwrap_or_else(|e| panic!("{document}: {e}"))
}

/// The document with all blocks rendered again, and the names of its blocks.
fn rendered(document: &str, text: &str) -> (String, Vec<String>) {
    let (mut fresh, mut names, mut rest) = (String::with_capacity(text.len()), Vec::new(), text);
    while let Some((before, after)) = rest.split_once(BEGIN) {
        let (name, after) = after.split_once(" -->").expect("the end of the block's name");
        let (_, after) = after.split_once(END).unwrap_or_else(|| panic!("{document}: {name} has no {END}"));
        let (_, render) = BLOCKS.iter().find(|(known, _)| *known == name).unwrap_or_else(|| {
            panic!("{document}: no block is called {name:?}: tests/references.rs lists them")
        });
        fresh += &format!("{before}{BEGIN}{name} -->\n{}\n{END}", render().trim());
        names.push(name.to_owned());
        rest = after;
    }
    (fresh + rest, names)
}

/// Renders every block again and prints the first line that differs.
#[test]
fn generated_blocks_are_fresh() {
    let update = std::env::var_os("METASENSE_UPDATE").is_some();
    let mut found = Vec::new();
    let mut stale = Vec::new();
    for document in &documents() {
        let text = read(document);
        let (fresh, names) = rendered(document, &text);
        found.extend(names);
        if fresh == text {
            continue;
        }
        if update {
            std::fs::write(root().join(document), &fresh).unwrap();
            continue;
        }
        let differs = text.lines().zip(fresh.lines()).find(|(old, new)| old != new);
        let (old, new) = differs.unwrap_or(("", "(only the lengths differ)"));
        stale.push(format!("{document}:\n  is        {old}\n  should be {new}"));
    }
    assert!(
        stale.is_empty(),
        "{}\nMETASENSE_UPDATE=1 cargo test -p metasense --test program -- references:: writes them anew",
        stale.join("\n")
    );
    for (name, _) in BLOCKS {
        assert!(found.iter().any(|used| used == name), "no document has the block {name:?}");
    }
}

/// Pictures that only this file draws.
#[test]
fn made_files_are_fresh() {
    let [claims, evidence, figure] = claims::files();
    for (name, drawn) in [
        ("who-senses/front.svg", who_senses::front()),
        ("lattices.svg", bodies::lattices()),
        ("elbow-law/map.svg", elbow_law::map()),
        ("claims/claims.csv", claims),
        ("claims/evidence.csv", evidence),
        ("claims/claims.svg", figure),
        ("four-forces-map/map.svg", map::four_forces_drawn()),
    ] {
        let path = root().join("results/committed").join(name);
        if std::env::var_os("METASENSE_UPDATE").is_some() {
            std::fs::write(&path, &drawn).unwrap();
        }
        let is_fresh = std::fs::read_to_string(&path).is_ok_and(|there| there == drawn);
        assert!(is_fresh, "{} is stale", path.display());
    }
}

/// Targets of `[text](path)` links, web addresses included.
fn links(text: &str) -> impl Iterator<Item = &str> {
    text.split("](").skip(1).filter_map(|rest| rest.split_once(')').map(|(link, _)| link))
}

/// GitHub's anchor of a heading: lower case, blanks as hyphens, other signs dropped.
fn anchor(heading: &str) -> String {
    let kept = heading.trim_start_matches('#').trim().to_lowercase();
    kept.chars()
        .filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'))
        .map(|c| if c == ' ' { '-' } else { c })
        .collect()
}

/// An independent script finds the same numbers in the rows, and detects a wrong one.
#[test]
fn tables_follow_from_the_rows_by_another_program() {
    let check = |script: &Path, tables: &[&str]| Command::new("python3").arg(script).args(tables).output();
    let Ok(run) = check(&root().join("results/check.py"), &[]) else {
        return skip::skipped("tables_follow_from_the_rows_by_another_program", "there is no Python");
    };
    let said = String::from_utf8_lossy(&run.stdout);
    assert!(run.status.success(), "{said}{}", String::from_utf8_lossy(&run.stderr));
    assert!(
        said.lines().count() >= 11 && said.lines().all(|line| line.ends_with(" cells, 0 differ")),
        "{said}"
    );

    let folder = tempfile::tempdir().unwrap();
    let results = folder.path().join("results");
    std::fs::create_dir(&results).unwrap();
    std::os::unix::fs::symlink(root().join("results/committed"), results.join("committed")).unwrap();
    std::fs::copy(root().join("results/check.py"), results.join("check.py")).unwrap();
    std::fs::copy(root().join("README.md"), folder.path().join("README.md")).unwrap();
    let tables = read("results/README.md");
    let (before, after) = tables.split_once("<!-- generated: relaxing -->").unwrap();
    let wrong = format!("{before}<!-- generated: relaxing -->{}", after.replacen(" [", " [9", 1));
    std::fs::write(results.join("README.md"), wrong).unwrap();
    let run = check(&results.join("check.py"), &["relaxing"]).unwrap();
    let said = String::from_utf8_lossy(&run.stdout);
    assert!(run.status.code() == Some(1) && said.contains("relaxing: 16 cells, 1 differ"), "{said}");
}

#[test]
fn links_lead_somewhere() {
    let mut broken = Vec::new();
    for document in &documents() {
        let text = read(document);
        let folder = root().join(document).parent().unwrap().to_owned();
        for link in links(&text).filter(|link| !link.contains("://")) {
            let (path, heading) = link.split_once('#').unwrap_or((link, ""));
            let target = if path.is_empty() { root().join(document) } else { folder.join(path) };
            let there = match heading {
                "" => target.exists(),
                heading => std::fs::read_to_string(&target)
                    .is_ok_and(|text| text.lines().any(|l| l.starts_with('#') && anchor(l) == heading)),
            };
            if !there {
                broken.push(format!("{document}: {link}"));
            }
        }
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn the_readme_can_be_read_in_ten_minutes() {
    let text = read("README.md");
    let (lines, bytes) = (text.lines().count(), text.len());
    assert!(lines <= 150 && bytes <= 10_240, "README.md has {lines} lines, {bytes} bytes");
}

/// All dependencies are from the public registry, whatever registry a machine uses.
#[test]
fn the_lock_file_names_no_private_registry() {
    let lock = read("Cargo.lock");
    let sources = lock.lines().filter(|line| line.starts_with("source = "));
    let foreign: Vec<_> =
        sources.filter(|line| !line.ends_with("https://github.com/rust-lang/crates.io-index\"")).collect();
    assert!(foreign.is_empty(), "{foreign:?}");
}

/// A Markdown table.
fn table(head: &[&str], rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let line = |cells: &mut dyn Iterator<Item = String>| {
        let cells: Vec<String> = cells.map(|cell| cell.replace('|', "\\|").replace('\n', " ")).collect();
        format!("| {} |\n", cells.join(" | "))
    };
    let mut text = line(&mut head.iter().map(|&cell| cell.to_owned()));
    text += &format!("|{}\n", "---|".repeat(head.len()));
    rows.into_iter().for_each(|row| text += &line(&mut row.into_iter()));
    text
}
