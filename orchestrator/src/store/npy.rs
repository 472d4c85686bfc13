//! Arrays as NPY bytes (format 1.0, C order), which `numpy.load` opens.

pub use metasense_worker::files::npy_bytes;

/// The values of an `.npy` file in C order.
///
/// # Errors
/// If the bytes are not an array of this type.
pub fn npy_values<T: npyz::Deserialize>(bytes: &[u8]) -> std::io::Result<Vec<T>> {
    npyz::NpyFile::new(bytes).and_then(npyz::NpyFile::into_vec)
}
