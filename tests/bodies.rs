//! Bodies of units other than squares: lattices by name and polygons from a file, from the spec to exports.

use crate::common::{Bench, TINY};

const LATTICE: &str = "columns = 4\nrows = 4\nspacing = 15.0\nligament_length = 2.25\n";
const DISC: &str =
    "layout = \"circular\"\ncolumns = 5\ndiameter = 75.0\nspacing = 15.0\nligament_length = 2.25\n";

/// A triangle that is clamped, a square with a sensor, and a square with a panel.
const MINE: &str = "units = [
  [[0, 0], [14, 2], [5, 12]],
  [[16, 0], [28, 1], [27, 11], [17, 12]],
  [[6, 15], [15, 14], [20, 21], [9, 27]],
]
ligaments = [[0, 1, 1, 0], [0, 2, 2, 0], [1, 3, 2, 1]]
clamp = [0]
panels = [{ unit = 2, direction = [1, -1] }]
sensors = [1]
";

fn linear(body: &str) -> String {
    let spec = TINY.replace(LATTICE, body).replace("iterations = 10\nwidth = 16\n", "kind = \"linear\"\n");
    let short =
        spec.replace("duration = 0.2", "duration = 0.1").replace("onset = [0.0, 0.1]", "onset = [0.0, 0.02]");
    short.replace("sensors = [1, 2]", "sensors = [1]")
}

/// Each lattice, as a sheet and as a disc, is drawn, trained, reported, exported and passed to all `body` commands. The trained
/// design is feasible, and each has its own hash.
#[test]
fn every_lattice_runs_from_the_spec_to_the_mould() {
    let bench = Bench::new();
    let mut hashes = std::collections::BTreeSet::new();
    bench.file("v.toml", "[variation]\nnodes = 0.05\n");
    for (lattice, outline, units, corners) in [
        ("square", LATTICE, 16, 4),
        ("kagome", LATTICE, 16, 3),
        ("triangular", LATTICE, 16, 6),
        ("chiral", LATTICE, 16, 4),
        ("kagome", DISC, 13, 3),
        ("triangular", DISC, 19, 6),
        ("chiral", DISC, 21, 4),
    ] {
        let own = format!("lattice = \"{lattice}\"\n{outline}");
        let tied = linear(&own).replace("[optimise]\n", "[optimise]\ntie = [2, 1]\n");
        bench.file("s.toml", &if outline == DISC { tied } else { linear(&own) });
        let csv = bench.output(&["expand", "s.toml", "--format", "csv"]);
        let trial = csv.lines().nth(1).unwrap().split(',').next().unwrap().to_owned();
        bench.output(&["run", "s.toml", "--db", "s.sqlite"]);
        for format in ["npz", "svg", "dxf", "stl"] {
            let out = format!("{lattice}.{format}");
            bench.output(&["export", "s.sqlite", &trial, "--format", format, "--out", &out]);
        }
        let svg = std::fs::read_to_string(bench.path(&format!("{lattice}.svg"))).unwrap();
        let points = |polygon: &str| {
            polygon.split("points=\"").nth(1).unwrap().split('"').next().unwrap().split(' ').count()
        };
        let drawn: Vec<usize> = svg.split("<polygon class=\"unit").skip(1).map(points).collect();
        assert_eq!(drawn, vec![corners; units], "{own}");
        bench.output(&["body", "casts", "s.sqlite", &trial[..8], "--casts", "2", "--variation", "v.toml"]);
        for asked in [
            &["body", "place", "s.toml", "--out", "p.svg"][..],
            &["body", "modes", "s.toml", "--count", "3", "--out", "m.svg"],
            &["body", "bound", "s.toml", "--samples", "1", "--noise", "0.05"],
        ] {
            bench.output(asked);
        }
        hashes.insert(trial);
    }
    assert_eq!(hashes.len(), 7, "{hashes:?}");
    assert_eq!(bench.output(&["body", "operator", "s.sqlite", "--format", "csv"]).lines().count(), 1 + 2 * 7);
    bench.output(&["report", "s.sqlite", "--out", "report.html"]);
    let done = bench.output(&[
        "query",
        "s.sqlite",
        "SELECT count(*) FROM trial WHERE state = 'done'",
        "--format",
        "csv",
    ]);
    assert!(done.contains('7'), "{done}");
}

/// The contents of a body file define the trial: another file name keeps the hash, another corner changes it, and the file may be
/// removed.
#[test]
fn a_body_from_a_file_is_what_it_holds() {
    let bench = Bench::new();
    let spec = linear("file = \"mine.body.toml\"\n").replace("panels = [2]", "panels = [1]");
    let hash = |bench: &Bench, spec: &str| {
        bench.file("s.toml", spec);
        let csv = bench.output(&["expand", "s.toml", "--format", "csv"]);
        csv.lines().nth(1).unwrap().split(',').next().unwrap().to_owned()
    };
    bench.file("mine.body.toml", MINE);
    bench.file("other.body.toml", MINE);
    let mine = hash(&bench, &spec);
    assert_eq!(mine, hash(&bench, &spec.replace("mine.body", "other.body")));
    bench.file("other.body.toml", &MINE.replace("[28, 1]", "[28, 2]"));
    assert_ne!(mine, hash(&bench, &spec.replace("mine.body", "other.body")));

    bench.file("s.toml", &spec);
    let drawn = bench.output(&["body", "draw", "s.toml", "--out", "a.svg", "--design-out", "a.csv"]);
    assert!(drawn.contains("3 units, 8 shifts: feasible"), "{drawn}");
    let nodes = std::fs::read_to_string(bench.path("a.csv")).unwrap();
    assert_eq!(nodes.lines().count(), 1 + 3 + 4 + 4);
    assert!(nodes.contains("\n1,1,28,1\n"), "{nodes}");
    // a table of corners is a design
    bench.file("b.csv", &nodes.replace("\n1,1,28,1\n", "\n1,1,28.5,1\n"));
    let drawn = bench.output(&["body", "draw", "s.toml", "--design", "b.csv", "--out", "b.svg"]);
    assert!(drawn.contains(" 0 violated"), "{drawn}");

    bench.output(&["run", "s.toml", "--db", "s.sqlite"]);
    std::fs::remove_file(bench.path("mine.body.toml")).unwrap();
    bench.output(&["export", "s.sqlite", &mine, "--format", "npz", "--out", "m.npz"]);
    bench.output(&["export", "s.sqlite", &mine, "--format", "stl", "--out", "m.stl"]);
    bench.file("v.toml", "[variation]\nnodes = 0.05\n");
    bench.output(&["body", "casts", "s.sqlite", &mine[..8], "--casts", "2", "--variation", "v.toml"]);
}

/// A force on a node, a couple on the same unit and a shaken base are drawn, trained and reported, and told apart by six channels.
#[test]
fn forces_act_on_nodes_and_turn_units() {
    let bench = Bench::new();
    let panels = "[{ unit = 13, node = 0, direction = [-1, 0] }, { unit = 13, couple = 5 }, { base = 1e-4, direction = [1, 0] }]";
    let spec = linear(&format!("{LATTICE}panels = {panels}\n")).replace("sensors = [1]", "sensors = [2]");
    let spec = spec.replace("[sweep]\npanels = [2]", "[sweep]\npanels = [3]");
    bench.file("s.toml", &spec.replace("samples = 8", "samples = 40"));
    bench.output(&["body", "draw", "s.toml", "--out", "a.svg"]);
    let svg = std::fs::read_to_string(bench.path("a.svg")).unwrap();
    for panel in ["panel 0: unit 13", "panel 1: unit 13", "panel 2: unit 0"] {
        assert_eq!(svg.matches(panel).count(), 1, "{panel}");
    }
    bench.output(&["run", "s.toml", "--db", "s.sqlite"]);
    let sql = "SELECT holdout_error_initial < 50, holdout_error_optimised < 50 FROM v_trial";
    assert_eq!(bench.output(&["query", "s.sqlite", sql, "--format", "csv"]).lines().nth(1), Some("1,1"));
    bench.output(&["report", "s.sqlite", "--out", "report.html"]);
}

/// Invalid contents of a body file are refused with spec, line, file and place.
#[test]
fn a_body_that_cannot_be_is_refused_with_its_place() {
    let bench = Bench::new();
    let spec = linear("file = \"bad.body.toml\"\n").replace("panels = [2]", "panels = [1]");
    bench.file("s.toml", &spec);
    for (from, to, expected) in [
        (
            "[14, 2], [5, 12]",
            "[5, 12], [14, 2]",
            "s.toml:3: body.file = \"bad.body.toml\", units[0]: its nodes must run counter-clockwise",
        ),
        ("[0, 1, 1, 0]", "[0, 1, 1, 9]", "ligaments[0] = [0, 1, 1, 9]: unit 1 has no node 9"),
        ("[0, 2, 2, 0], [1, 3, 2, 1]", "[0, 2, 1, 3]", "units[2]: is not connected"),
        ("[16, 0], [28, 1]", "[9, 4], [28, 1]", "\n  units 0 and 1 overlap"),
        ("[27, 11], [17, 12]", "[17, 12], [27, 11]", "unit 1: its edges cross"),
        ("clamp = [0]", "clamp = [0, 3]", "clamp: 3: the units are 0 to 2"),
        ("unit = 2,", "unit = 3,", "panels[0]: unit 3 does not exist: the units are 0 to 2"),
        ("clamp", "clamps", "bad.body.toml: TOML parse error at line 7"),
    ] {
        assert!(MINE.contains(from), "{from}");
        bench.file("bad.body.toml", &MINE.replace(from, to));
        let refused = bench.metasense(&["run", "s.toml", "--db", "s.sqlite"]);
        let said = String::from_utf8_lossy(&refused.stderr);
        assert!(refused.status.code() == Some(2) && said.contains(expected), "{to}: {said}");
    }
    bench.file("bad.body.toml", MINE);
    bench.file("s.toml", &spec.replace("file = ", "columns = 3\nfile = "));
    let refused = bench.metasense(&["run", "s.toml", "--db", "s.sqlite"]);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(said.contains("body.columns = 3: cannot be set together with body.file"), "{said}");
    assert!(!bench.path("s.sqlite").exists(), "nothing was started");
}
