//! The database: its version, its schema and its documented views.

use std::sync::LazyLock;

/// `PRAGMA application_id`: "mtsn".
pub const APPLICATION_ID: i32 = 0x6d74_736e;

/// `PRAGMA user_version` of the databases that this program reads and writes.
pub const VERSION: usize = 15;

/// SQL that creates the tables and views of this version in an empty file.
pub const SCHEMA: &str = include_str!("../schema.sql");

/// Position of the statement that creates a view.
fn start_of(view: &str) -> usize {
    SCHEMA.find(&format!("CREATE VIEW {view} AS")).expect("the schema creates the view")
}

/// SQL that creates one of the views.
///
/// # Panics
/// If there is no such view.
pub fn view_sql(view: &str) -> &'static str {
    let start = start_of(view);
    let end = SCHEMA[start..].find(';').expect("a statement ends");
    &SCHEMA[start..=start + end]
}

/// Names of the documented views.
const NAMES: [&str; 14] = [
    "v_trial",
    "v_step",
    "v_reading",
    "v_cast",
    "v_band",
    "v_under",
    "v_task",
    "v_network",
    "v_curve",
    "v_run",
    "v_attempt",
    "v_log",
    "v_artifact",
    "v_error_time",
];

/// The documented views, each with a description of its rows: the comment above the view in the schema.
pub static VIEWS: LazyLock<Vec<(&str, String)>> = LazyLock::new(|| {
    let description = |view: &str| {
        let lines: Vec<&str> =
            SCHEMA[..start_of(view)].lines().rev().map_while(|line| line.strip_prefix("-- ")).collect();
        lines.into_iter().rev().collect::<Vec<_>>().join(" ")
    };
    NAMES.into_iter().map(|view| (view, description(view))).collect()
});
