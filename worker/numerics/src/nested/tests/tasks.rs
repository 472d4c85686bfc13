//! Bodies trained for tasks other than forces.

use super::super::protocol::Session;
use super::linear::linear;
use super::*;
use crate::brains::Task;

fn trained_for(tasks: &[Task], batch: usize) -> Problem {
    let problem = linear(Protocol::Joint(StepTraining { batch, ..GOING }));
    // few samples can teach a readout what hardly varies
    let source = Source::Bell(Bell {
        amplitude: [0.15, 0.5],
        width: [0.06, 0.08],
        onset: [0.0, 0.05],
        peak: [0.45, 0.55],
        power: [2.0, 2.5],
    });
    let stimuli = Stimuli { source, samples: 120, test: 40, holdout: 60, ..problem.stimuli.clone() };
    Problem { tasks: tasks.to_vec(), stimuli, ..problem }
}

/// L(α + εδ) = L(α) + ε g·δ + O(ε²) through simulator and readout, at the samples of a step.
#[test]
fn the_gradient_of_a_task_holds_through_simulator_and_readout() {
    for tasks in [&[Task::Peak][..], &[Task::Panel, Task::Onset]] {
        let mut problem = trained_for(tasks, 16);
        problem.scene.density *= 4.0; // fewer steps
        problem.solver.accuracy = Accuracy(1e-11);
        (problem.optimise.coarse, problem.stimuli.samples, problem.stimuli.test) = (None, 20, 4);
        let pool = pool(2);
        let trial = Trial::new(&problem, &pool).unwrap();
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
    for tasks in [&[Task::Impulse][..], &[Task::Position], &[Task::Panel, Task::Peak]] {
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
        optimise(&trained_for(&[Task::Peak], 5), None, &pool(1), &mut Keeper::default()).unwrap_err();
    assert_eq!(failure, Failure::Initial(Trouble::FewForces));
}
