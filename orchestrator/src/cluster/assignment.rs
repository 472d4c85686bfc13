//! Assigns trials to shards: the longest first, by weight, each to the least busy shard or to one that trains its body. The
//! result is the same on every machine.
//!
//! The assignment is stored with the shards and never changes; new trials of a sweep are added. Equal trials give equal files.
//! The trials of each shard are stored, too, so that shards need not expand the spec.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::io::{self, ErrorKind};
use std::iter;
use std::path::{Path, PathBuf};

use metasense_lab::cost;

use super::Shard;
use super::home::attempts;
use crate::files;
use crate::plan::{Plan, PlannedTrial};

/// The shard of each trial, by its hash.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Assignment {
    shards: u32,
    of: BTreeMap<String, u32>,
}

/// An error of an assignment.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum AssignmentError {
    /// The file cannot be read or written.
    #[error("cannot {doing} {}, which assigns trials to shards", path.display())]
    File { doing: &'static str, path: PathBuf, source: io::Error },
    /// A line of the file is invalid.
    #[error("{}:{line}: {text:?} is not a hash with a shard from 1 to {shards}; restore the file", path.display())]
    Line { path: PathBuf, line: usize, text: String, shards: u32 },
    /// A line of a shard's list of trials is invalid.
    #[error("{}:{line}: {why}; `metasense cluster submit` writes it again", path.display())]
    Trial { path: PathBuf, line: usize, why: String },
    /// The folder contains databases, but no assignment.
    #[error(
        "{} contains databases of shards, but not {}, which assigns trials to shards: restore it, or merge the databases \
         and choose another folder",
        folder.display(), file
    )]
    Lost { folder: PathBuf, file: String },
}

/// Work of the shards. Each shard trains the bodies of its trials.
struct ShardLoads<'a> {
    /// Load by shard.
    loads: Vec<u64>,
    /// Loads with their shards, ascending.
    order: BTreeSet<(u64, u32)>,
    /// Shards that train each body.
    homes: HashMap<&'a str, BTreeSet<u32>>,
}

impl<'a> ShardLoads<'a> {
    fn new(shards: u32) -> Self {
        let order = (1..=shards).map(|shard| (0, shard)).collect();
        Self { loads: vec![0; shards as usize], order, homes: HashMap::new() }
    }

    fn put(&mut self, trial: &'a PlannedTrial, shard: u32) {
        let trains = self.homes.entry(&trial.training).or_default().insert(shard);
        let load = &mut self.loads[shard as usize - 1];
        self.order.remove(&(*load, shard));
        *load += trial.weight.sum(trains);
        self.order.insert((*load, shard));
    }

    /// The shard that trains the trial's body, unless its load is so high that training the body again on the least busy shard
    /// pays.
    fn shard_for(&self, trial: &PlannedTrial) -> u32 {
        let (least, shard) = *self.order.first().expect("there is a shard");
        let homes = self.homes.get(&*trial.training).into_iter().flatten();
        let home = homes.map(|home| (self.loads[*home as usize - 1], *home)).min();
        match home {
            Some((load, home)) if load <= least + 2 * trial.weight.steps => home,
            _ => shard,
        }
    }
}

impl Assignment {
    /// Assigns new trials.
    pub fn new(trials: &[PlannedTrial], shards: u32) -> Self {
        let mut assignment = Self { shards, of: BTreeMap::new() };
        assignment.add(trials);
        assignment
    }

    /// Reads the assignment of a folder and adds new trials.
    ///
    /// # Errors
    /// If the file is unreadable, or lost although databases exist.
    pub fn in_folder(folder: &Path, trials: &[PlannedTrial], shards: u32) -> Result<Self, AssignmentError> {
        let mut assignment = Self { shards, of: BTreeMap::new() };
        let path = folder.join(file_name(shards));
        match std::fs::read_to_string(&path) {
            Ok(text) => assignment.of = read(&text, shards, &path)?,
            Err(error) if error.kind() == ErrorKind::NotFound => {
                if attempts(folder).keys().any(|shard| shard.count() == shards) {
                    return Err(AssignmentError::Lost { folder: folder.to_owned(), file: file_name(shards) });
                }
            }
            Err(source) => return Err(AssignmentError::File { doing: "read", path, source }),
        }
        assignment.add(trials);
        Ok(assignment)
    }

    /// Writes the assignment if it has changed.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), AssignmentError> {
        let lines = self.of.iter().map(|(hash, shard)| format!("{hash},{shard}\n"));
        let text = iter::once(format!("{HEAD}\n")).chain(lines).collect();
        write(folder.join(file_name(self.shards)), text)
    }

    /// Writes the trials of each shard, one per line.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write_trials(&self, folder: &Path, trials: &[PlannedTrial]) -> Result<(), AssignmentError> {
        let mut texts = vec![String::new(); self.shards as usize];
        for trial in trials {
            let text = &mut texts[self.shard(&trial.hash) as usize - 1];
            text.push_str(&serde_json::to_string(trial).expect("a trial is JSON"));
            text.push('\n');
        }
        let shards = (1..=self.shards).filter_map(|index| Shard::new(index, self.shards));
        shards.zip(texts).try_for_each(|(shard, text)| write(trials_file(folder, shard), text))
    }

    /// All assignments in a folder, for any number of shards.
    ///
    /// # Errors
    /// If an assignment cannot be read.
    pub fn all_in(folder: &Path) -> Result<Vec<Self>, AssignmentError> {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        let named = entries.filter_map(|entry| {
            let name = entry.file_name();
            let (_, shards) = name.to_str()?.strip_suffix(".csv")?.rsplit_once("-of-")?;
            let shards = shards.parse().ok().filter(|shards| (1..=Shard::MOST).contains(shards))?;
            (name.to_str()? == file_name(shards)).then_some(shards)
        });
        let shards: BTreeSet<u32> = named.collect();
        shards.into_iter().map(|shards| Self::in_folder(folder, &[], shards)).collect()
    }

    /// Number of shards.
    pub fn shards(&self) -> u32 {
        self.shards
    }

    /// Hashes of all trials with their shards.
    pub fn hashes(&self) -> impl Iterator<Item = (&str, u32)> {
        self.of.iter().map(|(hash, shard)| (hash.as_str(), *shard))
    }

    /// Removes all other trials, which the spec no longer contains.
    pub fn keep<'a>(&mut self, trials: impl Iterator<Item = &'a PlannedTrial>) {
        let kept: HashSet<&str> = trials.map(|trial| trial.hash.as_str()).collect();
        self.of.retain(|hash, _| kept.contains(hash.as_str()));
    }

    /// Removes these trials.
    pub fn leave_out(&mut self, hashes: &HashSet<&str>) {
        self.of.retain(|hash, _| !hashes.contains(hash.as_str()));
    }

    /// Assigns unassigned trials only: first one trial per body, then those whose body is already in training.
    fn add(&mut self, trials: &[PlannedTrial]) {
        let (mut dealt, mut new) =
            (ShardLoads::new(self.shards), BTreeMap::<&str, Vec<&PlannedTrial>>::new());
        for trial in trials {
            match self.of.get(&trial.hash) {
                Some(shard) => dealt.put(trial, *shard),
                None => new.entry(&trial.training).or_default().push(trial),
            }
        }
        let (mut first, mut others) = (Vec::new(), Vec::new());
        for (training, mut group) in new {
            group.sort_by_key(|trial| (Reverse(trial.weight.comparison), &trial.hash));
            if !dealt.homes.contains_key(training) {
                first.push(group.remove(0));
            }
            others.extend(group);
        }
        first.sort_by_key(|trial| (Reverse(trial.weight.sum(true)), &trial.hash));
        others.sort_by_key(|trial| (Reverse(trial.weight.comparison), &trial.hash));
        for trial in first.into_iter().chain(others) {
            let shard = dealt.shard_for(trial);
            dealt.put(trial, shard);
            self.of.insert(trial.hash.clone(), shard);
        }
    }

    /// The shard of an assigned trial.
    pub fn shard(&self, hash: &str) -> u32 {
        *self.of.get(hash).unwrap_or_else(|| panic!("trial {hash} has not been assigned to a shard"))
    }

    /// Keeps only the trials of one shard in a plan, in their order.
    pub fn restrict(&self, shard: Shard, plan: &mut Plan) {
        plan.trials.retain(|trial| self.shard(&trial.hash) == shard.index());
        cost::first_trains(&mut plan.trials);
    }

    /// Estimated core-seconds per shard.
    pub fn costs(&self, trials: &[PlannedTrial]) -> Vec<f64> {
        let (mut costs, mut trained) = (vec![0.0; self.shards as usize], HashSet::new());
        for trial in trials {
            let shard = self.shard(&trial.hash);
            costs[shard as usize - 1] += trial.cost.sum(trained.insert((shard, &trial.training)));
        }
        costs
    }
}

const HEAD: &str = "hash,shard";

fn file_name(shards: u32) -> String {
    format!("assignment-of-{shards}.csv")
}

/// The submitted trials of a shard; `None` if there is no list.
///
/// # Errors
/// If the list cannot be read, or this program gives other hashes.
pub fn trials_of(folder: &Path, shard: Shard) -> Result<Option<Vec<PlannedTrial>>, AssignmentError> {
    let path = trials_file(folder, shard);
    let text = match std::fs::read_to_string(&path) {
        Ok(text) => text,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(source) => return Err(AssignmentError::File { doing: "read", path, source }),
    };
    let trial = |(line, text): (usize, &str)| {
        let wrong = |why| AssignmentError::Trial { path: path.clone(), line: line + 1, why };
        let mut trial: PlannedTrial = serde_json::from_str(text).map_err(|error| wrong(error.to_string()))?;
        if trial.spec.hash() != trial.hash {
            return Err(wrong(format!("this program computes a different hash for trial {}", trial.hash)));
        }
        trial.training = trial.spec.training();
        trial.cost = cost::of(&trial.spec, trial.units).0;
        Ok(trial)
    };
    let mut trials: Vec<PlannedTrial> = text.lines().enumerate().map(trial).collect::<Result<_, _>>()?;
    cost::first_trains(&mut trials);
    Ok(Some(trials))
}

fn trials_file(folder: &Path, shard: Shard) -> PathBuf {
    folder.join(format!("{}.trials.jsonl", shard.file_stem()))
}

fn write(path: PathBuf, text: String) -> Result<(), AssignmentError> {
    if std::fs::read_to_string(&path).is_ok_and(|written| written == text) {
        return Ok(());
    }
    let doing = "write";
    files::write(&path, text.as_bytes()).map_err(|source| AssignmentError::File { doing, path, source })
}

fn read(text: &str, shards: u32, path: &Path) -> Result<BTreeMap<String, u32>, AssignmentError> {
    let mut shard_by_hash = BTreeMap::new();
    for (number, text) in text.lines().enumerate().filter(|(number, text)| *number > 0 || *text != HEAD) {
        let entry = text.split_once(',').and_then(|(hash, shard)| {
            let shard = shard.parse().ok().filter(|shard| (1..=shards).contains(shard))?;
            (!hash.is_empty() && hash.bytes().all(|b| b.is_ascii_hexdigit())).then_some((hash, shard))
        });
        let Some((hash, shard)) = entry else {
            let (path, text) = (path.to_owned(), text.to_owned());
            return Err(AssignmentError::Line { path, line: number + 1, text, shards });
        };
        shard_by_hash.insert(hash.to_owned(), shard);
    }
    Ok(shard_by_hash)
}

#[cfg(test)]
mod tests;
