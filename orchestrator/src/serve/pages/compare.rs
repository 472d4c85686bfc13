//! Two trials side by side, or two databases by pairs of trials.

use std::sync::Arc;

use axum::extract::{Path, State};
use axum::response::Html;
use maud::{Markup, html};
use serde_json::Value;

use super::trial::{Trial, curves};
use super::{Query, ServerState, framed, to_trial};
use crate::analysis::compare::TrialPairs;
use crate::analysis::setting::flatten;
use crate::cell::brief;
use crate::look::short_hash;
use crate::look::{Figure, Table, legend, number, row};
use crate::plan::counted;
use crate::reader::Reader;
use crate::report::body;
use crate::report::load::finished_trials;
use crate::serve::{PageError, file_of};

pub async fn page(
    State(served): State<Arc<ServerState>>,
    Path(at): Path<String>,
    // `a`, `b`; `trial` of each that is ticked; `with` of the other database
    Query(asked): Query<Vec<(String, String)>>,
) -> Result<Html<String>, PageError> {
    let given = |keys: &[&str]| -> Vec<&str> {
        let of = asked.iter().filter(|(key, _)| keys.contains(&&key[..])).map(|(_, value)| value.trim());
        of.filter(|value| !value.is_empty()).collect()
    };
    let hashes = given(&["a", "b", "trial"]);
    let other = given(&["with"]).first().map_or_else(|| at.clone(), |with| (*with).to_owned());
    let shown = match hashes[..] {
        [] if other != at => databases(&served, &at, &other).await,
        [a, b] => trials(&served, [&at, &other], [a, b]).await,
        _ => Ok(html! {
            p class="quiet" { "Tick two " a href="trials" { "trials" } ", or enter both, each by the beginning of its hash." }
        }),
    };
    let [a, b] = [0, 1].map(|i| hashes.get(i).copied().unwrap_or_default());
    let shown = match shown {
        Err(PageError::Asked(why)) => html! { p class="trouble" role="alert" { (why) } },
        other => other?,
    };
    let content = html! {
        form method="get" class="line" {
            label { "Trial " input name="a" value=(a) size="12" autocomplete="off" spellcheck="false"; }
            label { "with trial " input name="b" value=(b) size="12" autocomplete="off" spellcheck="false"; }
            @if served.sources.len() > 1 {
                label { "of " select name="with" {
                    @for (i, source) in served.sources.iter().enumerate() {
                        @let i = i.to_string();
                        option value=(i) selected[i == other] { (source.name) }
                    }
                } }
            }
            button { "Compare" }
        }
        @if served.sources.len() > 1 {
            p class="quiet" { "Without trials, two databases are compared. Trials that agree in all settings that vary within a database form pairs." }
        }
        (shown)
    };
    framed(&served, &at, "compare", "Compare", None, &content)
}

async fn databases(served: &ServerState, first: &str, second: &str) -> Result<Markup, PageError> {
    let _turn = served.questions.acquire().await.expect("it is never closed");
    let mut trials = Vec::new();
    for at in [first, second] {
        let db = file_of(served, at).await?;
        trials.push(Reader::with_reader(&db, async |reader| finished_trials(reader).await).await?);
    }
    let work = move || {
        let found = TrialPairs::new(&trials[0], &trials[1]);
        let text = |value: Option<&Value>| value.map_or("none".to_owned(), Value::to_string);
        let differs: Vec<_> =
            found.differs.iter().map(|(path, [a, b])| (path.to_string(), text(*a), text(*b))).collect();
        (found.pairs.len(), found.alone, differs, found.table())
    };
    let worked = tokio::task::spawn_blocking(work).await;
    let (pairs, alone, differs, table) = worked.map_err(|e| PageError::Asked(e.to_string()))?;
    Ok(html! {
        p role="status" { (counted(pairs, "pair")) "; without a partner: " (alone[0]) " and " (alone[1]) "." }
        @for (path, a, b) in &differs { p class="quiet" { (path) ": " (a) " and " (b) } }
        h2 { "Paired trials, first / second" }
        p class="quiet" { "Above 1, the second has the lower value. Geometric means with 95 % intervals." }
        (table.html(Some("comparison")))
    })
}

async fn trials(served: &ServerState, at: [&str; 2], hashes: [&str; 2]) -> Result<Markup, PageError> {
    let mut found = Vec::new();
    for (at, hash) in at.into_iter().zip(hashes) {
        let db = file_of(served, at).await?;
        found.push(Reader::with_reader(&db, async |reader| Trial::read(reader, hash).await).await?);
    }
    let [a, b] = [&found[0], &found[1]];
    let drawings: Vec<_> = [(a, "first"), (b, "second")]
        .into_iter()
        .flat_map(|(trial, who)| {
            let last = trial.drawings().pop();
            last.map(|(title, name, sketch)| (format!("{who}: {title}"), name, sketch))
        })
        .collect();
    let lines = [("initial", a.column("error_test")), ("optimised", b.column("error_test"))];
    let keys = legend(&[("initial", "first"), ("optimised", "second")]);
    let steps = |(who, trial): (&str, &Trial)| -> Vec<Vec<Value>> {
        trial.column("error_test").into_iter().map(|(step, error)| row![who, step, error]).collect()
    };
    let data = Table::new("trial step error_test", [("first", a), ("second", b)].into_iter().flat_map(steps));
    let errors = curves("Test error during training of the body", ["outer step", "test error (%)"], &lines);
    Ok(html! {
        p {
            "First: " a href=(to_trial(at[0], &a.hash)) { (short_hash(&a.hash)) } " (" (a.state) "); second: "
            a href=(to_trial(at[1], &b.hash)) { (short_hash(&b.hash)) } " (" (b.state) ")."
        }
        h2 { "Results" }
        (facts(a, b).html(Some("comparison")))
        h2 { "Settings that differ" }
        (differences(a, b).html(None))
        @if let Some(errors) = errors {
            (Figure::new("both", "Steps", "Test error after every outer step.", keys, vec![errors], data).html(&[]))
        }
        @if !drawings.is_empty() {
            (body::figure("body", "Bodies", "The bodies, drawn to one scale (mm).", &drawings).html(&[]))
        }
    })
}

fn facts(a: &Trial, b: &Trial) -> Table {
    let values = a.rows.facts.rows[0].iter().zip(&b.rows.facts.rows[0]);
    let rows = a.rows.facts.columns.iter().zip(values).filter(|(_, (a, b))| !a.is_null() || !b.is_null());
    let ratio = |a: &Value, b: &Value| match (a.as_f64(), b.as_f64()) {
        (Some(x), Some(y)) if (a.is_f64() || b.is_f64()) && y != 0.0 => Value::from(number(x / y)),
        _ => Value::Null,
    };
    let rows = rows.map(|(name, (a, b))| row![name.replace('_', " "), a, b, ratio(a, b)]);
    Table::new("what first second ratio", rows)
}

fn differences(a: &Trial, b: &Trial) -> Table {
    let [a, b] = [a, b].map(|trial| flatten(&serde_json::from_str(&trial.spec).unwrap_or_default()));
    let keys: std::collections::BTreeSet<&String> = a.keys().chain(b.keys()).collect();
    let text = |value: Option<&Value>| value.map_or(Value::Null, |value| brief(value).into());
    let rows = keys.into_iter().filter(|key| a.get(*key) != b.get(*key));
    Table::new("key first second", rows.map(|key| row![key, text(a.get(key)), text(b.get(key))]))
}
