//! A small problem. The tests of `metasense-lab` include this file, too.

use metasense_numerics::body::{Layout, Pattern};
use metasense_numerics::brain::Architecture;
use metasense_numerics::brain::linear::Lags;
use metasense_numerics::brains::Tasks;
use metasense_numerics::dynamics::{
    Accuracy, Forces, Integrator, IntegratorSettings, LigamentStiffness, Panel, Scene,
};
use metasense_numerics::feasible::Limits;
use metasense_numerics::random::Purpose;
use metasense_numerics::stimuli::{Bell, HistorySource, RecordedForces};
use metasense_numerics::trial::{
    Decoder, DecoderKind, FinalComparison, ForceSets, Normalisation, OuterLoop, Problem, RateSchedule,
    RidgeChoice, ScenePolygons, StepTraining, Training, TrainingProtocol,
};
use std::sync::Arc;

/// 4 × 3 units, two panels, one sensor, 0.2 s, 16 samples, a network of width 8.
pub(crate) fn small(protocol: TrainingProtocol) -> Problem {
    let layout = Layout::planar(4, 3, 15.0, 2.25);
    let direction = [0.0, -1.0];
    Problem {
        under: Vec::new(),
        body: Arc::new(ScenePolygons),
        initial: layout.initial_design(25f64.to_radians()),
        scene: Scene {
            layout,
            density: 1e-8,
            stiffness: LigamentStiffness { stretch: 3.0, shear: 0.5, bend: 1.0 },
            damping_ratio: 0.02,
            clamped: vec![0, 1, 2, 3],
            panels: vec![Panel::central(9, direction), Panel::central(10, direction)],
            sensors: vec![5],
            duration: 0.2,
            instants: 40,
            ..Scene::default()
        },
        search: None,
        solver: IntegratorSettings::new(Integrator::Auto, Accuracy(1e-3)),
        limits: Limits::default(),
        frozen: vec![],
        tie: [1, 1],
        stimuli: ForceSets {
            source: HistorySource::Bell(Bell {
                amplitude: [0.15, 0.5],
                width: [0.05, 0.1],
                onset: [0.0, 0.1],
                peak: [0.35, 0.65],
                power: [1.5, 4.0],
            }),
            instants: 40,
            samples: 16,
            test: 4,
            replacement: false,
            holdout: 4,
        },
        channels: vec![0, 1, 2],
        disturbance: None,
        relative_to: None,
        variation: None,
        decoder_kind: DecoderKind::Network,
        tasks: Tasks::default(),
        decoder: Decoder { lags: Lags::whole(40), ridge: RidgeChoice::Auto },
        brain: Training {
            iterations: 30,
            rate: 1e-2,
            architecture: Architecture::paper(8),
            scaling: Normalisation::Rms,
        },
        optimise: OuterLoop {
            brain: DecoderKind::Network,
            protocol,
            iterations: 4,
            rate: 0.1,
            coarse: Some(IntegratorSettings::new(Integrator::Auto, Accuracy(1e-2))),
            casting: None,
        },
        evaluation: FinalComparison {
            seeds: 2,
            schedule: RateSchedule::Cosine,
            batch: Some(5),
            long: None,
            casts: 0,
            records: true,
            initial: true,
            tasks: false,
        },
        seed: 3,
    }
}

/// The problem on a sheet and on a disc of each other lattice: two panels, the first sensor of placement 0.
pub(crate) fn on_lattices(problem: &Problem) -> Vec<(String, Problem)> {
    let angle = 25f64.to_radians();
    let patterns = [
        ("kagome", Pattern::kagome()),
        ("triangular", Pattern::triangular(angle)),
        ("chiral", Pattern::chiral(angle)),
    ];
    let mut found = Vec::new();
    for (name, pattern) in patterns {
        let sheet = Layout::sheet(&pattern, 4, 3, 15.0, 2.25);
        let down = sheet.top_panels(2).expect("panels").into_iter().map(|unit| (unit, [0.0, -1.0]));
        let disc = Layout::circular(&pattern, 5, 15.0, 2.25);
        let inward = disc.circular_panels(2).expect("panels");
        let bodies = [("sheet", sheet.bottom(), down.collect(), sheet), ("disc", disc.hub(), inward, disc)];
        for (outline, clamped, struck, layout) in bodies {
            let panels =
                struck.into_iter().map(|(unit, direction)| Panel::central(unit, direction)).collect();
            let sensors = layout.placement(0, &clamped)[..1].to_vec();
            let initial = layout.initial_design(angle);
            let scene = Scene { clamped, panels, sensors, layout, ..problem.scene.clone() };
            found.push((format!("{outline} of {name}"), Problem { scene, initial, ..problem.clone() }));
        }
    }
    found
}

pub(crate) const GOING: StepTraining = StepTraining { batch: 5, brain_iterations: 3, brain_rate: 1e-3 };

/// 16 training, test and held-out samples from records. The forces of `spoilt` (set, number) are multiplied by `factor`: 0, or so
/// large that the simulation fails.
pub(crate) fn with_failing_samples(brain: DecoderKind, spoilt: &[(Purpose, usize)], factor: f64) -> Problem {
    let mut problem = small(TrainingProtocol::Random(GOING));
    problem.stimuli = ForceSets { samples: 32, test: 16, holdout: 16, ..problem.stimuli };
    (problem.decoder_kind, problem.optimise.brain) = (brain, brain);
    if brain == DecoderKind::Stacked {
        problem.optimise.brain = DecoderKind::Network;
    }
    let mut histories = problem.forces(Purpose::Stimulus, 0, 48);
    let recorded = |histories: Forces| {
        HistorySource::Recorded(RecordedForces {
            histories: Arc::new(histories),
            struck: None,
            scale: [1.0; 2],
            shift: [0.0; 2],
            low_pass: false,
        })
    };
    problem.stimuli.source = recorded(histories.clone());
    let len = histories.values.len() / 48;
    for &(purpose, number) in spoilt {
        let there = problem.forces(purpose, number as u64, 1).values;
        let history = histories.values.chunks_exact_mut(len).find(|history| *history == &there[..]);
        history.expect("dealt").iter_mut().for_each(|f| *f *= factor);
    }
    problem.stimuli.source = recorded(histories);
    problem
}
