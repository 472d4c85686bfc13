use super::*;

fn write(path: &Path, layout: &Layout, design: &[f64]) {
    std::fs::write(path, bytes(path, layout, design).expect("a known ending")).expect("written");
}

fn somewhere(name: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(name);
    (folder, path)
}

/// NPY is exact to the bit, CSV of nodes to rounding.
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

/// A CSV may have its columns in any order, further columns and the form that spreadsheets write; extensions may be upper case.
#[test]
fn a_design_is_read_however_it_is_written() {
    let layout = Layout::planar(2, 2, 15.0, 2.25);
    let design = layout.initial_design(0.3);
    let good = to_csv(&layout, &design);
    let (_folder, path) = somewhere("a.CSV");
    let swapped = |line: &str| {
        let fields: Vec<&str> = line.split(',').collect();
        [fields[3], fields[0], "of hand", fields[2], fields[1]].join(",") + "\n"
    };
    for text in [
        good.lines().map(swapped).collect::<String>(),
        good.replace(',', ";").replace('.', ",").replace('\n', "\r\n"),
        good.replace(',', "\t"),
        good.replace("\n0,", "\n0.0,").replace("\n1,", "\n\"1\","),
    ] {
        std::fs::write(&path, &text).expect("written");
        let back = read(&path, &layout).unwrap_or_else(|e| panic!("{e}: {text}"));
        let worst = back.iter().zip(&design).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-12, "{worst} mm: {text}");
    }
}

/// An array of α has shape (n) or (n/2, 2) in either memory order. Transposed arrays, other shapes, NaN and infinity are
/// rejected.
#[test]
fn an_array_is_a_design_in_two_shapes_alone() {
    let layout = Layout::planar(2, 2, 15.0, 2.25);
    let design = layout.initial_design(0.3);
    let n = design.len();
    let (_folder, path) = somewhere("a.NPY");
    let read = |shape: &[usize], values: &[f64]| {
        std::fs::write(&path, files::npy_bytes(shape, values)).expect("written");
        read(&path, &layout).map_err(|e| e.to_string())
    };
    for shape in [&[n][..], &[n / 2, 2]] {
        assert_eq!(read(shape, &design).as_ref(), Ok(&design), "{shape:?}");
    }
    for shape in [&[2, n / 2][..], &[1, n], &[n, 1], &[n / 2, 2, 1], &[n / 4, 4], &[n / 4, 2, 2]] {
        let error = read(shape, &design).unwrap_err();
        assert!(error.contains("a.NPY") && error.contains(&format!("has shape {shape:?}")), "{error}");
    }
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut design = design.clone();
        design[5] = bad;
        let error = read(&[n], &design).unwrap_err();
        assert!(error.contains("a.NPY") && error.contains("number 5 is "), "{error}");
    }
}

/// Each error names the line, or the expected size.
#[test]
fn a_file_that_is_no_design_is_refused_by_name() {
    let layout = Layout::planar(2, 2, 15.0, 2.25);
    let (_folder, path) = somewhere("a.csv");
    let good = to_csv(&layout, &layout.initial_design(0.3));
    let lines: Vec<&str> = good.lines().collect();
    for (text, said) in [
        (lines[..4].join("\n") + "\n" + &lines[5..].join("\n"), "unit 0, node 3 is missing"),
        (good.replace("0,0,", "9,0,"), "line 2: unit = 9: must be an integer from 0 to 3"),
        (
            good.replacen("0,0,6", "0,0,7", 1),
            "line 8: its shift differs from that of the other end of its ligament",
        ),
        (good.replacen("0,0,6", "0,0,x", 1), "line 2: x = \"x"),
        (good.replacen("0,0,", "0,0.5,", 1), "line 2: node = 0.5: must be an integer from 0 to 3"),
        (good.replacen("0,0,", "-1,0,", 1), "line 2: unit = -1: must be an integer from 0 to 3"),
        (good.replacen("0,0,", "0,1e300,", 1), "line 2: node = 1"),
        ("unit,node,x,y\n0,0,NaN,1\n".into(), "line 2: x = \"NaN\": must be a finite number"),
        (good.replace("unit,node,x,y", "unit,node,x,z"), "has no signal \"y\"; signals are unit, node, x, z"),
        (lines[1..].join("\n"), "line 1: "),
    ] {
        std::fs::write(&path, text).expect("written");
        let error = read(&path, &layout).expect_err("refused").to_string();
        assert!(error.contains(said) && error.contains("a.csv"), "{error}");
    }
    let (_folder, path) = somewhere("a.npy");
    write(&path, &Layout::planar(3, 2, 15.0, 2.25), &[0.0; 34]);
    let error = read(&path, &layout).expect_err("refused").to_string();
    assert!(error.contains("and 34 numbers; α of this body has 24"), "{error}");
    assert!(read(Path::new("a.txt"), &layout).is_err());
}
