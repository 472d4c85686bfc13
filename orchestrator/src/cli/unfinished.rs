//! The progress of a long command, stored in its `--out-dir` so that the same command resumes from there.

use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use metasense_worker::simd;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{Error, make_folder};
use crate::files::put_in_place;
use crate::leftovers::remove_abandoned;
use crate::provenance::code_with_lab;

/// Name of the file in the folder.
const NAME: &str = "unfinished.bin";
/// Version of the file format: a digest of all inputs, then the state as postcard.
const VERSION: u32 = 1;

/// The progress file of a command; without a folder, nothing is stored.
pub(super) struct Unfinished<T> {
    path: Option<PathBuf>,
    digest: [u8; 32],
    state: PhantomData<T>,
}

impl<T: Serialize + DeserializeOwned> Unfinished<T> {
    /// Opens the file of a command with these inputs, this code and instruction set; also returns the stored state.
    ///
    /// # Errors
    /// If the folder contains the progress of another command, other inputs or other code, or cannot be read.
    pub fn new(
        folder: Option<&Path>,
        command: &str,
        inputs: &impl Serialize,
    ) -> Result<(Self, Option<T>), Error> {
        let inputs = postcard::to_stdvec(&(VERSION, code_with_lab(), simd::name(), command, inputs))
            .expect("inputs are plain data");
        let digest = *blake3::hash(&inputs).as_bytes();
        let path = folder.map(|folder| folder.join(NAME));
        let ours = Self { path, digest, state: PhantomData };
        let Some(path) = &ours.path else { return Ok((ours, None)) };
        let folder = path.parent().unwrap_or(path);
        make_folder(folder)?;
        // files of processes that were killed while they wrote results
        remove_abandoned(folder, |name| name.starts_with('.') && name.ends_with(".tmp"));
        let bytes = match std::fs::read(path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok((ours, None)),
            Err(e) => return Err(Error::unreadable(path)(e)),
        };
        let state = bytes.strip_prefix(&digest).and_then(|bytes| postcard::from_bytes(bytes).ok());
        match state {
            Some(state) => Ok((ours, Some(state))),
            None => usage!(
                "{} contains the progress of another command, of other inputs or of another build: remove it, or choose \
                 another --out-dir",
                path.display()
            ),
        }
    }

    /// Stores the state; a failure is only printed.
    pub fn keep(&self, state: &T) {
        let Some(path) = &self.path else { return };
        let bytes = postcard::to_extend(state, self.digest.to_vec()).expect("a state is plain data");
        // all processes use this name, so killed ones leave no other files
        let beside = path.with_extension("new");
        let kept = std::fs::write(&beside, bytes).and_then(|()| put_in_place(&beside, path));
        if let Err(why) = kept {
            say!("the progress cannot be stored: {why}");
        }
    }

    /// Removes the file once the command has written its results.
    pub fn done(&self) -> Result<(), Error> {
        let Some(path) = &self.path else { return Ok(()) };
        for path in [path.with_extension("new"), path.clone()] {
            match std::fs::remove_file(&path) {
                Err(e) if e.kind() == std::io::ErrorKind::NotFound => {}
                removed => removed.map_err(Error::io("removing", &path))?,
            }
        }
        Ok(())
    }
}
