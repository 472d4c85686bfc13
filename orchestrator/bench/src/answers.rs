//! `answers`: time and memory of `status`, `query`, `analyse` and `report` on a large database.
//!
//! Shows how many trials a database may contain. Trials are synthetic, planned from a real spec: 5 values of M × 20 placements
//! × 10 seeds give 1000 per ligament length.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use metasense::cli::Error;
use metasense::exit::Exit;
use metasense::plan::Plan;
use metasense::print_line;
use metasense::processes;
use metasense::store::{Store, npy_bytes};
use serde_json::json;

use crate::made_up::{BulkDatabase, Scratch, at, count};

/// Time and peak memory of queries to databases with many trials
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Trials of each database, in thousands.
    #[arg(long, value_delimiter = ',', default_value = "1,10")]
    thousands: Vec<usize>,
    /// Outer steps per trial.
    #[arg(long, default_value_t = 100)]
    steps: u32,
    /// Training iterations per network, and points of its loss curve.
    #[arg(long, default_value_t = 500)]
    iterations: u32,
    /// Folder for the temporary databases.
    #[arg(long, default_value = "results", value_name = "DIR")]
    folder: PathBuf,
}

pub async fn execute(args: Args) -> Result<Exit, Error> {
    let scratch = Scratch::new(&args.folder, "answers");
    measure(&args, &scratch.0).await
}

async fn measure(args: &Args, folder: &Path) -> Result<Exit, Error> {
    for &thousands in &args.thousands {
        let db = folder.join(format!("{thousands}.sqlite"));
        make(&db, thousands, args).await?;
        let page = db.with_extension("html");
        let (db, page) = (db.to_string_lossy(), page.to_string_lossy());
        for what in [
            &["status", &*db][..],
            &["query", &*db, "SELECT * FROM v_trial", "--format", "csv"],
            &["query", &*db, "SELECT * FROM v_step", "--format", "csv"],
            &["analyse", &*db],
            &["report", &*db, "--out", &*page],
        ] {
            let (seconds, cpu, mib) = measure_command(what)?;
            let row = json!({
                "bench": "answers", "trials": 1000 * thousands, "steps": args.steps, "iterations": args.iterations,
                "asked": what.iter().filter(|word| **word != db && **word != page).copied().collect::<Vec<_>>().join(" "),
                "seconds": seconds, "cpu_seconds": cpu, "peak_mib": mib, "version": env!("CARGO_PKG_VERSION"),
            });
            print_line!("{row}")?;
        }
    }
    Ok(Exit::Done)
}

/// Wall-clock seconds, CPU seconds and peak memory (MiB) of a command.
pub fn measure_command(arguments: &[&str]) -> Result<(f64, f64, f64), Error> {
    let failed = |source| Error::Io { doing: "running", path: arguments.join(" ").into(), source };
    let began = Instant::now();
    let (null, quiet) = (Stdio::null(), Stdio::null());
    let mut command = Command::new("/proc/self/exe");
    let mut child =
        command.arg("metasense").args(arguments).stdout(null).stderr(quiet).spawn().map_err(failed)?;
    let (mut cpu, mut most) = (0.0, 0.0f64);
    loop {
        cpu = processes::cpu_seconds(child.id()).unwrap_or(cpu).max(cpu);
        most = most.max(processes::peak_mib(child.id()).unwrap_or(0.0));
        match child.try_wait().map_err(failed)? {
            Some(ended) if ended.success() => return Ok((began.elapsed().as_secs_f64(), cpu, most)),
            Some(ended) => return Err(failed(std::io::Error::other(ended.to_string()))),
            None => std::thread::sleep(Duration::from_millis(5)),
        }
    }
}

/// Creates a database of finished trials. Errors fall with M and with training, by formulas.
async fn make(file: &Path, thousands: usize, args: &Args) -> Result<(), Error> {
    let lengths: Vec<String> =
        (0..thousands).map(|i| format!("{:.4}", 2.0 + 0.5 * i as f64 / thousands as f64)).collect();
    let Args { steps, iterations, .. } = args;
    let text = format!(
        "name = \"bench-answers\"\n[body]\ncolumns = 8\nrows = 6\nspacing = 15.0\nligament_length = 2.25\ndensity = 1e-8\n\
         stiffness = {{ stretch = 3.0, shear = 0.5, bend = 1.0 }}\n[stimuli]\nkind = \"bell\"\n[brain]\niterations = {iterations}\n\
         [optimise]\niterations = {steps}\n[sweep]\npanels = [4]\nsensors = [1, 2, 3, 4, 5]\nplacements = 20\n\
         seeds = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]\n\"body.ligament_length\" = [{}]\n",
        lengths.join(", ")
    );
    let plan = Plan::new(file, text)?;
    let mut store = Store::open(file).await?;
    store.begin_sweep(&plan.spec, &plan.source.text, &plan.trials).await?;
    store.close().await?;
    let mut made = BulkDatabase::begin(file).await?;
    // noise per trial, ± 10 %
    let noise = "(1.0 + 0.2 * ((t.id * 7919) % 101) / 101.0 - 0.1)";
    let sql = [
        format!(
            "UPDATE trial AS t SET state = 'done', error_initial = 40.0 / (1 + 0.3 * sensors) * {noise},
               error_optimised = 40.0 / (1 + 2.0 * min(sensors, 2) + 0.1 * sensors) * {noise}, best_step = {steps} - 1,
               seconds_evaluation = 3.0, simd = 'avx2', solver = 'nystrom6', result = '{{}}',
               finished_at = '2026-01-01T00:00:00.000Z'"
        ),
        "UPDATE trial SET holdout_error_initial = 1.05 * error_initial, holdout_error_optimised = 1.05 * error_optimised,
           train_error_initial = error_initial, train_error_optimised = error_optimised"
            .to_owned(),
        format!(
            "INSERT INTO attempt (trial_id, number, state, steps, version, started_at, ended_at, code)
             SELECT id, 1, 'done', {steps}, '0', '2026-01-01T00:00:00.000Z', '2026-01-01T00:00:00.000Z', 'made up' FROM trial"
        ),
        format!(
            "{} INSERT INTO step SELECT t.id, n.i, 1, 1.0, 1.0, t.error_optimised * (1 + 4.0 / (1 + n.i)) * {noise}, 1.0, 1.0, 1.0,
               'projected', 0.1, NULL, NULL, NULL, NULL, 'ok', 64, 1000000, 100000, 1000, 10, 0, 20,
               0.3, 0.2, 0.4, 0.0, 0.01, 0.001, '2026-01-01T00:00:00.000Z', NULL FROM trial t CROSS JOIN n",
            count(*steps)
        ),
        format!(
            "INSERT INTO network SELECT t.id, value, 0, 10.0, 10.0, 10.0, {iterations}, 'ok', NULL, NULL, NULL
             FROM trial t, json_each('[\"initial\", \"optimised\"]')"
        ),
        format!(
            "{} INSERT INTO curve SELECT t.id, value, 0, n.i + 1, 0.5, t.error_initial * (1 + 9.0 / (1 + n.i)) * {noise}
             FROM trial t CROSS JOIN json_each('[\"initial\", \"optimised\"]') CROSS JOIN n",
            count((*iterations).min(200))
        ),
        format!(
            "{} INSERT INTO reading SELECT t.id, value, n.i, n.i, n.i = 5, 1e-3, 10.0, t.error_initial, t.error_initial, NULL, NULL, NULL
             FROM trial t CROSS JOIN json_each('[\"initial\", \"optimised\"]') CROSS JOIN n",
            count(6)
        ),
    ];
    made.execute(&sql).await?;
    let losses: Vec<f32> = (0..*iterations).map(|n| 0.5 * (1.0 + n as f32).powf(-0.6)).collect();
    sqlx::query(
        "INSERT INTO artifact (trial_id, name, shape, bytes) SELECT t.id, 'losses_' || value || '_0', ?1, ?2
         FROM trial t, json_each('[\"initial\", \"optimised\"]')",
    )
    .bind(format!("[{iterations}]"))
    .bind(npy_bytes(&[losses.len()], &losses))
    .execute(&mut made.db)
    .await
    .map_err(at(file))?;
    made.commit().await
}
