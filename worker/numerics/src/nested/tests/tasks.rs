//! Bodies trained for tasks other than forces.

use super::super::protocol::Session;
use super::linear::linear;
use super::*;
use crate::brains::{SensingTask, TaskEstimate, Tasks};
use crate::dynamics::Parameters;
use crate::variation::Deviations;

fn trained_for(tasks: &[SensingTask], batch: usize) -> Problem {
    let problem = linear(TrainingProtocol::Joint(StepTraining { batch, ..GOING }));
    // few samples can teach a readout what hardly varies
    let source = HistorySource::Bell(Bell {
        amplitude: [0.15, 0.5],
        width: [0.06, 0.08],
        onset: [0.0, 0.05],
        peak: [0.45, 0.55],
        power: [2.0, 2.5],
    });
    let stimuli = ForceSets { source, samples: 120, test: 40, holdout: 60, ..problem.stimuli.clone() };
    Problem { tasks: Tasks { trained: tasks.to_vec(), ..Tasks::default() }, stimuli, ..problem }
}

/// L(α + εδ) = L(α) + ε g·δ + O(ε²) through simulator and readout, at the samples of a step.
#[test]
fn the_gradient_of_a_task_holds_through_simulator_and_readout() {
    let cases = [
        (&[SensingTask::Peak][..], None),
        (&[SensingTask::Panel, SensingTask::Onset], None),
        (&[SensingTask::Peak, SensingTask::Position], Some(20)),
    ];
    for (tasks, window) in cases {
        let mut problem = trained_for(tasks, 16);
        problem.tasks.window = window;
        problem.scene.density *= 4.0; // fewer steps
        problem.solver.accuracy = Accuracy(1e-11);
        (problem.optimise.coarse, problem.stimuli.samples, problem.stimuli.test) = (None, 20, 4);
        let pool = pool(2);
        let trial = PreparedTrial::new(&problem, &pool).unwrap();
        let step = |design: Vec<f64>| {
            let mut keeper = Keeper::default();
            let (mut state, mut log) = (State::new(&problem), Log::new(0, &mut keeper));
            state.design = design;
            Session::new(&trial).train_and_differentiate(&mut state, &mut log).unwrap()
        };
        let start = step(problem.initial.clone());
        let mut stream = Stream::new(Purpose::Design, 1, [0, 0]);
        let direction: Vec<f64> = start.gradient.iter().map(|_| stream.normal()).collect();
        let slope: f64 = start.gradient.iter().zip(&direction).map(|(g, d)| g * d).sum();
        let at = |by: f64| {
            step(problem.initial.iter().zip(&direction).map(|(a, d)| a + by * d).collect()).loss_train
        };
        let steps = [4e-3, 2e-3, 1e-3];
        let remainders = steps.map(|step| (at(step) - start.loss_train - step * slope).abs());
        let orders = [0, 1].map(|i| (remainders[i] / remainders[i + 1]).log2());
        let second = orders.iter().all(|order| (1.8..2.2).contains(order));
        assert!(second && slope.abs() > 1e-4, "{tasks:?}: {slope:e} {orders:?} {remainders:?}");
    }
}

/// Training for a task lowers its held-out error; a resumed loop gives the same bits on another number of threads.
#[test]
fn training_for_a_task_lowers_its_error_and_resumes() {
    for tasks in
        [&[SensingTask::Impulse][..], &[SensingTask::Position], &[SensingTask::Panel, SensingTask::Peak]]
    {
        let mut problem = trained_for(tasks, 64);
        (problem.optimise.iterations, problem.optimise.rate) = (20, 0.2);
        let mut whole = Keeper::default();
        let through = optimise(&problem, None, &pool(1), &mut whole).unwrap().unwrap();
        let error = |body: &BodyEvaluation| body.networks[0].error_holdout.unwrap();
        let errors = [&through.initial, &through.optimised].map(error);
        assert!(errors[1] < 0.9 * errors[0] && errors[0] < 100.0, "{tasks:?}: {errors:?}");
        assert!(through.initial.readings[0].error_holdout.unwrap() < 100.0, "forces are decoded, too");
        assert!(through.bands.iter().all(Vec::is_empty));

        let mut first = Keeper { stop_after: Some(2), ..Default::default() };
        assert!(optimise(&problem, None, &pool(2), &mut first).unwrap().is_none());
        let resumed = optimise(&problem, first.states.pop(), &pool(2), &mut Keeper::default());
        assert_eq!(resumed.unwrap().unwrap().optimised, through.optimised, "{tasks:?}");
    }
}

/// A batch that is too small for a readout is an error of the initial body.
#[test]
fn too_few_samples_for_a_readout_are_named() {
    let failure =
        optimise(&trained_for(&[SensingTask::Peak], 5), None, &pool(1), &mut Keeper::default()).unwrap_err();
    assert_eq!(failure, Failure::Initial(Trouble::FewForces));
}

/// Estimates of tasks change neither results nor counts of work; they are those of `estimate_tasks`, also in a trial that resumes
/// within its comparison.
#[test]
fn estimates_of_tasks_stand_beside_the_comparison() {
    let problem = trained_for(&[], 64);
    let mut network = small(TrainingProtocol::Joint(GOING));
    network.stimuli = problem.stimuli.clone();
    network.brain.iterations = 6;
    for mut problem in [problem, network] {
        quicken(&mut problem);
        (problem.optimise.iterations, problem.optimise.rate) = (8, 0.2);
        let plain = carried_out(&problem, 1);
        problem.evaluation.tasks = true;
        let mut keeper = Keeper::default();
        let found = optimise(&problem, None, &pool(2), &mut keeper).unwrap().unwrap();
        let timeless = |found: &Optimised| Optimised {
            seconds: Seconds::default(),
            tasks: [vec![], vec![]],
            ..found.clone()
        };
        assert_eq!(format!("{:?}", timeless(&plain)), format!("{:?}", timeless(&found)));
        assert!(plain.tasks.iter().all(Vec::is_empty));

        let pool = pool(1);
        let trial = PreparedTrial::new(&problem, &pool).unwrap();
        for (body, tasks) in [&found.initial, &found.optimised].into_iter().zip(&found.tasks) {
            assert_eq!(tasks, &estimate_tasks(&trial, &body.design).unwrap());
            let of = |name: &str| tasks.iter().filter(|estimate| estimate.task.0 == name).count();
            assert_eq!(["forces", "panel", "peak", "count"].map(of), [1, 2, 2, 0], "{tasks:?}");
        }
        assert_ne!(found.tasks[0], found.tasks[1]);

        assert!(!keeper.saved.is_empty());
        let within = keeper.saved.into_iter().filter(|state| state.comparison.bodies.len() == 2);
        for state in within {
            let comparison = Comparison { tasks: Vec::new(), ..state.comparison }; // as in a checkpoint
            let resumed =
                optimise(&problem, Some(State { comparison, ..state }), &pool, &mut Keeper::default());
            let resumed = resumed.unwrap().unwrap();
            assert_eq!((resumed.tasks, resumed.counters), (found.tasks.clone(), found.counters));
        }
    }
}

/// Readouts that are fitted to the body as designed have larger errors on casts of it; without casts there is no such error.
#[test]
fn tasks_are_judged_on_casts() {
    let mut problem = trained_for(&[], 64);
    let pool = pool(2);
    let estimates = |problem: &Problem| {
        estimate_tasks(&PreparedTrial::new(problem, &pool).unwrap(), &problem.initial).unwrap()
    };
    let plain = estimates(&problem);
    assert!(plain.iter().all(|estimate| estimate.casts.is_none()));
    let material = Parameters { stretch: 0.1, shear: 0.1, bend: 0.1, ..Parameters::default() };
    problem.variation = Some(Deviations { material, nodes: 0.2, ..Deviations::default() });
    problem.evaluation.casts = 3;
    let found = estimates(&problem);
    let nominal = |estimate: &TaskEstimate| TaskEstimate { casts: None, ..estimate.clone() };
    assert_eq!(found.iter().map(nominal).collect::<Vec<_>>(), plain);
    let worse = found.iter().filter(|estimate| estimate.casts.unwrap() > estimate.error).count();
    assert!(worse > found.len() / 2, "{found:?}");
}

/// Labels of the part of a mixture belong to the samples, in steps and in all sets: otherwise pulls would not differ from pushes.
#[test]
fn the_kind_of_a_sample_is_that_of_its_forces() {
    let mut problem = trained_for(&[SensingTask::Kind], 48);
    let HistorySource::Bell(push) = problem.stimuli.source else { panic!("pulses") };
    let pull = Bell { amplitude: push.amplitude.map(|f| -f), ..push };
    problem.stimuli.source =
        HistorySource::Mix(vec![(0.4, HistorySource::Bell(push)), (0.6, HistorySource::Bell(pull))]);
    for protocol in
        [TrainingProtocol::Joint(StepTraining { batch: 48, ..GOING }), TrainingProtocol::Random(GOING)]
    {
        problem.optimise.protocol = protocol;
        let mut keeper = Keeper::default();
        let found = optimise(&problem, None, &pool(2), &mut keeper).unwrap().unwrap();
        let steps =
            keeper.reports.iter().flat_map(|step| [step.loss_train, step.error_test.map(|e| 0.01 * e)]);
        let steps: Vec<f64> = steps.flatten().collect();
        assert!(steps.len() >= 4 && steps.iter().all(|loss| *loss < 0.4), "{protocol:?}: {steps:?}");
        let own = &found.initial.networks[0];
        let errors = [own.error_train, own.error_test, own.error_holdout].map(|error| error.unwrap());
        assert!(errors.iter().all(|error| *error < 40.0), "{protocol:?}: {errors:?}");
    }
}
