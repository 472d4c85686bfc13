//! What a command that computes for long has come to, in its `--out`, so that the same command goes on from there.

use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use metasense_worker::simd;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{Error, make_folder, write};
use crate::provenance::code;

/// Its name in the folder.
const NAME: &str = "unfinished.bin";
/// Of the file: a digest of everything that the results hang on, then the state as postcard.
const VERSION: u32 = 1;

/// The file of one command; without a folder there is none, and nothing is kept.
pub(super) struct Unfinished<T> {
    path: Option<PathBuf>,
    digest: [u8; 32],
    state: PhantomData<T>,
}

impl<T: Serialize + DeserializeOwned> Unfinished<T> {
    /// That of a command of this name with these inputs, by this code and instruction set, and what it had come to.
    ///
    /// # Errors
    /// If the folder holds what another command, other inputs or other code have come to, or cannot be read.
    pub fn new(
        folder: Option<&Path>,
        command: &str,
        inputs: &impl Serialize,
    ) -> Result<(Self, Option<T>), Error> {
        let inputs = postcard::to_stdvec(&(VERSION, code(), simd::name(), command, inputs))
            .expect("inputs are plain data");
        let digest = *blake3::hash(&inputs).as_bytes();
        let path = folder.map(|folder| folder.join(NAME));
        let ours = Self { path, digest, state: PhantomData };
        let Some(path) = &ours.path else { return Ok((ours, None)) };
        make_folder(path.parent().unwrap_or(path))?;
        let bytes = match std::fs::read(path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok((ours, None)),
            Err(source) => return Err(Error::Unreadable { path: path.clone(), source }),
        };
        let state = bytes.strip_prefix(&digest).and_then(|bytes| postcard::from_bytes(bytes).ok());
        match state {
            Some(state) => Ok((ours, Some(state))),
            None => Err(Error::Usage(format!(
                "{} is what another command, the same with other inputs, or another build has come to: remove it, or give \
                 another --out",
                path.display()
            ))),
        }
    }

    /// Keeps what the command has come to; says so where it cannot.
    pub fn keep(&self, state: &T) {
        let Some(path) = &self.path else { return };
        let bytes = postcard::to_extend(state, self.digest.to_vec()).expect("a state is plain data");
        if let Err(why) = write(path, bytes) {
            say!("what has been computed is not kept: {why}");
        }
    }

    /// The command has written its results.
    pub fn done(&self) -> Result<(), Error> {
        let Some(path) = &self.path else { return Ok(()) };
        match std::fs::remove_file(path) {
            Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
                Err(Error::Io { doing: "removing", path: path.clone(), source })
            }
            _ => Ok(()),
        }
    }
}
