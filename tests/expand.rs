//! `expand` lists the trials in the order of running; `schema` describes specs.

use crate::common::{Bench, SPEC, TINY, without_cost};

/// Breadth first: each (K, M) of each body has its first placement before any has its second. Hashes are pinned, because they name
/// trials in existing databases.
#[test]
fn trials_come_breadth_first_with_stable_hashes() {
    let bench = Bench::new();
    let axes = "sensors = [1, 2]\nplacements = 2\n\"body.columns\" = [5, 6]\n\
                exclude = [{ sensors = 2, \"body.columns\" = 5, placement = 1 }]\n";
    let one_network = format!("{axes}[evaluation]\nseeds = 1\n");
    bench.file("s.toml", &SPEC.replace("sensors = [1, 2]\n", &one_network));
    let csv = bench.output(&["expand", "s.toml", "--format", "csv"]);
    insta::assert_snapshot!(csv.lines().map(without_cost).collect::<Vec<_>>().join("\n"));
    assert!(!bench.path("results").exists(), "expand wrote something");
}

/// Two placements per seed, different for each seed: the trials that a grid of four placements has there.
#[test]
fn seeds_may_have_placements_of_their_own() {
    let bench = Bench::new();
    let trials = |sweep: &str| -> Vec<(String, [String; 2])> {
        bench.file("s.toml", &format!("{SPEC}{sweep}"));
        let csv = bench.output(&["expand", "s.toml", "--format", "csv"]);
        let mut lines = csv.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
        let head = lines.next().unwrap();
        let at = |name: &str| head.iter().position(|column| column == name).unwrap();
        let [placement, seed] = [at("placement"), at("seed")];
        lines.map(|cells| (cells[0].clone(), [cells[placement].clone(), cells[seed].clone()])).collect()
    };
    let own = trials("seeds = [7, 9]\nplacements = 2\nown_placements = true\n");
    let mut grid = trials("seeds = [7, 9]\nplacements = 4\n");
    grid.retain(|(_, [placement, seed])| ["0", "1"].contains(&placement.as_str()) == (seed == "7"));
    assert_eq!((own.len(), own), (8, grid));
}

/// Settings of the file that overrides have made irrelevant are left out with a warning, and the trials are those of the whole sweep.
/// A key that the file itself does not use, or that the command line sets, is refused.
#[test]
fn a_narrowed_sweep_leaves_out_what_it_does_not_use() {
    let bench = Bench::new();
    let axis = "\"brain.kind\" = [\"cnn\", \"linear\"]\n\"brain.learning_rate\" = [0.01, 0.02]\n";
    bench.file("s.toml", &TINY.replace("[sweep]\n", &format!("[sweep]\n{axis}")));
    let hashes = |changes: &[&str]| -> Vec<String> {
        let csv = bench.output(&[&["expand", "s.toml", "--format", "csv"], changes].concat());
        csv.lines().skip(1).map(|line| line[..32].to_owned()).collect()
    };
    let (all, narrow) = (hashes(&[]), "sweep.\"brain.kind\"=[\"linear\"]");
    let linear = hashes(&[narrow]);
    assert!(linear.len() < all.len() && linear.iter().all(|hash| all.contains(hash)), "{linear:?}, {all:?}");
    let said = |changes: &[&str]| {
        let output = bench.metasense(&[&["expand", "s.toml"], changes].concat());
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (code, text) = said(&[narrow]);
    assert!(
        code == Some(0) && text.contains("warning: ") && text.contains("brain.iterations = 10"),
        "{text}"
    );
    assert!(text.contains("brain.learning_rate = [0.01, 0.02]: has no effect"), "{text}");
    assert_eq!(hashes(&[narrow, "sweep.brain.learning_rate="]), linear, "also without the axis");
    let (code, text) = said(&[narrow, "brain.iterations=11"]);
    assert!(code == Some(2) && text.contains("brain.iterations = 11"), "{text}");
    bench.file("s.toml", &TINY.replace("iterations = 10", "iterations = 10\nridge = 0.1"));
    let (code, text) = said(&["sweep.seeds=[3]"]);
    assert!(code == Some(2) && text.contains("brain.ridge = 0.1"), "{text}");
    bench.file("s.toml", TINY);
    let same = "{ \"body.columns\" = 5 }, { \"body.columns\" = 5, \"sensors.delay\" = 0.0 }";
    let (code, text) = said(&[&format!("sweep.points=[{same}]")]);
    let expected = "warning: sweep.points: 2 trials equal to others; left out";
    assert!(code == Some(0) && text.contains(expected), "{text}");
}

/// A mixture of forces has hundreds of characters: complete for programs, only its beginning in tables.
#[test]
fn long_values_are_cut_where_people_read() {
    let bench = Bench::new();
    let bells = "{ weight = 0.5, kind = \"bell\" }";
    let point = format!("\"stimuli.kind\" = \"mix\", \"stimuli.mix\" = [{bells}, {bells}]");
    bench.file(
        "s.toml",
        &SPEC.replace("sensors = [1, 2]\n", &format!("sensors = [1]\npoints = [{{ {point} }}]\n")),
    );
    let [table, csv] = ["table", "csv"].map(|format| bench.output(&["expand", "s.toml", "--format", format]));
    let widest = table.lines().map(|line| line.chars().count()).max();
    assert!(table.contains("…") && widest < Some(400), "{table}");
    assert!(!csv.contains("…") && csv.matches("amplitude").count() == 2, "{csv}");
}

/// Explicit defaults and equivalent notations change no hash; neither do keys that the trial does not use.
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
    let sensors = |keys: &str| hashes(&(SPEC.to_owned() + "[sensors]\n" + keys));
    assert_eq!(sensors("offset = [0, 0]\ntilt = 0"), plain);
    assert_ne!(sensors("offset = [0, 1]")[1], plain[1]);
    assert_eq!(sensors("channels = [\"omega\", \"ay\", \"ax\"]"), plain);
    let swept =
        SPEC.to_owned() + "\"sensors.channels\" = [[\"ax\", \"ay\", \"omega\"], [\"omega\", \"ax\"]]\n";
    let [all, some] =
        ["channels = [\"ax\", \"ay\", \"omega\"]", "channels = [\"ax\", \"omega\"]"].map(sensors);
    let both = hashes(&swept);
    assert!(all.iter().chain(&some).all(|hash| both.contains(hash)) && some[1] != plain[1], "{both:?}");
    let figures = "mass = 0\ninertia = 0\nrange = [1e5, 30.0]\nresolution = [1.0, 0.001]";
    assert_eq!(sensors(&format!("chip = \"WT9011DCL\"\n{figures}")), sensors(figures));
    let numbers = "density = 1e-8\nstiffness = { stretch = 3.0, shear = 0.5, bend = 1.0 }";
    let body = |keys: &str| hashes(&SPEC.replace(numbers, keys));
    let material =
        |keys: &str| body(&format!("[body.material]\nthickness = 8\nligament_width = 2.25\n{keys}"));
    let same = "density = 8e-9\nstiffness = { stretch = 4.0, shear = 0.8888888888888888, bend = 1.6875 }";
    assert_eq!(material("modulus = 0.5\ndensity = 1e-9"), body(same));
    assert_eq!(material("modulus = 0.5\ndensity = 1e-9\nrubber = \"Dragon Skin 10\""), body(same));
    assert_ne!(material("rubber = \"Dragon Skin 10\""), body(same));
    let optimise = |keys: &str| hashes(&(SPEC.to_owned() + "[optimise]\n" + keys));
    assert_eq!(optimise("tie = [1, 1]\nfrozen = []"), plain);
    assert_eq!(optimise("frozen = [7, 8]"), optimise("frozen = [8, 7]"));
    assert_ne!(optimise("tie = [2, 1]")[1], plain[1]);
    let varied = hashes(&(SPEC.to_owned() + "\"variation.stretch\" = [0.0, 0.1]\n"));
    assert!(varied.len() == 5 && plain.iter().all(|hash| varied.contains(hash)), "{varied:?}");
    let anywhere = |value: &str| hashes(&SPEC.replace("[sweep]", &format!("anywhere = {value}\n[sweep]")));
    assert!(anywhere("false") == plain && anywhere("true")[1] != plain[1]);
    assert_ne!(hashes(&SPEC.replace("bend = 1.0", "bend = 1.5"))[1], plain[1]);
    assert_eq!(
        hashes(&SPEC.replace("[1, 2]", "[2, 3]"))[1],
        plain[2],
        "a changed list keeps the trials that stay"
    );
}

/// Points are multiplied with the lists and vary slowest; equivalent lists give the same trials.
#[test]
fn linked_values_multiply_with_the_lists() {
    let bench = Bench::new();
    let rows = |sweep: &str| -> Vec<String> {
        bench.file("s.toml", &SPEC.replace("panels = [2]\nsensors = [1, 2]\n", sweep));
        let csv = bench.output(&["expand", "s.toml", "--format", "csv"]);
        csv.lines().skip(1).map(without_cost).collect()
    };
    let shown = |rows: &[String]| -> Vec<String> {
        let pick = |row: &String| {
            let cells: Vec<&str> = row.split(',').collect();
            [1, 2, 5, 10].map(|i| cells[i]).join(" ")
        };
        rows.iter().map(pick).collect()
    };
    let linked = rows(
        "sensors = [1, 2]\npoints = [{ panels = 2, \"body.columns\" = 6 }, { panels = 4, \"body.columns\" = 8 }]\n",
    );
    assert_eq!(shown(&linked), ["2 1 36 6", "2 2 36 6", "4 1 48 8", "4 2 48 8"]);
    let excluded = "sensors = [1, 2]\npanels = [2, 4]\n\"body.columns\" = [6, 8]\n\
                    exclude = [{ panels = 2, \"body.columns\" = 8 }, { panels = 4, \"body.columns\" = 6 }]\n";
    assert_eq!(rows(excluded), linked);
    // a point without a key has the spec's value, and `exclude` entries with this key do not match it
    let some = rows(
        "panels = [2]\nsensors = [1]\n\"brain.iterations\" = [10, 20]\n\
         points = [{}, { \"body.columns\" = 8 }]\nexclude = [{ \"body.columns\" = 8, \"brain.iterations\" = 20 }]\n",
    );
    assert_eq!(shown(&some), ["2 1 36 6", "2 1 36 6", "2 1 48 8"]);
}

/// The first trial is the default only without any hash.
#[test]
fn a_hash_that_names_no_one_trial_is_refused() {
    let bench = Bench::new();
    bench.file("s.toml", SPEC);
    // 18 trials, 16 first digits
    let seeds = "sweep.seeds=[1, 2, 3, 4, 5, 6, 7, 8, 9]";
    let csv = bench.output(&["expand", "s.toml", seeds, "--format", "csv"]);
    let digits: Vec<&str> = csv.lines().skip(1).map(|line| &line[..1]).collect();
    let (_, shared) = digits.iter().enumerate().find(|(i, digit)| digits[..*i].contains(digit)).unwrap();
    let several = format!("s.toml: trial {shared}: several hashes begin with this text: ");
    for (hash, why) in [
        (*shared, &*several),
        ("xyz", "s.toml: trial xyz: no hash begins with this text"),
        ("", "is empty: set the variable in its place, or leave it out"),
    ] {
        let output = bench.metasense(&["body", "modes", "s.toml", seeds, hash]);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{errors}");
        assert!(errors.contains(why), "{errors}");
    }
}

/// Hashes of all committed specs' trials stay the same, because they name trials in existing databases.
#[test]
fn committed_specs_keep_their_hashes() {
    let bench = Bench::new();
    let folders =
        ["sweeps", "claims"].map(|name| format!("{}/../schemas/{name}", env!("CARGO_MANIFEST_DIR")));
    let mut digests = Vec::new();
    let entries = folders.iter().flat_map(|folder| std::fs::read_dir(folder).unwrap());
    for entry in entries.map(|entry| entry.unwrap().path()) {
        let csv = bench.output(&["expand", entry.to_str().unwrap(), "--format", "csv"]);
        let hashes: String = csv.lines().skip(1).map(|line| format!("{}\n", &line[..32])).collect();
        let name = entry.file_stem().unwrap().to_str().unwrap();
        digests.push(format!("{name} {}", &blake3::hash(hashes.as_bytes()).to_hex()[..16]));
    }
    digests.sort();
    insta::assert_snapshot!(digests.join("\n"), @r"
    authors-fig2 3853960b36d29b1b
    authors-fig2-paper 5b4c0542cdd0e27a
    authors-fig3 e9d4d49d13078d1a
    authors-fig4 1a71aa5580a67a94
    authors-fig5 e9ecf93bf79ecb14
    blows-map 1eef528a8e4a55e8
    brains-two-core 5eb82c6f08db37b1
    design-two-core 627aa031480f4f0a
    disc-map 86e8152c5c0b3a8a
    eight-forces-map 7deac9337597129f
    elbow-law 4763b8ca8274ddb3
    families 321c70f108bfbb89
    fig2 bced9d6dd8d54f61
    fig2-linear 3a1cb407e60bff17
    fig3 bf037e6c8d375f84
    fig4b 688de3edf8cea134
    fig4b-until 323a329cfecf88a1
    fig4c cdb6e7edaff7021e
    fig5 a3ec099760be45bd
    filtered cc899af32b8ba722
    four-forces 35a08e9b6ae529b6
    four-forces-map 9183e9432d89c555
    four-forces-map-network 8308d75a3d2616a4
    gradient c39bace70d622cb2
    long-training 656d530cd0c8056b
    placed-two-core 6a5121d9e7f59190
    position-two-core a88b1e3dc86a6f5e
    pressed 02cec997d792791e
    protocol-map 462515f2d2ebde28
    quickstart 1e458c89c51ea0a8
    random 286d45edbe9c1528
    random-bodies-map ba35251987b96fde
    real-scale 5396d9fbc8683175
    reference f69dce36048b28bd
    robust-two-core 31216fdd98101304
    size-map 613e0173fc2de345
    size-map-network ed0a0046ce69f708
    tasks-two-core c139bef0c2a2f47e
    transfer 0b8c88cffe467170
    two-forces 6251ca1d33765752
    who-senses 4c9c563f0b87e50c
    why 911469f71ee3033a
    ");
}

/// Every committed spec, and with it that of every figure, expands into valid trials.
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
        assert!(names.contains(&format!("{figure}.toml")), "{figure} is missing of {names:?}");
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
    let schema: serde_json::Value = serde_json::from_str(&Bench::new().output(&["setup", "schema"])).unwrap();
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

/// Forty trials with very different estimates, about thirteen per shard: the longest shard has at most 1.15 times the mean.
#[test]
fn shards_are_dealt_by_cost() {
    let bench = Bench::new();
    let spec = concat!(env!("CARGO_MANIFEST_DIR"), "/../schemas/sweeps/eight-forces-map.toml");
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
    // costs from one process, because the measured speed varies with the machine's load
    let cost: std::collections::BTreeMap<String, f64> = rows(&[]).into_iter().collect();
    let costs: Vec<f64> = shards.iter().map(|rows| rows.iter().map(|row| cost[&row.0]).sum()).collect();
    let mean = costs.iter().sum::<f64>() / 3.0;
    assert!(costs.iter().all(|cost| *cost <= 1.15 * mean), "{costs:?}");
    assert_eq!(shards.iter().map(Vec::len).sum::<usize>(), rows(&[]).len());
}

/// Mass and natural frequencies are printed; 10¹¹ times the mass or stiffness gives a warning.
#[test]
fn a_body_that_cannot_be_meant_is_warned_of() {
    let bench = Bench::new();
    bench.file("s.toml", TINY);
    let said = |more: &str| {
        let output = bench.metasense(&["expand", "s.toml", more]);
        assert!(output.status.success());
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let usual = said("sweep.seeds=[1]");
    assert!(usual.contains("mass of a body") && usual.contains(" Hz (damping ratio "), "{usual}");
    assert!(!usual.contains("warning"), "{usual}");
    for more in ["body.density=1e3", "body.stiffness={ stretch = 3e20, shear = 5e19, bend = 1e20 }"] {
        let warned = said(more);
        assert!(warned.contains("warning: ") && warned.contains("body.density"), "{more}: {warned}");
    }
}

/// What is possible but may not be meant: the plan stays as it is.
#[test]
fn what_may_not_be_meant_is_warned_of() {
    let bench = Bench::new();
    bench.file("s.toml", TINY);
    let small = ["body.columns=3", "body.rows=3", "sweep.sensors=[1]", "sweep.placements=4"];
    for (changes, expected) in [
        (&small[..], "warning: sweep.placements: 4 placements of 1 sensor are only 1 distinct set of units"),
        (&["sensors.relative_to={ random = 1 }"], "warning: sensors.relative_to: has no effect"),
        (&["time.duration=86400.0"], "warning: stimuli: no training sample has a force; check stimuli.onset"),
        (&["optimise.iterations=1"], "warning: optimise.iterations = 1: the body is not trained"),
        (&["stimuli.onset=[0.0, 0.2]"], "warning: stimuli.onset: pulses may start at 0.2 s, after the end"),
        (
            &["body.contact={ cutoff_angle = 179.0 }"],
            "no natural frequencies: body.contact: parts of the body",
        ),
        (
            &["body.columns=40", "body.rows=40"],
            "natural frequencies are not computed for bodies of more than",
        ),
    ] {
        let output = bench.metasense(&[&["expand", "s.toml"], changes].concat());
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && said.contains(expected), "{changes:?}: {said}");
    }
    let said = String::from_utf8_lossy(&bench.metasense(&["expand", "s.toml"]).stderr).into_owned();
    assert!(!said.contains("warning"), "{said}");
}
