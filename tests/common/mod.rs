//! Shared by the end-to-end tests: a temporary folder, the program, and the reference spec to edit.

pub mod processes;
pub mod proxy;
pub mod roll;
pub mod skip;
pub mod slurm;

use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};

use metasense::look::Table;
use metasense::reader::Reader;
use npyz::WriterBuilder;

/// A small but complete spec of two trials.
pub const SPEC: &str = r#"name = "s"
[body]
columns = 6
rows = 6
spacing = 15.0
ligament_length = 2.25
density = 1e-8
stiffness = { stretch = 3.0, shear = 0.5, bend = 1.0 }
[stimuli]
kind = "bell"
samples = 12
test = 4
[sweep]
panels = [2]
sensors = [1, 2]
"#;

/// A line of `expand --format csv` without the trial's cost, which is measured each time.
pub fn without_cost(line: &str) -> String {
    let cells: Vec<&str> = line.split(',').collect();
    [&cells[..10], &cells[11..]].concat().join(",")
}

/// Two trials of a quarter of a second each: a heavy body is slow and needs few steps; a narrow network has small checkpoints.
pub const TINY: &str = r#"name = "tiny"
[body]
columns = 4
rows = 4
spacing = 15.0
ligament_length = 2.25
density = 4e-8
stiffness = { stretch = 3.0, shear = 0.5, bend = 1.0 }
[time]
duration = 0.2
samples = 20
[stimuli]
kind = "bell"
samples = 8
test = 2
holdout = 2
width = [0.05, 0.1]
onset = [0.0, 0.1]
[solver]
tolerance = 1e-3
[brain]
iterations = 10
width = 16
[optimise]
iterations = 4
batch = 4
[sweep]
panels = [2]
sensors = [1, 2]
"#;

/// The same with a light body and finer steps, for tests of errors: six samples determine them better than with a heavy body.
pub fn light() -> String {
    TINY.replace("density = 4e-8", "density = 1e-8").replace("tolerance = 1e-3", "tolerance = 1e-4")
}

/// A folder that is removed after the test.
pub struct Bench {
    folder: tempfile::TempDir,
}

impl Bench {
    pub fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A number from a database in the folder, 0 if there is none yet. Queried in this process, while another may end.
    pub fn number(&self, db: &str, sql: &str) -> u64 {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let found = runtime.block_on(async {
            let mut reader = Reader::open(&self.path(db)).await.ok()?;
            reader.query::<Table>(sql).await.ok()?.rows.first()?.first()?.as_u64()
        });
        found.unwrap_or(0)
    }

    /// Writes a file and returns its path.
    pub fn file(&self, name: &str, text: &str) -> PathBuf {
        std::fs::write(self.path(name), text).unwrap();
        self.path(name)
    }

    /// Writes an NPY file.
    pub fn write_array(&self, name: &str, shape: &[u64], values: &[f64]) {
        let mut bytes = Vec::new();
        let mut npy =
            npyz::WriteOptions::new().default_dtype().shape(shape).writer(&mut bytes).begin_nd().unwrap();
        npy.extend(values.iter().copied()).unwrap();
        npy.finish().unwrap();
        std::fs::write(self.path(name), bytes).unwrap();
    }

    /// Shape and values of an NPY file.
    pub fn array(&self, name: &str) -> (Vec<u64>, Vec<f64>) {
        let bytes = std::fs::read(self.path(name)).unwrap();
        let file = npyz::NpyFile::new(&bytes[..]).unwrap();
        (file.shape().to_vec(), file.into_vec().unwrap())
    }

    /// Values of an array of any type in an NPZ file.
    pub fn member(&self, file: &str, name: &str) -> Vec<f64> {
        let mut archive = zip::ZipArchive::new(std::fs::File::open(self.path(file)).unwrap()).unwrap();
        let array = npyz::NpyFile::new(archive.by_name(&format!("{name}.npy")).unwrap()).unwrap();
        match array.dtype().descr().as_str() {
            "'<f8'" => array.into_vec().unwrap(),
            "'<u8'" => array.into_vec::<u64>().unwrap().into_iter().map(|n| n as f64).collect(),
            "'|u1'" => array.into_vec::<u8>().unwrap().into_iter().map(f64::from).collect(),
            other => panic!("{name}: {other}"),
        }
    }

    /// Runs the program in the folder.
    pub fn metasense(&self, args: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_metasense"))
            .args(args)
            .current_dir(self.folder.path())
            .output()
            .unwrap()
    }

    /// The exit code of a call with outputs that nobody reads, as in `metasense … 2>&1 | true`.
    pub fn closed(&self, args: &[&str]) -> Option<i32> {
        let closed = || std::io::pipe().unwrap().1;
        let mut command = Command::new(env!("CARGO_BIN_EXE_metasense"));
        command.args(args).current_dir(self.folder.path()).stdout(closed()).stderr(closed());
        command.status().unwrap().code()
    }

    /// Starts the program in the folder; discards its output.
    pub fn start(&self, args: &[&str]) -> Child {
        let mut command = Command::new(env!("CARGO_BIN_EXE_metasense"));
        command.args(args).current_dir(self.folder.path()).stdout(Stdio::null()).stderr(Stdio::null());
        command.spawn().unwrap()
    }

    /// Runs the program repeatedly and kills it whenever `file` has changed, until it ends by itself. Returns the number of kills
    /// and the last output.
    pub fn killed_until_done(&self, args: &[&str], file: &str) -> (usize, Output) {
        let kept = || std::fs::read(self.path(file)).unwrap_or_default();
        let mut kills = 0;
        loop {
            let before = kept();
            let mut command = Command::new(env!("CARGO_BIN_EXE_metasense"));
            command.args(args).current_dir(self.folder.path()).stdout(Stdio::piped()).stderr(Stdio::piped());
            let mut child = command.spawn().unwrap();
            while child.try_wait().unwrap().is_none() {
                let now = kept();
                if !now.is_empty() && now != before {
                    child.kill().unwrap();
                    break;
                }
                std::thread::sleep(std::time::Duration::from_millis(1));
            }
            let output = child.wait_with_output().unwrap();
            match output.status.code() {
                Some(_) => return (kills, output),
                None => kills += 1,
            }
        }
    }

    /// The files of a folder, with their contents.
    pub fn files(&self, folder: &str) -> Vec<(String, Vec<u8>)> {
        let entries = std::fs::read_dir(self.path(folder)).unwrap().map(|entry| entry.unwrap().path());
        let name = |path: &PathBuf| path.file_name().unwrap().to_str().unwrap().to_owned();
        let mut files: Vec<_> = entries.map(|path| (name(&path), std::fs::read(path).unwrap())).collect();
        files.sort();
        files
    }

    /// Standard output of a call that must succeed.
    pub fn output(&self, args: &[&str]) -> String {
        let output = self.metasense(args);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(
            output.status.success(),
            "{args:?}: {}\n{errors}{}",
            output.status,
            String::from_utf8_lossy(&output.stdout)
        );
        String::from_utf8(output.stdout).unwrap()
    }
}

/// All results except times.
const RESULTS: &[&str] = &[
    "SELECT hash, state, error_initial, error_optimised, holdout_error_initial, holdout_error_optimised, best_step,
       nonlinear_acceleration_initial, nonlinear_rotation_optimised FROM v_trial ORDER BY hash",
    "SELECT hash, step, loss_test, loss_train, gradient_norm, step_length, outcome FROM v_step ORDER BY hash, step",
    "SELECT hash, name, shape, hex(bytes) FROM v_artifact ORDER BY hash, name",
    "SELECT hash, body, casting, reader, kind, coverage, width FROM v_band ORDER BY hash, body, casting, reader, kind",
];

pub fn results(bench: &Bench, db: &str) -> Vec<String> {
    RESULTS.iter().map(|sql| bench.output(&["query", db, sql, "--format", "csv"])).collect()
}
