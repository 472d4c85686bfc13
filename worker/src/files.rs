//! Numbers from files that others wrote: CSV tables, NPY arrays, NPZ archives of arrays.

use std::collections::BTreeMap;
use std::io::{Cursor, Read};
use std::path::Path;

use csv::{ReaderBuilder, StringRecord, Trim};
use npyz::{AutoSerialize, NpyFile, WriterBuilder};
use zip::ZipArchive;

/// An array of any shape, the last index fastest.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// Its shape.
    pub shape: Vec<usize>,
    /// Its numbers.
    pub values: Vec<f64>,
}

/// The bytes of an `.npy` file.
///
/// # Panics
/// If the shape does not hold as many values as there are.
pub fn npy_bytes<T: AutoSerialize + Copy>(shape: &[usize], values: &[T]) -> Vec<u8> {
    assert_eq!(shape.iter().product::<usize>(), values.len(), "shape {shape:?}");
    let shape: Vec<u64> = shape.iter().map(|&n| n as u64).collect();
    let mut bytes = Vec::with_capacity(128 + size_of_val(values));
    let mut writer = npyz::WriteOptions::new()
        .default_dtype()
        .shape(&shape)
        .writer(&mut bytes)
        .begin_nd()
        .expect("writing to memory");
    writer.extend(values.iter().copied()).expect("writing to memory");
    writer.finish().expect("writing to memory");
    bytes
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
mod tests;
