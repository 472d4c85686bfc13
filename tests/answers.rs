//! `analyse` finds in a database what was put into it.

mod synthetic;

use std::path::Path;
use std::process::Command;

use serde_json::Value;

fn metasense(db: &Path, args: &[&str]) -> (bool, String, String) {
    let out =
        Command::new(env!("CARGO_BIN_EXE_metasense")).arg(args[0]).arg(db).args(&args[1..]).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (out.status.success(), text(out.stdout), text(out.stderr))
}

fn database() -> (tempfile::TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("synthetic.sqlite");
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(synthetic::fill(&db));
    (folder, db)
}

/// Rows of an answer that agree with all pairs.
fn rows<'a>(answers: &'a Value, question: &str, pairs: &[(&str, &str)]) -> Vec<&'a Value> {
    let agrees = |row: &&Value| pairs.iter().all(|(k, v)| row[k].as_str().is_some_and(|s| s.starts_with(v)));
    answers[question].as_array().unwrap_or_else(|| panic!("no {question}")).iter().filter(agrees).collect()
}

#[test]
fn analyse_finds_what_was_put_into_the_database() {
    let (_folder, db) = database();
    let (ok, out, err) = metasense(&db, &["analyse", "--format", "json"]);
    assert!(ok, "{err}");
    let answers: Value = serde_json::from_str(&out).unwrap();

    // The optimised body's error falls to M = 2 and no further; the initial one's falls evenly.
    let elbows = |body| rows(&answers, "elbow", &[("setting", "K = 4"), ("body", body), ("set", "holdout")]);
    assert_eq!(elbows("optimised")[0]["verdict"], "elbow at M = 2", "{:#?}", answers["elbow"]);
    assert_eq!(elbows("initial")[0]["verdict"], "no elbow", "{:#?}", answers["elbow"]);

    // 28·0.93⁶ = 18.1 % with six sensors; 28·e^−0.74 = 13.4 % with one.
    let fewer = rows(&answers, "fewer", &[("setting", "K = 4"), ("set", "test")]);
    assert_eq!(
        (&fewer[0]["initial_sensors"], &fewer[0]["optimised_sensors"]),
        (&Value::from(6), &Value::from(1))
    );

    let law = rows(&answers, "complexity", &[("setting", "K = 2"), ("body", "optimised"), ("set", "test")]);
    let (low, high) = (law[0]["b_low"].as_f64().unwrap(), law[0]["b_high"].as_f64().unwrap());
    assert!(low < 0.7 && 0.7 < high, "{:#?}", law[0]);

    // The optimised body's curve is a quarter of the initial one's: a factor 4^(1/0.6) = 10.1 in iterations.
    let iterations = |by| rows(&answers, "iterations", &[("setting", "K = 4, M = 1,"), ("to_equal", by)]);
    let ratio = iterations("training loss")[0]["ratio"].as_f64().unwrap();
    assert!((ratio / 10.08 - 1.0).abs() < 0.02, "{:#?}", iterations("training loss")[0]);
    // Errors fall with the root of the iterations, so by the square of 28·0.93 over 28·e^−0.74; known at some 200 of 1000.
    let ratio = iterations("holdout error")[0]["ratio"].as_f64().unwrap();
    let truth = (0.93 / (-0.74f64).exp()).powi(2);
    assert!((ratio / truth - 1.0).abs() < 0.04, "{truth}: {:#?}", iterations("holdout error")[0]);

    // 30 % and the law's 15.0 % at 168 parameters, noise of 3 % apart.
    let random = rows(&answers, "random", &[("setting", "K = 2, M = 1"), ("set", "test")]);
    assert_eq!((random.len(), &random[0]["bodies"]), (1, &Value::from(3)), "{:#?}", answers["random"]);
    for (column, truth) in
        [("over_initial", 1.5), ("over_optimised", 45.0 / (20.0 * 1.68f64.powf(-0.7) + 3.0))]
    {
        let ratio = random[0][column].as_f64().unwrap();
        assert!((ratio / truth - 1.0).abs() < 0.04, "{column} {truth}: {:#?}", random[0]);
    }

    let long = rows(&answers, "long", &[("setting", "K = 2, M = 1, 6 × 6")]);
    let ratio = |rows: &[&Value]| rows[0]["ratio"].as_f64().unwrap();
    let ordinary =
        ratio(&rows(&answers, "paired", &[("setting", "K = 2, M = 1, 6 × 6 units"), ("set", "test")]));
    assert_eq!((long.len(), &long[0]["iterations"]), (2, &Value::from(2000)), "{:#?}", answers["long"]);
    assert!((ratio(&long) / ordinary / 2.5 - 1.0).abs() < 1e-6, "{ordinary} {:#?}", long[0]);

    let paired = rows(&answers, "paired", &[("setting", "K = 4, M = 2,"), ("set", "holdout")]);
    let truth = 0.93f64.powi(2) / (-1.48f64).exp();
    assert!((paired[0]["ratio"].as_f64().unwrap() / truth - 1.0).abs() < 1e-6, "{:#?}", paired[0]);
}

#[test]
fn csv_holds_one_table_and_says_so() {
    let (_folder, db) = database();
    let (ok, _, err) = metasense(&db, &["analyse", "--format", "csv"]);
    assert!(!ok && err.contains("--question"), "{err}");
    let (ok, out, err) = metasense(&db, &["analyse", "--format", "csv", "--question", "elbow"]);
    assert!(ok && out.starts_with("setting,body,set,verdict,"), "{out}{err}");
}

/// What a browser would fetch, and what the page must say.
#[test]
fn a_report_is_one_file_that_needs_nothing_else() {
    let (folder, db) = database();
    let (page, figures) = (folder.path().join("r.html"), folder.path().join("figures"));
    let (ok, _, err) =
        metasense(&db, &["report", "--out", page.to_str().unwrap(), "--figures", figures.to_str().unwrap()]);
    assert!(ok, "{err}");
    let html = std::fs::read_to_string(&page).unwrap();
    for fetched in ["src=", "<link", "@import", "url(", "fetch("] {
        assert!(!html.contains(fetched), "the page fetches by {fetched}");
    }
    let links = html.matches("href=").count();
    assert_eq!(links, html.matches("href=\"data:text/csv").count(), "every link is a download");
    for name in [
        "pairs",
        "sensors",
        "random",
        "forces",
        "samples",
        "bodies",
        "waves",
        "losses",
        "complexity",
        "run_time",
    ] {
        assert!(html.contains(&format!("<h2 id=\"{name}\">")), "no figure {name}");
        assert!(figures.join(format!("{name}.csv")).is_file(), "no data of {name}");
    }
    for said in [
        "elbow at M = 2",
        "3 random bodies have 1.",
        "After 2000 iterations",
        "no elbow",
        "non_finite: sample 3",
        "# made-up trials",
        "1 failed",
    ] {
        assert!(html.contains(said), "the page does not say {said}");
    }
    for name in ["answer-elbow.csv", "trials.csv", "synthetic.toml"] {
        assert!(figures.join(name).is_file(), "no {name}");
    }
    let figure = std::fs::read_to_string(figures.join("sensors.svg")).unwrap();
    assert!(figure.starts_with("<svg xmlns") && figure.contains("<style>"), "{}", &figure[..200]);
}
