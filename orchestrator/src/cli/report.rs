//! `report`: writes answers and figures into one HTML file.

use std::path::{Path, PathBuf};

use clap::ValueEnum;

use super::named::{Database, word};
use super::{Error, cores, make_folder, print_path, write};
use crate::analysis::{DecisionTerms, Question};
use crate::exit::Exit;
use crate::look::{Figure, Legend, Picture, file};
use crate::reader::Reader;
use crate::report::{ReportData, figures, html, load};

/// Writes the answers and figures of a database into one HTML file
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The database, or a folder of shards: their facts
    #[arg(value_name = "DB|FOLDER")]
    db: PathBuf,
    /// The trial whose forces, bodies and waves are shown, by its hash or the beginning of it [default: the design of a
    /// search, else a typical trial]
    #[arg(value_parser = word)]
    hash: Option<String>,
    /// File to write; by default beside the database
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    out: Option<PathBuf>,
    /// Also writes each figure (SVG) with its data, each answer and the trials (CSV), and the specs into this folder
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    out_dir: Option<PathBuf>,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let asked =
        async |reader: &mut Reader| load::story(reader, args.hash.as_deref(), DecisionTerms::default()).await;
    let story = Reader::with_reader(Database::at(&args.db).await?, asked).await?;
    let (drawn, missing) = figures(&story, cores());
    let out = args.out.unwrap_or_else(|| args.db.with_extension("html"));
    if let Some(folder) = &args.out_dir {
        write_parts(folder, &story, &drawn)?;
        let names = file_names(story.sweeps.iter().map(|s| s.name.as_str()));
        for (sweep, name) in story.sweeps.iter().zip(names) {
            write(&folder.join(format!("{name}.toml")), &sweep.text)?;
        }
    }
    write(&out, html(story, &drawn, missing.as_deref()))?;
    print_path(&out)?;
    if let Some(folder) = &args.out_dir {
        print_line!("{}", folder.display())?;
    }
    Ok(Exit::Done)
}

/// Writes figures, answers and trials.
pub(super) fn write_parts(folder: &Path, story: &ReportData, drawn: &[Figure]) -> Result<(), Error> {
    write_figures(folder, drawn)?;
    for question in Question::all() {
        let table = question.answer(&story.trials, story.terms);
        if !table.rows.is_empty() && question.was_put(&story.trials) {
            let name = question.to_possible_value().expect("none is hidden");
            write(&folder.join(format!("answer-{}.csv", name.get_name())), table.csv())?;
        }
    }
    write(&folder.join("trials.csv"), &story.states.csv)
}

/// Distinct and safe file names for sweeps, whose names in a database are arbitrary.
pub(super) fn file_names<'a>(names: impl Iterator<Item = &'a str>) -> Vec<String> {
    let mut taken: Vec<String> = Vec::new();
    for name in names {
        let harmless = |(i, c): (usize, char)| c.is_alphanumeric() || "-_".contains(c) || i > 0 && c == '.';
        let safe = name.chars().take(100).enumerate().map(|c| if harmless(c) { c.1 } else { '_' });
        let safe = safe.collect::<String>();
        let numbered = (2..).map(|n| format!("{safe}-{n}"));
        let free = std::iter::once(safe.clone()).chain(numbered).find(|name| !taken.contains(name));
        taken.push(free.expect("numbers do not end"));
    }
    taken
}

/// Width of a figure's file (px).
const WIDTH: f64 = 440.0;

/// Writes every figure with its data into a folder; creates the folder if it is missing.
pub(super) fn write_figures(folder: &Path, drawn: &[Figure]) -> Result<(), Error> {
    make_folder(folder)?;
    for figure in drawn {
        // legend entries that occur in the picture
        let own = |p: &Picture| -> Legend {
            figure.legend.iter().filter(|(key, _)| p.shows(key)).cloned().collect()
        };
        let files = figure.pictures.iter().map(|p| file(std::slice::from_ref(p), 1, WIDTH, &own(p)));
        for (i, svg) in files.enumerate() {
            let number = if figure.pictures.len() > 1 { format!("-{}", i + 1) } else { String::new() };
            write(&folder.join(format!("{}{number}.svg", figure.name)), svg)?;
        }
        write(&folder.join(format!("{}.csv", figure.name)), &figure.data)?;
    }
    Ok(())
}
