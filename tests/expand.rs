//! `expand` shows what would run, in the order of running; `schema` describes what may be written.

mod common;

use common::{Bench, SPEC};

/// Breadth first: each (K, M) of each body has its first placement before any has its second. Hashes are pinned: they
/// name trials in databases that exist.
#[test]
fn trials_come_breadth_first_with_stable_hashes() {
    let bench = Bench::new();
    let axes = "sensors = [1, 2]\nplacements = 2\n\"body.columns\" = [5, 6]\n\
                exclude = [{ sensors = 2, \"body.columns\" = 5, placement = 1 }]\n";
    bench.file("s.toml", &SPEC.replace("sensors = [1, 2]\n", axes));
    let csv = bench.output(&["expand", "s.toml", "--format", "csv"]);
    let without_cost = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        [&cells[..10], &cells[11..]].concat().join(",")
    };
    insta::assert_snapshot!(csv.lines().map(without_cost).collect::<Vec<_>>().join("\n"));
    assert!(!bench.path("results").exists(), "expand wrote something");
}

/// Keys at their defaults, and what can be said in two ways, change no hash; what a trial is not does not either.
#[test]
fn the_same_trial_said_differently_has_the_same_hash() {
    let bench = Bench::new();
    let hashes = |text: &str| {
        bench.file("s.toml", text);
        let csv = bench.output(&["expand", "s.toml", "--format", "csv"]);
        csv.lines().map(|line| line.split(',').next().unwrap().to_owned()).collect::<Vec<_>>()
    };
    let plain = hashes(SPEC);
    let wordy = SPEC.replace("name = \"s\"", "name = \"other\"")
        + "seeds = [1]\n[optimise]\niterations = 350\nprotocol = \"joint\"\n[time]\nsamples = 200\n[run]\nworkers = 3\n";
    let wordy = wordy
        .replace("columns = 6", "columns = 6\nclamp = \"bottom\"\npanel_units = [31, 34]\nspacing = 15")
        .replace("\nspacing = 15.0", "");
    assert_eq!(hashes(&wordy), plain);
    let brain = |keys: &str| hashes(&(SPEC.to_owned() + "[brain]\n" + keys));
    for said in
        ["", "preset = \"paper\"", "width = 64\ncausal = false", "kernels = [3, 3, 1]\ndilations = [1, 1, 1]"]
    {
        assert_eq!(brain(said), plain, "{said}");
    }
    let long = brain("preset = \"long\"");
    assert_eq!(brain("width = 24\nkernels = [9, 9, 9, 1]\ndilations = [1, 4, 16, 1]"), long);
    assert_ne!(long[1], plain[1]);
    assert_ne!(brain("preset = \"long\"\ncausal = true")[1], long[1]);
    assert_ne!(hashes(&SPEC.replace("bend = 1.0", "bend = 1.5"))[1], plain[1]);
    assert_eq!(
        hashes(&SPEC.replace("[1, 2]", "[2, 3]"))[1],
        plain[2],
        "a changed list keeps the trials that stay"
    );
}

/// Every spec that is committed, and with it every figure's, stands for trials that can be had.
#[test]
fn every_committed_spec_expands() {
    let bench = Bench::new();
    let folder = std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../schemas/sweeps"));
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| name.ends_with(".toml"))
        .collect();
    names.sort();
    for name in &names {
        let csv = bench.output(&["expand", folder.join(name).to_str().unwrap(), "--format", "csv"]);
        assert!(csv.lines().count() > 1, "{name}: no trials");
        let text = std::fs::read_to_string(folder.join(name)).unwrap();
        let called = format!("name = \"{}\"", name.trim_end_matches(".toml"));
        assert!(text.contains(&called), "{name}: {called} is not in it");
    }
    for figure in ["fig2", "fig3", "fig4b", "fig4c", "fig5"] {
        for name in [format!("{figure}.toml"), format!("{figure}-two-core.toml")] {
            assert!(names.contains(&name), "{name} is missing of {names:?}");
        }
    }
}

#[test]
fn json_rows_are_a_list_of_objects() {
    let bench = Bench::new();
    bench.file("s.toml", SPEC);
    let rows: serde_json::Value =
        serde_json::from_str(&bench.output(&["expand", "s.toml", "--format", "json"])).unwrap();
    assert_eq!(rows[1]["sensors"], 2, "{rows}");
    assert_eq!(rows[1]["brain_parameters"], 13_698, "{rows}");
    assert_eq!(rows[1]["design_parameters"], 168, "{rows}");
    bench.file("s.toml", &(SPEC.to_owned() + "[brain]\npreset = \"long\"\n"));
    let rows: serde_json::Value =
        serde_json::from_str(&bench.output(&["expand", "s.toml", "--format", "json"])).unwrap();
    let long = 9 * 6 * 24 + 24 + 2 * (9 * 24 * 24 + 24) + 24 * 2 + 2;
    assert_eq!(rows[1]["brain_parameters"], long, "{rows}");
}

#[test]
fn the_schema_knows_every_table() {
    let schema: serde_json::Value = serde_json::from_str(&Bench::new().output(&["schema"])).unwrap();
    for table in [
        "body",
        "time",
        "solver",
        "sensors",
        "stimuli",
        "brain",
        "optimise",
        "evaluation",
        "feasible",
        "sweep",
    ] {
        assert!(schema["properties"][table].is_object(), "{table}");
    }
}

/// Thirty trials whose estimates differ fourteen-fold, ten a shard: the longest has 1.15 times the mean at most.
#[test]
fn shards_are_dealt_by_cost_and_stay_as_they_are_written_down() {
    let bench = Bench::new();
    let spec = concat!(env!("CARGO_MANIFEST_DIR"), "/../schemas/sweeps/fig4b-linear.toml");
    let rows = |more: &[&str]| -> Vec<(String, f64)> {
        let csv = bench.output(&[&["expand", spec, "--format", "csv"], more].concat());
        let at = csv.lines().next().unwrap().split(',').position(|name| name == "cost_seconds").unwrap();
        let row = |line: &str| {
            let cells: Vec<&str> = line.split(',').collect();
            (cells[0].to_owned(), cells[at].parse().unwrap())
        };
        csv.lines().skip(1).map(row).collect()
    };
    let shards: Vec<_> = ["1/3", "2/3", "3/3"].iter().map(|shard| rows(&["--shard", shard])).collect();
    let costs: Vec<f64> = shards.iter().map(|rows| rows.iter().map(|row| row.1).sum()).collect();
    let mean = costs.iter().sum::<f64>() / 3.0;
    assert!(costs.iter().all(|cost| *cost <= 1.15 * mean), "{costs:?}");
    assert_eq!(shards.iter().map(Vec::len).sum::<usize>(), rows(&[]).len());
    // All to the first one, once: what is written down counts.
    let lines = rows(&[]).iter().map(|row| format!("{},1\n", row.0)).collect::<String>();
    bench.file("deal-of-3.csv", &format!("hash,shard\n{lines}"));
    assert_eq!(rows(&["--shard", "1/3", "--folder", "."]), rows(&[]));
}
