use super::*;
use metasense_numerics::body::Pattern;
use metasense_numerics::dynamics::{Panel, PrescribedMotion, Strike};
use metasense_numerics::random::Purpose;
use metasense_numerics::stimuli::point;
use metasense_schemas::spec::{Brain, Evaluation, Feasible, Optimise, Sensors, Solver, Time};
use serde_json::{Value, json};

/// The reference scene, with some keys changed.
pub(crate) fn trial(changes: &[(&str, Value)]) -> TrialSpec {
    let mut spec = json!({
        "body": {
            "columns": 6, "rows": 6, "spacing": 15.0, "ligament_length": 2.25, "density": 1e-8,
            "stiffness": { "stretch": 3.0, "shear": 0.5, "bend": 1.0 },
        },
        "time": Time::default(),
        "solver": Solver::default(),
        "sensors": Sensors::default(),
        "stimuli": { "kind": "bell" },
        "brain": Brain::default(),
        "optimise": Optimise::default(),
        "evaluation": Evaluation::default(),
        "feasible": Feasible::default(),
        "point": { "panels": 2, "sensors": 1, "placement": 0, "seed": 1 },
        "panel_units": [31, 34], "sensor_units": [21],
    });
    for (key, value) in changes {
        let path = format!("/{}", key.replace('.', "/"));
        let (parent, name) = path.rsplit_once('/').unwrap();
        match spec.pointer_mut(parent).unwrap() {
            Value::Array(list) => list[name.parse::<usize>().unwrap()] = value.clone(),
            table => table[name] = value.clone(),
        }
    }
    serde_json::from_value(spec).unwrap()
}

/// Degrees become radians, the bottom row is clamped, panels push down.
#[test]
fn the_reference_scene_is_a_problem() {
    let problem = problem(&trial(&[])).unwrap();
    assert_eq!(problem.scene.clamped, [0, 1, 2, 3, 4, 5]);
    assert_eq!(problem.scene.panels[1], Panel::central(34, [0.0, -1.0]));
    assert_eq!(problem.initial.len(), 168);
    assert!((problem.limits.min_block_angle - 25f64.to_radians()).abs() < 1e-15);
}

/// Each change makes the spec invalid, and the error names its key.
#[test]
fn an_impossible_value_is_named_by_its_key() {
    let cases = [
        ("body.rows", json!(1), "body.rows"),
        ("body.rows", Value::Null, "body.rows"),
        ("body.columns", json!(0), "body.columns"),
        ("body.spacing", json!(-15.0), "body.spacing"),
        ("body.ligament_length", json!(15.0), "body.ligament_length"),
        ("body.initial_angle", json!(50.0), "body.initial_angle"),
        ("body.initial_angle", json!(44.0), "body.initial_angle"),
        ("body.density", json!(0.0), "body.density"),
        ("body.damping_ratio", json!(-0.1), "body.damping_ratio"),
        ("body.stiffness.shear", json!(-0.5), "body.stiffness.shear"),
        ("body.contact", json!({ "stiffness": -1.0 }), "body.contact.stiffness"),
        // accepted when read from databases, but not run
        ("body.contact", json!({ "min_angle": 6.0 }), "body.contact.min_angle"),
        ("body.contact", json!({ "min_angle": 60.0, "cutoff_angle": 179.0 }), "body.contact.min_angle"),
        ("body.clamp", json!("hub"), "body.clamp"),
        ("body.clamp", json!([3, 3]), "body.clamp"),
        ("body.clamp", json!([99]), "body.clamp"),
        ("time.samples", json!(0), "time.samples"),
        ("time.duration", json!(0.0), "time.duration"),
        ("solver.tolerance", json!(0.0), "solver.tolerance"),
        ("stimuli.test", json!(470), "stimuli.test"),
        ("stimuli.holdout", json!(0), "stimuli.holdout"),
        ("stimuli.width", json!([0.0, 0.1]), "stimuli.width"),
        ("stimuli.peak", json!([0.5, 1.0]), "stimuli.peak"),
        ("stimuli.amplitude", json!([0.5, 0.1]), "stimuli.amplitude"),
        ("brain.iterations", json!(0), "brain.iterations"),
        ("brain.learning_rate", json!(-1.0), "brain.learning_rate"),
        ("brain.width", json!(0), "brain.width"),
        ("brain.width", json!(1025), "brain.width"),
        ("brain.kernels", json!([3]), "brain.kernels"),
        ("brain.kernels", json!(vec![1; 17]), "brain.kernels"),
        ("brain.kernels", json!([3, 0, 1]), "brain.kernels"),
        ("brain.kernels", json!([3, 4, 1]), "brain.kernels"),
        ("brain.kernels", json!([401, 1]), "brain.kernels"),
        ("brain.dilations", json!([1, 1]), "brain.dilations"),
        ("brain.dilations", json!([1, 0, 1]), "brain.dilations"),
        ("brain.dilations", json!([1, 200, 1]), "brain.dilations"),
        ("brain.dilations", json!([1, u64::MAX, 1]), "brain.dilations"),
        ("optimise.learning_rate", json!(0.0), "optimise.learning_rate"),
        ("optimise.batch", json!(8), "optimise.batch"),
        ("optimise.brain_iterations", json!(8), "optimise.brain_iterations"),
        ("evaluation.seeds", json!(0), "evaluation.seeds"),
        ("evaluation.batch", json!(0), "evaluation.batch"),
        ("evaluation.long_iterations", json!(0), "evaluation.long_iterations"),
        ("feasible.min_block_angle", json!(95.0), "feasible.min_block_angle"),
        ("feasible.max_block_angle", json!(90.0), "feasible.max_block_angle"),
        ("feasible.clearance", json!(-1.0), "feasible.clearance"),
        ("panel_units.0", json!(2), "body.panel_units"),
        ("panel_units.0", json!(34), "body.panel_units"),
        ("panel_units", json!([31]), "sweep.panels"),
        ("sensor_units", json!([40]), "sensors.placements"),
        ("point.sensors", json!(20), "sweep.sensors"),
    ];
    for (key, value, named) in cases {
        let paper = ("optimise.protocol", json!("paper"));
        match problem(&trial(&[paper, (key, value.clone())])) {
            Ok(_) => panic!("{key} = {value} was taken"),
            Err(invalid) => assert_eq!(invalid.key, named, "{key} = {value}: {invalid}"),
        }
    }
}

/// Presets, their overrides, and invalid combinations.
#[test]
fn the_network_is_as_the_spec_says() {
    let network = |changes: &[(&str, Value)]| {
        problem(&trial(changes)).map(|problem| problem.shape().architecture).map_err(|invalid| invalid.key)
    };
    let (long, causal) = (("brain.preset", json!("long")), ("brain.causal", json!(true)));
    let of = |width, kernels: &[usize], dilations: &[usize], causal| {
        Ok(Architecture::new(width, kernels, dilations, causal))
    };
    assert_eq!(network(&[]), Ok(Architecture::paper(64)));
    assert_eq!(network(&[("brain.preset", json!("paper"))]), Ok(Architecture::paper(64)));
    assert_eq!(network(std::slice::from_ref(&long)), of(24, &[9, 9, 9, 1], &[1, 4, 16, 1], false));
    let wide = [long.clone(), ("brain.width", json!(1024)), causal.clone()];
    assert_eq!(network(&wide), Err("brain.width".into()), "15 million weights");
    let narrow = [long.clone(), ("brain.width", json!(7)), causal.clone()];
    assert_eq!(network(&narrow), of(7, &[9, 9, 9, 1], &[1, 4, 16, 1], true));
    let even = ("brain.kernels", json!([4, 2, 3, 1, 1]));
    assert_eq!(network(&[even.clone(), causal.clone()]), of(64, &[4, 2, 3, 1, 1], &[1; 5], true));
    assert_eq!(network(&[even, causal, long.clone()]), Err("brain.dilations".into()));
    // causal kernels reach twice as far back
    let far = [("brain.kernels", json!([3, 1])), ("brain.dilations", json!([199, 1]))];
    assert!(network(&far).is_ok());
    assert_eq!(
        network(&[&far[..], &[("brain.causal", json!(true))]].concat()),
        Err("brain.dilations".into())
    );
    assert_eq!(network(&[long, ("time.samples", json!(32))]), Err("brain.dilations".into()));
}

/// Keys that the protocol does not use are rejected.
#[test]
fn each_protocol_refuses_the_keys_of_the_others() {
    for (protocol, key, value) in [
        ("joint", "optimise.gradient", json!("direct")),
        ("random", "optimise.batch", json!(8)),
        ("paper", "optimise.brain_learning_rate", json!(1e-3)),
    ] {
        let invalid = problem(&trial(&[("optimise.protocol", json!(protocol)), (key, value)])).unwrap_err();
        assert_eq!(invalid.key, key, "{protocol}");
    }
    for protocol in ["paper", "joint", "random"] {
        problem(&trial(&[("optimise.protocol", json!(protocol))])).unwrap();
    }
}

/// Circular bodies of every lattice are clamped at the hub, forces act inward, and sensor candidates are other units.
#[test]
fn a_circular_body_is_struck_inward() {
    let angle = 25f64.to_radians();
    let patterns = [
        ("square", Pattern::square()),
        ("kagome", Pattern::kagome()),
        ("triangular", Pattern::triangular(angle)),
        ("chiral", Pattern::chiral(angle)),
    ];
    for ((lattice, pattern), across) in patterns.iter().flat_map(|of| [(of, 6), (of, 7)]) {
        let layout = Layout::circular(pattern, across, 15.0, 2.25);
        let panels: Vec<usize> = layout.circular_panels(4).unwrap().iter().map(|p| p.0).collect();
        let problem = problem(&trial(&[
            ("body.layout", json!("circular")),
            ("body.lattice", json!(lattice)),
            ("body.columns", json!(across)),
            ("body.rows", Value::Null),
            ("point.panels", json!(4)),
            ("panel_units", json!(panels)),
            ("sensor_units", json!([])),
            ("sensors.search", json!("greedy")),
            ("sensors.from", json!("free")),
        ]))
        .unwrap();
        let what = format!("{lattice}, {across}");
        assert_eq!(problem.scene.clamped, layout.hub(), "{what}");
        let candidates = problem.search.unwrap().candidates;
        assert_eq!(candidates.len(), layout.units() - layout.hub().len(), "{what}");
        assert!(layout.hub().iter().all(|unit| !candidates.contains(unit)), "{what}");
        assert_eq!(problem.scene.layout, layout, "{what}");
        for panel in &problem.scene.panels {
            let [x, y] = layout.centres[panel.unit];
            let inward = -(x * panel.direction[0] + y * panel.direction[1]) / x.hypot(y);
            assert!(inward > 0.9, "{what}, unit {}: {inward}", panel.unit);
        }
    }
}

/// Offsets and angles of blows do not change force histories. They are normal with mean 0, independent of each other and of the
/// kind of stimuli, and differ between samples, panels and purposes. Each part of a mixture has its own.
#[test]
fn blows_miss_the_centroid_and_the_direction() {
    let of = |stimuli: Value| problem(&trial(&[("stimuli", stimuli)])).unwrap();
    let problems = [
        json!({ "kind": "bell" }),
        json!({ "kind": "bell", "offset": 2.0 }),
        json!({ "kind": "bell", "offset": 2.0, "angle": 5.0 }),
        json!({ "kind": "mix", "mix": [
            { "weight": 0.5, "kind": "bell" }, { "weight": 0.5, "kind": "irregular", "offset": 2.0, "angle": 5.0 },
        ] }),
    ]
    .map(of);
    let panels = &problems[0].scene.panels;
    let mut misses: Vec<Vec<[f64; 2]>> = Vec::new();
    for purpose in [Purpose::Stimulus, Purpose::Holdout, Purpose::Fresh] {
        let [none, off, both, mixed] = problems.each_ref().map(|p| p.forces(purpose, 0, 400));
        assert!(none.strikes.is_empty() && none.values == off.values && none.values == both.values);
        let miss = |n: usize, [x, y, arm]: Strike| {
            let [p, q] = panels[n % panels.len()].direction;
            let (along, across) = (p * x + q * y, p * y - q * x);
            assert!((along.hypot(across) - 1.0).abs() < 1e-14);
            [-arm / along, across.atan2(along).to_degrees()]
        };
        let of = |strikes: &[Strike]| -> Vec<[f64; 2]> {
            strikes.iter().enumerate().map(|(n, strike)| miss(n, *strike)).collect()
        };
        let [straight, askew] = [of(&off.strikes), of(&both.strikes)];
        let same = |(a, b): (&[f64; 2], &[f64; 2])| (a[0] - b[0]).abs() < 1e-12 && a[1].abs() < 1e-12;
        assert!(straight.iter().zip(&askew).all(same), "offsets depend on the angles");
        for (d, asked) in [2.0, 5.0].into_iter().enumerate() {
            let n = askew.len() as f64;
            let mean = askew.iter().map(|miss| miss[d]).sum::<f64>() / n;
            let size = (askew.iter().map(|miss| miss[d].powi(2)).sum::<f64>() / n).sqrt();
            // four standard errors
            assert!(mean.abs() < 4.0 * asked / n.sqrt(), "{purpose:?}: mean {mean}");
            assert!((size / asked - 1.0).abs() < 4.0 / (2.0 * n).sqrt(), "{purpose:?}: {size} of {asked}");
        }
        let product = askew.iter().map(|miss| miss[0] * miss[1]).sum::<f64>() / askew.len() as f64;
        assert!(product.abs() < 4.0 * 10.0 / (askew.len() as f64).sqrt(), "offset and angle go together");
        assert_eq!(problems[2].forces(purpose, 7, 1), both.select(&[7]));
        let blows = (0..400).filter(|&i| mixed.sample(i) != none.sample(i)).count();
        let struck = (0..400).filter(|&i| mixed.select(&[i]).strikes == both.select(&[i]).strikes).count();
        let centred = |n: &usize| mixed.strikes[*n] == panels[n % panels.len()].straight();
        assert_eq!((struck, (0..800).filter(centred).count()), (blows, 2 * (400 - blows)));
        misses.push(askew);
    }
    assert!(misses[0] != misses[1] && misses[1] != misses[2], "purposes share their draws");
}

/// `body.panels` sets where each force acts; several may act on one unit.
#[test]
fn forces_act_where_the_list_of_panels_says() {
    let with = |list: Value, units: Value| {
        problem(&trial(&[("body.panels", list), ("panel_units", units)])).map(|problem| problem.scene.panels)
    };
    let list = json!([
        { "unit": 34, "node": 1, "direction": [3, -4], "at": [0.5, 0] },
        { "unit": 34, "couple": -5 },
    ]);
    let node = Panel { node: Some(1), moment: -0.4, ..Panel::central(34, [0.6, -0.8]) };
    let couple = Panel { moment: -5.0, ..Panel::central(34, [0.0; 2]) };
    assert_eq!(with(list, json!([34, 34])).unwrap(), [node, couple]);
    // the base is represented by the first held unit
    let list = json!([{ "base": 1e-5, "direction": [1, 0] }, { "unit": 34 }]);
    let shaken = Panel { moves: Some(PrescribedMotion::Base(1e-5)), ..Panel::central(0, [1.0, 0.0]) };
    assert_eq!(with(list, json!([0, 34])).unwrap(), [shaken, Panel::central(34, [0.0, -1.0])]);
    let list = json!([{ "base": 1e-5, "unit": 31, "direction": [1, 0] }, { "unit": 34 }]);
    let driven = Panel { moves: Some(PrescribedMotion::Unit(1e-5)), ..Panel::central(31, [1.0, 0.0]) };
    assert_eq!(with(list, json!([31, 34])).unwrap(), [driven, Panel::central(34, [0.0, -1.0])]);
    for (list, place, remedy) in [
        (json!([{ "direction": [1, 0] }]), "panels[0]", "unit must be given"),
        (json!([{ "base": 0 }]), "panels[0]", "a mass above 0"),
        (json!([{ "base": 1e-5, "unit": 34, "node": 1 }]), "panels[0]", "cannot be combined with node"),
        (json!([{ "base": 1e-5, "unit": 2 }]), "panels[0]", "leave it out of body.clamp"),
        (json!([{ "base": 1e-5, "unit": 36 }]), "panels[0]", "unit 36 does not exist"),
        (json!([{ "unit": 34 }, { "base": 1e-5, "unit": 34 }]), "panels[0]", "moves as panels[1] prescribes"),
        (json!([{ "unit": 36 }]), "panels[0]", "units are 0 to 35"),
        (json!([{ "unit": 34 }, { "unit": 34, "node": 4 }]), "panels[1]", "from 0 to 3"),
        (json!([{ "unit": 34, "direction": [0, 0] }]), "panels[0]", "not zero"),
        (json!([{ "unit": 34, "couple": 0 }]), "panels[0]", "not zero"),
        (json!([{ "unit": 34, "couple": 2, "node": 1 }]), "panels[0]", "couple cannot be combined"),
        (json!([{ "unit": 34 }, { "unit": 31 }, { "unit": 34 }]), "panels[2]", "repeats panels[0]"),
        (json!([{ "unit": 2 }, { "unit": 34 }]), "2", "is clamped"),
    ] {
        let unit = |struck: &Value| struck.get("unit").cloned().unwrap_or(json!(0));
        let units: Vec<Value> = list.as_array().unwrap().iter().map(unit).collect();
        let refused = with(list, json!(units)).unwrap_err();
        assert_eq!((refused.key.as_str(), refused.value.as_str()), ("body.panels", place));
        assert!(refused.remedy.contains(remedy), "{refused:?}");
    }
}

/// Compression moves held units towards the middle between the outermost; units there stay.
#[test]
fn compression_moves_what_is_held() {
    let with = |keys: &[(&'static str, Value)]| problem(&trial(keys)).map(|problem| problem.scene);
    let sides = ("body.clamp", json!("sides"));
    let scene = with(&[sides.clone(), ("body.compression", json!([0.1, -0.02]))]).unwrap();
    assert_eq!(scene.clamped, [0, 5, 6, 11, 12, 17, 18, 23, 24, 29, 30, 35]);
    let near = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]) < 1e-12;
    assert!(near(scene.imposed[0], [3.75, -0.75]) && near(scene.imposed[11], [-3.75, 0.75]), "{scene:?}");
    // in every row, shifted by half a cell or not
    for (lattice, rows) in [("kagome", 3), ("triangular", 4), ("chiral", 4)] {
        let sheet = [
            sides.clone(),
            ("body.lattice", json!(lattice)),
            ("body.rows", json!(rows)),
            ("body.initial_angle", json!(12.0)),
        ];
        let body = trial(&sheet).body;
        let layout = layout(&body).unwrap();
        let held = clamped(&body, &layout).unwrap();
        let of_row = |row: i32| held.iter().filter(|unit| layout.grid[**unit][1] == row).count();
        assert!((0..rows).all(|row| of_row(row) == 2), "{lattice}: {held:?}");
    }
    let ends = with(&[("body.clamp", json!("ends")), ("panel_units", json!([6, 23]))]);
    assert!(ends.is_ok_and(|scene| scene.clamped.len() == 12 && scene.imposed.is_empty()));
    let refused = [
        (vec![("body.compression", json!([0.0, 0.1]))], "body.compression", "all held units have the same y"),
        (
            vec![sides.clone(), ("body.compression", json!([0.6, 0.0]))],
            "body.compression",
            "from -0.5 to 0.5",
        ),
        (vec![("body.clamp", json!("ends"))], "body.clamp", "holds unit 31, on which a panel acts"),
        (
            vec![("body.clamp", json!("ends")), ("panel_units", json!([32, 34]))],
            "body.panel_units",
            "is clamped",
        ),
        (
            vec![("body.layout", json!("circular")), ("body.rows", Value::Null), sides],
            "body.clamp",
            "for a circular body",
        ),
    ];
    for (keys, key, remedy) in refused {
        let fault = with(&keys).unwrap_err();
        assert!(fault.key == key && fault.remedy.contains(remedy), "{fault:?}");
    }
}

/// Guides hold only units that no clamp holds; compression moves them in their held coordinates.
#[test]
fn guides_hold_units_in_part() {
    let with = |keys: &[(&'static str, Value)]| problem(&trial(keys)).map(|problem| problem.scene);
    let sides = json!([{ "units": "sides", "holds": ["x"] }, { "units": [6, 14], "holds": ["turn"] }]);
    let scene = with(&[("body.guides", sides.clone())]).unwrap();
    let side = |unit: usize| [true, false, unit == 6];
    let mut known: Vec<_> = [6, 11, 12, 17, 18, 23, 24, 29, 30, 35].map(|unit| (unit, side(unit))).to_vec();
    known.insert(3, (14, [false, false, true]));
    assert_eq!((scene.guided.clone(), scene.clamped.len()), (known, 6));
    // clamped units move with those held along x; the unit in the middle stays
    let free = [("body.guides", sides), ("body.clamp", json!([2])), ("body.compression", json!([0.1, 0.0]))];
    let scene = with(&free).unwrap();
    let ways: Vec<f64> = scene.imposed.iter().map(|way| way[0]).collect();
    let near = |k: usize, way: f64| (ways[k] - way).abs() < 1e-12;
    assert!(near(0, 0.75) && near(1, 3.75) && near(2, -3.75) && near(6, 0.0), "{ways:?} {:?}", scene.guided);
    assert!(scene.imposed.iter().all(|way| way[1] == 0.0));
    let none = ("body.clamp", json!([]));
    let rollers = |units: Value, holds: Value| ("body.guides", json!([{ "units": units, "holds": holds }]));
    let press = ("body.compression", json!([0.1, 0.0]));
    let base = json!([{ "base": 1e-5, "direction": [1, 0] }, { "unit": 34 }]);
    let shaken = [("body.panels", base), ("panel_units", json!([0, 34]))];
    for (keys, key, remedy) in [
        (vec![rollers(json!([9]), json!([]))], "body.guides", "must name"),
        (vec![rollers(json!([9]), json!(["x", "x"]))], "body.guides", "each once"),
        (vec![rollers(json!([]), json!(["x"]))], "body.guides", "must contain a unit"),
        (vec![rollers(json!([9]), json!(["x", "y", "turn"]))], "body.guides", "body.clamp"),
        (vec![rollers(json!([0]), json!(["x"]))], "body.guides", "is clamped"),
        (vec![rollers(json!([99]), json!(["x"]))], "body.guides", "units are 0 to 35"),
        (vec![rollers(json!("hub"), json!(["x"]))], "body.guides", "for a planar body"),
        (vec![rollers(json!([31]), json!(["y"]))], "body.guides", "the force on this unit"),
        (vec![none.clone(), rollers(json!("sides"), json!(["x"])), press], "body.compression", "as a whole"),
        (
            [vec![none.clone(), rollers(json!("sides"), json!(["x"]))], shaken.to_vec()].concat(),
            "body.panels",
            "as a whole",
        ),
    ] {
        let fault = with(&keys).unwrap_err();
        assert!(fault.key == key && fault.remedy.contains(remedy), "{fault:?}");
    }
    // two rollers and a slot prevent all rigid motion
    let three = json!([{ "units": [0], "holds": ["x", "y"] }, { "units": [5], "holds": ["y"] }]);
    let scene = with(&[none.clone(), ("body.guides", three)]).unwrap();
    assert!(!scene.is_loose() && scene.clamped.is_empty());
    let parallel = json!([{ "units": [0, 5, 12], "holds": ["y"] }]);
    assert!(with(&[none, ("body.guides", parallel)]).unwrap().is_loose());
}

/// Every sample of a mixture equals that kind's sample of the same number, for every purpose. Frequencies follow the weights, and a
/// sample does not depend on which others are drawn.
#[test]
fn a_mixture_takes_each_sample_from_one_of_its_kinds() {
    let of = |stimuli: Value| problem(&trial(&[("stimuli", stimuli)])).unwrap();
    let mix = of(json!({ "kind": "mix", "mix": [
        { "weight": 0.25, "kind": "bell", "width": [0.1, 0.1] }, { "weight": 0.75, "kind": "irregular" },
    ] }));
    let [bell, blow] =
        [json!({ "kind": "bell", "width": [0.1, 0.1] }), json!({ "kind": "irregular" })].map(of);
    let mut drawn = Vec::new();
    for purpose in [Purpose::Stimulus, Purpose::Holdout, Purpose::Fresh] {
        let [mixed, bells, blows] = [&mix, &bell, &blow].map(|p| p.forces(purpose, 0, 200));
        let bell: Vec<bool> = (0..200).map(|i| mixed.sample(i) == bells.sample(i)).collect();
        assert!((0..200).all(|i| bell[i] || mixed.sample(i) == blows.sample(i)), "{purpose:?}");
        let bells = bell.iter().filter(|bell| **bell).count();
        assert!((32..=68).contains(&bells), "{bells} of 200 pulses at a weight of 0.25, {purpose:?}");
        assert_eq!(mix.forces(purpose, 7, 3).sample(1), mixed.sample(8));
        drawn.push(bell);
    }
    assert!(drawn[0] != drawn[1] && drawn[1] != drawn[2], "purposes share the draw of the kind");
}

/// A blow acts at a point that is uniform along the panels. Its two forces sum to the blow on a single panel, and the label of the
/// position is the point. A sample depends on its number alone, also in a mixture.
#[test]
fn blows_anywhere_are_divided_between_neighbours() {
    let edge = [30, 31, 32, 33, 34];
    let of = |units: &[usize], stimuli: Value| {
        let (panels, units) = (("point.panels", json!(units.len())), ("panel_units", json!(units)));
        problem(&trial(&[panels, units, ("stimuli", stimuli)])).unwrap()
    };
    for kind in ["bell", "gauss", "irregular"] {
        let [one, all] = [(&edge[..1], false), (&edge[..], true)]
            .map(|(units, anywhere)| of(units, json!({ "kind": kind, "anywhere": anywhere })));
        let labeller = all.labeller();
        let [first, last] = [0, 4].map(|k| labeller.points[k]);
        let mut positions = Vec::new();
        for purpose in [Purpose::Stimulus, Purpose::Holdout, Purpose::Fresh] {
            let [blows, forces] = [&one, &all].map(|problem| problem.forces(purpose, 0, 300));
            assert_eq!(all.forces(purpose, 7, 3).sample(1), forces.sample(8));
            for (i, targets) in all.targets(&forces).chunks_exact(all.scene.instants * edge.len()).enumerate()
            {
                let len = forces.instants + 1;
                let sample = forces.sample(i);
                let sum = |n: usize| (0..edge.len()).map(|k| sample[k * len + n]).sum::<f64>();
                assert!((0..len).all(|n| (sum(n) - blows.sample(i)[n]).abs() < 1e-12), "{kind}, {i}");
                let struck = |k: &usize| sample[k * len..][..len].iter().any(|f| *f != 0.0);
                let struck: Vec<usize> = (0..edge.len()).filter(struck).collect();
                assert!(struck.len() == 2 && struck[1] == struck[0] + 1, "{kind}, {i}: {struck:?}");
                let at = point(purpose, 1, i as u64, edge.len());
                let label = labeller.label(SensingTask::Position, targets, 0);
                let found = [0, 1].map(|d| first[d] + 0.25 * at * (last[d] - first[d]));
                assert!((0..2).all(|d| (label[d] - found[d]).abs() < 1e-9), "{kind}: {label:?} {found:?}");
                positions.push(0.25 * at);
            }
        }
        assert_ne!(positions[..300], positions[300..600], "purposes share the draw of the point");
        // Kolmogorov and Smirnov: 1.63/√n is exceeded with probability 1 %
        positions.sort_by(f64::total_cmp);
        let n = positions.len() as f64;
        let gap = |(i, x): (usize, &f64)| (x - i as f64 / n).abs().max((x - (i as f64 + 1.0) / n).abs());
        let distance = positions.iter().enumerate().map(gap).fold(0.0, f64::max);
        assert!(distance < 1.63 / n.sqrt(), "{kind}: {distance}");
    }

    let mix = of(
        &edge,
        json!({ "kind": "mix", "mix": [
        { "weight": 0.5, "kind": "gauss", "anywhere": true }, { "weight": 0.5, "kind": "irregular" },
    ] }),
    );
    let alone = of(&edge, json!({ "kind": "gauss", "anywhere": true }));
    let [mixed, alone] = [&mix, &alone].map(|problem| problem.forces(Purpose::Fresh, 0, 100));
    let same = (0..100).filter(|&i| mixed.sample(i) == alone.sample(i)).count();
    assert_eq!(same, mix.parts_of(Purpose::Fresh, 0, 100).iter().filter(|part| **part == 0).count());
    assert!((30..=70).contains(&same), "{same}");
}

/// Panels on which no force acts are refused.
#[test]
fn blows_anywhere_need_forces() {
    let shaken = json!([{ "unit": 31 }, { "base": 1e-4 }]);
    let invalid = problem(&trial(&[
        ("body.panels", shaken),
        ("panel_units", json!([31, 0])),
        ("stimuli.anywhere", json!(true)),
    ]))
    .unwrap_err();
    assert!(invalid.key == "stimuli.anywhere" && invalid.remedy.contains("base"), "{invalid:?}");
}

/// Each number of an external design has one coefficient per constraint.
#[test]
fn a_constraint_names_no_number_twice() {
    let check = |terms: Value| {
        let description = json!({
            "name": "b", "alpha": [1.0, 2.0], "constraints": [{ "terms": terms, "least": 0.0 }],
            "panels": ["p"], "sensors": ["s"], "channels": ["ax"],
        });
        external::check(&serde_json::from_value(description).unwrap())
    };
    check(json!([[0, 1.0], [1, 1.0]])).unwrap();
    let refused = check(json!([[0, 1.0], [0, 1.0]])).unwrap_err();
    assert!(refused.remedy.contains("distinct"), "{refused}");
}
