//! Tasks other than forces, estimated from the signals of finished trials' bodies.

use crate::common::{Bench, light};
use crate::exports::{between, compiled, holds};
use crate::files::execute;
use serde_json::Value;

/// A spec of trials whose samples suffice for readouts of tasks.
fn with_samples() -> String {
    light()
        .replace(
            "samples = 8\ntest = 2\nholdout = 2\n",
            "samples = 60\ntest = 12\nholdout = 40\nsilent = 0.3\n",
        )
        .replace("[brain]\niterations = 10\nwidth = 16\n", "[brain]\nkind = \"linear\"\n")
}

/// Every task on both bodies of each trial with both readouts; the table pairs them.
#[test]
fn finished_bodies_are_read_for_other_tasks() {
    let bench = Bench::new();
    let spec = light().replace(
        "samples = 8\ntest = 2\nholdout = 2\n",
        "samples = 60\ntest = 12\nholdout = 40\nsilent = 0.3\n",
    );
    bench.file("s.toml", &spec);
    bench.output(&["run", "s.toml", "--db", "s.sqlite"]);
    let json = |args: &[&str]| -> Vec<Value> { serde_json::from_str(&bench.output(args)).unwrap() };
    let rows = json(&["body", "tasks", "s.sqlite", "--format", "json"]);
    let trials = bench.number("s.sqlite", "SELECT count(*) FROM trial") as usize;
    // six tasks with two readouts each, and the forces
    assert_eq!(rows.len(), trials * 2 * 13, "{rows:?}");
    let number = |row: &Value, name: &str| row[name].as_f64().unwrap_or_else(|| panic!("{row}"));
    for row in &rows {
        let (low, error, high) = (number(row, "low"), number(row, "error"), number(row, "high"));
        assert!(0.0 <= low && low <= error && error <= high && number(row, "samples") > 20.0, "{row}");
    }
    // well decoded forces are better than the trivial predictor
    let of = |task: &str| -> Vec<&Value> { rows.iter().filter(|row| row["task"] == task).collect() };
    assert!(of("forces").iter().all(|row| row["trained_for"] == "forces" && row["trivial"] == 100.0));
    for task in ["peak", "impulse"] {
        let decoded: Vec<&Value> = of(task).into_iter().filter(|row| row["readout"] == "decoded").collect();
        let told = decoded.iter().filter(|row| number(row, "error") < number(row, "trivial")).count();
        assert!(2 * told > decoded.len(), "{task}: {decoded:?}");
    }
    let table = bench.output(&["body", "tasks", "s.sqlite"]);
    assert!(table.contains("ratio_low") && table.lines().count() > 10, "{table}");
    let hash = rows[0]["hash"].as_str().unwrap();
    let one = json(&["body", "tasks", "s.sqlite", &hash[..8], "--format", "json"]);
    assert!(one.len() == 26 && one[..] == rows[..26], "{one:?}");

    // both panels are struck in every sample, so the count is constant
    bench.file("all.toml", &spec.replace("silent = 0.3\n", ""));
    bench.output(&["run", "all.toml", "--db", "all.sqlite"]);
    let output = bench.metasense(&["body", "tasks", "all.sqlite", "--format", "json"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("the same in all samples: count"), "{said}");
}

/// A sweep trains one body per task. The body trained for a task is a body of its own; the table has a transfer matrix. Keys without
/// effect do not change a trial's hash.
#[test]
fn a_sweep_trains_a_body_per_task() {
    let bench = Bench::new();
    let spec = light()
        .replace("samples = 8\ntest = 2\nholdout = 2\n", "samples = 60\ntest = 12\nholdout = 40\n")
        .replace("[brain]\niterations = 10\nwidth = 16\n", "[brain]\nkind = \"linear\"\n")
        .replace("iterations = 4\nbatch = 4", "iterations = 6\nbatch = 24")
        .replace("sensors = [1, 2]", "sensors = [1]\n\"brain.task\" = [\"forces\", \"impulse\", \"all\"]");
    bench.file("s.toml", &spec);
    bench.output(&["run", "s.toml", "--db", "s.sqlite"]);
    let tasks = "SELECT count(DISTINCT holdout_error_optimised) FROM v_trial WHERE state = 'done'";
    assert_eq!(bench.number("s.sqlite", tasks), 3);
    let improved = "SELECT count(*) FROM v_trial WHERE holdout_error_optimised < holdout_error_initial";
    assert!(bench.number("s.sqlite", improved) >= 2);
    let rows: Vec<Value> =
        serde_json::from_str(&bench.output(&["body", "tasks", "s.sqlite", "--format", "json"])).unwrap();
    let error = |trained_for: &str, body: &str| -> Vec<f64> {
        let own = rows.iter().filter(|row| row["trained_for"] == trained_for && row["body"] == body);
        own.map(|row| row["error"].as_f64().unwrap()).collect()
    };
    assert_eq!(error("forces", "initial"), error("impulse", "initial"), "one initial body");
    assert_ne!(error("forces", "optimised"), error("impulse", "optimised"));
    let table = bench.output(&["body", "tasks", "s.sqlite"]);
    let (_, matrix) = table.split_once("by the task of the training:\n").unwrap_or_else(|| panic!("{table}"));
    let head = matrix.lines().next().unwrap();
    assert!(["all", "forces", "impulse"].iter().all(|name| head.contains(name)), "{table}");

    let hashes = |name: &str, spec: &str| {
        bench.file(name, spec);
        let listed = bench.output(&["expand", name, "--format", "json"]);
        let listed: Vec<Value> = serde_json::from_str(&listed).unwrap();
        listed.iter().map(|row| row["hash"].to_string()).collect::<Vec<_>>()
    };
    let with_memory = spec.replace("kind = \"linear\"\n", "kind = \"linear\"\nmemory = [0.1, 0.0]\n");
    let (own, short) = (hashes("s.toml", &spec), hashes("t.toml", &with_memory));
    assert_eq!([0, 1, 2].map(|i| own[i] == short[i]), [false, true, true], "only forces use the memory");
}

/// With `evaluation.tasks`, a trial stores the rows that `body tasks` otherwise computes, and nothing else changes: hashes without
/// it, errors, counts of work. Designs are not needed again. Databases of earlier builds get the view.
#[test]
fn a_trial_stores_its_tasks() {
    let bench = Bench::new();
    let spec = with_samples().replace("iterations = 4\nbatch = 4", "iterations = 8\nbatch = 24");
    let on = format!("{spec}[evaluation]\ntasks = true\n");
    bench.file("off.toml", &spec);
    bench.file("on.toml", &on);
    bench.file("no.toml", &on.replace("tasks = true", "tasks = false"));
    let hashes = |name: &str| {
        let listed: Vec<Value> =
            serde_json::from_str(&bench.output(&["expand", name, "--format", "json"])).unwrap();
        listed.iter().map(|row| row["hash"].to_string()).collect::<Vec<_>>()
    };
    assert_eq!(hashes("off.toml"), hashes("no.toml"));
    assert!(hashes("off.toml").iter().all(|hash| !hashes("on.toml").contains(hash)));
    for name in ["off", "on"] {
        bench.output(&["run", &format!("{name}.toml"), "--db", &format!("{name}.sqlite")]);
    }
    let query =
        |name: &str, sql: &str| bench.output(&["query", &format!("{name}.sqlite"), sql, "--format", "csv"]);
    let same = "SELECT holdout_error_initial, holdout_error_optimised, error_optimised FROM v_trial ORDER BY sensors, seed";
    assert_eq!(query("off", same), query("on", same));
    let counters = "SELECT result->>'$.counters' FROM trial ORDER BY sensors, seed";
    assert_eq!(query("off", counters), query("on", counters));
    assert_eq!(bench.number("off.sqlite", "SELECT count(*) FROM v_task"), 0);

    let rows = |name: &str| {
        let rows = bench.output(&["body", "tasks", &format!("{name}.sqlite"), "--format", "json"]);
        let mut rows: Vec<Value> = serde_json::from_str(&rows).unwrap();
        rows.iter_mut().for_each(|row| drop(row.as_object_mut().unwrap().remove("hash")));
        rows
    };
    let computed = rows("off");
    execute(&bench.path("on.sqlite"), "DELETE FROM artifact");
    assert_eq!(rows("on"), computed);
    let stored = query(
        "on",
        "SELECT body, task, readout, error, low, high, least, trivial, samples, score FROM v_task",
    );
    assert_eq!(stored.lines().count(), 1 + computed.len());
    let classes = "task IN ('panel', 'count', 'kind') AND readout = 'direct'";
    let calibrated = |of: &str| {
        let sql =
            format!("SELECT count(*) FROM v_task WHERE ({of}) AND log_loss > 0 AND calibration_error >= 0");
        bench.number("on.sqlite", &sql)
    };
    assert!(calibrated(classes) > 0 && calibrated(classes) == calibrated("1"));
    assert_eq!(
        bench.number("on.sqlite", &format!("SELECT count(*) FROM v_task WHERE {classes}")),
        calibrated("1")
    );

    // gain per task, as an answer, in the report, and the same as in the table of `body tasks`
    let answer = bench.output(&["analyse", "on.sqlite", "--question", "tasks", "--format", "csv"]);
    assert!(
        answer.starts_with("setting,M,trained_for,task,readout,unit,trials,trivial,initial,optimised,ratio"),
        "{answer}"
    );
    bench.output(&["report", "on.sqlite", "--out", "r.html", "--out-dir", "r"]);
    let text = |name: &str| std::fs::read_to_string(bench.path(name)).unwrap();
    assert_eq!(text("r/tasks.csv").lines().count(), answer.lines().count());
    assert!(
        answer.lines().nth(1).is_some_and(|row| !row.contains(",1.0,,")),
        "training changes errors: {answer}"
    );
    let page = text("r.html");
    for words in [
        "What does training gain for other sensing tasks?",
        "panel, trained body (%)",
        "panel, frequency of a class with this probability (%)",
        "position, mean error (mm)",
    ] {
        assert!(page.contains(words), "{words}");
    }
    bench.output(&["report", "off.sqlite", "--out", "off.html"]);
    assert!(!text("off.html").contains("other sensing tasks"));

    // a database of an earlier build
    execute(&bench.path("on.sqlite"), "DROP VIEW v_task");
    assert_eq!(query("on", "SELECT count(*) FROM v_task").lines().last(), Some(&*computed.len().to_string()));
    execute(&bench.path("on.sqlite"), "CREATE VIEW v_task AS SELECT hash FROM trial");
    assert_eq!(
        query("on", "SELECT count(task) FROM v_task").lines().last(),
        Some(&*computed.len().to_string())
    );
    bench.output(&["run", "off.toml", "--db", "on.sqlite"]);
    let current =
        "SELECT count(*) FROM sqlite_schema WHERE name = 'v_task' AND sql LIKE '%calibration_error%'";
    assert_eq!(bench.number("on.sqlite", current), 1);
}

/// A requirement per task excludes designs; without stored tasks, or for a constant label, it is refused.
#[test]
fn a_goal_can_require_tasks() {
    let bench = Bench::new();
    let spec = with_samples().replace("sensors = [1, 2]", "sensors = [1, 2]\nplacements = 1");
    let goal = |tasks: &str| {
        format!(
            "{spec}[goal]\nerror = 1000.0\nfresh = 3\nconfidence = 0.5\ntasks = {tasks}\n[evaluation]\ntasks = true\n"
        )
    };
    let design = |text: &str, db: &str| {
        bench.file("s.toml", text);
        let out = bench.metasense(&["design", "s.toml", "--db", db, "--format", "csv"]);
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        (out.status.code(), text(out.stdout), text(out.stderr))
    };
    let (code, table, said) = design(&goal("{ panel = 200.0, peak = 10.0 }"), "met.sqlite");
    assert!(code == Some(0) && said.contains("meets 1000 %, panel: 200 %, peak: 10 N"), "{table}{said}");
    let (code, table, said) = design(&goal("{ panel = 200.0, peak = 1e-6 }"), "met.sqlite");
    assert!(code == Some(1) && said.contains("no design was confirmed"), "{table}{said}");
    let refused = |text: &str, what: &str| {
        let (code, _, said) = design(text, "none.sqlite");
        assert!(code == Some(2) && said.contains(what), "{said}");
    };
    let off = goal("{ panel = 5.0 }").replace("[evaluation]\ntasks = true\n", "");
    refused(&off, "goal.tasks: applies to trials that estimate tasks: set evaluation.tasks = true");
    let constant = goal("{ panel = 5.0, count = 5.0 }").replace("silent = 0.3\n", "");
    refused(&constant, "goal.tasks.count = 5.0: its label is the same in all training samples");
}

/// The readouts of a trial in C give the trial's errors, if blocks are single instants, and estimates; with other weights their test
/// fails. ONNX is refused.
#[test]
fn readouts_are_exported_as_c() {
    let bench = Bench::new();
    let spec = with_samples().replace("iterations = 4\nbatch = 4", "iterations = 3\nbatch = 24").replace(
        "sensors = [1, 2]",
        "sensors = [1]\npoints = [{ \"brain.task\" = \"panel\" }, { \"brain.task\" = \"position\" }, \
             { \"brain.task\" = \"all\" }, { \"brain.task\" = \"all\", \"time.samples\" = 70 }]",
    );
    bench.file("s.toml", &format!("{spec}[evaluation]\ntasks = true\n"));
    bench.output(&["run", "s.toml", "--db", "s.sqlite"]);
    let trials: Vec<Value> = serde_json::from_str(&bench.output(&[
        "query",
        "s.sqlite",
        "SELECT hash, json_group_array(json_array(task, error)) AS errors, trained_for FROM v_task
         WHERE body = 'optimised' AND readout = 'direct' GROUP BY hash",
        "--format",
        "json",
    ]))
    .unwrap();
    assert_eq!(trials.len(), 4);
    for trial in &trials {
        let hash = trial["hash"].as_str().unwrap();
        let export = |format: &str, numbers: &str| {
            let call = ["export", "s.sqlite", hash, "--format", format, "--out", "b.c"];
            let more = ["--numbers", numbers];
            bench.metasense(&[&call[..], if numbers == "f32" { &[] } else { &more[..] }].concat())
        };
        for numbers in ["f32", "i16", "i8"] {
            assert!(export("c", numbers).status.success());
            let source = std::fs::read_to_string(bench.path("b.c")).unwrap();
            let (good, said) = holds("cc", &source, &bench.path(""));
            assert!(good && said.contains("20 samples"), "{trial} {numbers}: {said}");
            let (weight, other) =
                (between(&source, "STEP[] = {", "}").to_owned(), "\n    3e4f, 3e4f, 3e4f,\n");
            let wrong = source.replacen(&weight, other, 1);
            let (passes, _) = compiled("cc", std::iter::empty(), &wrong, &bench.path(""));
            assert!(!passes || trial["trained_for"] == "all", "{trial} {numbers}: other weights");
            let blocks = [
                ("BRAIN_INSTANTS 20", "BLOCK 1", "BLOCKS 20"),
                ("BRAIN_INSTANTS 70", "BLOCK 3", "BLOCKS 24"),
            ];
            let has = |line: &str| source.contains(&format!("#define {line}\n"));
            assert!(blocks.iter().any(|(instants, block, count)| has(instants) && has(block) && has(count)));
            if numbers == "i8" || !has("BLOCK 1") {
                continue;
            }
            let errors: Vec<(String, f64)> = serde_json::from_str(trial["errors"].as_str().unwrap()).unwrap();
            for (task, error) in errors.iter().filter(|(task, _)| source.contains(&format!("     {task}: ")))
            {
                let line = between(&source, &format!("     {task}: "), "\n");
                let stated: f64 = between(line, "held-out error ", " ").parse().unwrap();
                assert!((stated - error).abs() < 0.02 * error + 1e-4, "{task} {numbers}: {stated} {error}");
            }
            let bytes: usize = between(&source, "constants ", " bytes").parse().unwrap();
            assert!(bytes < 2000 || trial["trained_for"] == "all", "{bytes}");
        }
        let refused = export("onnx", "f32");
        let said = String::from_utf8_lossy(&refused.stderr);
        assert!(refused.status.code() == Some(2) && said.contains("use --format c"), "{said}");
    }
    let hash = trials[0]["hash"].as_str().unwrap();
    bench.output(&["export", "s.sqlite", hash, "--format", "device", "--out", "d"]);
    let source = std::fs::read_to_string(bench.path("d/brain.c")).unwrap();
    assert!(holds("cc", &source, &bench.path("")).0 && !bench.path("d/brain.onnx").exists());
}

/// Windows from the contact on give smaller errors of blows at random times than whole records. Their C files start with the contact,
/// too. Training for forces uses no window.
#[test]
fn readouts_see_a_window_from_the_contact_on() {
    let bench = Bench::new();
    let spec = with_samples()
        .replace("kind = \"bell\"", "kind = \"irregular\"\nanywhere = true")
        .replace("width = [0.05, 0.1]\nonset = [0.0, 0.1]\n", "onset = [0.0, 0.1]\n")
        .replace("silent = 0.3\n", "")
        .replace("iterations = 4\nbatch = 4", "iterations = 3\nbatch = 24")
        .replace(
            "sensors = [1, 2]",
            "sensors = [1]\n\"brain.task\" = [\"all\", \"forces\"]\npoints = [{}, { \"brain.window\" = 0.05 }]",
        );
    bench.file("s.toml", &format!("{spec}[evaluation]\ntasks = true\n"));
    bench.output(&["run", "s.toml", "--db", "s.sqlite"]);
    let error = |window: &str, task: &str, body: &str| -> f64 {
        let sql = format!(
            "SELECT avg(error) AS error FROM v_task WHERE task = '{task}' AND body = '{body}' AND readout = 'direct'
             AND window {window}"
        );
        bench.output(&["query", "s.sqlite", &sql, "--format", "csv"]).lines().nth(1).unwrap().parse().unwrap()
    };
    for body in ["initial", "optimised"] {
        let better = |task: &str| error("= 0.05", task, body) < 0.9 * error("IS NULL", task, body);
        assert!(better("onset") && better("position"), "{body}");
        let count = |readout: &str| {
            let rows = "SELECT count(*) FROM v_task WHERE window = 0.05 AND log_loss > 0";
            bench.number("s.sqlite", &format!("{rows} AND readout = '{readout}' AND body = '{body}'"))
        };
        assert!(count("network") > 0 && count("network") == count("direct"), "classes have probabilities");
    }
    let trained = "SELECT count(DISTINCT v.holdout_error_optimised) FROM v_trial v JOIN trial t USING (hash)
                   WHERE t.spec->>'$.brain.task' IS NULL";
    assert_eq!(bench.number("s.sqlite", trained), 1);
    let of = "SELECT hash FROM v_task WHERE trained_for = 'all' AND window = 0.05";
    let hash = bench.output(&["query", "s.sqlite", of, "--format", "csv"]);
    let hash = hash.lines().nth(1).unwrap();
    for numbers in ["f32", "i8"] {
        let call = ["export", "s.sqlite", hash, "--format", "c", "--numbers", numbers, "--out", "b.c"];
        bench.output(&call);
        let source = std::fs::read_to_string(bench.path("b.c")).unwrap();
        let (good, said) = holds("cc", &source, &bench.path(""));
        assert!(
            good && said.contains(" 0 further contacts") && source.contains("TRIGGER"),
            "{numbers}: {said}"
        );
    }
}

/// A sample's part of a mixture is a class, estimated from signals alone; `all` does not include it.
#[test]
fn the_kind_of_force_is_a_task_of_mixtures() {
    let bench = Bench::new();
    let gauss = "kind = \"gauss\"\nwidth = [0.01, 0.02]\nonset = [0.05, 0.1]\nanywhere = true";
    let blow = "kind = \"irregular\"\nonset = [0.0, 0.1]";
    let parts = [gauss, blow].map(|keys| format!("[[stimuli.mix]]\nweight = 0.5\n{keys}\n")).concat();
    let spec = light()
        .replace("samples = 8\ntest = 2\nholdout = 2\n", "samples = 60\ntest = 20\nholdout = 40\n")
        .replace("kind = \"bell\"", "kind = \"mix\"")
        .replace("width = [0.05, 0.1]\nonset = [0.0, 0.1]\n", &parts)
        .replace("[brain]\niterations = 10\nwidth = 16\n", "[brain]\nkind = \"linear\"\n")
        .replace("iterations = 4\nbatch = 4", "iterations = 2\nbatch = 24")
        .replace("sensors = [1, 2]", "sensors = [1]\n\"brain.task\" = [\"kind\", \"all\"]");
    bench.file("s.toml", &spec);
    bench.output(&["run", "s.toml", "--db", "s.sqlite"]);
    let rows: Vec<Value> =
        serde_json::from_str(&bench.output(&["body", "tasks", "s.sqlite", "--format", "json"])).unwrap();
    let kind: Vec<&Value> = rows.iter().filter(|row| row["task"] == "kind").collect();
    assert_eq!(kind.len(), 4, "two trials of two bodies: {rows:?}");
    assert!(kind.iter().all(|row| row["readout"] == "direct" && row["trivial"].as_f64() > Some(20.0)));
    let trained = "SELECT count(DISTINCT holdout_error_optimised) FROM v_trial WHERE state = 'done'";
    assert_eq!(bench.number("s.sqlite", trained), 2);
}
