use std::io::Write;

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::*;

/// Names, numbers, and the line of what is none.
#[test]
fn a_table_is_read_and_its_faults_named() {
    let read = |text: &str| content(Path::new("a.csv"), text.as_bytes());
    let expected = vec![("t".to_owned(), vec![0.0, 1e-3]), ("F 1".to_owned(), vec![2.0, -3.5])];
    assert_eq!(read("t,\"F 1\"\n0,2\n\n1e-3, -3.5\n"), Ok(Content::Table(expected)));
    let expected = vec![("t".to_owned(), vec![0.0]), ("F, left".to_owned(), vec![2.0])];
    assert_eq!(read("\u{feff} t ,\"F, left\"\r\n\"0\",2 "), Ok(Content::Table(expected)));
    for (text, said) in [
        ("", "is empty"),
        (" \n\n", "is empty"),
        ("t,f\n0,1\n0\n", "line 3: 1 fields where the first line names 2"),
        ("t,f\n0,x\n", "line 2: f = \"x\" is no number"),
        (" \nt,f\r\n0,1\r\n\r\n \r\n0,x\r\n", "line 6: f = \"x\" is no number"),
        ("t,f\n\n\n0,x\n", "line 4: f = \"x\" is no number"),
    ] {
        assert_eq!(read(text), Err(said.to_owned()));
    }
    assert!(content(Path::new("a.txt"), b"").is_err());
}

/// What numpy.save(numpy.array([[1, 2, 3], [4, 5, 6]], order="F")) writes has its rows again.
#[test]
fn an_array_in_fortran_order_is_turned() {
    let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    let header = "{'descr': '<f8', 'fortran_order': True, 'shape': (2, 3), }";
    bytes.extend(format!("{header:<117}\n").bytes());
    bytes.extend([1.0f64, 4.0, 2.0, 5.0, 3.0, 6.0].iter().flat_map(|x| x.to_le_bytes()));
    let array = Array { shape: vec![2, 3], values: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0] };
    assert_eq!(content(Path::new("a.npy"), &bytes), Ok(Content::Array(array)));
    assert!(content(Path::new("a.npy"), &bytes[..150]).is_err());
    assert!(content(Path::new("a.npz"), &bytes).is_err());
}

/// Ten thousand files of each kind, with bytes changed, cut out, doubled or taken from a list of awkward ones: an answer
/// each, and no panic. A failure prints the seed of its file.
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
            let read = std::panic::catch_unwind(|| content(Path::new(name), &bytes).is_ok());
            assert!(read.is_ok(), "{name}: seed {seed}: {}", String::from_utf8_lossy(&bytes));
        }
    }
}

/// An archive with one array.
fn zip(held: &[u8], method: CompressionMethod) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    zip.start_file("a.npy", SimpleFileOptions::default().compression_method(method)).unwrap();
    zip.write_all(held).unwrap();
    let whole = zip.finish().unwrap().into_inner();
    let Ok(Content::Archive(arrays)) = content(Path::new("a.npz"), &whole) else { panic!("no archive") };
    assert!(arrays["a"].is_ok(), "{arrays:?}");
    whole
}
