//! Numbers from files that others wrote: CSV tables, NPY arrays, NPZ archives of arrays.

use std::collections::BTreeMap;
use std::io::{Cursor, Read};
use std::path::Path;

use csv::{ReaderBuilder, StringRecord, Trim};
use npyz::NpyFile;
use zip::ZipArchive;

/// An array of any shape, the last index fastest.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// Its shape.
    pub shape: Vec<usize>,
    /// Its numbers.
    pub values: Vec<f64>,
}

/// What a file holds.
#[derive(Debug, Clone, PartialEq)]
pub enum Content {
    /// Columns of a CSV with their names.
    Table(Vec<(String, Vec<f64>)>),
    /// An NPY.
    Array(Array),
    /// The arrays of an NPZ by name; of those that are no numbers, why not.
    Archive(BTreeMap<String, Result<Array, String>>),
}

/// Takes a file's bytes apart, by its ending.
///
/// # Errors
/// Says what is wrong, and where.
pub fn content(path: &Path, bytes: &[u8]) -> Result<Content, String> {
    match path.extension().and_then(|e| e.to_str()) {
        Some("csv") => table(bytes).map(Content::Table),
        Some("npy") => array(bytes).map(Content::Array),
        Some("npz") => archive(bytes).map(Content::Archive),
        _ => Err("must be a .csv, .npy or .npz file".into()),
    }
}

/// A CSV: a line of names, then lines of numbers.
fn table(bytes: &[u8]) -> Result<Vec<(String, Vec<f64>)>, String> {
    let mut columns: Vec<(String, Vec<f64>)> = Vec::new();
    let bare = |field: &str| field.trim_matches('"').to_owned(); // those behind a blank, which are none to `csv`
    let mut reader =
        ReaderBuilder::new().has_headers(false).flexible(true).trim(Trim::All).from_reader(bytes);
    for row in reader.records() {
        let row = row.map_err(|e| e.to_string())?;
        if row.len() == 1 && row[0].is_empty() {
            continue; // a line of blanks
        }
        if columns.is_empty() {
            columns = row.iter().map(|name| (bare(name), Vec::new())).collect();
            continue;
        }
        let line = || line_of(&row, bytes);
        if row.len() != columns.len() {
            let (found, wanted) = (row.len(), columns.len());
            return Err(format!("line {}: {found} fields where the first line names {wanted}", line()));
        }
        for ((name, values), field) in columns.iter_mut().zip(&row) {
            let value = bare(field).parse();
            values.push(value.map_err(|_| format!("line {}: {name} = {field:?} is no number", line()))?);
        }
    }
    if columns.is_empty() { Err("is empty".into()) } else { Ok(columns) }
}

/// The line of a CSV's row, from 1: `csv` counts it before it skips blank lines and the second half of "\r\n".
fn line_of(row: &StringRecord, bytes: &[u8]) -> usize {
    let from = row.position().map_or(0, |position| position.byte() as usize);
    let skipped = bytes[from..].iter().take_while(|byte| b"\r\n".contains(byte)).count();
    1 + bytes[..from + skipped].iter().filter(|byte| **byte == b'\n').count()
}

/// An NPY of real numbers, in either order.
///
/// # Errors
/// Says what is wrong.
pub fn array(bytes: &[u8]) -> Result<Array, String> {
    let file = NpyFile::new(bytes).map_err(|e| e.to_string())?;
    let shape: Vec<usize> = file.shape().iter().map(|&n| n as usize).collect();
    let order = file.order();
    let mut values = numbers(file)?;
    if order == npyz::Order::Fortran && shape.len() > 1 {
        values = (0..values.len())
            .map(|mut at| {
                let mut from = 0;
                for (axis, &length) in shape.iter().enumerate().rev() {
                    from += at % length * shape[..axis].iter().product::<usize>();
                    at /= length;
                }
                values[from]
            })
            .collect();
    }
    Ok(Array { shape, values })
}

fn numbers(file: NpyFile<&[u8]>) -> Result<Vec<f64>, String> {
    fn read<T: npyz::Deserialize, R: std::io::Read>(
        data: npyz::NpyReader<T, R>,
        wide: fn(T) -> f64,
    ) -> Result<Vec<f64>, String> {
        data.map(|x| x.map(wide)).collect::<Result<_, _>>().map_err(|e| e.to_string())
    }
    let file = match file.try_data::<f64>() {
        Ok(data) => return read(data, |x| x),
        Err(file) => file,
    };
    let file = match file.try_data::<f32>() {
        Ok(data) => return read(data, f64::from),
        Err(file) => file,
    };
    let file = match file.try_data::<u8>() {
        Ok(data) => return read(data, f64::from),
        Err(file) => file,
    };
    let file = match file.try_data::<i64>() {
        Ok(data) => return read(data, |x| x as f64),
        Err(file) => file,
    };
    let file = match file.try_data::<i32>() {
        Ok(data) => return read(data, f64::from),
        Err(file) => file,
    };
    match file.try_data::<i16>() {
        Ok(data) => read(data, f64::from),
        Err(file) => Err(format!("holds {}; must hold real numbers", file.dtype().descr())),
    }
}

/// The arrays of an NPZ, a zip archive, as `numpy.savez` and `savez_compressed` write it.
fn archive(bytes: &[u8]) -> Result<BTreeMap<String, Result<Array, String>>, String> {
    let mut zip = ZipArchive::new(Cursor::new(bytes)).map_err(|e| e.to_string())?;
    let mut arrays = BTreeMap::new();
    for i in 0..zip.len() {
        let name = zip.name_for_index(i).transpose().map_err(|e| e.to_string())?.unwrap_or_default();
        let name = name.trim_end_matches(".npy").to_owned();
        let held = (zip.by_index(i).map_err(|e| e.to_string())).and_then(|mut file| {
            let mut held = Vec::new();
            file.read_to_end(&mut held).map_err(|e| e.to_string())?;
            array(&held)
        });
        arrays.insert(name, held);
    }
    Ok(arrays)
}

#[cfg(test)]
mod tests {
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
        let wholes = [
            ("a.npy", &fortran),
            ("b.npy", &small),
            ("a.npz", &stored),
            ("b.npz", &deflated),
            ("a.csv", &csv),
        ];
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
}
