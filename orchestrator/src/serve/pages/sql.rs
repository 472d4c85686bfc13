//! Queries in SQL: rows on a page and as files, a plot of two columns, and the views.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::{Path, State};
use axum::http::header;
use axum::response::{Html, IntoResponse, Response};
use maud::{Markup, html};
use metasense_schemas::database::VIEWS;
use serde::Deserialize;
use serde_json::Value;

use super::{Query, ServerState, framed, query, trial_links};
use crate::look::{Axis, Format, Plot, Scale, Table, lines, prose};
use crate::plan::counted;
use crate::reader::{AnswerLimits, Reader};
use crate::serve::{PageError, file_of};

/// Limits of an answer on a page, and in a file.
const PAGE: AnswerLimits = AnswerLimits { rows: 1000, bytes: 2 << 20, time: Duration::from_secs(5) };
const FILE: AnswerLimits = AnswerLimits { rows: 200_000, bytes: 32 << 20, time: Duration::from_secs(20) };
/// The statement in the empty form.
const FIRST: &str = "SELECT sensors, avg(holdout_error_initial), avg(holdout_error_optimised), count(*)\nFROM v_trial WHERE state = 'done' GROUP BY 1";

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub struct SqlQuery {
    q: String,
    x: String,
    y: String,
}

pub async fn page(
    State(served): State<Arc<ServerState>>,
    Path(at): Path<String>,
    Query(asked): Query<SqlQuery>,
) -> Result<Html<String>, PageError> {
    let answer = match asked.q.trim() {
        "" => None,
        sql => Some(answer(&served, &at, sql, PAGE, false).await),
    };
    let shown = match answer {
        None => html! {},
        Some(Err(PageError::Asked(why))) => html! { p class="trouble" role="alert" { (why) } },
        Some(Err(refusal)) => return Err(refusal),
        Some(Ok(SqlAnswer { table, cut, .. })) => html! {
            p role="status" {
                (counted(table.rows.len(), "row")) @if let Some(why) = cut { "; incomplete: " (why) } ". As a file: "
                a href=(format!("sql.csv{}", query(&[("q", &asked.q)]))) download="answer.csv" { "CSV" } " "
                a href=(format!("sql.parquet{}", query(&[("q", &asked.q)]))) download="answer.parquet" { "Parquet" }
            }
            (plot(&asked, &table))
            div class="cells" { (table.linked(None, trial_links(&at))) }
        },
    };
    let text = if asked.q.is_empty() { FIRST } else { &asked.q };
    let content = html! {
        form method="get" id="ask" {
            label for="sql" { "One SQL statement; Ctrl-Enter runs it" }
            textarea id="sql" name="q" rows="6" spellcheck="false" autocomplete="off" data-ask { (text) }
            button { "Run" }
        }
        (shown)
        (views(&served, &at).await?)
    };
    framed(&served, &at, "sql", "SQL", None, &content)
}

/// An answer as a file. Refuses incomplete answers, because a file cannot show that it was cut.
pub async fn file(
    State(served): State<Arc<ServerState>>,
    Path(at): Path<String>,
    Query(asked): Query<SqlQuery>,
    format: Format,
    kind: &'static str,
) -> Result<Response, PageError> {
    let typed = format == Format::Parquet;
    let SqlAnswer { table, cut, types } = answer(&served, &at, &asked.q, FILE, typed).await?;
    format.check(&table.columns).map_err(PageError::Asked)?;
    if let Some(why) = cut {
        return Err(PageError::Asked(format!("{why}. For more, use `metasense query`.")));
    }
    let file = if typed { table.parquet(&types) } else { table.written(format) };
    Ok(([(header::CONTENT_TYPE, kind)], file).into_response())
}

struct SqlAnswer {
    table: Table,
    /// Why it is incomplete.
    cut: Option<String>,
    /// Declared types of the columns, if they were asked for.
    types: Vec<String>,
}

async fn answer(
    served: &ServerState,
    at: &str,
    sql: &str,
    limits: AnswerLimits,
    typed: bool,
) -> Result<SqlAnswer, PageError> {
    let db = file_of(served, at).await?;
    let turn = Arc::clone(&served.questions).acquire_owned().await.expect("it is never closed");
    let sql = sql.to_owned();
    // In a separate task: an abandoned statement keeps its permit until SQLite has ended it.
    let answering = tokio::spawn(async move {
        let mut reader = Reader::confined(&db).await?;
        let answer = reader.limited(&sql, limits).await;
        let types = if typed && answer.is_ok() { reader.types(&sql).await } else { Vec::new() };
        reader.close().await;
        drop(turn);
        answer.map(|(table, cut)| SqlAnswer { table, cut, types })
    });
    match tokio::time::timeout(2 * limits.time, answering).await {
        Ok(answered) => Ok(answered.unwrap_or_else(|panic| std::panic::resume_unwind(panic.into_panic()))?),
        Err(_) => Err(PageError::Asked("the statement took too long".into())),
    }
}

/// A plot of two numeric columns.
fn plot(asked: &SqlQuery, table: &Table) -> Markup {
    let numeric = |i: &usize| table.rows.iter().any(|row| row[*i].is_number());
    let columns: Vec<usize> = (0..table.columns.len()).filter(numeric).collect();
    if columns.len() < 2 {
        return html! {};
    }
    let named = |name: &str| columns.iter().copied().find(|i| table.columns[*i] == name);
    let choose = |label: &str, key: &str, chosen: &str| {
        html! {
            label { (label) " "
                select name=(key) {
                    option value="" { "–" }
                    @for &i in &columns {
                        option value=(table.columns[i]) selected[table.columns[i] == chosen] { (table.columns[i]) }
                    }
                }
            }
        }
    };
    let drawn = named(&asked.x).zip(named(&asked.y)).map(|(x, y)| {
        let point = |row: &Vec<Value>| row[x].as_f64().zip(row[y].as_f64());
        let points: Vec<(f64, f64)> = table.rows.iter().filter_map(point).collect();
        let axis = |i: usize, values: Vec<f64>| Axis::new(&table.columns[i], Scale::Linear, values);
        let [xs, ys] = [points.iter().map(|p| p.0).collect(), points.iter().map(|p| p.1).collect()];
        let title = format!("{} against {}", table.columns[y], table.columns[x]);
        let mut plot = Plot::new(&title, axis(x, xs), axis(y, ys)).sized(640.0, 320.0);
        plot.dots("optimised", points.into_iter().map(|p| (p, format!("{}, {}", p.0, p.1))));
        plot.picture().svg(None)
    });
    html! {
        form method="get" class="line" {
            input type="hidden" name="q" value=(asked.q);
            (choose("Plot", "y", &asked.y)) (choose("against", "x", &asked.x))
            button { "Draw" }
        }
        @if let Some(drawn) = drawn { div class="plots one" { div { (drawn) } } }
    }
}

/// Columns of a view to select: all, but only the length of arrays.
fn shown(columns: &[String]) -> String {
    match columns.iter().position(|column| column == "bytes") {
        Some(at) => {
            [&columns[..at], &["length(bytes) AS bytes".to_owned()], &columns[at + 1..]].concat().join(", ")
        }
        None => "*".into(),
    }
}

/// The views for users, with their columns.
async fn views(served: &ServerState, at: &str) -> Result<Markup, PageError> {
    let db = file_of(served, at).await?;
    let mut reader = Reader::confined(&db).await?;
    let mut columns = Vec::new();
    for (view, _) in VIEWS.iter() {
        columns.push(reader.columns(&format!("SELECT * FROM {view}")).await?);
    }
    reader.close().await;
    Ok(html! {
        h2 { "Views" }
        dl class="views" {
            @for ((view, what), columns) in VIEWS.iter().zip(&columns) {
                dt { a href=(query(&[("q", &format!("SELECT {} FROM {view} LIMIT 100", shown(columns)))])) { (view) } }
                dd { (prose(&format!("A row is {}. ", lines(what, usize::MAX).join(" ")))) span class="quiet" { (columns.join(", ")) } }
            }
        }
    })
}
