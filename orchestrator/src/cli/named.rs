//! Arguments of several commands: specs with changes, and trials as `SPEC HASH` or `DB HASH`.

use std::ffi::OsString;
use std::fmt::Display;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use metasense_lab::measured::{self, Measured};
use metasense_lab::simulate;
use metasense_schemas::spec::{SweepSpec, TrialSpec};
use metasense_source::Source;
use metasense_worker::design::FeasibleSet;
use metasense_worker::memory;
use metasense_worker::run::NoResult;
use metasense_worker::{design, problem};

use super::spec_body::SpecBody;
use super::{Error, Format};
use crate::analysis;
use crate::cluster::facts::Facts;
use crate::cluster::home::attempts;
use crate::files;
use crate::look::{Table, short_hash};
use crate::plan::{Plan, PlannedTrial, counted};
use crate::reader::{Reader, StoredTrial, quoted};
use crate::report::load::finished_trials;
use crate::store::StoreError;

/// Measured records of a trial's body. Prints a note if their signals had to be resampled.
pub(super) fn read_records(file: &Path, trial: &TrialSpec) -> Result<Measured, Error> {
    let measured = measured::read(file, trial)?;
    measured.note(trial).iter().for_each(|note| say!("{note}"));
    Ok(measured)
}

/// Parses a word; refuses an empty one, which would name any trial.
pub(super) fn word(text: &str) -> Result<String, String> {
    match text.trim().is_empty() {
        true => Err("is empty: set the variable in its place, or leave it out".into()),
        false => Ok(text.to_owned()),
    }
}

/// A spec with changes.
#[derive(Debug, Clone, clap::Args)]
pub(super) struct Spec {
    /// The spec file (TOML), such as schemas/sweeps/quickstart.toml
    #[arg(value_name = "SPEC")]
    pub file: PathBuf,
    /// Values that replace those of the spec, in TOML syntax: optimise.iterations=20 sensors.noise=0.03 'sweep.seeds=[1,
    /// 2]'; KEY= without a value removes a key
    #[arg(value_name = "KEY=VALUE", value_parser = word)]
    pub changes: Vec<String>,
}

impl Spec {
    /// Reads the spec and applies the changes.
    pub fn source(&self) -> Result<Source, Error> {
        let text = files::read_spec(&self.file).map_err(|error| match error.kind() {
            ErrorKind::InvalidData => Error::Usage(error.to_string()),
            _ => Error::unreadable(&self.file)(error),
        })?;
        Ok(Source::spec(&self.file, text, &self.changes)?)
    }

    /// Expands the spec into trials.
    pub fn plan(&self) -> Result<Plan, Error> {
        planned(self.source()?)
    }
}

/// Expands a spec into trials; warns about what is left out.
pub(super) fn planned(source: Source) -> Result<Plan, Error> {
    let plan = Plan::of(source)?;
    plan.left_out.iter().for_each(|why| say!("warning: {why}; left out"));
    Ok(plan)
}

/// One trial.
#[derive(Debug, Clone, clap::Args)]
pub(super) struct Named {
    /// The spec file, or the database that contains the trial
    #[arg(value_name = "SPEC|DB")]
    pub source: PathBuf,
    /// The trial, by its hash or the beginning of it (`metasense expand SPEC` lists the hashes; with SPEC, the first trial
    /// by default). After SPEC also values that replace those of the spec, as in `run`
    #[arg(value_name = "HASH|KEY=VALUE", value_parser = word)]
    pub words: Vec<String>,
}

/// Finished trials of a database, and how to print them.
#[derive(Debug, clap::Args)]
pub(super) struct Finished {
    /// The database
    #[arg(value_name = "DB")]
    db: PathBuf,
    /// One trial, by its hash or the beginning of it [default: all finished trials]
    #[arg(value_parser = word)]
    hash: Option<String>,
    /// Format: a table of means, or rows
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    pub format: Format,
}

impl Finished {
    /// The trials. Calls `visit` with what is stored of each `wanted` trial.
    ///
    /// # Errors
    /// If no trial is finished, or as `visit`.
    pub async fn visit(
        &self,
        wanted: impl Fn(&analysis::Trial) -> bool,
        mut visit: impl FnMut(&StoredTrial, &mut analysis::Trial) -> Result<(), Error>,
    ) -> Result<Vec<analysis::Trial>, Error> {
        let visited =
            Reader::with_reader(Database::at(&self.db).await?, async |reader| -> Result<_, Error> {
                let mut trials = finished_trials(reader).await?;
                if let Some(hash) = &self.hash {
                    let hash = reader.hash_of(hash).await?;
                    trials.retain(|trial| trial.hash == hash);
                }
                for trial in trials.iter_mut().filter(|trial| wanted(trial)) {
                    if let Some(stored) = reader.stored(&trial.hash).await? {
                        visit(&stored, trial)?;
                    }
                }
                Ok(trials)
            })
            .await?;
        let (db, word) = (self.db.display(), files::quoted(&self.db));
        let none = || Error::Usage(format!("{db} contains no finished trial; see `metasense status {word}`"));
        if visited.is_empty() { Err(none()) } else { Ok(visited) }
    }
}

/// A database to read: a file, or the facts of the shards of a folder.
#[derive(Debug)]
pub(super) enum Database {
    File(PathBuf),
    Facts(Facts),
}

impl Database {
    /// Opens a path. For a folder, first adds new databases of shards to its facts.
    pub async fn at(path: &Path) -> Result<Self, Error> {
        if !path.is_dir() {
            return Ok(Self::File(path.to_owned()));
        }
        if attempts(path).is_empty() {
            return usage!("{} contains no database of a shard; pass a database in it", path.display());
        }
        let mut facts =
            Facts::for_folder(path).map_err(Error::io("making a folder in", std::env::temp_dir()))?;
        for (file, why) in facts.look().await? {
            say!("refused: {}: {why}", file.display());
        }
        say!("{}", facts.message());
        Ok(Self::Facts(facts))
    }
}

impl AsRef<Path> for Database {
    fn as_ref(&self) -> &Path {
        match self {
            Self::File(path) => path,
            Self::Facts(facts) => facts.db(),
        }
    }
}

/// A body of a trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Which {
    /// Before training
    Initial,
    /// After training
    Optimised,
}

/// The design of one of the trial's bodies, or from a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Design {
    Of(Which),
    File(PathBuf),
}

impl From<OsString> for Design {
    fn from(text: OsString) -> Self {
        match text.to_str().map(|name| Which::from_str(name, false)) {
            Some(Ok(which)) => Self::Of(which),
            _ => Self::File(text.into()),
        }
    }
}

impl Named {
    /// Whether the source is a database, not a spec.
    pub fn is_database(&self) -> bool {
        let named_so = self.source.extension().is_some_and(|e| e == "sqlite");
        named_so || self.source.is_dir() || files::is_database(&self.source)
    }

    /// The hash on the command line, or its beginning.
    pub fn hash_argument(&self) -> Result<Option<&str>, Error> {
        let database = self.is_database();
        let mut words = self.words.iter().filter(|word| !word.contains('='));
        let asked = words.next().map(String::as_str);
        if database && self.words.iter().any(|word| word.contains('=')) {
            return usage!("KEY=VALUE changes a spec; the trials of a database cannot be changed");
        }
        match words.next() {
            Some(_) => usage!("name one trial: SPEC HASH or DB HASH"),
            None => Ok(asked),
        }
    }

    /// The spec on the command line.
    fn spec(&self) -> Spec {
        let changes = self.words.iter().filter(|word| word.contains('=')).cloned().collect();
        Spec { file: self.source.clone(), changes }
    }

    pub fn plan(&self) -> Result<Plan, Error> {
        self.spec().plan()
    }

    /// The trial of the plan with the given hash; without a hash, `default`.
    pub fn find_trial(&self, plan: &Plan, default: &PlannedTrial) -> Result<PlannedTrial, Error> {
        let Some(hash) = self.hash_argument()? else { return Ok(default.clone()) };
        let (path, word) = (self.source.display(), files::quoted(&self.source));
        let found = plan.find(hash).cloned();
        found.map_err(|e| Error::Usage(format!("{path}: {e}; `metasense expand {word}` lists them")))
    }

    /// The database and the hash or its beginning; for a spec, the database that it writes to.
    pub fn in_database(&self) -> Result<(PathBuf, String), Error> {
        if self.is_database() {
            let word = files::quoted(&self.source);
            let Some(asked) = self.hash_argument()? else { return usage!("name the trial: {word} HASH") };
            return Ok((self.source.clone(), asked.to_owned()));
        }
        let plan = self.plan()?;
        let trial = self.find_trial(&plan, &plan.trials[0])?;
        Ok((plan.default_database(), trial.hash))
    }

    /// The stored trial; an error with its state and reason if it is not done.
    pub async fn stored(&self) -> Result<StoredTrial, Error> {
        let (db, hash) = self.in_database()?;
        let db = Database::at(&db).await?;
        let asked = async |reader: &mut Reader| -> Result<_, Error> {
            if let Some(stored) = reader.stored(&hash).await? {
                return Ok(stored);
            }
            let hash = reader.hash_of(&hash).await?;
            let sql = format!("SELECT state, reason FROM trial WHERE hash = {}", quoted(&hash));
            let row = reader.query::<Table>(&sql).await?.rows.swap_remove(0);
            let [state, reason] = [0, 1].map(|i| row[i].as_str().unwrap_or_default());
            Err(Error::Usage(match state {
                "failed" => format!(
                    "trial {hash} failed: {reason}; `metasense run SPEC --retry-failed` resumes it (metasense status {} {})",
                    files::quoted(&self.source),
                    short_hash(&hash)
                ),
                _ => format!("trial {hash} is not done yet: {state}; `metasense run SPEC` finishes it"),
            }))
        };
        Reader::with_reader(&db, asked).await
    }

    /// Hash and spec of the trial; by default the first of a spec.
    pub async fn read(&self) -> Result<(String, TrialSpec), Error> {
        self.read_or(|plan| &plan.trials[0]).await
    }

    async fn read_or(&self, default: impl Fn(&Plan) -> &PlannedTrial) -> Result<(String, TrialSpec), Error> {
        if !self.is_database() {
            let plan = self.plan()?;
            let trial = self.find_trial(&plan, default(&plan))?;
            return Ok((trial.hash, trial.spec));
        }
        let (db, hash) = self.in_database()?;
        let db = Database::at(&db).await?;
        Reader::with_reader(&db, async |reader| {
            let hash = reader.hash_of(&hash).await?;
            let sql = format!("SELECT spec FROM trial WHERE hash = {}", quoted(&hash));
            let text = reader.query::<Table>(&sql).await?.rows.swap_remove(0).swap_remove(0);
            let spec = serde_json::from_str(text.as_str().unwrap_or_default());
            let spec = spec.map_err(|e| StoreError::unreadable(&hash, "spec", e))?;
            Ok((hash, spec))
        })
        .await
    }

    /// The body of the trial; without a hash, the body that all trials of the spec share.
    pub async fn body(&self) -> Result<SpecBody, Error> {
        let (path, word) = (self.source.display(), files::quoted(&self.source));
        if self.is_database() || self.hash_argument()?.is_some() {
            return SpecBody::of_trial(&self.read().await?.1).map_err(|e| self.refused(e));
        }
        SpecBody::new(&self.spec().source()?)?.ok_or_else(|| {
            Error::Usage(format!(
                "{path} has several bodies: name a trial, {word} HASH; `metasense expand {word}` lists them"
            ))
        })
    }

    /// The trial, if its body is an external one.
    pub async fn external(&self) -> Result<Option<TrialSpec>, Error> {
        if !self.is_database() && self.spec().source()?.parse::<SweepSpec>()?.body.kind.is_polygons() {
            return Ok(None);
        }
        Ok(Some(self.read().await?.1).filter(|trial| !trial.body.kind.is_polygons()))
    }

    /// Checks that this machine has the memory that the trial needs.
    pub fn check_memory(&self, trial: &TrialSpec) -> Result<(), Error> {
        let Err(e) = memory::check_here(trial) else { return Ok(()) };
        match self.is_database() {
            true => Err(self.refused(e)),
            false => Err(self.spec().source()?.error_with(&e.key, Some(&e.value), &e.remedy).into()),
        }
    }

    /// The error for a key, with file and line if the source is a spec.
    pub fn refused_key(&self, key: &str, remedy: &str) -> Error {
        match self.is_database() {
            true => self.refused(format!("{key}: {remedy}")),
            false => self.spec().source().map_or_else(|e| e, |s| s.error_with(key, None, remedy).into()),
        }
    }

    /// The error of a failed computation: the machine lacks resources, or the input is bad.
    pub fn failed(&self, failure: NoResult) -> Error {
        match failure {
            NoResult::Shortage(what) => Error::Short(what),
            failure => self.refused(failure),
        }
    }

    /// An error that begins with the name of the source.
    pub fn refused(&self, why: impl Display) -> Error {
        Error::Usage(format!("{}: {why}", self.source.display()))
    }
}

/// One trial, and a design of its body.
#[derive(Debug, Clone, clap::Args)]
pub(super) struct Designed {
    #[command(flatten)]
    pub trial: Named,
    /// The design: `initial`, `optimised` (of a finished trial in a database), or a file (.npy or .csv)
    #[arg(long, value_name = "DESIGN|FILE", default_value = "initial")]
    pub design: Design,
}

impl Designed {
    /// Hash and spec of the trial, and the design; by default the first trial of a spec.
    pub async fn read(&self) -> Result<(String, TrialSpec, Vec<f64>), Error> {
        self.read_or(|plan| &plan.trials[0]).await
    }

    /// Like [`Self::read`], with another default.
    pub async fn read_or(
        &self,
        default: impl Fn(&Plan) -> &PlannedTrial,
    ) -> Result<(String, TrialSpec, Vec<f64>), Error> {
        let (hash, spec, own) = match self.design {
            Design::Of(Which::Initial) | Design::File(_) => {
                let (hash, spec) = self.trial.read_or(default).await?;
                (hash, spec, None)
            }
            Design::Of(Which::Optimised) if !self.trial.is_database() => {
                return usage!("--design optimised: name a finished trial by DB HASH");
            }
            Design::Of(Which::Optimised) => {
                let StoredTrial { hash, specs: [_, spec], designs: [_, design], .. } =
                    self.trial.stored().await?;
                (hash, spec, Some(design))
            }
        };
        let (layout, initial) = simulate::body(&spec).map_err(|e| self.trial.refused(e))?;
        if let Design::File(file) = &self.design {
            let given = design::read(file, &layout)?;
            let limits = problem::limits(&spec.feasible).map_err(|e| self.trial.refused(e))?;
            let broken = FeasibleSet::new(&layout, limits, &[]).violations(&given);
            if let Some(first) = broken.first() {
                say!(
                    "warning: {} violates {} of [feasible] and cannot be cast; the first: {first}. `metasense body project` repairs it",
                    file.display(),
                    counted(broken.len(), "limit")
                );
            }
            return Ok((hash, spec, given));
        }
        Ok((hash, spec, own.unwrap_or(initial)))
    }
}
