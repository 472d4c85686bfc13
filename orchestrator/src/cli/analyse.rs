//! `analyse`: tables of results from a database's finished trials.

use std::path::{Path, PathBuf};

use maud::html;
use serde_json::Value;

use super::named::Database;
use super::report::write_figures;
use super::{Error, Format, print_rows, write};
use crate::analysis::claims::{claims_table, evidence_table, is_other, tried};
use crate::analysis::compare::TrialPairs;
use crate::analysis::{DecisionTerms, Question, Trial};
use crate::exit::Exit;
use crate::look::page;
use crate::provenance;
use crate::reader::Reader;
use crate::report::claims::{figure, trials_table};
use crate::report::load::{finished_trials, verdicts};

/// Answers the questions of a sweep in tables: gain, sensors needed, complexity, time
///
/// Among them: whether the trained body is better, how many sensors are enough, and how the error depends on complexity and time.
///
/// `--question claims` rates the claims of arXiv:2605.23967: a claim holds, is compatible with the paper's number, holds in
/// part, makes no difference, fails, is open, or depends on the decoder. First run the specs that it names into
/// one database (run SPEC --db FILE). Trials of different settings (noise, damping, …) are rated separately. Trials with
/// chips or fewer channels, placed sensors, frozen or pressed units, custom bodies or another lattice count only for the
/// claims about random bodies.
#[derive(Debug, clap::Args)]
#[command(visible_alias = "analyze")]
pub(super) struct Args {
    /// The database, or a folder of shards: their facts
    #[arg(value_name = "DB|FOLDER")]
    db: PathBuf,
    /// Compares the trials of FIRST with those of the database, in pairs: ratios of errors and seconds, FIRST /
    /// database
    #[arg(long, value_name = "FIRST", conflicts_with_all = ["question", "within", "fall", "price"])]
    compare: Option<PathBuf>,
    /// Answers only this question; may be repeated [default: the verdicts in words, and all questions that the sweep can
    /// answer]
    #[arg(long, value_enum)]
    question: Vec<Question>,
    #[command(flatten)]
    terms: DecisionTerms,
    /// With --question claims: also writes both tables of the claims and the trials (CSV), the figure (SVG) and a page
    /// (index.html)
    #[arg(long, value_name = "DIR", requires = "question", help_heading = "Output")]
    out_dir: Option<PathBuf>,
    /// Format of the tables. JSON of several tables is an object of lists by question; CSV and Parquet hold one table
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    if let Some(first) = &args.compare {
        return compare(first, &args.db, args.format).await;
    }
    let all = args.question.is_empty();
    if matches!(args.format, Format::Csv | Format::Parquet) && (all || args.question.len() > 1) {
        return usage!("CSV and Parquet hold one table: choose it with --question");
    }
    let rates_claims = [Question::Claims, Question::Evidence].iter().any(|q| args.question.contains(q));
    if args.out_dir.is_some() && !rates_claims {
        return usage!("--out-dir: only for the claims; add --question claims");
    }
    let sentences = all && args.format == Format::Table;
    let (trials, verdicts, caveats) = Reader::with_reader(Database::at(&args.db).await?, async |reader| {
        let made = reader.code_versions().await?;
        let trials = finished_trials(reader).await?;
        let verdicts = if sentences { verdicts(reader, &trials, args.terms).await? } else { Vec::new() };
        Ok::<_, Error>((trials, verdicts, provenance::caveats(reader, &made).await?))
    })
    .await?;
    for verdict in &verdicts {
        print_line!("{}\n", verdict.text)?;
    }
    let mut questions = args.question.clone();
    if all {
        questions = Question::all().iter().copied().filter(|question| question.was_put(&trials)).collect();
    }
    let mut objects = Vec::new();
    for &question in &questions {
        let table = question.answer(&trials, args.terms);
        match args.format {
            Format::Json if all && table.rows.is_empty() => {}
            Format::Json if all || questions.len() > 1 => {
                let name = clap::ValueEnum::to_possible_value(&question).expect("none is hidden");
                let rows = String::from_utf8(table.written(Format::Json)).expect("JSON is text");
                objects.push(format!("{}: {}", Value::from(name.get_name()), rows.trim_end()));
            }
            Format::Table if all && table.rows.is_empty() => {}
            Format::Table => {
                print_line!("{}", question.title())?;
                match table.sole_verdict() {
                    _ if table.rows.is_empty() => {
                        print_line!("no finished trial of this database answers this question")?;
                    }
                    Some(verdict) => print_line!("{verdict}")?,
                    None => {
                        let shown = table.without_empty_columns();
                        print_rows(&shown, args.format)?;
                        let empty = table.columns.iter().filter(|c| !shown.columns.contains(c));
                        let empty: Vec<&str> = empty.map(String::as_str).collect();
                        if !empty.is_empty() {
                            print_line!("omitted columns without values: {}", empty.join(", "))?;
                        }
                    }
                }
                print_line!()?;
            }
            _ => print_rows(&table, args.format)?,
        }
    }
    if args.format == Format::Json && (all || questions.len() > 1) {
        print_line!("{{\n{}\n}}", objects.join(",\n"))?;
    }
    if let Some(folder) = &args.out_dir {
        write_claims(folder, &trials)?;
    }
    match trials.iter().filter(|trial| rates_claims && is_other(trial)).count() {
        0 => {}
        other => say!(
            "{} of {} trials have chips or fewer channels, placed sensors, frozen or pressed units, custom bodies or another \
             lattice. They differ from the paper's scenes and count only for the claims about random bodies",
            other,
            trials.len()
        ),
    }
    caveats.iter().for_each(|caveat| say!("{caveat}"));
    if trials.is_empty() {
        say!("no trial of {} is done yet", args.db.display());
    }
    Ok(Exit::Done)
}

/// Writes tables, trials, figure and page of the claims.
fn write_claims(folder: &Path, trials: &[Trial]) -> Result<(), Error> {
    let found = tried(trials);
    let [claims, evidence] = [claims_table(&found), evidence_table(&found)];
    let drawn: Vec<_> = figure(&found).into_iter().collect();
    write_figures(folder, &drawn)?;
    write(&folder.join("claims.csv"), claims.csv())?;
    write(&folder.join("evidence.csv"), evidence.csv())?;
    write(&folder.join("trials.csv"), trials_table(trials).csv())?;
    let content = html! {
        (claims.html(None))
        @for figure in &drawn { (figure.html(&[])) }
        h2 { "Evidence" }
        (evidence.html(Some("evidence")))
    };
    let question = "Do the claims of arXiv:2605.23967 hold, and with which decoder?";
    write(&folder.join("index.html"), page("The paper's claims", question, content))
}

async fn compare(first: &Path, second: &Path, format: Format) -> Result<Exit, Error> {
    let trials = async |path: &Path| {
        let db = Database::at(path).await?;
        Reader::with_reader(db, async |reader| Ok::<_, Error>(finished_trials(reader).await?)).await
    };
    let (a, b) = (trials(first).await?, trials(second).await?);
    let found = TrialPairs::new(&a, &b);
    let shown = |value: Option<&Value>| value.map_or("none".to_owned(), Value::to_string);
    for (path, [a, b]) in &found.differs {
        say!("{path}: {} in {}, {} in {}", shown(*a), first.display(), shown(*b), second.display());
    }
    let [a, b] = found.alone;
    say!(
        "{} pairs; without a partner: {a} of {}, {b} of {}",
        found.pairs.len(),
        first.display(),
        second.display()
    );
    if found.pairs.is_empty() {
        return usage!(
            "--compare {}: no finished trial has a partner in {}: partners must agree in all keys that vary in either database",
            first.display(),
            second.display()
        );
    }
    if format == Format::Table {
        print_line!(
            "Ratios first/second database over pairs of trials (above 1: the second value is lower): geometric means, 95 % intervals"
        )?;
    }
    print_rows(&found.table(), format)?;
    Ok(Exit::Done)
}
