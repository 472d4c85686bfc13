//! `analyse` recovers the effects that were put into a database.

use std::path::Path;
use std::process::Command;

use crate::synthetic;
use serde_json::Value;

fn metasense(db: &Path, args: &[&str]) -> (bool, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_metasense"));
    let out = command.args(args[0].split(' ')).arg(db).args(&args[1..]).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (out.status.success(), text(out.stdout), text(out.stderr))
}

fn database() -> (tempfile::TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("synthetic.sqlite");
    synthetic::write(&db);
    (folder, db)
}

/// Rows of an answer that agree with all pairs of column and beginning of the value.
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

    // The trained body's error falls until M = 2 and no further; the initial body's falls evenly.
    let elbows = |body| rows(&answers, "elbow", &[("setting", "K = 4"), ("body", body), ("set", "holdout")]);
    for (height, verdicts) in
        [("in %", ["elbow at M = 2", "no elbow"]), ("in logarithms", ["elbow at M = 2", "no elbow"])]
    {
        for (body, verdict) in ["optimised", "initial"].into_iter().zip(verdicts) {
            let found: Vec<&Value> = elbows(body).into_iter().filter(|row| row["height"] == height).collect();
            assert_eq!(found[0]["verdict"], verdict, "{height}: {:#?}", answers["elbow"]);
        }
    }

    // 28·0.93⁶ = 18.1 % with six sensors; 28·e^−0.74 = 13.4 % with one.
    let fewer = rows(&answers, "fewer", &[("setting", "K = 4"), ("set", "test")]);
    assert_eq!(
        (&fewer[0]["initial_sensors"], &fewer[0]["optimised_sensors"]),
        (&Value::from(6), &Value::from(1))
    );

    let law = rows(&answers, "complexity", &[("setting", "K = 2"), ("body", "optimised"), ("set", "test")]);
    let (low, high) = (law[0]["b_low"].as_f64().unwrap(), law[0]["b_high"].as_f64().unwrap());
    assert!(low < 0.7 && 0.7 < high, "{:#?}", law[0]);

    // The trained body's curve is a quarter of the initial body's: a factor 4^(1/0.6) = 10.1 in iterations.
    let iterations = |by| rows(&answers, "iterations", &[("setting", "K = 4, M = 1,"), ("to_equal", by)]);
    let ratio = iterations("training loss")[0]["ratio"].as_f64().unwrap();
    assert!((ratio / 10.08 - 1.0).abs() < 0.02, "{:#?}", iterations("training loss")[0]);
    // Errors fall with the root of the iterations, so the ratio is the square of 28·0.93 over 28·e^−0.74. About 200 of 1000
    // iterations are stored.
    let ratio = iterations("holdout error")[0]["ratio"].as_f64().unwrap();
    let truth = (0.93 / (-0.74f64).exp()).powi(2);
    assert!((ratio / truth - 1.0).abs() < 0.04, "{truth}: {:#?}", iterations("holdout error")[0]);

    // Errors of 30 % and, by the law, 15.0 % at 168 parameters, with a noise of 3 %.
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

/// Without a question, the report's verdicts come first, then one table per question that the trials can answer.
#[test]
fn analyse_begins_with_the_verdicts_of_the_report() {
    let (folder, db) = database();
    let (ok, out, err) = metasense(&db, &["analyse"]);
    assert!(ok, "{err}");
    let page = folder.path().join("r.html");
    let (ok, _, err) = metasense(&db, &["report", "--out", page.to_str().unwrap()]);
    assert!(ok, "{err}");
    let html = std::fs::read_to_string(&page).unwrap().replace('\u{a0}', " ");
    let first = out.lines().next().unwrap();
    assert!(first.contains("the error of the initial body is") && html.contains(&first[..40]), "{first}");
    assert!(!out.contains("The claims of"), "{out}");
}

/// 28·e^(−0.7·min(M, 2) − 0.04·M): 6.4 % at M = 2. Each further sensor brings 4 %: M = 4 is 8 % better, but dearer at a price of 1
/// % per sensor.
#[test]
fn how_many_sensors_to_build_hangs_on_their_price() {
    let (_folder, db) = database();
    let asked = ["analyse", "--question", "elbow", "--format", "json", "--price", "1"];
    let (ok, out, err) = metasense(&db, &asked);
    assert!(ok, "{err}");
    let answers: Value = serde_json::from_str(&format!("{{\"elbow\": {out}}}")).unwrap();
    let found =
        rows(&answers, "elbow", &[("setting", "K = 4"), ("body", "optimised"), ("set", "holdout")])[0];
    for (column, m) in
        [("within", 4), ("within_without_largest", 3), ("price", 2), ("price_without_largest", 2)]
    {
        assert_eq!(found[column], Value::from(m), "{column}: {found:#}");
    }
    assert!(found["price_votes"].as_f64().unwrap() > 0.95 && found["over"] == "5 placements", "{found:#}");
    let (ok, sentences, err) = metasense(&db, &["analyse", "--price", "1"]);
    assert!(ok, "{err}");
    for said in [
        "smallest M within 10 % of the best: trained body M = 4 (",
        "smallest error + 1 % × M: trained body M = 2 (",
    ] {
        assert!(sentences.contains(said), "{said}: {sentences}");
    }
    let (ok, _, err) = metasense(&db, &["analyse", "--price", "cheap"]);
    assert!(!ok && err.contains("cheap") && err.contains("--price"), "{err}");
}

/// A database compared with itself: every trial has its partner and every ratio is 1. The message names a missing database.
#[test]
fn a_database_is_compared_with_another() {
    let (_folder, db) = database();
    let (ok, out, err) = metasense(&db, &["analyse", "--compare", db.to_str().unwrap(), "--format", "json"]);
    assert!(ok && err.contains("0 of"), "{err}");
    let rows: Vec<Value> = serde_json::from_str(&out).unwrap();
    assert!(rows.len() > 10 && rows.iter().all(|row| row["ratio"] == 1.0), "{out}");
    assert_eq!(rows[0]["setting"], "all");
    let (ok, _, err) = metasense(&db, &["analyse", "--compare", "nowhere.sqlite"]);
    assert!(!ok && err.contains("nowhere.sqlite"), "{err}");
}

#[test]
fn csv_holds_one_table_and_says_so() {
    let (_folder, db) = database();
    let (ok, _, err) = metasense(&db, &["analyse", "--format", "csv"]);
    assert!(!ok && err.contains("--question"), "{err}");
    let (ok, out, err) = metasense(&db, &["analyse", "--format", "csv", "--question", "elbow"]);
    assert!(ok && out.starts_with("setting,body,set,height,verdict,"), "{out}{err}");
}

/// Checks that the page requests nothing, and its contents.
#[test]
fn a_report_is_one_file_that_needs_nothing_else() {
    let (folder, db) = database();
    let (page, figures) = (folder.path().join("r.html"), folder.path().join("figures"));
    let (ok, _, err) =
        metasense(&db, &["report", "--out", page.to_str().unwrap(), "--out-dir", figures.to_str().unwrap()]);
    assert!(ok, "{err}");
    let html = std::fs::read_to_string(&page).unwrap();
    for fetched in ["src=", "<link", "@import", "url(", "fetch("] {
        assert!(!html.contains(fetched), "the page fetches by {fetched}");
    }
    let links = html.matches("href=").count();
    let [downloads, within] = ["data:text/csv", "#"].map(|to| html.matches(&format!("href=\"{to}")).count());
    assert_eq!(links, downloads + within, "every link is a download or leads to a figure");
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
    assert!(!html.contains("id=\"casts\""), "a figure of casts, of which there are none");
    for said in [
        "elbow at M = 2",
        "the held-out error of 3 random bodies is 1.",
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
    let trials = std::fs::read_to_string(figures.join("trials.csv")).unwrap();
    let head: Vec<&str> = trials.lines().next().unwrap().split(',').collect();
    for column in ["linear_holdout_error_optimised", "body.columns"] {
        assert!(head.contains(&column), "no column {column} in {head:?}");
    }
    let figure = std::fs::read_to_string(figures.join("sensors.svg")).unwrap();
    assert!(figure.starts_with("<svg xmlns") && figure.contains("<style>"), "{}", &figure[..200]);
}

/// Names of sweeps are arbitrary: no file leaves the folder, and none replaces another.
#[test]
fn figures_stay_in_their_folder_whatever_sweeps_are_called() {
    let (folder, db) = database();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let mut store = metasense::store::Store::open(&db).await.unwrap();
        for (name, text) in [
            ("../../up", "a"),
            ("..", "b"),
            ("x/y", "c"),
            ("x y", "d"),
            ("same", "e"),
            ("same", "f"),
            ("same-2", "g"),
        ] {
            let spec = synthetic::sweep_named(name);
            store.begin_sweep(&spec, text, &[]).await.unwrap();
        }
        store.close().await.unwrap();
    });
    let (inner, page) = (folder.path().join("a/b/figures"), folder.path().join("r.html"));
    let to = |path: &Path| path.to_str().unwrap().to_owned();
    let (ok, _, err) = metasense(&db, &["report", "--out", &to(&page), "--out-dir", &to(&inner)]);
    assert!(ok, "{err}");
    let mut texts: Vec<String> = std::fs::read_dir(&inner)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "toml"))
        .map(|path| std::fs::read_to_string(path).unwrap())
        .collect();
    texts.sort();
    assert_eq!(texts, ["a", "b", "c", "d", "e", "f", "g", synthetic::TEXT]);
    let beside = |path: &Path| std::fs::read_dir(path).unwrap().count();
    assert_eq!((beside(&folder.path().join("a")), beside(&folder.path().join("a/b"))), (1, 1));
}

/// Readers leave the folder as it was, also if the requested data are missing.
#[test]
fn readers_leave_no_file_behind() {
    let (folder, db) = database();
    let out = folder.path().join("out");
    std::fs::create_dir(&out).unwrap();
    let at = |name: &str| out.join(name).to_str().unwrap().to_owned();
    let trial = format!("{:032x}", 1);
    std::fs::write(out.join("r.toml"), "").unwrap();
    let records = format!("initial={}", at("r.toml"));
    for (expected, args) in [
        (true, vec!["analyse".to_owned(), "--question".into(), "paired".into()]),
        (true, vec!["report".into(), "--out".into(), at("r.html")]),
        (false, vec!["report".into(), "no-such".into(), "--out".into(), at("r.html")]),
        (
            true,
            vec![
                "export".into(),
                trial.clone(),
                "--format".into(),
                "npy".into(),
                "--out".into(),
                at("a.npy"),
            ],
        ),
        (
            true,
            vec![
                "export".into(),
                "v_trial".into(),
                "--format".into(),
                "csv".into(),
                "--out".into(),
                at("v.csv"),
            ],
        ),
        (
            false,
            vec![
                "export".into(),
                "no-such".into(),
                "--format".into(),
                "npy".into(),
                "--out".into(),
                at("b.npy"),
            ],
        ),
        (false, vec!["lab evaluate".into(), trial, "--records".into(), records]),
        (
            false,
            vec!["lab evaluate".into(), "no-such".into(), "--records".into(), "initial=none.toml".into()],
        ),
        (false, vec!["status".into()]),
    ] {
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        let (ok, _, err) = metasense(&db, &args);
        assert_eq!(ok, expected, "{args:?}: {err}");
        let mut files: Vec<_> =
            std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        files.sort();
        assert_eq!(files, ["out", "synthetic.sqlite"], "{args:?}");
    }
}

/// At K = 4 the trained body's elbow was put at M = 2, as in the paper, and one sensor beats six; K = 8 was not tried.
#[test]
fn claims_are_rated_by_what_was_put_into_the_database() {
    let (folder, db) = database();
    let (ok, out, err) = metasense(&db, &["analyse", "--question", "claims", "--format", "json"]);
    assert!(ok, "{err}");
    let rows: Value = serde_json::from_str(&out).unwrap();
    let rating = |says: &str| {
        let row = rows.as_array().unwrap().iter().find(|row| row["says"].as_str().unwrap().starts_with(says));
        row.unwrap_or_else(|| panic!("{says}: not among {out}"))["rating"].as_str().unwrap().to_owned()
    };
    assert_eq!(rating("K = 4: its error has an elbow at M = 2"), "holds");
    assert_eq!(rating("K = 4: the trained body with two sensors"), "holds");
    assert_eq!(rating("K = 8: its error"), "not tested");
    let out = folder.path().join("claims");
    let asked = ["analyse", "--question", "evidence", "--format", "csv", "--out-dir", out.to_str().unwrap()];
    let (ok, evidence, err) = metasense(&db, &asked);
    assert!(ok, "{err}");
    assert_eq!(
        evidence.lines().next(),
        Some("claim,with,set,rating,stated,found,low,high,chance,tells,note,trials,over")
    );
    for (file, part) in [
        ("claims.csv", "elbow at M = 2"),
        ("evidence.csv", "holdout"),
        ("trials.csv", "holdout_error_optimised"),
        ("claims.svg", "the paper"),
        ("index.html", "arXiv:2605.23967"),
    ] {
        let text = std::fs::read_to_string(out.join(file)).unwrap();
        assert!(text.contains(part), "{file} lacks {part:?}");
    }
    // every claim names existing specs
    for spec in rows.as_array().unwrap().iter().flat_map(|row| row["specs"].as_str().unwrap().split(", ")) {
        let spec = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(spec);
        assert!(spec.is_file(), "{}", spec.display());
    }
}
