//! Arrays as NPY bytes (format 1.0, C order), which `numpy.load` opens.

use npyz::{AutoSerialize, WriterBuilder};

/// The values of an `.npy` file in C order.
///
/// # Errors
/// Where the bytes are no array of this type.
pub fn npy_values<T: npyz::Deserialize>(bytes: &[u8]) -> std::io::Result<Vec<T>> {
    npyz::NpyFile::new(bytes).and_then(npyz::NpyFile::into_vec)
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
