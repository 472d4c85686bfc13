//! Bodies and casts: training over casts, evaluation on casts, and the commands for casts.

use crate::common::{Bench, TINY};
use serde_json::Value;

const SCATTER: &str = "[variation]\nstretch = 0.05\nshear = { common = 0.05, ligament = 0.03 }\nbend = 0.05\ndamping = 0.2\ndensity = { unit = 0.03 }\nnodes = 0.1\n";

fn json(text: &str) -> Vec<Value> {
    serde_json::from_str(text).unwrap_or_else(|e| panic!("{e}: {text}"))
}

/// A trial trained as designed and one trained over casts: one sensor, linear decoder, three casts of each body.
fn spec() -> String {
    TINY.replace("sensors = [1, 2]", "sensors = [1]\n\"optimise.objective\" = [\"nominal\", \"mean\"]")
        .replace(
            "[brain]\niterations = 10\nwidth = 16\n",
            &format!("{SCATTER}[brain]\nkind = \"linear\"\n[evaluation]\ncasts = 3\n"),
        )
}

/// Every decoder is evaluated on every cast of both bodies. `body casts` gives the same bits for the same casts, and continues with
/// others; with less variation, errors are smaller; failures are refused by file and line.
#[test]
fn casts_of_finished_bodies_are_read() {
    let bench = Bench::new();
    bench.file("s.toml", &spec());
    bench.output(&["run", "s.toml", "--workers", "1"]);
    let db = "results/tiny.sqlite";
    let ask = |sql: &str| json(&bench.output(&["query", db, sql, "--format", "json"]));
    let rows = ask("SELECT objective, body, casting, reader, records, error, nominal_error, hash FROM v_cast
                    ORDER BY objective, body, casting, reader");
    // two trials, two bodies, three casts; three decoders: as designed, over casts, and fitted to all six training samples
    assert_eq!(rows.len(), 2 * 2 * 3 * 3, "{rows:?}");
    let error = |row: &Value| row["error"].as_f64().unwrap_or_else(|| panic!("{row}"));
    assert!(rows.iter().all(|row| error(row) > 0.0 && row["nominal_error"].as_f64().unwrap() > 0.0));
    // rows of a trial with a linear decoder contain its own error as designed
    let own = ask(
        "SELECT count(*) AS n, sum(c.nominal_error = CASE c.body WHEN 'initial' THEN t.holdout_error_initial
                     ELSE t.holdout_error_optimised END) AS own FROM v_cast c JOIN v_trial t USING (hash)",
    );
    assert_eq!((&own[0]["n"], &own[0]["own"]), (&Value::from(36), &Value::from(36)));
    let of = |objective: &str, body: &str| -> Vec<f64> {
        rows.iter().filter(|row| row["objective"] == objective && row["body"] == body).map(error).collect()
    };
    // coverage of the bands is stored where the trial's own decoder, or one for all casts, is evaluated
    let covered = ask("SELECT count(*) AS n, sum(records = 0) AS own, count(instants_covered) AS instants,
                         count(samples_covered) AS samples, min(instants_covered) >= 0 AS least, max(instants_covered) <= 1 AS most
                       FROM v_cast");
    assert_eq!(
        covered[0],
        serde_json::json!({"n": 36, "own": 24, "instants": 24, "samples": 24, "least": 1, "most": 1})
    );
    // equal bodies have equal casts, whatever the training objective
    assert_eq!(of("nominal", "initial"), of("mean", "initial"));
    assert_ne!(of("nominal", "optimised"), of("mean", "optimised"));

    let hash = rows.iter().find(|row| row["objective"] == "mean").unwrap()["hash"].as_str().unwrap();
    let asked =
        ["body", "casts", db, hash, "--design", "optimised", "--casts", "4", "--rows", "--format", "json"];
    let each = json(&bench.output(&asked));
    assert_eq!(each.len(), 4 * 3);
    for row in rows.iter().filter(|row| row["hash"] == hash && row["body"] == "optimised") {
        let same = |other: &&Value| ["casting", "reader", "records"].iter().all(|key| row[key] == other[key]);
        assert_eq!(error(each.iter().find(same).unwrap()), error(row));
    }

    bench.file("less.toml", "[variation]\nnodes = 0.001\n");
    let less =
        json(&bench.output(&["body", "casts", db, hash, "--variation", "less.toml", "--format", "json"]));
    let more = json(&bench.output(&["body", "casts", db, hash, "--format", "json"]));
    let median = |rows: &[Value]| rows[0]["median"].as_f64().unwrap();
    assert!(less[0]["reader"] == "nominal" && median(&less) < median(&more), "{less:?} {more:?}");

    // analyse uses the same rows: of three casts, the median is the second, and the 90th percentile is 0.2 and 0.8 of the last two
    let analysed = ["analyse", db, "--question", "casts", "--format", "json"];
    let analysed = json(&bench.output(&analysed));
    assert_eq!(analysed.len(), 3 * 3, "{analysed:?}");
    for (name, objective, body) in [
        ("initial", "nominal", "initial"),
        ("nominal", "nominal", "optimised"),
        ("mean of casts", "mean", "optimised"),
    ] {
        for by in ["nominal", "casts", "records"] {
            let said = |row: &&Value| row["body"] == name && row["read_by"] == by;
            let said = analysed.iter().find(said).unwrap_or_else(|| panic!("{name}, {by}: {analysed:?}"));
            let own =
                |row: &&Value| row["objective"] == objective && row["body"] == body && row["reader"] == by;
            let mut errors: Vec<f64> = rows.iter().filter(own).map(error).collect();
            errors.sort_by(f64::total_cmp);
            for (column, expected) in
                [("median", errors[1]), ("percentile_90", 0.2 * errors[1] + 0.8 * errors[2])]
            {
                let found = said[column].as_f64().unwrap();
                assert!((found / expected - 1.0).abs() < 1e-9, "{column} {expected}: {said}");
            }
            assert_eq!((&said["trials"], &said["casts"], &said["failed"]), (&1.into(), &3.into(), &0.into()));
        }
    }
    bench.output(&["report", db, "--out", "r.html"]);
    let page = std::fs::read_to_string(bench.path("r.html")).unwrap();
    for part in ["<h2 id=\"casts\">", "with one linear decoder for all casts: initial ", "mean of casts"] {
        assert!(page.contains(part), "the page lacks {part}");
    }

    bench.file("wrong.toml", "[variation]\nstretch = 2.0\n");
    bench.file("unknown.toml", "[variation]\nnode = 0.1\n");
    bench.file("tiny.toml", TINY);
    for (args, why) in [
        (&["body", "casts", db, hash, "--variation", "wrong.toml"][..], "variation.stretch = 2: "),
        (
            &["body", "casts", db, hash, "--variation", "unknown.toml"],
            "unknown.toml:2: variation.node = 0.1: unknown key",
        ),
        (&["body", "casts", "tiny.toml"], "has no [variation]"),
    ] {
        let output = bench.metasense(args);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && said.contains(why), "{args:?}: {said}");
    }
}

/// A variation that no other key uses does not change the trial; equal objectives have equal hashes.
#[test]
fn what_no_key_reads_makes_no_other_trial() {
    let bench = Bench::new();
    let hashes = |text: &str| -> Vec<String> {
        bench.file("s.toml", text);
        let csv = bench.output(&["expand", "s.toml", "--format", "csv"]);
        csv.lines().skip(1).map(|line| line[..32].to_owned()).collect()
    };
    let plain = hashes(TINY);
    assert_eq!(
        hashes(&TINY.replace("[brain]", &format!("{SCATTER}[evaluation]\ncasts = 0\n[brain]"))),
        plain
    );
    assert_ne!(hashes(&TINY.replace("[brain]", &format!("{SCATTER}[brain]"))), plain);
    let with = |keys: &str| {
        hashes(&TINY.replace("[brain]", &format!("{SCATTER}[brain]")).replace("batch = 4", keys))
    };
    assert_eq!(with("batch = 4\nobjective = \"nominal\""), with("batch = 4"));
    assert_eq!(with("objective = { cvar = 0.0 }"), with("objective = \"mean\"\ncasts = 4\nbatch = 8"));
    assert_eq!(with("objective = { cvar = 1.0 }"), with("objective = \"worst\""));
    assert_ne!(with("objective = \"worst\""), with("objective = \"mean\""));
    let turns =
        |batch: u32| hashes(&TINY.replace("[brain]", &format!("[evaluation]\nbatch = {batch}\n[brain]")));
    assert_eq!(turns(3000), plain);
    assert_ne!(turns(2), plain);
}
