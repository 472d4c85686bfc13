//! Designs on the command line: projected, drawn, read from files, generated at random.

use crate::common::{Bench, SPEC};

fn npy(values: &[f64]) -> Vec<u8> {
    let mut head = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({},), }}", values.len());
    head.extend(std::iter::repeat_n(' ', (64 - (11 + head.len()) % 64) % 64));
    head.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((head.len() as u16).to_le_bytes());
    bytes.extend(head.as_bytes());
    bytes.extend(values.iter().flat_map(|x| x.to_le_bytes()));
    bytes
}

/// A spec of a 3 × 3 body; `more` is added to `[body]`.
fn small(more: &str) -> String {
    SPEC.replace("columns = 6\nrows = 6", &format!("columns = 3\nrows = 3\n{more}")).replace("[1, 2]", "[1]")
}

/// The feasible initial body is returned bit for bit; a distorted design is projected.
#[test]
fn any_design_goes_in_and_a_castable_one_comes_out() {
    let bench = Bench::new();
    bench.file("s.toml", &small(""));
    bench.output(&["body", "draw", "s.toml", "--out", "a.svg", "--design-out", "a.npy"]);
    let said = bench.output(&["body", "project", "s.toml", "--design", "a.npy", "--out", "b.npy"]);
    assert!(said.contains("untouched"), "{said}");
    let read = |name: &str| std::fs::read(bench.path(name)).unwrap();
    assert_eq!(read("a.npy"), read("b.npy"));

    let wild: Vec<f64> = (0..48).map(|i| 7.0 * f64::sin(1.7 * f64::from(i * i))).collect();
    std::fs::write(bench.path("wild.npy"), npy(&wild)).unwrap();
    let drawn = bench.output(&["body", "draw", "s.toml", "--design", "wild.npy", "--out", "wild.svg"]);
    assert!(drawn.contains("mm") && drawn.contains('°') && drawn.contains("unit"), "{drawn}");
    let said = bench.output(&["body", "project", "s.toml", "--design", "wild.npy", "--out", "tame.csv"]);
    assert!(said.contains("status    projected") && said.contains("interior angle"), "{said}");
    let drawn = bench.output(&["body", "draw", "s.toml", "--design", "tame.csv", "--out", "tame.svg"]);
    assert!(drawn.contains(" 0 violated"), "{drawn}");
}

/// NaN, infinity and transposed shapes are refused in designs and weights, with the file's name; nothing is written.
#[test]
fn what_is_no_design_is_refused_wherever_one_is_read() {
    let bench = Bench::new();
    bench.file("s.toml", &small(""));
    let mut holed = [0.5; 48];
    holed[7] = f64::NAN;
    std::fs::write(bench.path("nan.npy"), npy(&holed)).unwrap();
    holed[7] = f64::INFINITY;
    std::fs::write(bench.path("inf.npy"), npy(&holed)).unwrap();
    bench.write_array("turned.npy", &[2, 24], &[0.5; 48]);
    bench.output(&["body", "draw", "s.toml", "--out", "a.svg", "--design-out", "a.NPY"]);
    bench.write_array("f.npy", &[1, 2, 201], &[0.0; 402]);
    bench.file("n.csv", &(String::from("unit,node,x,y\n") + &"0,0,NaN,1\n".repeat(36)));
    for file in ["nan.npy", "inf.npy", "turned.npy", "n.csv"] {
        for call in [
            &["body", "draw", "s.toml", "--out", "b.svg", "--design", file][..],
            &["body", "project", "s.toml", "--out", "b.npy", "--design", file],
            &["body", "simulate", "s.toml", "--forces", "f.npy", "--out-dir", "b", "--design", file],
            &["expand", "s.toml", &format!("body.design=\"{file}\"")],
            &["expand", "s.toml", "sensors.noise=0.1", &format!("sensors.relative_to=\"{file}\"")],
        ] {
            let refused = bench.metasense(call);
            let said = String::from_utf8_lossy(&refused.stderr);
            assert!(refused.status.code() == Some(2) && said.contains(file), "{call:?}: {said}");
        }
    }
    assert!(["b.svg", "b.npy", "b"].iter().all(|name| !bench.path(name).exists()));
    // (n/2, 2) is also a valid shape of a design
    let (_, shifts) = bench.array("a.NPY");
    bench.write_array("pairs.npy", &[24, 2], &shifts);
    bench.output(&["body", "project", "s.toml", "--design", "pairs.npy", "--out", "c.npy"]);
    assert_eq!(bench.array("c.npy").1, shifts);
}

/// Projections do not move frozen units. `draw` also refuses a panel that no trial can have.
#[test]
fn what_is_frozen_stays_and_what_cannot_be_is_not_drawn() {
    let bench = Bench::new();
    bench.file("s.toml", &small(""));
    bench.output(&["body", "draw", "s.toml", "--out", "a.svg", "--design-out", "a.csv"]);
    let wild: Vec<f64> = (0..48).map(|i| 7.0 * f64::sin(1.7 * f64::from(i * i))).collect();
    std::fs::write(bench.path("wild.npy"), npy(&wild)).unwrap();
    bench.output(&[
        "body",
        "project",
        "s.toml",
        "optimise.frozen=[4]",
        "--design",
        "wild.npy",
        "--out",
        "b.csv",
    ]);
    let corners = |name: &str, unit: &str| -> Vec<f64> {
        let text = std::fs::read_to_string(bench.path(name)).unwrap();
        let lines = text.lines().filter(|line| line.starts_with(unit));
        lines
            .flat_map(|line| line.split(',').skip(2).map(|x| x.parse().unwrap()).collect::<Vec<_>>())
            .collect()
    };
    let moved = |unit: &str| {
        let both = corners("a.csv", unit).into_iter().zip(corners("b.csv", unit));
        both.map(|(a, b)| f64::abs(a - b)).fold(0.0, f64::max)
    };
    assert!(moved("4,") < 1e-9 && moved("0,") > 1e-3, "{} {}", moved("4,"), moved("0,"));
    for panels in [
        "body.panels=[{ unit = 20 }]",
        "body.panel_units=[20]",
        "sensors.placements=[[20]]",
        "sensors.placements=[[20, 20]]",
    ] {
        let refused =
            bench.metasense(&["body", "draw", "s.toml", "sweep.sensors=[1, 2]", panels, "--out", "c.svg"]);
        let said = String::from_utf8_lossy(&refused.stderr);
        assert!(refused.status.code() == Some(2) && said.contains("20"), "{said}");
    }
    // ties do not affect drawings
    let ties = "sweep.\"optimise.tie\"=[[1, 1], [2, 2]]";
    bench.output(&["body", "draw", "s.toml", ties, "--out", "d.svg"]);
    let refused =
        bench.metasense(&["body", "project", "s.toml", ties, "--design", "wild.npy", "--out", "e.csv"]);
    assert_eq!(refused.status.code(), Some(2), "{}", String::from_utf8_lossy(&refused.stderr));
}

/// In a sweep over bodies, a hash selects the body; without one, all trials must have the same body.
#[test]
fn the_body_is_that_of_the_trial() {
    let bench = Bench::new();
    bench.file("s.toml", &(small("") + "\"body.columns\" = [3, 4]\n"));
    let csv = bench.output(&["expand", "s.toml", "--format", "csv"]);
    let hashes: Vec<&str> = csv.lines().skip(1).map(|line| line.split(',').next().unwrap()).collect();
    for (hash, units) in hashes.iter().zip(["9 units", "12 units"]) {
        let drawn =
            bench.output(&["body", "draw", "s.toml", &hash[..8], "--out", "a.svg", "--design-out", "a.npy"]);
        assert!(drawn.contains(units), "{drawn}");
        let said =
            bench.output(&["body", "project", "s.toml", &hash[..8], "--design", "a.npy", "--out", "b.npy"]);
        assert!(said.contains("untouched"), "{said}");
    }
    for call in [
        &["body", "draw", "s.toml", "--out", "c.svg"][..],
        &["body", "project", "s.toml", "--design", "a.npy", "--out", "c.npy"],
    ] {
        let refused = bench.metasense(call);
        let said = String::from_utf8_lossy(&refused.stderr);
        assert!(refused.status.code() == Some(2) && said.contains(" HASH"), "{call:?}: {said}");
    }
    let refused = bench.metasense(&["body", "draw", "s.toml", "zz", "--out", "c.svg"]);
    assert_eq!(refused.status.code(), Some(2), "{}", String::from_utf8_lossy(&refused.stderr));
    // Seeds and sensors do not change the body.
    bench.file("s.toml", &(small("") + "seeds = [1, 2]\n"));
    bench.output(&["body", "draw", "s.toml", "--out", "a.svg"]);
}

/// A drawing is SVG; other extensions are refused.
#[test]
fn a_drawing_of_another_kind_is_refused() {
    let bench = Bench::new();
    bench.file("s.toml", &small(""));
    for name in ["x.pdf", "x"] {
        let out = bench.metasense(&["body", "draw", "s.toml", "--out", name]);
        let message = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(2), "{name}: {message}");
        assert!(message.contains(&format!("--out {name}: a drawing is an SVG file; use x.svg")), "{message}");
        assert!(!bench.path(name).exists(), "{name}");
    }
}

/// A spec may start from a seeded random design or from a file, whose contents are part of the trial's hash.
#[test]
fn a_spec_starts_from_the_design_that_it_names() {
    let bench = Bench::new();
    let hash = |text: &str| {
        bench.file("s.toml", text);
        let csv = bench.output(&["expand", "s.toml", "--format", "csv"]);
        csv.lines().nth(1).unwrap().split(',').next().unwrap().to_owned()
    };
    let plain = hash(&small(""));
    let one = hash(&small("design = { random = 1 }"));
    assert!(plain != one && one != hash(&small("design = { random = 2 }")));
    assert_eq!(one, hash(&small("design = { random = 1, spread = 0.25 }")), "the default");
    assert_ne!(one, hash(&small("design = { random = 1, spread = 0.1 }")));
    bench.output(&["body", "draw", "s.toml", "--out", "a.svg", "--design-out", "a.npy"]);
    let file = hash(&small("design = \"a.npy\""));
    std::fs::copy(bench.path("a.npy"), bench.path("b.npy")).unwrap();
    assert_eq!(file, hash(&small("design = \"b.npy\"")), "the name of the file is no part of a trial");
    bench.output(&["body", "draw", "s.toml", "--out", "a.svg", "--design-out", "b.csv"]);
    let axis = small("")
        .replace("sensors = [1]", "sensors = [1]\n\"body.design\" = [{ random = 1 }, { random = 2 }]");
    assert_eq!(hash(&axis), one);
    // likewise the body to which noise is relative; without noise it is not part of the trial
    let noisy = |noise: &str, of: &str| {
        let sensors = format!("[sensors]\nnoise = {noise}\n{of}\n[sweep]");
        hash(&small("").replace("[sweep]", &sensors))
    };
    let of_file = noisy("0.03", "relative_to = \"a.npy\"");
    assert_eq!(of_file, noisy("0.03", "relative_to = \"b.npy\""));
    assert_ne!(of_file, noisy("0.03", ""));
    // relative to the folder of the spec that names it
    std::fs::create_dir(bench.path("sub")).unwrap();
    std::fs::rename(bench.path("b.npy"), bench.path("sub/b.npy")).unwrap();
    let sensors = "[sensors]\nnoise = 0.03\nrelative_to = \"b.npy\"\n[sweep]";
    bench.file("sub/base.toml", &small("").replace("[sweep]", sensors));
    assert_eq!(of_file, hash("base = \"sub/base.toml\"\nname = \"s\"\n"));
    for noise in ["0.0", "[300.0, 0.5]"] {
        assert_eq!(noisy(noise, "relative_to = \"a.npy\""), noisy(noise, ""), "{noise}");
    }
}

/// Exit code 2 with file, key and every violated constraint, before anything starts.
#[test]
fn a_design_that_cannot_be_cast_is_refused_with_the_list() {
    let bench = Bench::new();
    std::fs::write(bench.path("bad.npy"), npy(&[0.0; 48])).unwrap();
    std::fs::write(bench.path("short.npy"), npy(&[0.0; 47])).unwrap();
    let refused_text = |text: &str| {
        bench.file("s.toml", text);
        let out = bench.metasense(&["expand", "s.toml"]);
        assert_eq!(out.status.code(), Some(2), "{out:?}");
        String::from_utf8(out.stderr).unwrap()
    };
    let refused = |design: &str| refused_text(&small(design));
    let mut wild = vec![0.0; 48];
    wild[0] = 20.0;
    std::fs::write(bench.path("bad.npy"), npy(&wild)).unwrap();
    let said = refused("design = \"bad.npy\"");
    assert!(said.contains("s.toml:") && said.contains("body.design") && said.contains("unit 0"), "{said}");
    assert!(refused("design = \"short.npy\"").contains("and 47 numbers; α of this body has 48"));
    assert!(refused("design = \"none.npy\"").contains("none.npy"));
    assert!(refused("design = { randon = 1 }").contains("random"));
    let sensors = "[sensors]\nnoise = 0.1\nrelative_to = { shifts = [0.0] }\n[sweep]";
    let said = refused_text(&small("").replace("[sweep]", sensors));
    assert!(
        said.contains(
            "sensors.relative_to = 1 shifts: must contain 48 numbers, the length of α of this body"
        ),
        "{said}"
    );
    assert!(
        refused("design = { random = 1, spread = 0.0 }").contains("spread must be above 0 and at most 1")
    );
}
