//! The progress of a long command, kept in its `--out-dir` so that the same command goes on from there.

use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use metasense_worker::simd;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{Error, make_folder};
use crate::files::put_in_place;
use crate::leftovers::remove_abandoned;
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
    /// Opens the file of a command of this name with these inputs, this code and instruction set; with the state kept in it.
    ///
    /// # Errors
    /// If the folder holds the progress of another command, other inputs or other code, or cannot be read.
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
        let folder = path.parent().unwrap_or(path);
        make_folder(folder)?;
        // of whoever was killed while it wrote its results
        remove_abandoned(folder, |name| name.starts_with('.') && name.ends_with(".tmp"));
        let bytes = match std::fs::read(path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok((ours, None)),
            Err(e) => return Err(Error::unreadable(path)(e)),
        };
        let state = bytes.strip_prefix(&digest).and_then(|bytes| postcard::from_bytes(bytes).ok());
        match state {
            Some(state) => Ok((ours, Some(state))),
            None => Err(Error::Usage(format!(
                "{} contains the progress of another command, of other inputs or of another build: remove it, or choose \
                 another --out-dir",
                path.display()
            ))),
        }
    }

    /// Writes the state; a failure is only said.
    pub fn keep(&self, state: &T) {
        let Some(path) = &self.path else { return };
        let bytes = postcard::to_extend(state, self.digest.to_vec()).expect("a state is plain data");
        // one name whatever the process: of a killed one nothing is left behind
        let beside = path.with_extension("new");
        let kept = std::fs::write(&beside, bytes).and_then(|()| put_in_place(&beside, path));
        if let Err(why) = kept {
            say!("the progress cannot be stored: {why}");
        }
    }

    /// The command has written its results.
    pub fn done(&self) -> Result<(), Error> {
        let Some(path) = &self.path else { return Ok(()) };
        for path in [path.with_extension("new"), path.clone()] {
            match std::fs::remove_file(&path) {
                Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
                    return Err(Error::io("removing", path)(e));
                }
                _ => {}
            }
        }
        Ok(())
    }
}
