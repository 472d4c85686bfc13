//! Compares geometry, energies, trajectories, gradients and force histories with their cases.

use metasense_numerics::body::Geometry;
use metasense_numerics::dynamics::{
    Energy, Forces, IntegratorSettings, Outcome, Scene, Simulation, Tolerance, Wrt, energy, energy_gradients,
    run, signal_error, simulate, start, tune,
};
use metasense_numerics::stimuli::resample;

use super::case::{Case, CaseError};
use super::{ComparedQuantity, DEFAULT, relative};

/// Tolerance relative to the array's norm: rounding of sums of a few hundred terms in f64.
const ROUNDING: f64 = 1e-12;

/// Largest accepted ratio of the error at default settings to the requested tolerance.
pub(super) const LEEWAY: f64 = 1.2;

/// Solver for all comparisons of trajectories.
pub(super) const TIGHT: IntegratorSettings = IntegratorSettings::tsit5(Tolerance::both(1e-11));

/// Initial design, vertices, centroids, arms, area, mass, moment, void angles, ligaments.
pub fn geometry(case: &Case) -> Result<Vec<ComparedQuantity>, CaseError> {
    let scene = case.scene()?;
    let layout = &scene.layout;
    let g = scene.geometry(&case.design(&scene)?);
    let arrays = [
        ("alpha_initial", layout.initial_design(case.number("scene.initial_angle")?)),
        ("vertices", g.vertices.concat().into_flattened()),
        ("centroids", g.centroids.as_flattened().to_vec()),
        ("r", g.arms.as_flattened().to_vec()),
        ("area", g.area.clone()),
        ("mass", g.mass.clone()),
        ("moment", g.moment.clone()),
        ("void_angles", g.void_angles(layout).as_flattened().to_vec()),
    ];
    let row = |(name, ours): (&str, Vec<f64>)| case.row(name, &ours, name, ROUNDING);
    let mut rows = arrays.into_iter().map(row).collect::<Result<Vec<_>, _>>()?;
    let mut different = case.list("ligaments")?.len().abs_diff(layout.ligaments.len());
    for (i, ours) in layout.ligaments.iter().enumerate().take(case.list("ligaments")?.len()) {
        let read = |key: &str| case.size(&format!("ligaments.{i}.{key}"));
        let theirs = [read("a")?, read("node_a")?, read("b")?, read("node_b")?];
        different += usize::from(theirs != [ours.a.unit, ours.a.node, ours.b.unit, ours.b.node]);
    }
    rows.push(ComparedQuantity::new("ligaments that differ", different as f64, 0.0));
    Ok(rows)
}

/// Elastic and contact energy, the derivatives of their sum in state and design, and the void angles.
pub fn energies(case: &Case) -> Result<Vec<ComparedQuantity>, CaseError> {
    let scene = case.scene()?;
    let design = case.design(&scene)?;
    let (mut elastic, mut contact, mut dx, mut dalpha) = (vec![], vec![], vec![], vec![]);
    let rest = scene.geometry(&design).void_angles(&scene.layout);
    let mut voids = vec![];
    for state in case.states("displacement", scene.layout.units())? {
        let e = energy(&scene, &design, &state);
        elastic.push(e.elastic);
        contact.push(e.contact);
        let (in_state, in_design) = energy_gradients(&scene, &design, &state);
        dx.extend(in_state.into_flattened());
        dalpha.extend(in_design);
        for (ligament, psi) in scene.layout.ligaments.iter().zip(&rest) {
            let turned = state[ligament.b.unit][2] - state[ligament.a.unit][2];
            voids.extend([psi[0] - turned, psi[1] + turned]);
        }
    }
    let sum = elastic.iter().zip(&contact).map(|(e, c)| e + c).collect();
    let arrays = [
        ("energy_elastic", elastic),
        ("energy_contact", contact),
        ("energy", sum),
        ("dU_dx", dx),
        ("dU_dalpha", dalpha),
    ];
    let row = |(name, ours): (&str, Vec<f64>)| case.row(name, &ours, name, ROUNDING);
    let mut rows = arrays.into_iter().map(row).collect::<Result<Vec<_>, _>>()?;
    // Angles are compared modulo 2π.
    let on_circle =
        |angles: &[f64]| angles.iter().flat_map(|a| <[f64; 2]>::from(a.sin_cos())).collect::<Vec<_>>();
    let theirs = case.array_of("void_angles", voids.len())?;
    rows.push(ComparedQuantity::new(
        "void_angles",
        relative(&on_circle(&voids), &on_circle(&theirs)),
        ROUNDING,
    ));
    Ok(rows)
}

pub(super) fn outcomes(simulation: &Simulation) -> String {
    let failed: Vec<&str> =
        simulation.outcomes.iter().filter(|o| **o != Outcome::Ok).map(|o| o.name()).collect();
    failed.join(" ")
}

/// Signals, final state and energies at tight tolerance; the error at default settings; forces from a record.
pub fn trajectory(case: &Case, pool: &metasense_numerics::Pool) -> Result<Vec<ComparedQuantity>, CaseError> {
    let scene = case.scene()?;
    let (design, forces) = (case.design(&scene)?, case.forces(&scene)?);
    let own = |key: &str| case.number(&format!("self_consistency.{key}"));
    let signals = case.array("sensors")?;
    let tolerance = |own: f64| (3.0 * own).max(1e-7);

    let tight = simulate(&scene, &design, &forces, &TIGHT, true, pool);
    let mut rows = vec![
        case.row("sensors", &tight.signals, "sensors", tolerance(own("sensors_relative_l2")?))?
            .noted(outcomes(&tight)),
    ];
    let states = states(&scene, &design, &forces, &tight, &scene.geometry(&design));
    let mut theirs = case.array("final_displacement")?;
    theirs.extend(case.array("final_velocity")?);
    let allowed = tolerance(own("final_state_relative_l2")?);
    let less = |a: Vec<f64>, b: Vec<f64>| a.iter().zip(&b).map(|(a, b)| a - b).collect::<Vec<f64>>();
    let stays = less(case.array("external_work")?, case.array("dissipated_work")?);
    // Voids that are narrow at rest, and displaced held units, store energy from the start.
    let places = start(&scene, &design).map_err(|outcome| case.wrong(outcome.name()))?;
    let Energy { elastic, contact } = energy(&scene, &design, &places);
    let start = elastic + contact;
    let gained: Vec<f64> = states.kinetic.iter().zip(&states.elastic).map(|(k, e)| k + e - start).collect();
    rows.extend([
        ComparedQuantity::new("final state", relative(&states.last, &theirs), allowed),
        case.row("kinetic energy", &states.kinetic, "kinetic_energy", allowed)?,
        case.row("elastic energy", &states.elastic, "elastic_energy", allowed)?,
        ComparedQuantity::new("work done minus dissipation", relative(&gained, &stays), allowed.max(1e-6)),
    ]);
    if !scene.imposed.is_empty() {
        rows.push(case.row("initial equilibrium", places.as_flattened(), "start", ROUNDING)?);
    }
    if let Ok(dt) = case.number("record_dt") {
        let record = case.array("record")?;
        let samples = record.len() / (forces.samples * forces.panels).max(1);
        let start = case.number("record_t0")?;
        let read = |record| resample(record, start, dt, scene.duration, scene.instants);
        let ours: Vec<f64> = record.chunks(samples.max(1)).flat_map(read).collect();
        rows.push(ComparedQuantity::new("forces from the record", relative(&ours, &forces.values), ROUNDING));
    }

    let tuned = tune(&scene, &design, &forces, &DEFAULT, pool);
    let usual = run(&scene, &design, &forces, &tuned.plan, false, pool);
    let work = usual.counters.force_evaluations / forces.samples.max(1) as u64;
    let (name, error) =
        ("sensors at default settings", signal_error(&usual.signals, &signals, 3 * scene.sensors.len()));
    // If the pilot found no steps within the tolerance, the error is only shown.
    let row = match tuned.error {
        Some(_) => ComparedQuantity::new(name, error, LEEWAY * DEFAULT.accuracy.0),
        None => ComparedQuantity::shown(name, error),
    };
    let note = format!("{work} force evaluations per sample; {} {}", tuned.plan.reason, outcomes(&usual));
    rows.push(row.noted(note.trim_end()));
    Ok(rows)
}

/// States of a run.
#[derive(Default)]
pub(super) struct States {
    /// Final displacements, then final velocities, of all samples.
    pub last: Vec<f64>,
    /// Kinetic energy at every instant.
    pub kinetic: Vec<f64>,
    /// Elastic energy at every instant, contact included.
    pub elastic: Vec<f64>,
}

pub(super) fn states(
    scene: &Scene,
    design: &[f64],
    forces: &Forces,
    run: &Simulation,
    geometry: &Geometry,
) -> States {
    let (mut states, mut velocities) = (States::default(), vec![]);
    let Some(tape) = &run.tape else { return states };
    for sample in (0..forces.samples).filter(|&i| run.outcomes[i] == Outcome::Ok) {
        for n in 1..=scene.instants {
            let (x, v) = tape.state(sample, n);
            let e = energy(scene, design, &x);
            states.elastic.push(e.elastic + e.contact);
            let of =
                |(v, (m, j)): (&[f64; 3], (&f64, &f64))| m * (v[0] * v[0] + v[1] * v[1]) + j * v[2] * v[2];
            let inertia = geometry.mass.iter().zip(&geometry.moment);
            states.kinetic.push(0.5 * v.iter().zip(inertia).map(of).sum::<f64>());
            if n == scene.instants {
                states.last.extend(x.into_flattened());
                velocities.extend(v.into_flattened());
            }
        }
    }
    states.last.extend(velocities);
    states
}

/// Gradient in α of ⟨cotangent, signals⟩, compared with automatic differentiation.
pub fn adjoint(case: &Case, pool: &metasense_numerics::Pool) -> Result<Vec<ComparedQuantity>, CaseError> {
    let scene = case.scene()?;
    let (design, forces) = (case.design(&scene)?, case.forces(&scene)?);
    let run = simulate(&scene, &design, &forces, &TIGHT, true, pool);
    let cotangent = case.array_of("cotangent", run.signals.len())?;
    let gradient = run.vjp(&cotangent, Wrt::Design, pool);
    // The reference is a fifth-order run of 40 000 steps. Its error is the difference to 20 000 steps, divided by 2⁵ − 1. With
    // contact it is the difference itself: ∂²E_c/∂ψ² jumps at ψ_c, so gradients on a fixed grid converge with order 1.
    let order = if scene.contact.is_some() { 1 } else { 5 };
    let own = case.number("gradient_20000_steps_relative_difference")? / (2f64.powi(order) - 1.0);
    Ok(vec![
        case.row("sensors", &run.signals, "sensors", 1e-6)?.noted(outcomes(&run)),
        case.row("dα", &gradient.design, "gradient", (3.0 * own).max(1e-6))?
            .noted(format!("the reference's own error {own:.0e}")),
    ])
}

/// Bell pulses from their recorded parameters.
pub fn stimuli(case: &Case) -> Result<Vec<ComparedQuantity>, CaseError> {
    use metasense_numerics::stimuli::Pulse;
    let scene = case.scene()?;
    let read = |name: &str| case.array(name);
    let (amplitude, width, onset, peak, power) =
        (read("amplitude")?, read("width")?, read("onset")?, read("peak")?, read("power")?);
    let expected = case.array_of("forces", amplitude.len() * (scene.instants + 1))?;
    let mut found = vec![0.0; expected.len()];
    for (i, history) in found.chunks_mut(scene.instants + 1).enumerate() {
        let pulse = Pulse {
            amplitude: amplitude[i],
            width: width[i],
            onset: onset[i],
            peak: peak[i],
            power: power[i],
        };
        pulse.history_into(scene.duration, history);
    }
    Ok(vec![ComparedQuantity::new("forces", relative(&found, &expected), ROUNDING)])
}
