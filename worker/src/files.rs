//! Reads numbers from users' files: CSV tables, NPY arrays and NPZ archives.
//!
//! Ambiguous content is rejected, with its location and the key that resolves it.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Cursor, Read};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use metasense_schemas::spec::Signal;
use npyz::{AutoSerialize, Deserialize, NpyFile, WriterBuilder};
use zip::ZipArchive;

mod table;

pub use table::{ColumnTable, Form};

/// Largest accepted file, or array of an archive (bytes).
const LARGEST: u64 = 4 << 30;

/// Opens a regular file. Others can name the path, so pipes, which block, and devices, which never end, are rejected.
///
/// # Errors
/// If it cannot be opened, is not a regular file, or is too large.
pub fn open(path: &Path) -> io::Result<File> {
    let file = File::options().read(true).custom_flags(libc::O_NONBLOCK).open(path)?;
    let known = file.metadata()?;
    match known.is_file() && known.len() <= LARGEST {
        true => Ok(file),
        false => Err(io::Error::other(format!("must be an ordinary file of at most {} GiB", LARGEST >> 30))),
    }
}

/// Reads a regular file.
///
/// # Errors
/// As [`open`], or if it cannot be read.
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open(path)?.take(LARGEST).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Extension of a file name, in lower case.
pub fn ending(path: &Path) -> String {
    path.extension().map_or(String::new(), |ending| ending.to_string_lossy().to_lowercase())
}

/// Decodes UTF-8 and strips the byte order mark.
///
/// # Errors
/// Names the line and the probable encoding.
pub fn text(bytes: &[u8]) -> Result<&str, String> {
    let save = "save it as UTF-8";
    if bytes.starts_with(b"\xff\xfe") || bytes.starts_with(b"\xfe\xff") {
        return Err(format!("is encoded as UTF-16: {save}"));
    }
    if let Some(at) = bytes.iter().position(|byte| *byte == 0) {
        let line = 1 + bytes[..at].iter().filter(|byte| **byte == b'\n').count();
        return Err(format!("line {line}: contains a zero byte, so it is UTF-16 or not text: {save}"));
    }
    let text = std::str::from_utf8(bytes).map_err(|e| {
        let (before, at) = (&bytes[..e.valid_up_to()], bytes[e.valid_up_to()]);
        let line = 1 + before.iter().filter(|byte| **byte == b'\n').count();
        format!("line {line}: byte 0x{at:02x} is not UTF-8 (Latin-1 or Windows-1252?): {save}")
    })?;
    Ok(text.strip_prefix('\u{feff}').unwrap_or(text))
}

/// An array of any shape, in C order.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// Shape.
    pub shape: Vec<usize>,
    /// Values.
    pub values: Vec<f64>,
}

/// Encodes an `.npy` file.
///
/// # Panics
/// If the shape does not match the number of values.
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

/// The values of an `.npy` file in C order.
///
/// # Errors
/// If the bytes are not an array of this type.
pub fn npy_values<T: Deserialize>(bytes: &[u8]) -> io::Result<Vec<T>> {
    NpyFile::new(bytes).and_then(NpyFile::into_vec)
}

/// Contents of a file.
#[derive(Debug, Clone, PartialEq)]
pub enum Content {
    /// A CSV file.
    Table(ColumnTable),
    /// An NPY file.
    Array(Array),
    /// Arrays of an NPZ file by name: `None` if `Form::read` excludes it, an error if it contains no numbers.
    Archive(BTreeMap<String, Option<Result<Array, String>>>),
}

/// Parses a file by its extension.
///
/// # Errors
/// Describes the fault and its location.
pub fn content(path: &Path, bytes: &[u8], form: &Form) -> Result<Content, String> {
    match ending(path).as_str() {
        "csv" => ColumnTable::parse(bytes, form).map(Content::Table),
        "npy" => array(bytes).map(Content::Array),
        "npz" => archive(bytes, form).map(Content::Archive),
        _ => {
            Err("must be a .csv, .npy or .npz file; name a table of text .csv, or convert it with `python -m metasense.records` (also \
                 MATLAB, HDF5, UFF, TDMS)"
                .into())
        }
    }
}

/// Parses an NPY of real numbers in C or Fortran order: booleans, integers of 8 to 64 bits that `f64` represents exactly, floats
/// of 32 and 64 bits.
///
/// # Errors
/// Describes the fault.
pub fn array(mut bytes: &[u8]) -> Result<Array, String> {
    let file = NpyFile::new(&mut bytes).map_err(|e| format!("is not an NPY file: {e}"))?;
    let shape: Vec<usize> = file.shape().iter().map(|&n| n as usize).collect();
    let order = file.order();
    let count = shape.iter().try_fold(1usize, |count, &n| count.checked_mul(n));
    if count == Some(0) {
        return Err(format!("contains no numbers: its shape is {shape:?}"));
    }
    let mut values = numbers(file)?;
    if count != Some(values.len()) || !bytes.is_empty() {
        return Err(format!("contains data beyond its array of shape {shape:?}"));
    }
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

fn numbers(file: NpyFile<&mut &[u8]>) -> Result<Vec<f64>, String> {
    fn read<T: Deserialize>(
        data: npyz::NpyReader<T, &mut &[u8]>,
        wide: impl Fn(T) -> Option<f64>,
    ) -> Result<Vec<f64>, String> {
        let one = |(n, x): (usize, io::Result<T>)| {
            wide(x.map_err(|e| e.to_string())?)
                .ok_or_else(|| format!("number {n} is an integer beyond 2^53: it cannot be read exactly"))
        };
        data.enumerate().map(one).collect()
    }
    macro_rules! first_of {
        ($file:expr; $($kind:ty => $wide:expr),+) => {{
            let file = $file;
            $(let file = match file.try_data::<$kind>() {
                Ok(data) => return read(data, $wide),
                Err(file) => file,
            };)+
            file
        }};
    }
    let file = first_of!(file;
        f64 => Some, f32 => |x| Some(x.into()), bool => |x| Some(f64::from(u8::from(x))),
        i8 => |x| Some(x.into()), i16 => |x| Some(x.into()), i32 => |x| Some(x.into()),
        u8 => |x| Some(x.into()), u16 => |x| Some(x.into()), u32 => |x| Some(x.into()),
        i64 => |x| (x.unsigned_abs() <= 1 << 53).then_some(x as f64),
        u64 => |x| (x <= 1 << 53).then_some(x as f64)
    );
    Err(format!(
        "contains {}; must contain booleans, integers, or floats of 32 or 64 bits",
        file.dtype().descr()
    ))
}

/// Arrays of an NPZ as `numpy.savez` and `savez_compressed` write it.
fn archive(bytes: &[u8], form: &Form) -> Result<BTreeMap<String, Option<Result<Array, String>>>, String> {
    let mut zip = ZipArchive::new(Cursor::new(bytes)).map_err(|e| format!("is not an NPZ file: {e}"))?;
    let mut arrays = BTreeMap::new();
    for i in 0..zip.len() {
        let name = zip.name_for_index(i).transpose().map_err(|e| e.to_string())?.unwrap_or_default();
        let name = name.strip_suffix(".npy").unwrap_or(&name).to_owned();
        let own = Signal::Name(name.clone());
        let held = form.read.as_ref().is_none_or(|read| read.contains(&&own)).then(|| {
            let mut file = zip.by_index(i).map_err(|e| e.to_string())?.take(LARGEST);
            let mut held = Vec::new();
            file.read_to_end(&mut held).map_err(|e| e.to_string())?;
            array(&held)
        });
        if arrays.insert(name.clone(), held).is_some() {
            return Err(format!("contains two arrays named {name:?}"));
        }
    }
    Ok(arrays)
}

#[cfg(test)]
mod tests;
