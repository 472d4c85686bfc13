use super::*;

fn write(path: &Path, layout: &Layout, design: &[f64]) {
    std::fs::write(path, bytes(path, layout, design).expect("a known ending")).expect("written");
}

fn somewhere(name: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(name);
    (folder, path)
}

/// NPY keeps every bit; CSV of nodes keeps them to rounding.
#[test]
fn a_design_comes_back_from_its_file() {
    for layout in [Layout::planar(3, 2, 15.0, 2.25), Layout::circular(&Pattern::square(), 5, 12.0, 1.8)] {
        let mut design = layout.initial_design(0.4);
        design[3] = 0.1 + 0.2;
        let (_folder, npy) = somewhere("a.npy");
        write(&npy, &layout, &design);
        assert_eq!(read(&npy, &layout).expect("read"), design);
        let (_folder, csv) = somewhere("a.csv");
        write(&csv, &layout, &design);
        let back = read(&csv, &layout).expect("read");
        let worst = back.iter().zip(&design).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-12, "{worst} mm");
    }
}

/// Whatever is wrong is said, with the line or the number expected.
#[test]
fn a_file_that_is_no_design_is_refused_by_name() {
    let layout = Layout::planar(2, 2, 15.0, 2.25);
    let (_folder, path) = somewhere("a.csv");
    let good = to_csv(&layout, &layout.initial_design(0.3));
    let lines: Vec<&str> = good.lines().collect();
    for (text, said) in [
        (lines[..4].join("\n") + "\n" + &lines[5..].join("\n"), "unit 0, node 3 is missing"),
        (good.replace("0,0,", "9,0,"), "line 2: units are 0 to 3"),
        (good.replacen("0,0,6", "0,0,7", 1), "line 8: is shifted otherwise than its ligament's other end"),
        (good.replacen("0,0,6", "0,0,x", 1), "line 2: must be unit,node,x,y"),
        ("unit,node,x,y\n0,0,NaN,1\n".into(), "line 2: x and y must be finite"),
        (good.replace("unit,node,x,y", "x,y,unit,node"), "line 1: \"x,y,unit,node\"; must be unit,node,x,y"),
        (lines[1..].join("\n"), "line 1: "),
    ] {
        std::fs::write(&path, text).expect("written");
        let error = read(&path, &layout).expect_err("refused").to_string();
        assert!(error.contains(said) && error.contains("a.csv"), "{error}");
    }
    let (_folder, path) = somewhere("a.npy");
    write(&path, &Layout::planar(3, 2, 15.0, 2.25), &[0.0; 34]);
    let error = read(&path, &layout).expect_err("refused").to_string();
    assert!(error.contains("holds 34 numbers; α of this body has 24"), "{error}");
    assert!(read(Path::new("a.txt"), &layout).is_err());
}
