//! BLAKE3 checksums of checkpoints and arrays, stored with the bytes and verified on every read. Rows without a checksum are
//! not verified.

use super::{Result, StoreError};

/// The checksum of bytes.
pub(super) fn digest(bytes: &[u8]) -> Vec<u8> {
    blake3::hash(bytes).as_bytes().to_vec()
}

/// Verifies stored bytes of a trial. An empty checksum is not verified.
pub(crate) fn check(hash: &str, what: &str, bytes: &[u8], checksum: &[u8]) -> Result<()> {
    match checksum.is_empty() || checksum == blake3::hash(bytes).as_bytes() {
        true => Ok(()),
        false => Err(StoreError::Damaged(hash.to_owned(), what.to_owned())),
    }
}
