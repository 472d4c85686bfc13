//! External bodies are trained like bodies of polygons; each fault of the program ends a trial with that fault's name.

use std::process::Output;

use crate::common::{Bench, results};

/// A program in Python without packages: three low-passes with rates and weights as design. Its argument selects a fault.
const BODY: &str = r#"
import json, mmap, os, random, sys, time
mode, calls = sys.argv[1] if len(sys.argv) > 1 else "", 0
ALPHA = [20.0, 30.0, 40.0, 1.0, 0.9, 0.8, 1.1, 1.2, 1.0]

def view(request, name):
    file = os.open(request["memory"], os.O_RDWR)
    with mmap.mmap(file, request["bytes"]) as memory:
        offset, *shape = request[name]
        count = 1
        for n in shape:
            count *= n
        values = memoryview(memory)[8 * offset : 8 * (offset + count)].cast("d")
        yield values
        values.release()
    os.close(file)

def read(request, name):
    with_values = view(request, name)
    found = list(next(with_values))
    list(with_values)
    return found

def put(request, name, values):
    with_values = view(request, name)
    target = next(with_values)
    for i, value in enumerate(values):
        target[i] = value
    list(with_values)
    return {"shape": request[name][1:]}

def history(request, forces, sample, steps):
    _, n, panels, instants = request["forces"]
    own = {k: forces[(sample * panels + i) * instants :][:instants] for i, k in enumerate(request["panels"])}
    stride = (instants - 1) // steps
    return [[own.get(k, [0.0] * instants)[t * stride] for k in range(2)] for t in range(steps)]

def run(request, alpha, forces, sample, sensor, steps):
    dt, x, states = request["duration"] / steps, 0.0, []
    for f in history(request, forces, sample, steps):
        states.append(x)
        x += dt * (-alpha[sensor] * x + alpha[3 + 2 * sensor] * f[0] + alpha[4 + 2 * sensor] * f[1])
    return states + [x]

def apply(request):
    alpha, forces, (_, samples, steps, sensors, _) = read(request, "alpha"), read(request, "forces"), request["signals"]
    signals = [0.0] * (samples * steps * sensors)
    for i in range(samples):
        for m, sensor in enumerate(request["sensors"]):
            for t, x in enumerate(run(request, alpha, forces, i, sensor, steps)[1:]):
                signals[(i * steps + t) * sensors + m] = x + (random.random() if mode == "random" else 0.0)
    if mode == "nan":
        signals = [float("nan")] * len(signals)
    answer = put(request, "signals", signals)
    return {"shape": [samples, steps, sensors]} if mode == "shape" else answer

def vjp(request):
    alpha, forces, (_, samples, steps, sensors, _) = read(request, "alpha"), read(request, "forces"), request["cotangent"]
    cotangent, gradient, dt = read(request, "cotangent"), [0.0] * len(alpha), request["duration"] / steps
    for i in range(samples):
        for m, sensor in enumerate(request["sensors"]):
            states, f, back = run(request, alpha, forces, i, sensor, steps), history(request, forces, i, steps), 0.0
            for t in reversed(range(steps)):
                back += cotangent[(i * steps + t) * sensors + m]
                gradient[sensor] -= dt * back * states[t]
                gradient[3 + 2 * sensor] += dt * back * f[t][0]
                gradient[4 + 2 * sensor] += dt * back * f[t][1]
                back -= dt * alpha[sensor] * back
    if mode == "wrong":
        gradient = [1.01 * g for g in gradient]
    return put(request, "gradient", gradient)

for line in sys.stdin:
    request = json.loads(line)
    calls += 1
    if request["call"] == "describe":
        answer = {
            "name": "low-passes", "version": "1", "alpha": ALPHA, "lower": [10.0] * 3 + [0.1] * 6, "upper": [60.0] * 3 + [2.0] * 6,
            "constraints": [{"terms": [[i, 1.0] for i in range(3, 9)], "least": 6.0, "most": 6.0}],
            "panels": ["left", "right"], "sensors": ["a", "b", "c"], "channels": ["level"], "draw": True,
        }
    elif request["call"] == "draw":
        answer = {"svg": "<svg xmlns='http://www.w3.org/2000/svg'/>"}
    else:
        if mode == "exit":
            print("no room for a plate", file=sys.stderr)
            sys.exit(3)
        if mode == "hang":
            time.sleep(60)
        if mode == "garbage":
            print("hello")
        if mode == "dies" and calls == 8:
            os.kill(os.getpid(), 9)
        if mode == "closes" and not os.path.exists("closed"):
            open("closed", "w").close()
            os.close(1)
            time.sleep(60)
        if mode == "error":
            print(json.dumps({"error": "mesh: inverted element"}), flush=True)
            continue
        answer = {"apply": apply, "vjp": vjp}[request["call"]](request)
    print(json.dumps(answer), flush=True)
"#;

const SPEC: &str = r#"name = "low"
[body]
kind = "external"
command = ["python3", "body.py"]
[time]
duration = 0.2
samples = 20
[stimuli]
kind = "bell"
samples = 16
test = 4
holdout = 6
width = [0.05, 0.1]
onset = [0.0, 0.1]
[sensors]
noise = 0.01
[brain]
kind = "linear"
[optimise]
iterations = 6
batch = 6
learning_rate = 0.1
[sweep]
panels = [2]
sensors = [1, 2]
seeds = [1, 2]
"#;

fn bench(mode: &str) -> Bench {
    let bench = Bench::new();
    bench.file("body.py", BODY);
    let command = format!("[\"python3\", \"body.py\", \"{mode}\"]\ntime_limit = 2");
    bench.file("s.toml", &SPEC.replace("[\"python3\", \"body.py\"]", &command));
    bench
}

fn error(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A sweep whose body processes die at every eighth call, on two workers, gives the rows of an undisturbed sweep. Training
/// keeps the bounds and the constraint.
#[test]
fn a_foreign_body_is_trained_whatever_kills_its_process() {
    let (calm, disturbed) = (bench(""), bench("dies"));
    calm.output(&["run", "s.toml", "--workers", "1"]);
    disturbed.output(&["run", "s.toml", "--workers", "2"]);
    let rows = |bench: &Bench| {
        let sql = "SELECT sensors, seed, layout, design_parameters, holdout_error_initial, holdout_error_optimised, best_step
            FROM v_trial ORDER BY 1, 2";
        bench.output(&["query", "results/low.sqlite", sql, "--format", "csv"])
    };
    assert_eq!(rows(&calm), rows(&disturbed));
    assert_eq!(rows(&calm).matches(",external,9,").count(), 4, "{}", rows(&calm));
    assert_eq!(results(&calm, "results/low.sqlite"), results(&disturbed, "results/low.sqlite"));
    let sql = "SELECT hash FROM v_trial ORDER BY sensors DESC, seed";
    let hashes = calm.output(&["query", "results/low.sqlite", sql, "--format", "csv"]);
    let hash = hashes.lines().nth(1).unwrap();
    calm.output(&["export", "results/low.sqlite", hash, "--format", "npy", "--out", "d.npy"]);
    let (_, design) = calm.array("d.npy");
    assert!((design[3..].iter().sum::<f64>() - 6.0).abs() < 1e-5, "{design:?}");
    assert!(design[3..].iter().all(|w| (0.1..=2.0).contains(w)), "{design:?}");
    assert!(design[..3].iter().zip([20.0, 30.0, 40.0]).any(|(a, b)| (a - b).abs() > 0.1), "{design:?}");
    calm.output(&["report", "results/low.sqlite", "--out", "r.html"]);
    let report = std::fs::read_to_string(calm.path("r.html")).unwrap();
    assert_eq!(report.matches("data:image/svg+xml,%3C%73%76%67").count(), 2);
    assert!(!report.contains("are missing"), "{report}");
    calm.output(&["analyse", "results/low.sqlite"]);
    calm.output(&["body", "draw", "s.toml", "--out", "d.svg"]);
    assert!(std::fs::read_to_string(calm.path("d.svg")).unwrap().starts_with("<svg"));
}

/// A process that closes its output and does not end is replaced by a new one.
#[test]
fn a_process_that_closes_its_output_is_restarted() {
    let bench = bench("closes");
    bench.output(&["trial", "s.toml"]);
    assert!(bench.path("closed").exists());
}

/// Each fault has a name, and the message contains the process's output.
#[test]
fn faults_of_a_process_are_named() {
    for (mode, name, words) in [
        ("exit", "body_died", "no room for a plate"),
        ("hang", "body_time_limit", "body.time_limit = 2 s"),
        ("shape", "body_invalid", "signals must be"),
        ("garbage", "body_invalid", "printed \"hello\""),
        ("error", "body_invalid", "mesh: inverted element"),
        ("random", "body_not_repeatable", "`apply`"),
        ("nan", "non_finite", "the initial body"),
    ] {
        let output = bench(mode).metasense(&["trial", "s.toml"]);
        let said = error(&output);
        assert!(!output.status.success() && said.contains(name) && said.contains(words), "{mode}: {said}");
    }
}

/// The hash depends on the content of the body's source, not on its path.
#[test]
fn the_source_of_a_body_is_part_of_the_hash() {
    let hashes = |bench: &Bench| {
        let table = bench.output(&["expand", "s.toml", "--format", "csv"]);
        table.lines().skip(1).map(|line| line.split(',').next().unwrap().to_owned()).collect::<Vec<_>>()
    };
    let (one, other) = (bench(""), bench(""));
    assert_eq!(hashes(&one), hashes(&other));
    other.file("body.py", &BODY.replace("20.0, 30.0", "20.0, 30.5"));
    assert_ne!(hashes(&one), hashes(&other));
    other.file("body.py", &format!("{BODY}# another source\n"));
    assert_ne!(hashes(&one), hashes(&other));
}

/// `verify` detects a gradient with an error of 1 %.
#[test]
fn a_body_is_verified() {
    let right = bench("").output(&["lab", "verify", "s.toml"]);
    assert!(right.contains("derivative"), "{right}");
    let wrong = bench("wrong").metasense(&["lab", "verify", "s.toml"]);
    let said = String::from_utf8_lossy(&wrong.stdout).into_owned();
    assert_eq!(wrong.status.code(), Some(1), "{said}{}", error(&wrong));
    assert!(said.lines().any(|line| line.contains("derivative") && line.contains("false")), "{said}");
}

/// Records are compared with the signals that the body's program computes under the same forces. Inverse decoders and twins,
/// which need a model of polygons, are rejected by name.
#[test]
fn records_of_a_foreign_body_are_evaluated() {
    let bench = bench("");
    let spec = SPEC.replace("sensors = [1, 2]\nseeds = [1, 2]", "sensors = [1]\nseeds = [1]");
    bench.file("s.toml", &spec.replace("noise = 0.01", "placements = [[0]]"));
    let (records, steps, dt) = (12, 20, 0.01);
    let force =
        |i: usize, k: usize, n: usize| ((1 + i * (k + 1)) as f64 * 0.3 + n as f64 * 0.4).sin().max(0.0);
    let (mut forces, mut signals) = (Vec::new(), Vec::new());
    for i in 0..records {
        forces.extend((0..2).flat_map(|k| (0..=steps).map(move |n| force(i, k, n))));
        let advance = |x: &mut f64, n| {
            *x += dt * (-20.0 * *x + 1.0 * force(i, 0, n) + 0.9 * force(i, 1, n));
            Some(*x)
        };
        signals.extend((0..steps).scan(0.0, advance));
    }
    bench.write_array("f.npy", &[records as u64, 2, steps as u64 + 1], &forces);
    bench.write_array("x.npy", &[records as u64, steps as u64, 1], &signals);
    let described = "[recorded]\nfiles = [\"f.npy\"]\nrate = 100.0\n[signals]\nfiles = [\"x.npy\"]\nrate = 100.0\nstart = 0.01\n";
    bench.file("r.toml", described);
    let evaluate = ["lab", "evaluate", "s.toml", "--records", "initial=r.toml", "--format", "csv"];
    let table = bench.output(&[&evaluate[..], &["--out-dir", "e"]].concat());
    assert_eq!(table.lines().count(), 3, "{table}");
    let [measured, simulated] =
        ["signals_initial", "simulated_signals_initial"].map(|name| bench.member("e/records.npz", name));
    assert!(
        measured.iter().zip(&simulated).all(|(a, b)| (a - b).abs() < 1e-12),
        "{measured:?}\n{simulated:?}"
    );
    for option in [["--brain", "inverse"], ["--twin", "initial=t.toml"]] {
        let refused = bench.metasense(&[&evaluate[..], &option].concat());
        let said = error(&refused);
        assert!(
            refused.status.code() == Some(2) && said.contains(option[0]) && said.contains("polygons"),
            "{said}"
        );
    }
}

/// Keys for polygons only and nonexistent places are rejected by name before the run starts.
#[test]
fn what_only_polygons_have_is_refused() {
    let bench = bench("");
    for (change, key) in [
        ("body.columns=4", "body.columns"),
        ("body.design={ random = 1 }", "body.design"),
        ("feasible.min_edge=2", "feasible.min_edge"),
        ("solver.method=\"tsit5\"", "solver.method"),
        ("solver.tolerance=0.01", "solver.tolerance"),
        ("sensors.search=\"greedy\"", "sensors.search"),
        ("sensors.mass=1e-6", "sensors.mass"),
        ("sensors.channels=[\"omega\"]", "sensors.channels"),
        ("sensors.placements=[[3], [0, 1]]", "sensors.placements"),
        ("variation={ stretch = 0.1 }", "variation"),
        ("goal={ error = 1 }", "goal"),
        ("optimise.tie=[2, 2]", "optimise.tie"),
        ("brain.kind=\"inverse\"", "brain.kind"),
        ("sweep.panels=[3]", "sweep.panels"),
        ("body.panel_units=[0, 0]", "body.panel_units"),
        ("body.command=[\"no-such-program\"]", "body.command"),
        ("body.kind=\"polygons\"", "body.command"),
    ] {
        let output = bench.metasense(&["expand", "s.toml", change]);
        let said = error(&output);
        assert!(output.status.code() == Some(2) && said.contains(key), "{change}: {said}");
    }
    for command in [&["body", "modes", "s.toml"][..], &["body", "bound", "s.toml"]] {
        let said = error(&bench.metasense(command));
        assert!(said.contains("body.kind") && said.contains("polygons"), "{command:?}: {said}");
    }
}
