use std::io::Write;

use metasense_schemas::spec::{Decimal, Separator};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::*;

fn named(names: &[&str]) -> Vec<Signal> {
    names.iter().map(|name| Signal::Name((*name).into())).collect()
}

fn numbered(numbers: &[usize]) -> Vec<Signal> {
    numbers.iter().copied().map(Signal::Number).collect()
}

/// Parses the columns `read` of a CSV, with keys of the table `recorded`.
fn columns(text: impl AsRef<[u8]>, read: &[Signal], form: Form) -> Result<Vec<Vec<f64>>, String> {
    let form = Form { read: Some(read.iter().collect()), keys: Some("recorded"), ..form };
    let table = ColumnTable::parse(text.as_ref(), &form)?;
    read.iter().map(|signal| Ok(table.values(table.column(signal)?).to_vec())).collect()
}

/// Reads names and numbers; names the line of a field that is not a number.
#[test]
fn a_table_is_read_and_its_faults_named() {
    let read = |text: &str, names: &[&str]| columns(text, &named(names), Form::default());
    assert_eq!(
        read("t,\"F 1\"\n0,2\n\n1e-3, -3.5\n", &["t", "F 1"]),
        Ok(vec![vec![0.0, 1e-3], vec![2.0, -3.5]])
    );
    assert_eq!(
        read("\u{feff} t ,\"F, left\"\r\n\"0\",2 ", &["F, left", "t"]),
        Ok(vec![vec![2.0], vec![0.0]])
    );
    for (text, said) in [
        ("", "is empty"),
        (" \n\n", "is empty"),
        ("t,f\n", "no line of numbers after line 1"),
        ("t,f\n0,1\n0\n", "line 3: 1 fields where line 1 has 2"),
        ("t,f\n0,1,\n", "line 2: 3 fields where line 1 has 2"),
        ("# made by me\nt,f\n0,1\n", "line 2: 2 fields where line 1 has 1"),
        ("t,f\n0,x\n", "line 2: f = \"x\" is not a number"),
        ("t,f\ns,N\n0,1\n", "line 2: t = \"s\" is not a number: if the line states units, remove it"),
        ("sep=;\nt;f\n0;1\n", "line 1: \"sep=;\" is for Excel: remove it"),
        ("t f\n0 1\n", "has no signal \"f\"; signals are t f; fields must be separated by"),
        (" \nt,f\r\n0,1\r\n\r\n \r\n0,x\r\n", "line 6: f = \"x\" is not a number"),
        ("t,f\n\n\n0,x\n", "line 4: f = \"x\" is not a number"),
        ("t,f\n0,1\n1,\n", "line 3: f is empty"),
        ("t,f\n0,1\n,\n", "line 3: t is empty"),
        ("t,f\n0,1\nt,f\n0,1\n", "line 3: repeats the names of line 1"),
        ("t,f\n0,1\n1,NaN\n", "line 3: f = \"NaN\": must be a finite number"),
        ("t,f\n0,1e999\n", "line 2: f = \"1e999\": must be a finite number"),
        ("t,f,t,f\n0,1,2,3\n", "has two columns named \"f\""),
        ("t,g\n0,1\n", "has no signal \"f\"; signals are t, g"),
    ] {
        let error = read(text, &["f", "t"]).unwrap_err();
        assert!(error.contains(said), "{text:?}: {error}\n{said}");
    }
    assert!(content(Path::new("a.txt"), b"", &Form::default()).is_err());
    assert!(content(Path::new("a.CSV"), b"t,f\n0,1\n", &Form::default()).is_ok());
}

/// Columns that are not read may contain anything; columns of equal names can be read by number.
#[test]
fn what_nobody_reads_prevents_nothing() {
    let text = "chip,t,f,f,\nWT901(00:0C),0,1,,\n\"null, \",1,,5,x\n";
    assert_eq!(columns(text, &named(&["t"]), Form::default()), Ok(vec![vec![0.0, 1.0]]));
    let text = "t,f,f\n0,1,2\n";
    assert_eq!(columns(text, &numbered(&[2]), Form::default()), Ok(vec![vec![2.0]]));
    let error = columns(text, &numbered(&[3]), Form::default()).unwrap_err();
    assert!(error.contains("has no column 3; columns are 0 to 2"), "{error}");
}

/// A first line of numbers is ambiguous, as is one that mixes words and numbers. Words, or the names to be read, make it a
/// header.
#[test]
fn a_header_is_taken_for_one_where_that_is_certain() {
    let form = |header| Form { header, ..Form::default() };
    let first = numbered(&[0]);
    for (text, names, data) in [
        ("0\n1\n", vec![1.0], vec![0.0, 1.0]),
        ("0,1,2\n3,4,5\n", vec![3.0], vec![0.0, 3.0]),
        ("1e3,t\n3,4.5\n", vec![3.0], vec![1e3, 3.0]),
        ("nan\n1\n", vec![1.0], Vec::new()),
        ("0;5\n1;6\n", vec![1.0], vec![0.0, 1.0]),
        ("1.234,5;2026-10-02\n5.5;2026-10-02\n", vec![5.5], Vec::new()),
        ("n/a\n1.5\n", vec![1.5], Vec::new()),
    ] {
        let error = columns(text, &first, form(None)).unwrap_err();
        assert!(error.contains("line 1: ") && error.contains("set recorded.header = "), "{text:?}: {error}");
        assert_eq!(columns(text, &first, form(Some(true))), Ok(vec![names]), "{text:?}");
        if !data.is_empty() {
            assert_eq!(columns(text, &first, form(Some(false))), Ok(vec![data]), "{text:?}");
        }
    }
    assert_eq!(columns(",ax\n0,7.0\n", &numbered(&[1]), form(None)), Ok(vec![vec![7.0]]));
    assert_eq!(columns("1,ax\n0,7.0\n", &named(&["ax"]), form(None)), Ok(vec![vec![7.0]]));
    assert_eq!(columns("0,1\n5,7.0\n", &named(&["1"]), form(Some(true))), Ok(vec![vec![7.0]]));
    let error = columns("0,1\n5,7\n", &named(&["1"]), form(None)).unwrap_err();
    assert!(error.contains("set recorded.header"), "{error}");
    let error = columns("t,f\n5,7\n", &named(&["f"]), form(Some(false))).unwrap_err();
    assert!(error.contains("have no names"), "{error}");
    // An unnamed index column, as R and pandas write it.
    let error = columns("t,f\n1,0.5,2\n2,0.6,3\n", &named(&["f"]), form(None)).unwrap_err();
    assert!(error.contains("line 2: 3 fields where line 1 has 2"), "{error}");
}

/// Separators and decimal marks are detected if only one choice gives numbers.
#[test]
fn separators_and_decimal_marks_are_found() {
    let good = Ok(vec![vec![0.0, 0.01, 1234.5], vec![1.0, -0.5, 2e-3]]);
    for text in [
        "t,f\n0,1\n0.01,-0.5\n1234.5,2e-3\n",
        "t;f\n0;1\n0.01;-0.5\n1234.5;2e-3\n",
        "t;f\n0;1\n0,01;-0,5\n1234,5;2e-3\n",
        "t\tf\n0\t1\n0.01\t-0.5\n1234.5\t2e-3\n",
        "t\tf\t\r\n0\t1\t\r\n0,01\t-0,5\t\r\n1234,5\t2e-3\t\r\n",
        "t,f\n\"0\",\"1\"\n\"0,01\",\"-0,5\"\n\"1234,5\",\"2e-3\"\n",
        "t;note, of hand;f\n0;a;1\n0,01;b, c;-0,5\n1234,5;;2e-3\n",
        "t,\tf\n0,\t1\n0.01,\t-0.5\n1234.5,\t2e-3\n",
        "chip;t;f\n1.5.0;0;1\n1.5.0;0,01;-0,5\n1.5.0;1234,5;2e-3\n",
    ] {
        assert_eq!(columns(text, &named(&["t", "f"]), Form::default()), good, "{text:?}");
    }
    // One column whose name contains a separator.
    for text in ["\"f, N\"\n0.5\n", "f; N\n0.5\n", "f\tN\n0.5\n"] {
        assert_eq!(columns(text, &numbered(&[0]), Form::default()), Ok(vec![vec![0.5]]), "{text:?}");
    }
}

/// If two choices give numbers, the error names the key that decides; with this key the file is read.
#[test]
fn what_may_be_read_in_two_ways_is_refused_with_the_key_that_settles_it() {
    let (comma, semicolon) = (Some(Separator::Comma), Some(Separator::Semicolon));
    let (decimal_comma, point) = (Some(Decimal::Comma), Some(Decimal::Point));
    let form = |separator, decimal| Form { separator, decimal, ..Form::default() };
    for (text, read, key, settled) in [
        // One column of decimal commas, or two columns of integers.
        (
            "Force, N\n0,25\n1,50\n",
            numbered(&[0]),
            "recorded.decimal",
            vec![
                (form(None, decimal_comma), vec![0.25, 1.5]),
                (form(comma, None), vec![0.0, 1.0]),
                (form(None, point), vec![0.0, 1.0]),
            ],
        ),
        (
            "Force, N\n0,25\n1,50\n",
            named(&["Force"]),
            "recorded.decimal",
            vec![(form(comma, None), vec![0.0, 1.0])],
        ),
        (
            "f\n0,25\n1,50\n",
            numbered(&[0]),
            "recorded.separator",
            vec![(form(None, decimal_comma), vec![0.25, 1.5]), (form(semicolon, None), vec![0.25, 1.5])],
        ),
        (
            "f; N\n0,25\n1,50\n",
            numbered(&[0]),
            "recorded.separator, or decimal",
            vec![(form(None, decimal_comma), vec![0.25, 1.5])],
        ),
        // Decimal commas without a header.
        (
            "x, a;f, y\n0,1;0,5\n1,1;1,5\n",
            numbered(&[0]),
            "recorded.separator",
            vec![(form(semicolon, None), vec![0.1, 1.1])],
        ),
        // Thousands or thousandths.
        (
            "t;f\n5;1,234\n6;12,500\n",
            named(&["f"]),
            "recorded.decimal",
            vec![(form(None, decimal_comma), vec![1.234, 12.5])],
        ),
        (
            "t;f\n5;1.234\n6;12.500\n",
            named(&["f"]),
            "recorded.decimal",
            vec![(form(None, point), vec![1.234, 12.5])],
        ),
        // Both marks.
        ("t;f\n0.5;1\n0.6;1,5\n", named(&["t", "f"]), "recorded.decimal", vec![]),
    ] {
        let error = columns(text, &read, form(None, None)).unwrap_err();
        assert!(error.contains(key), "{text:?}: {error}\n{key}");
        for (form, values) in settled {
            let found = columns(text, &read, form.clone());
            assert_eq!(found.as_ref().map(|columns| &columns[0]), Ok(&values), "{text:?}, {form:?}");
        }
    }
    for text in ["t;f\n0;1.234,5\n", "t;f\n0;1,234,567\n", "t;f\n0;1 234,5\n"] {
        let error = columns(text, &named(&["f"]), Form::default()).unwrap_err();
        assert!(error.contains("line 2: f = ") && error.contains("is not a number"), "{text:?}: {error}");
    }
    // Two columns if both are read.
    let both = columns("ms,mN\n0,500\n1,498\n", &named(&["ms", "mN"]), form(None, None));
    assert_eq!(both, Ok(vec![vec![0.0, 1.0], vec![500.0, 498.0]]));
}

/// Encodings other than UTF-8 are named with their line.
#[test]
fn other_encodings_are_named() {
    let utf16 = |text: &str| text.encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<u8>>();
    for (bytes, said) in [
        (utf16("\u{feff}t,f\n0,1\n"), "UTF-16"),
        (utf16("t,f\n0,1\n"), "UTF-16"),
        (b"t,f\n0,1\n2,\xb0\n".to_vec(), "line 3: byte 0xb0 is not UTF-8 (Latin-1"),
    ] {
        let error = columns(&bytes, &named(&["t"]), Form::default()).unwrap_err();
        assert!(error.contains(said), "{error}");
    }
}

/// Array as `numpy.save(numpy.array([[1, 2, 3], [4, 5, 6]], order="F"))` writes it.
#[test]
fn an_array_in_fortran_order_is_turned() {
    let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    let header = "{'descr': '<f8', 'fortran_order': True, 'shape': (2, 3), }";
    bytes.extend(format!("{header:<117}\n").bytes());
    bytes.extend([1.0f64, 4.0, 2.0, 5.0, 3.0, 6.0].iter().flat_map(|x| x.to_le_bytes()));
    let array = Array { shape: vec![2, 3], values: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0] };
    assert_eq!(content(Path::new("a.NPY"), &bytes, &Form::default()), Ok(Content::Array(array)));
    assert!(content(Path::new("a.npy"), &bytes[..150], &Form::default()).is_err());
    assert!(content(Path::new("a.npz"), &bytes, &Form::default()).is_err());
}

/// Reads NPY of every real type; rejects other types, inexact integers, and files that are empty, truncated or contain two
/// arrays.
#[test]
fn arrays_of_real_numbers_are_read_and_others_named() {
    let npy = |descr: &str, shape: &str, data: &[u8]| {
        let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
        let header = format!("{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}");
        bytes.extend(format!("{header:<117}\n").bytes());
        bytes.extend(data);
        bytes
    };
    for (descr, data) in [
        ("'|b1'", &[1, 0][..]),
        ("'|i1'", &[1, 0]),
        ("'|u1'", &[1, 0]),
        ("'<i2'", &[1, 0, 0, 0]),
        ("'>u2'", &[0, 1, 0, 0]),
        ("'<u4'", &[1, 0, 0, 0, 0, 0, 0, 0]),
        ("'>i8'", &[0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0]),
        ("'<f4'", &[0, 0, 0x80, 0x3f, 0, 0, 0, 0]),
    ] {
        let expected = Array { shape: vec![2], values: vec![1.0, 0.0] };
        assert_eq!(array(&npy(descr, "(2,)", data)), Ok(expected), "{descr}");
    }
    let one = npy("'|u1'", "(1,)", &[7]);
    for (bytes, said) in [
        (npy("'<c16'", "(1,)", &[0; 16]), "must contain booleans, integers, or floats"),
        (npy("'<U1'", "(1,)", &[0; 4]), "must contain booleans"),
        (npy("'|O'", "(1,)", &[0; 4]), "must contain booleans"),
        (
            npy("'<i8'", "(2,)", &[[0; 8], (1i64 << 60).to_le_bytes()].concat()),
            "number 1 is an integer beyond 2^53",
        ),
        (npy("'<f8'", "(0, 3)", &[]), "contains no numbers: its shape is [0, 3]"),
        (npy("'|u1'", "(3,)", &[1, 2]), ""),
        ([one.clone(), one].concat(), "contains data beyond its array of shape [1]"),
        (b"t,f\n0,1\n".to_vec(), "is not an NPY file"),
    ] {
        let error = array(&bytes).unwrap_err();
        assert!(error.contains(said), "{error}\n{said}");
    }
}

/// 10,000 mutated files of each kind (bytes changed, removed, doubled or replaced by special ones) cause errors but no panic. A
/// failure prints the seed of its file.
#[test]
fn no_file_makes_a_reader_panic() {
    let npy = |header: &str, data: &[f64]| {
        let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
        bytes.extend(format!("{header:<117}\n").bytes());
        bytes.extend(data.iter().flat_map(|x| x.to_le_bytes()));
        bytes
    };
    let fortran = npy("{'descr': '<f8', 'fortran_order': True, 'shape': (2, 3), }", &[1.0; 6]);
    let small = npy("{'descr': '<i2', 'fortran_order': False, 'shape': (4,), }", &[1.0]);
    let csv = b"t,\"F 1\"\n0,2\n\n1e-3, -3.5\n".to_vec();
    let [stored, deflated] =
        [CompressionMethod::Stored, CompressionMethod::Deflated].map(|m| zip(&fortran, m));
    let wholes =
        [("a.npy", &fortran), ("b.npy", &small), ("a.npz", &stored), ("b.npz", &deflated), ("a.csv", &csv)];
    let awkward: [&[u8]; 8] =
        [b"18446744073709551615", b"-1", b"0", b"(", b"\xff\xff\xff\xff", b"\0", b"PK\x05\x06", b"'"];
    for (name, whole) in wholes {
        for seed in 0..10_000u64 {
            let mut state = seed;
            let mut roll = |n: usize| {
                // SplitMix64
                state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
                let z = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
                let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
                ((z ^ (z >> 31)) % n.max(1) as u64) as usize
            };
            let mut bytes = whole.clone();
            for _ in 0..=roll(4) {
                let (from, length) = (roll(bytes.len()), roll(9));
                let to = (from + length).min(bytes.len());
                let part = bytes[from..to].to_vec();
                match roll(5) {
                    0 => drop(bytes.drain(from..to)),
                    1 => drop(bytes.splice(from..from, part)),
                    2 => drop(bytes.splice(from..to, awkward[roll(awkward.len())].iter().copied())),
                    3 => bytes[from..to].fill(roll(256) as u8),
                    _ => bytes.truncate(from),
                }
                if bytes.is_empty() {
                    break;
                }
            }
            let read =
                std::panic::catch_unwind(|| content(Path::new(name), &bytes, &Form::default()).is_ok());
            assert!(read.is_ok(), "{name}: seed {seed}: {}", String::from_utf8_lossy(&bytes));
        }
    }
}

/// An NPZ with one array.
fn zip(held: &[u8], method: CompressionMethod) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    zip.start_file("a.npy", SimpleFileOptions::default().compression_method(method)).unwrap();
    zip.write_all(held).unwrap();
    let whole = zip.finish().unwrap().into_inner();
    let Ok(Content::Archive(arrays)) = content(Path::new("a.npz"), &whole, &Form::default()) else {
        panic!("not an archive")
    };
    assert!(arrays["a"].as_ref().is_some_and(Result::is_ok), "{arrays:?}");
    whole
}
