//! `identify`: estimates a body's material from its records.

use crate::common::Bench;

/// A small body with simulated records.
pub const SPEC: &str = r#"name = "i"
[body]
columns = 3
rows = 3
spacing = 15.0
ligament_length = 2.25
density = 1e-8
stiffness = { stretch = 3.0, shear = 0.5, bend = 1.0 }
damping_ratio = 0.03
[time]
duration = 0.2
samples = 40
[stimuli]
kind = "bell"
samples = 4
test = 1
[sweep]
panels = [2]
sensors = [1]
"#;

/// Material of the records; SPEC is the start of the fit.
const TRUE: [f64; 5] = [3.3, 0.42, 1.15, 0.04, 1.15e-8];

fn hash(bench: &Bench, spec: &str) -> String {
    let csv = bench.output(&["expand", spec, "--format", "csv"]);
    let mut lines = csv.lines().map(|line| line.split(','));
    let at = lines.next().and_then(|mut names| names.position(|name| name == "hash")).unwrap();
    lines.next().and_then(|mut row| row.nth(at)).unwrap().to_owned()
}

/// The spec with another stretch, shear, bend, damping and density.
pub fn made_of(spec: &str, [stretch, shear, bend, damping, density]: [f64; 5]) -> String {
    spec.replace(
        "stretch = 3.0, shear = 0.5, bend = 1.0",
        &format!("stretch = {stretch}, shear = {shear}, bend = {bend}"),
    )
    .replace("1e-8", &density.to_string())
    .replace("0.03", &damping.to_string())
}

/// Simulated records of the body of `TRUE` under three blows on both panels, with 2 % of noise, in two forms: arrays as from
/// `simulate`, and a CSV of one record with ten times the rate and other units.
pub fn bench() -> Bench {
    let bench = Bench::new();
    bench.file("s.toml", SPEC);
    let made = made_of(SPEC, TRUE);
    bench.file("true.toml", &made);
    let blow = |record: usize, panel: usize, t: f64| {
        let (onset, width) = (0.01 + 0.01 * record as f64, 0.05 + 0.02 * panel as f64);
        let z = ((t - onset) / width).clamp(0.0, 1.0);
        (0.2 + 0.1 * record as f64 - 0.1 * panel as f64) * (std::f64::consts::PI * z).sin().powi(2)
    };
    let forces = |records: usize, instants: usize| -> Vec<f64> {
        let each = (0..records).flat_map(|r| [0, 1].map(|k| (r, k)));
        each.flat_map(|(r, k)| (0..=instants).map(move |n| blow(r, k, 0.2 * n as f64 / instants as f64)))
            .collect()
    };
    let run = |spec: &str, forces: &str, out: &str| {
        bench.output(&["body", "simulate", spec, &hash(&bench, spec), "--forces", forces, "--out-dir", out]);
        let bytes = std::fs::read(bench.path(&format!("{out}/signals.npy"))).unwrap();
        npyz::NpyFile::new(&bytes[..]).unwrap().into_vec::<f64>().unwrap()
    };
    // Equidistributed, hence equal on every machine. The sum of twelve such numbers is nearly normal.
    let noise =
        |i: usize| -> f64 { (1..=12).map(|k| ((i * 12 + k) as f64 * 0.754_877_666).fract() - 0.5).sum() };
    let noisy = |signals: &[f64]| -> Vec<f64> {
        let size = |c: usize| {
            let of: Vec<f64> = signals.iter().skip(c).step_by(3).map(|s| s * s).collect();
            (of.iter().sum::<f64>() / of.len() as f64).sqrt()
        };
        let size = [size(0).max(size(1)), size(0).max(size(1)), size(2)];
        signals.iter().enumerate().map(|(i, s)| s + 0.02 * size[i % 3] * noise(i)).collect()
    };
    bench.write_array("f.npy", &[3, 2, 41], &forces(3, 40));
    bench.write_array("y.npy", &[3, 40, 3], &noisy(&run("true.toml", "f.npy", "a")));
    bench.file(
        "r.toml",
        "[recorded]\nfiles = [\"f.npy\"]\nrate = 200.0\n[signals]\nfiles = [\"y.npy\"]\nstart = 0.005\n",
    );
    // readings half a step off the trial's instants, forces at ten times the rate
    bench.file(
        "half.toml",
        &made.replace("samples = 40", "samples = 80").replace("[stimuli]", "[stimuli]\nforce_samples = 400"),
    );
    bench.write_array("h.npy", &[3, 2, 401], &forces(3, 400));
    let between: Vec<f64> =
        noisy(&run("half.toml", "h.npy", "c")).chunks(6).flat_map(|two| two[..3].to_vec()).collect();
    bench.write_array("between.npy", &[3, 40, 3], &between);
    // the clocks of the records are 1.5, 4 and 3 ms late
    bench.file("fine.toml", &made.replace("samples = 40", "samples = 400"));
    let fine = noisy(&run("fine.toml", "h.npy", "d"));
    let late = |(record, by): (usize, usize)| {
        let at = move |n: usize| 3 * (400 * record + (10 * n + by).min(400) - 1);
        (1..=40).flat_map(move |n| at(n)..at(n) + 3)
    };
    let clocks: Vec<f64> = [3, 8, 6].into_iter().enumerate().flat_map(late).map(|i| fine[i]).collect();
    bench.write_array("clocks.npy", &[3, 40, 3], &clocks);
    bench.file(
        "clocks.toml",
        "[recorded]\nfiles = [\"h.npy\"]\nrate = 2000.0\n[signals]\nfiles = [\"clocks.npy\"]\nrate = 200.0\nstart = 0.005\n\
         start_deviation = 0.003\n",
    );
    bench.file("s_fine.toml", &SPEC.replace("[stimuli]", "[stimuli]\nforce_samples = 400"));
    for (name, start) in [("between", 0.0025), ("late", 0.0125)] {
        bench.file(
            &format!("{name}.toml"),
            &format!(
                "[recorded]\nfiles = [\"h.npy\"]\nrate = 2000.0\n[signals]\nfiles = [\"between.npy\"]\nrate = 200.0\nstart = {start}\n"
            ),
        );
    }
    bench.write_array("g.npy", &[1, 2, 401], &forces(1, 400));
    let signals = noisy(&run("fine.toml", "g.npy", "b"));
    let mut csv = String::from("ms,left,right,ax,ay,spin\n");
    for n in 0..=400 {
        let t = 0.2 * n as f64 / 400.0;
        let y = |c: usize| if n == 0 { 0.0 } else { signals[3 * (n - 1) + c] };
        let (ax, ay, spin) = (y(0) * 1e-3, y(1) * 1e-3, y(2).to_degrees());
        csv += &format!("{},{},{},{ax},{ay},{spin}\n", 1e3 * t, 1e3 * blow(0, 0, t), 1e3 * blow(0, 1, t));
    }
    bench.file("record.csv", &csv);
    bench.file(
        "csv.toml",
        "[recorded]\nfiles = [\"record.csv\"]\ntime = \"ms\"\ntime_unit = \"ms\"\nforce = [\"left\", \"right\"]\n\
         force_unit = \"mN\"\n[signals]\nchannels = [\"ax\", \"ay\", \"spin\"]\nacceleration_unit = \"m/s2\"\n\
         angular_velocity_unit = \"deg/s\"\n",
    );
    bench
}

/// Fitted, lower and upper value of each row.
fn estimates(csv: &str) -> Vec<[f64; 3]> {
    let number = |text: &str| text.parse().unwrap_or(f64::NAN);
    let rows = csv.lines().skip(1).map(|line| line.split(',').collect::<Vec<_>>());
    rows.map(|row| [number(row[3]), number(row[4]), number(row[5])]).collect()
}

fn assert_true(found: &[[f64; 3]], within: f64) {
    assert_eq!(found.len(), 5, "{found:?}");
    for ([value, low, high], truth) in found.iter().zip(TRUE) {
        assert!((low..=high).contains(&&truth), "{truth} outside {low} … {high}; {found:?}");
        assert!((value / truth - 1.0).abs() < within, "{value} for {truth}; {found:?}");
    }
}

/// Readings between the trial's instants are compared at their own times; interpolation of the aliased signals would give another
/// material. With a clock error of 10 ms the fit explains nothing, and prints no values for a spec.
#[test]
fn readings_are_compared_when_they_were_taken() {
    let bench = bench();
    let fit = |records: &str, more: &[&str]| {
        bench.metasense(&[&["lab", "identify", "s_fine.toml", "--records", records], more].concat())
    };
    let found = fit("between.toml", &["--format", "csv"]);
    assert!(found.status.success(), "{}", String::from_utf8_lossy(&found.stderr));
    assert_true(&estimates(&String::from_utf8(found.stdout).unwrap()), 0.03);
    // shifted by a trigger, in a shorter sample
    let text = std::fs::read_to_string(bench.path("between.toml")).unwrap();
    let trigger = "[recorded]\ntrigger = { threshold = 0.02, before = 0.0111 }";
    bench.file("trigger.toml", &text.replace("[recorded]", trigger));
    let short = ["time.duration=0.16", "time.samples=32", "stimuli.force_samples=320", "--format", "csv"];
    let found = fit("trigger.toml", &short);
    assert!(found.status.success(), "{}", String::from_utf8_lossy(&found.stderr));
    assert_true(&estimates(&String::from_utf8(found.stdout).unwrap()), 0.03);
    let late = fit("late.toml", &[]);
    let said = String::from_utf8(late.stdout).unwrap();
    assert_eq!(late.status.code(), Some(1), "{said}");
    assert!(said.contains("signals not explained") && !said.contains("[body]"), "{said}");
    // at another rate the readings are resampled, and the program warns
    bench.file("slow.toml", &SPEC.replace("samples = 40", "samples = 50"));
    let warned = bench.metasense(&["lab", "identify", "slow.toml", "--records", "between.toml"]);
    let warned = String::from_utf8(warned.stderr).unwrap();
    assert!(warned.contains("Set time.samples = 40"), "{warned}");
}

/// Late clocks, different for each record, are fitted with the material and with a twin. The lines for the file of records contain
/// the true clocks.
#[test]
fn clocks_that_are_off_are_fitted() {
    const LATE: [f64; 3] = [1.5e-3, 4e-3, 3e-3];
    let bench = bench();
    let fit = |free: &[&str], spec: &str, records: &str, format: &str| {
        let call = ["lab", "identify", spec, "--records", records, "--format", format];
        bench.output(&[&call[..], free].concat())
    };
    let assert_late = |csv: &str| {
        let rows = csv.lines().filter(|line| line.starts_with("start of record"));
        let rows: Vec<Vec<&str>> = rows.map(|line| line.split(',').collect()).collect();
        assert_eq!(rows.len(), LATE.len(), "{csv}");
        for (row, late) in rows.iter().zip(LATE) {
            let [value, low, high] = [3, 4, 5].map(|i| row[i].parse::<f64>().unwrap());
            assert!((value - late).abs() < 2e-4 && low < late && late < high, "{late}\n{csv}");
        }
    };
    let csv = fit(&[], "s_fine.toml", "clocks.toml", "csv");
    assert_late(&csv);
    assert_true(&estimates(&csv)[..5], 0.03);
    bench.file("true_fine.toml", &made_of(SPEC, TRUE).replace("[stimuli]", "[stimuli]\nforce_samples = 400"));
    assert_late(&fit(&["--fit", "variation"], "true_fine.toml", "clocks.toml", "csv"));
    let table = fit(&[], "s_fine.toml", "clocks.toml", "table");
    let line = table.lines().find(|line| line.starts_with("start = [")).unwrap_or_else(|| panic!("{table}"));
    let text = std::fs::read_to_string(bench.path("clocks.toml")).unwrap();
    let known = text.replace("start = 0.005", line).replace("start_deviation = 0.003", "");
    bench.file("known.toml", &known);
    let csv = fit(&[], "s_fine.toml", "known.toml", "csv");
    assert_true(&estimates(&csv), 0.03);

    let refused = |call: &[&str], says: &[&str]| {
        let run = bench.metasense(call);
        let said = String::from_utf8_lossy(&run.stderr);
        assert!(run.status.code() == Some(2) && says.iter().all(|s| said.contains(s)), "{said}");
    };
    refused(
        &["lab", "evaluate", "s_fine.toml", "--records", "initial=clocks.toml"],
        &["clocks.toml", "signals.start_deviation", "signals.start", "lab identify"],
    );
    for (from, to, says) in [
        (
            "start_deviation = 0.003",
            "start_deviation = -0.003",
            ["start_deviation = -0.003", "between 0 and 0.02"],
        ),
        (
            "start_deviation = 0.003",
            "start_deviation = 0.03",
            ["start_deviation = 0.03", "between 0 and 0.02"],
        ),
        ("start = 0.005", "start = [0.005, 0.005]", ["start = 2 numbers", "each of the 3 records"]),
    ] {
        bench.file("wrong.toml", &text.replace(from, to));
        let says = [&["wrong.toml:"], &says[..]].concat();
        refused(&["lab", "identify", "s_fine.toml", "--records", "wrong.toml"], &says);
    }
    // the force begins so late that nothing remains to compare after the possible shift
    bench.file("wide.toml", &text.replace("start_deviation = 0.003", "start_deviation = 0.006"));
    let short = ["time.duration=0.06", "time.samples=12", "stimuli.force_samples=120"];
    let call = [&["lab", "identify", "s_fine.toml"], &short[..], &["--records", "wide.toml"]].concat();
    refused(&call, &["wide.toml:", "start_deviation = 0.006", "record 0", "reduce start_deviation"]);
}

/// Arrays give the true material, with the same digits on one and two threads. Page, figures, data and fitted signals are written;
/// other parameters stay; every interval is present.
#[test]
fn records_tell_the_material() {
    let bench = bench();
    let hash = hash(&bench, "s.toml");
    let fit = |more: &[&str]| {
        let call = [&["lab", "identify", "s.toml", &hash, "--records", "r.toml"], more].concat();
        bench.output(&call)
    };
    let one = fit(&["--format", "csv"]);
    let two = fit(&["--format", "csv", "--threads", "2", "--out-dir", "fit"]);
    assert_eq!(one, two);
    assert_true(&estimates(&one), 0.1);
    for (name, start) in [
        ("index.html", "<!DOCTYPE html>"),
        ("fit-1.svg", "<svg"),
        ("convergence-2.svg", "<svg"),
        ("fit.csv", "record,unit,channel"),
        ("convergence.csv", "iteration,"),
        ("estimates.csv", "parameter,unit"),
    ] {
        let text = std::fs::read_to_string(bench.path(&format!("fit/{name}"))).unwrap();
        assert!(text.starts_with(start), "{name}: {}", &text[..40]);
    }
    let bytes = std::fs::read(bench.path("fit/signals.npy")).unwrap();
    assert_eq!(npyz::NpyFile::new(&bytes[..]).unwrap().shape(), [3, 40, 3]);
    // a fit with the wrong parameter held leaves more of the signals than a free fit, which leaves noise
    let left = |table: &str| -> f64 {
        let line =
            table.lines().find(|line| line.starts_with("misfit relative to the signals' RMS")).unwrap();
        line.split(" -> ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap()
    };
    let (held, free) = (fit(&["--fit", "stretch,shear,density,bend"]), fit(&[]));
    assert!(left(&held) > 2.0 * left(&free), "{held}\n{free}");
    assert!(held.contains("converged") && held.contains("damping_ratio = 0.03"), "{held}");
    assert!(!free.contains("discrepancy"), "{free}");
}

/// Killed after every iteration, the files equal those of one uninterrupted call.
#[test]
fn a_fit_goes_on_where_it_was_killed() {
    let bench = bench();
    let hash = hash(&bench, "s.toml");
    let call = |out: &'static str| {
        [
            "lab",
            "identify",
            "s.toml",
            hash.as_str(),
            "--records",
            "r.toml",
            "--format",
            "csv",
            "--out-dir",
            out,
        ]
    };
    let (whole, again) = (bench.output(&call("whole")), call("again"));
    let (kills, last) = bench.killed_until_done(&again, "again/unfinished.bin");
    let said = String::from_utf8_lossy(&last.stderr);
    assert!(kills >= 3 && said.contains("resumed after"), "{kills} kills: {said}");
    assert!(last.status.success() && String::from_utf8_lossy(&last.stdout) == whole, "{said}");
    assert!(bench.files("again") == bench.files("whole"), "the files differ");
}

/// A record with its own clock and other units, on a clock as fine as the record's.
#[test]
fn a_record_with_a_clock_of_its_own_tells_the_material() {
    let bench = bench();
    let spec = SPEC.replace("samples = 40", "samples = 400");
    bench.file("s.toml", &spec);
    let hash = hash(&bench, "s.toml");
    let found =
        bench.output(&["lab", "identify", "s.toml", &hash, "--records", "csv.toml", "--format", "csv"]);
    assert_true(&estimates(&found), 0.1);
}

/// If records determine no parameter, outcome and exit code show it; parameters that they do determine are fitted nevertheless.
#[test]
fn records_that_determine_nothing_are_no_fit() {
    let bench = bench();
    let never =
        "damping_ratio = 0.03\ncontact = { min_angle = -175.0, cutoff_angle = -170.0, stiffness = 1.0 }";
    bench.file("contact.toml", &SPEC.replace("damping_ratio = 0.03", never));
    let fit = |free: &str| {
        let call =
            ["lab", "identify", "contact.toml", "--records", "r.toml", "--fit", free, "--format", "csv"];
        let run = bench.metasense(&call);
        assert_eq!(run.status.code(), Some(1), "{free}: {}", String::from_utf8_lossy(&run.stderr));
        let csv = String::from_utf8(run.stdout).unwrap();
        csv.lines().skip(1).map(|line| line.rsplit(',').next().unwrap().to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(fit("contact"), ["not identifiable"]);
    let all = fit("stretch,shear,bend,damping,density,contact");
    assert!(all[..5].iter().all(|outcome| outcome == "converged") && all[5] == "not identifiable", "{all:?}");
}

/// Refused with a remedy before anything is simulated.
#[test]
fn what_cannot_be_fitted_is_refused() {
    let bench = bench();
    bench.file("still.toml", &SPEC.replace("damping_ratio = 0.03", "damping_ratio = 0.0"));
    let refused = |spec: &str, records: &str, more: &[&str], says: &[&str]| {
        let hash = hash(&bench, spec);
        let call = [&["lab", "identify", spec, &hash, "--records", records], more].concat();
        let run = bench.metasense(&call);
        let said = String::from_utf8_lossy(&run.stderr);
        assert!(run.status.code() == Some(2) && says.iter().all(|s| said.contains(s)), "{said}");
    };
    refused("s.toml", "r.toml", &["--fit", "weight"], &["--fit", "weight", "stretch"]);
    refused("s.toml", "nowhere.toml", &[], &["nowhere.toml"]);
    bench.file("lost.toml", "[recorded]\nfiles = [\"lost.npy\"]\nrate = 200.0\n[signals]\n");
    refused("s.toml", "lost.toml", &[], &["lost.npy"]);
    refused("still.toml", "r.toml", &[], &["still.toml", "body.damping_ratio = 0", "--fit"]);
    refused("s.toml", "r.toml", &["--fit", "contact"], &["body.contact.stiffness = 0"]);
}
