//! Stiff and extreme scenes, one row each with the expected outcome. None may hang, panic or return NaN.

use metasense_numerics::body::Layout;
use metasense_numerics::dynamics::{
    EdgeContact, Forces, IntegratorSettings, Outcome, Panel, Scene, Tolerance, Wrt, run, signal_error,
    simulate, tune,
};
use metasense_worker::reference::{bells, reference};

use super::super::body::LEEWAY;
use super::super::{ComparedQuantity, norm};

/// A scene with two seeded bell samples, or with other forces.
struct Extreme {
    scene: Scene,
    design: Vec<f64>,
    forces: Forces,
    /// Whether a tight reference run is affordable, so that the error can be shown.
    judged: bool,
    /// Expected outcome of every sample.
    expected: Outcome,
    /// Origin of the forces, if not the seed.
    source: &'static str,
}

fn initial(layout: &Layout) -> Vec<f64> {
    layout.initial_design(25f64.to_radians())
}

fn usual() -> Extreme {
    let scene = reference();
    let forces = bells(&scene, 2);
    Extreme { design: initial(&scene.layout), scene, forces, judged: true, expected: Outcome::Ok, source: "" }
}

fn with(change: impl FnOnce(&mut Extreme)) -> Extreme {
    let mut extreme = usual();
    change(&mut extreme);
    extreme
}

/// The reference scene on another layout, with the sensor in the middle and panels by the rule.
fn on(columns: usize, rows: usize) -> Extreme {
    with(|e| {
        e.scene.layout = Layout::planar(columns, rows, 15.0, 2.25);
        e.design = initial(&e.scene.layout);
        e.scene.clamped = e.scene.layout.bottom();
        let panels = e.scene.layout.top_panels(2).unwrap_or_else(|| vec![columns * rows - 1]);
        e.scene.panels = panels.into_iter().map(|unit| Panel::central(unit, [0.0, -1.0])).collect();
        e.scene.sensors = vec![(rows / 2).max(1) * columns + columns / 2];
        e.forces = bells(&e.scene, 2);
    })
}

/// The reference scene with another number of instants and new forces.
fn sampled(instants: usize) -> Extreme {
    with(|e| {
        e.scene.instants = instants;
        e.forces = bells(&e.scene, 2);
    })
}

/// Path of measured blows, if they are available beside a clone.
const MEASURED: &str = "../../shared/data/hammer/blow_1.npy";
/// Force of one blow of a hard hammer tip for 50 ms at 25 600 samples/s (N), 0.3 ms long with 70–90 N, and its origin.
fn blow() -> (Vec<f64>, &'static str) {
    let measured = || {
        let bytes = std::fs::read(MEASURED).ok()?;
        let rows = npyz::NpyFile::new(&bytes[..]).and_then(npyz::NpyFile::into_vec::<f64>).ok()?;
        // Time, force, acceleration.
        Some(rows.get(rows.len() / 3..)?.get(..1281)?.to_vec())
    };
    let half_sine = |n: usize| {
        let z = (n as f64 / 25_600.0 - 0.8e-3) / 0.3e-3;
        if (0.0..1.0).contains(&z) { 80.0 * (std::f64::consts::PI * z).sin() } else { 0.0 }
    };
    match measured() {
        Some(force) => (force, "a measured blow"),
        None => ((0..=1280).map(half_sine).collect(), "a blow of our own, no measured one is at hand"),
    }
}

/// Such a blow, scaled, on the first panel: forces on their own clock, signals at ten instants.
fn hammer(scale: f64, judged: bool) -> Extreme {
    with(|e| {
        (e.scene.duration, e.scene.instants, e.judged) = (0.05, 10, judged);
        let (force, source) = blow();
        e.source = source;
        let values = force.iter().map(|f| scale * f).chain(std::iter::repeat_n(0.0, 1281)).collect();
        e.forces = Forces { samples: 1, panels: 2, instants: 1280, values, strikes: Vec::new() };
    })
}

/// Shifts that move the nodes of every second unit towards its centre; 1/100 of its area and 1/10 000 of its moment remain.
fn slivers(layout: &Layout) -> Vec<f64> {
    let mut design = vec![0.0; layout.design_len()];
    for (groups, [i, j]) in layout.groups.of_nodes.iter().zip(&layout.grid) {
        if (i + j) % 2 == 0 {
            let s = 0.9 * layout.half();
            for (node, shift) in [[-s, 0.0], [0.0, -s], [s, 0.0], [0.0, s]].into_iter().enumerate() {
                let group = groups[node].expect("a square's nodes are all part of the design");
                design[2 * group..][..2].copy_from_slice(&shift);
            }
        }
    }
    design
}

fn scenes() -> Vec<(&'static str, Extreme)> {
    vec![
        (
            "stretch × 10 000",
            with(|e| {
                e.scene.stiffness.stretch *= 1e4;
                e.scene.duration = 0.1; // the same blows, ten times as fast
            }),
        ),
        ("bend → 0", with(|e| e.scene.stiffness.bend = 1e-9)),
        ("no damping", with(|e| e.scene.damping_ratio = 0.0)),
        ("heavy damping, ζ = 2", with(|e| e.scene.damping_ratio = 2.0)),
        (
            "forces × 1000",
            with(|e| {
                e.forces.values.iter_mut().for_each(|f| *f *= 1e3);
                e.judged = false; // chaotic: units turn over
            }),
        ),
        (
            "pulse of one sample",
            with(|e| {
                let instants = e.scene.instants + 1;
                e.forces.values.fill(0.0);
                e.forces.values[3] = 0.5;
                e.forces.values[3 * instants - 2] = 5.0; // and one at the very end
            }),
        ),
        ("hammer blow of 0.3 ms, a hundredth", hammer(0.01, true)),
        // As measured on metal: units reach 15 m/s and turn over, so any two integrators diverge.
        ("hammer blow of 0.3 ms", hammer(1.0, false)),
        (
            "contact at its limit",
            with(|e| {
                e.scene.contact =
                    Some(EdgeContact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 5f64.to_radians() });
                e.forces.values.iter_mut().for_each(|f| *f *= 3.0);
            }),
        ),
        (
            "voids closed at rest",
            with(|e| {
                let [min_angle, cutoff_angle] = [60.0, 65.0].map(f64::to_radians);
                e.scene.contact = Some(EdgeContact { stiffness: 1.0, min_angle, cutoff_angle });
                e.expected = Outcome::ForbiddenContact;
            }),
        ),
        ("zero force", with(|e| e.forces.values.fill(0.0))),
        (
            "one free unit",
            with(|e| {
                e.scene.layout = Layout::planar(1, 2, 15.0, 2.25);
                e.design = initial(&e.scene.layout);
                e.scene.clamped = vec![0];
                e.scene.panels = vec![Panel::central(1, [0.6, -0.8])];
                e.scene.sensors = vec![1];
                e.forces = bells(&e.scene, 2);
            }),
        ),
        ("40 × 40 units", {
            let mut e = on(40, 40);
            e.scene.duration = 0.1;
            e.judged = false; // the tight run alone would take a minute
            e
        }),
        ("a sensor on a panel", with(|e| e.scene.sensors = vec![31])),
        (
            "units of almost no area",
            with(|e| {
                e.design = slivers(&e.scene.layout);
                e.scene.duration = 0.05;
                e.judged = false; // an explicit method takes millions of steps against the damping of so light a unit
            }),
        ),
        ("T = 2", sampled(2)),
        ("T = 5000", sampled(5000)),
    ]
}

/// One row per scene: error of the signals at default settings against a tight run, if affordable.
pub fn rows(solver: IntegratorSettings, pool: &metasense_numerics::Pool) -> Vec<ComparedQuantity> {
    scenes()
        .into_iter()
        .map(|(name, extreme)| {
            let run = || examine(name, &extreme, solver, pool);
            std::panic::catch_unwind(std::panic::AssertUnwindSafe(run))
                .unwrap_or_else(|_| ComparedQuantity::failed(name).noted("panicked"))
        })
        .collect()
}

fn examine(
    name: &str,
    extreme: &Extreme,
    solver: IntegratorSettings,
    pool: &metasense_numerics::Pool,
) -> ComparedQuantity {
    let Extreme { scene, design, forces, .. } = extreme;
    let started = std::time::Instant::now();
    let tuned = tune(scene, design, forces, &solver, pool);
    let run = run(scene, design, forces, &tuned.plan, true, pool);
    let scale = norm(&run.signals).max(f64::MIN_POSITIVE);
    let cotangent: Vec<f64> = run.signals.iter().map(|s| s / scale / scale).collect();
    let gradient = run.vjp(&cotangent, Wrt::Design, pool);
    let finite = run.signals.iter().chain(&gradient.design).all(|v| v.is_finite());
    let ended = run.outcomes.iter().all(|outcome| *outcome == extreme.expected);
    let mut names: Vec<&str> = run.outcomes.iter().map(|o| o.name()).collect();
    names.sort_unstable();
    names.dedup();
    let (evaluations, seconds) = (run.counters.force_evaluations, started.elapsed().as_secs_f64());
    let note = format!(
        "{}; {}; {evaluations} force evaluations, pilot {}, {seconds:.1} s with dα",
        names.join(" and "),
        tuned.plan.reason,
        tuned.counters.force_evaluations,
    );
    let row = if !finite || !ended {
        ComparedQuantity::failed(name)
    } else if extreme.judged && run.outcomes.iter().all(|o| *o == Outcome::Ok) {
        if forces.values.iter().all(|f| *f == 0.0) {
            return ComparedQuantity::new(name, scale, 1e-6).noted(format!("norm of the signals; {note}"));
        }
        // At T = 2, the absolute part of a wider tolerance would exceed the remaining vibration.
        let tolerance = if scene.instants > 2 { 1e-9 } else { 1e-13 };
        let tight = IntegratorSettings::tsit5(Tolerance::both(tolerance));
        let exact = simulate(scene, design, forces, &tight, false, pool);
        let error = signal_error(&run.signals, &exact.signals, 3 * scene.sensors.len());
        match tuned.error {
            Some(_) => ComparedQuantity::new(name, error, LEEWAY * solver.accuracy.0),
            None => ComparedQuantity::shown(name, error),
        }
    } else {
        ComparedQuantity { error: None, tolerance: None, pass: true, ..ComparedQuantity::new(name, 0.0, 0.0) }
    };
    let source = if extreme.source.is_empty() { String::new() } else { format!("; {}", extreme.source) };
    let expected = if ended { String::new() } else { format!("; {} was expected", extreme.expected.name()) };
    row.noted(note + &source + &expected)
}
