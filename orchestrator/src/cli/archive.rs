//! `archive`: writes a folder for publication with everything needed to reproduce the results of a database.

use std::collections::BTreeMap;
use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::named::Database;
use super::report::{file_names, write_parts};
use super::{Error, cores, make_folder, write};
use crate::analysis::DecisionTerms;
use crate::analysis::numbers::in_order;
use crate::cluster::merge::{Extent, merge};
use crate::exit::Exit;
use crate::look::{Format, Table};
use crate::plan::counted;
use crate::reader::Reader;
use crate::report::{ReportData, figures, html, load};
use metasense_source::each_file;

/// Writes a folder with everything needed to reproduce results, for a data repository
///
/// The folder has the specs, the database, trials, answers and figures, the report, code and machines of all trials, a README with
/// the commands that re-run the sweep and compare every bit, and an RO-Crate 1.1 manifest with the SHA-256 of each file.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The database, or a folder of shards
    #[arg(value_name = "DB|FOLDER")]
    db: PathBuf,
    /// The folder to write; it must be new or empty
    #[arg(value_name = "DIR")]
    dir: PathBuf,
}

const DATABASE: &str = "results.sqlite";
const REPORT: &str = "report.html";
const PROVENANCE: &str = "provenance.json";
const README: &str = "README.md";
const MANIFEST: &str = "ro-crate-metadata.json";
/// Folder of specs, figures with their data, answers and trials.
const RESULTS: &str = "results";

/// Code and machines that computed the results.
const MADE: &str = "SELECT version, code, revision, rustc, cpu, simd, threads, count(DISTINCT trial_id) AS trials,
    min(started_at) AS first, max(ended_at) AS last FROM attempt WHERE NOT redone AND state = 'done' GROUP BY 1, 2, 3, 4, 5, 6, 7
  ORDER BY trials DESC, 1, 2, 3, 4, 5, 6, 7";

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let Args { db, dir } = &args;
    if std::fs::read_dir(dir).is_ok_and(|mut entries| entries.next().is_some()) || dir.is_file() {
        return usage!("{}: must be a new or an empty folder", dir.display());
    }
    let asked = async |reader: &mut Reader| {
        let story = load::story(reader, None, DecisionTerms::default()).await?;
        Ok::<_, Error>((story, reader.query::<Table>(MADE).await?))
    };
    let (story, made) = Reader::with_reader(Database::at(db).await?, asked).await?;
    if made.rows.is_empty() {
        return usage!("{} contains no finished trial", db.display());
    }
    let names = file_names(story.sweeps.iter().map(|sweep| sweep.name.as_str()));
    let open = story.states.all - story.states.done - story.states.failed;
    if open > 0 {
        say!("warning: {} not finished; `metasense run` resumes them", counted(open, "trial"));
    }
    make_folder(dir)?;
    let (drawn, missing) = figures(&story, cores());
    let results = dir.join(RESULTS);
    write_parts(&results, &story, &drawn)?;
    for (sweep, name) in story.sweeps.iter().zip(&names) {
        write_spec_files(&results, name, &names, &sweep.text)?;
    }
    merge(Extent::Whole, std::slice::from_ref(db), &dir.join(DATABASE)).await?;
    write(&dir.join(PROVENANCE), made.written(Format::Json))?;
    write(&dir.join(README), readme(&story, &names, &made))?;
    let title = in_order(story.sweeps.iter().map(|sweep| sweep.name.as_str())).join(", ");
    write(&dir.join(REPORT), html(story, &drawn, missing.as_deref()))?;
    write(&dir.join(MANIFEST), manifest(dir, &title, &names, &made)?)?;
    print_line!("{}", dir.display())?;
    Ok(Exit::Done)
}

/// Writes the spec `name` and copies of the files that it names by absolute path; the spec refers to the copies. `specs` are the
/// names of all specs. Warns about missing files.
fn write_spec_files(folder: &Path, name: &str, specs: &[String], text: &str) -> Result<(), Error> {
    let mut copies = BTreeMap::<String, String>::new();
    for file in files_of(text) {
        let path = Path::new(&file);
        match path.file_name().filter(|_| path.is_absolute() && path.is_file()) {
            Some(_) if copies.contains_key(&file) => {}
            Some(last) => {
                let copy = free_name(folder, specs, &format!("{name}-{}", last.to_string_lossy()));
                write(&folder.join(&copy), std::fs::read(path).map_err(Error::unreadable(path))?)?;
                copies.insert(file, copy);
            }
            None => say!("warning: {name}.toml reads {file}: add this file to {}", folder.display()),
        }
    }
    write(&folder.join(format!("{name}.toml")), refer_to(&copies, text))
}

/// The name, with a number before its ending if the folder contains or will contain a file of this name.
fn free_name(folder: &Path, specs: &[String], name: &str) -> String {
    let is_spec = |name: &str| name.strip_suffix(".toml").is_some_and(|name| specs.iter().any(|s| s == name));
    let at = name.rfind('.').unwrap_or(name.len());
    let numbered = (2..).map(|n| format!("{}-{n}{}", &name[..at], &name[at..]));
    let mut all = std::iter::once(name.to_owned()).chain(numbered);
    let free = all.find(|name| !is_spec(name) && !folder.join(name).exists());
    free.expect("numbers do not end")
}

/// The text of a spec with the names of copies in place of those of their files.
fn refer_to(copies: &BTreeMap<String, String>, text: &str) -> String {
    fn strings(value: &Spanned<DeValue<'_>>, found: &mut Vec<(Range<usize>, String)>) {
        match value.get_ref() {
            DeValue::Table(table) => table.values().for_each(|value| strings(value, found)),
            DeValue::Array(values) => values.iter().for_each(|value| strings(value, found)),
            DeValue::String(text) => found.push((value.span(), text.to_string())),
            _ => {}
        }
    }
    let mut found = Vec::new();
    if !copies.is_empty() {
        let table = DeTable::parse(text).expect("its files were found");
        table.get_ref().values().for_each(|value| strings(value, &mut found));
    }
    // from the last, so that the places of the others stay
    found.sort_by_key(|(place, _)| std::cmp::Reverse(place.start));
    let mut own = text.to_owned();
    for (place, file) in found {
        if let Some(copy) = copies.get(&file) {
            own.replace_range(place, &toml::Value::from(copy.as_str()).to_string());
        }
    }
    own
}

/// Files that a spec names.
fn files_of(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    if let Ok(mut table) = text.parse::<toml::Table>() {
        each_file(&mut table, &mut |file| found.push(file.clone()));
    }
    found
}

/// The different values of a column, those of most trials first.
fn different<'a>(made: &'a Table, column: &str) -> Vec<&'a str> {
    let column = made.column(column);
    in_order(made.rows.iter().map(|row| row[column].as_str().unwrap_or("unknown")))
}

/// End of the last trial.
fn last_end(made: &Table) -> &str {
    different(made, "last").into_iter().max().unwrap_or("unknown")
}

fn readme(story: &ReportData, names: &[String], made: &Table) -> String {
    let [version, code, revision, simd] =
        ["version", "code", "revision", "simd"].map(|key| different(made, key));
    let several = code.len() + simd.len() > 2;
    let mut text = format!(
        "# {}\n\nResults of [metasense]({MANIFEST}) {}, code {}, commit {}, instruction set {}: {}, {} of them finished. Before you \
         publish this folder, add authors and a licence to `{MANIFEST}`.\n\n\
         | file | contents |\n|---|---|\n\
         | `{REPORT}` | answers and figures |\n\
         | `{RESULTS}/` | specs (TOML), trials and answers (CSV), figures (SVG) with their data (CSV) |\n\
         | `{DATABASE}` | all rows (SQLite); `metasense query {DATABASE}` lists the views |\n\
         | `{PROVENANCE}` | code, compiler, processor and instruction set of all finished trials |\n\
         | `{MANIFEST}` | RO-Crate 1.1: every file with its SHA-256 |\n\n## Run it again\n\n\
         The same code gives the same bits with the same instruction set and C library. The last command compares each trial and ends \
         with exit code 1 if any bit differs.\n\n",
        names.join(", "),
        version.join(", "),
        code.join(", "),
        revision.join(", "),
        simd.join(", "),
        counted(story.states.all, "trial"),
        story.states.done
    );
    if several {
        text += &format!(
            "Several codes or instruction sets computed these trials (`{PROVENANCE}`). Trials of others than yours may differ.\n\n"
        );
    }
    let set = match simd[..] {
        [one] if one != "unknown" => format!(" --simd {one}"),
        _ => String::new(),
    };
    for name in names {
        text += &format!("    metasense run {RESULTS}/{name}.toml{set} --db again.sqlite\n");
    }
    text + &format!("    metasense cluster merge {DATABASE} again.sqlite --out both.sqlite\n")
}

/// Appends the paths of all files in `folder` and its subfolders, each with the prefix `below`, and sorts them.
fn contents(folder: &Path, below: &str, found: &mut Vec<String>) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let name = format!("{below}{}", entry.file_name().to_string_lossy());
        match entry.file_type()?.is_dir() {
            true => contents(&entry.path(), &format!("{name}/"), found)?,
            false => found.push(name),
        }
    }
    found.sort();
    Ok(())
}

/// The manifest (RO-Crate 1.1) of the files that are now in a folder.
fn manifest(dir: &Path, title: &str, names: &[String], made: &Table) -> Result<String, Error> {
    let failed = Error::io("reading", dir);
    let mut files = Vec::new();
    contents(dir, "", &mut files).map_err(&failed)?;
    let refers = |name: &String| json!({ "@id": name });
    let mut graph = vec![
        json!({ "@id": MANIFEST, "@type": "CreativeWork", "about": { "@id": "./" },
            "conformsTo": { "@id": "https://w3id.org/ro/crate/1.1" } }),
        json!({ "@id": "./", "@type": "Dataset", "name": format!("metasense: {title}"),
            "description": "Bodies of metamaterial sensors, trained together with their decoders",
            "datePublished": last_end(made), "mentions": { "@id": "#run" },
            "hasPart": files.iter().map(refers).collect::<Vec<_>>() }),
        json!({ "@id": "#metasense", "@type": "SoftwareApplication", "name": "metasense",
            "softwareVersion": different(made, "version").join(", "), "identifier": different(made, "code").join(", ") }),
        json!({ "@id": "#run", "@type": "CreateAction", "name": "metasense run", "instrument": { "@id": "#metasense" },
            "endTime": last_end(made), "result": { "@id": DATABASE },
            "object": names.iter().map(|name| refers(&format!("{RESULTS}/{name}.toml"))).collect::<Vec<_>>() }),
    ];
    for name in &files {
        let (mut file, mut digest) = (File::open(dir.join(name)).map_err(&failed)?, Sha256::new());
        let size = std::io::copy(&mut file, &mut digest).map_err(&failed)?;
        let digest: String = digest.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
        let format = match Path::new(name).extension().and_then(|ending| ending.to_str()) {
            Some("csv") => "text/csv",
            Some("html") => "text/html",
            Some("json") => "application/json",
            Some("md") => "text/markdown",
            Some("sqlite") => "application/vnd.sqlite3",
            Some("svg") => "image/svg+xml",
            Some("toml") => "application/toml",
            _ => "application/octet-stream",
        };
        graph.push(json!({ "@id": name, "@type": "File", "encodingFormat": format,
            "contentSize": size.to_string(), "sha256": digest }));
    }
    let crate_ = json!({ "@context": ["https://w3id.org/ro/crate/1.1/context",
        { "sha256": "https://w3id.org/ro/terms/workflow-run#sha256" }], "@graph": Value::Array(graph) });
    Ok(serde_json::to_string_pretty(&crate_).expect("JSON") + "\n")
}

#[cfg(test)]
mod tests;
