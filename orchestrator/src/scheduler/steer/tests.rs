use super::super::{Event, RecordKind, RunOutcome, Settings, WorkerId, on_event};
use super::*;

/// Records and answers are empty.
#[derive(Debug, Clone, PartialEq)]
struct Nothing;

impl Payload for Nothing {
    type Step = ();
    type Saved = ();
    type Result = ();
    type Asker = ();
}

/// A new trial that does not wait for its body.
const ALONE: Prior = Prior { attempts: 0, steps: None, body: 0, trained: true };

type Actions = Vec<Action<Nothing>>;

/// A run whose workers are up and have the first trials.
fn run(trials: usize, workers: u32) -> SchedulerState {
    run_of(&vec![ALONE; trials], workers)
}

fn run_of(priors: &[Prior], workers: u32) -> SchedulerState {
    let settings = Settings {
        workers,
        paused: false,
        retries: 0,
        backoff: 500,
        no_progress: 10_000,
        time_limit: None,
        memory_limited: false,
        grace: 2_500,
    };
    let mut state = SchedulerState::new(settings, priors);
    up(&mut state, Event::Clock(0));
    state
}

/// Handles an event, then starts the workers that it spawned; returns all actions.
fn up(state: &mut SchedulerState, event: Event<Nothing>) -> Actions {
    let mut actions = on_event(state, event);
    let spawned: Vec<WorkerId> =
        actions.iter().filter_map(|a| if let Action::Spawn(id) = a { Some(*id) } else { None }).collect();
    for worker in spawned {
        actions.extend(on_event(state, Event::Up(worker)));
    }
    actions
}

fn steer(state: &mut SchedulerState, command: Steer) -> (SteerAnswer, Actions) {
    let mut actions = up(state, Event::Steer(command, ()));
    let answer = |action: &Action<Nothing>| match action {
        Action::Answer((), answer) => Some(*answer),
        _ => None,
    };
    let (at, answer) =
        actions.iter().enumerate().find_map(|(at, a)| Some((at, answer(a)?))).expect("an answer");
    actions.remove(at);
    (answer, actions)
}

const fn id(slot: u32) -> WorkerId {
    WorkerId { slot, generation: 1 }
}

const fn lease(trial: u32, attempt: u32) -> Lease {
    Lease { trial, attempt }
}

fn finish(state: &mut SchedulerState, slot: u32, trial: u32) -> Actions {
    let mut actions = up(state, Event::Finished(id(slot), lease(trial, 1), ()));
    actions.extend(up(state, Event::Recorded(lease(trial, 1), RecordKind::Result)));
    actions
}

const fn failed(trial: u32, reason: Reason, settled: bool) -> Action<Nothing> {
    Action::RecordFailure { lease: lease(trial, 1), reason, settled }
}

/// A pause stops running trials; trials that end for other reasons wait, too. The same trials resume, those with progress
/// first.
#[test]
fn a_pause_takes_trials_back_and_hands_out_none() {
    let mut state = run(3, 2);
    let (answer, actions) = steer(&mut state, Steer::Pause);
    assert_eq!(answer, SteerAnswer::Paused(2));
    assert_eq!(actions, [Action::AskStop(id(0)), Action::AskStop(id(1))]);
    assert_eq!(steer(&mut state, Steer::Pause), (SteerAnswer::Paused(2), vec![]), "nobody is asked twice");
    let back = up(&mut state, Event::Failed(id(0), lease(0, 1), Reason::Stopped));
    assert_eq!(back, [failed(0, Reason::Stopped, false)]);
    // this trial finished before the pause took effect
    assert_eq!(finish(&mut state, 1, 1), [Action::RecordResult(lease(1, 1), ())]);
    assert_eq!(up(&mut state, Event::Clock(60_000)), []);
    let (answer, actions) = steer(&mut state, Steer::Resume);
    assert_eq!(answer, SteerAnswer::Resumed(2));
    assert_eq!(actions, [Action::Assign(id(0), lease(0, 2)), Action::Assign(id(1), lease(2, 1))]);
}

/// A trial that has done its requested steps ends for this run, and after the last one the run ends. If it was cancelled
/// meanwhile, it is recorded as cancelled.
#[test]
fn a_trial_at_its_pause_is_over_for_this_run() {
    let mut state = run(3, 2);
    let paused = up(&mut state, Event::Failed(id(0), lease(0, 1), Reason::Paused));
    assert_eq!(paused, [failed(0, Reason::Paused, true), Action::Assign(id(0), lease(2, 1))]);
    steer(&mut state, Steer::Cancel(1));
    let cancelled = up(&mut state, Event::Failed(id(1), lease(1, 1), Reason::Paused));
    assert_eq!(cancelled, [failed(1, Reason::Cancelled, true)]);
    let last = up(&mut state, Event::Failed(id(0), lease(2, 1), Reason::Paused));
    assert_eq!(last, [failed(2, Reason::Paused, true), Action::Close(id(0)), Action::Close(id(1))]);
}

/// Cancels a waiting trial, a running one, one whose worker dies and one that finishes first; none is assigned again.
#[test]
fn what_is_cancelled_is_recorded_and_not_given_out_again() {
    let mut state = run(5, 3);
    let waits = steer(&mut state, Steer::Cancel(4));
    assert_eq!(waits, (SteerAnswer::Cancelled(false), vec![Action::RecordCancelled(lease(4, 0))]));
    for slot in 0..3 {
        let (answer, actions) = steer(&mut state, Steer::Cancel(slot));
        assert_eq!((answer, &actions[..]), (SteerAnswer::Cancelled(true), &[Action::AskStop(id(slot))][..]));
    }
    let stopped = up(&mut state, Event::Failed(id(0), lease(0, 1), Reason::Stopped));
    assert_eq!(stopped, [failed(0, Reason::Cancelled, true), Action::Assign(id(0), lease(3, 1))]);
    let died = up(&mut state, Event::Lost(id(1), Reason::WorkerKilled(9)));
    assert_eq!(died, [failed(1, Reason::Cancelled, true)]);
    assert_eq!(finish(&mut state, 2, 2)[0], Action::RecordResult(lease(2, 1), ()));
    let refused = |why| (SteerAnswer::Refused(why), vec![]);
    assert_eq!(steer(&mut state, Steer::Cancel(2)), refused(SteerRefusal::Done));
    assert_eq!(steer(&mut state, Steer::Cancel(4)), refused(SteerRefusal::Failed(Reason::Cancelled)));
    assert_eq!(steer(&mut state, Steer::Next(0)), refused(SteerRefusal::Failed(Reason::Cancelled)));
    for trial in [0, 1, 4] {
        up(&mut state, Event::Recorded(lease(trial, 1), RecordKind::Failure));
    }
    let last = finish(&mut state, 0, 3);
    assert!(!last.iter().any(|a| matches!(a, Action::Assign(..) | Action::Spawn(_))), "{last:?}");
    let ended = [0, 2].map(|slot| up(&mut state, Event::Lost(id(slot), Reason::WorkerExited(0))));
    assert_eq!(ended.concat(), [Action::End(RunOutcome::Complete)]);
}

/// The trial of the last `Next` command goes first, even if it has just died and would have to wait.
#[test]
fn what_is_to_be_next_goes_first() {
    let mut state = run(5, 1);
    assert_eq!(steer(&mut state, Steer::Next(0)), (SteerAnswer::Refused(SteerRefusal::Running), vec![]));
    for trial in [4, 3] {
        assert_eq!(steer(&mut state, Steer::Next(trial)), (SteerAnswer::Next(false), vec![]));
    }
    let next = |state: &mut SchedulerState, trial| {
        finish(state, 0, trial).into_iter().find(|action| matches!(action, Action::Assign(..)))
    };
    assert_eq!(next(&mut state, 0), Some(Action::Assign(id(0), lease(3, 1))));
    assert_eq!(next(&mut state, 3), Some(Action::Assign(id(0), lease(4, 1))));
    assert_eq!(next(&mut state, 4), Some(Action::Assign(id(0), lease(1, 1))));
    let mut state = run(3, 1);
    state.settings.retries = 1;
    up(&mut state, Event::Lost(id(0), Reason::WorkerKilled(11)));
    let (answer, _) = steer(&mut state, Steer::Next(0));
    assert_eq!(answer, SteerAnswer::Next(false));
    assert!(matches!(state.phase(0), Phase::Running(_)) || state.queues.ready.first() == Some(&(-1, 0)));
    // with one body for all trials, the second waits until the first has trained it
    let mut state = run_of(&[Prior { trained: false, ..ALONE }; 3], 2);
    assert_eq!(steer(&mut state, Steer::Next(2)).0, SteerAnswer::Next(true));
}

/// New workers start at once, also in slots that were given up; of surplus workers, idle ones end first, then the first to
/// finish.
#[test]
fn workers_become_more_and_fewer() {
    let mut state = run(6, 1);
    let (answer, actions) = steer(&mut state, Steer::Workers(3));
    assert_eq!(answer, SteerAnswer::Workers([1, 3]));
    assert_eq!(actions[..2], [Action::Spawn(id(1)), Action::Spawn(id(2))]);
    assert_eq!((state.busy(), state.waiting()), (3, 3));
    // one worker becomes idle in a pause
    steer(&mut state, Steer::Pause);
    finish(&mut state, 1, 1);
    let (answer, actions) = steer(&mut state, Steer::Workers(1));
    assert_eq!((answer, &actions[..]), (SteerAnswer::Workers([3, 1]), &[Action::Close(id(1))][..]));
    assert_eq!(finish(&mut state, 2, 2), [Action::RecordResult(lease(2, 1), ()), Action::Close(id(2))]);
    steer(&mut state, Steer::Resume);
    let next = finish(&mut state, 0, 0);
    assert_eq!(next[1..], [Action::Assign(id(0), lease(3, 1))], "one goes on");
    for slot in [1, 2] {
        assert_eq!(up(&mut state, Event::Lost(id(slot), Reason::WorkerExited(0))), []);
    }
    state.slots[1].work = SlotState::GivenUp;
    let (_, actions) = steer(&mut state, Steer::Workers(2));
    assert_eq!(actions[0], Action::Spawn(WorkerId { slot: 1, generation: 2 }));
}

/// Added trials run in order, even when everything else has ended; they are never refused, as they are already in the database.
#[test]
fn added_trials_are_run() {
    let mut state = run(1, 1);
    let ended = finish(&mut state, 0, 0);
    assert_eq!(ended[1..], [Action::Close(id(0))]);
    let priors = [Prior { attempts: 4, ..ALONE }, ALONE];
    let (answer, actions) = steer(&mut state, Steer::Add(priors.to_vec()));
    assert_eq!((answer, actions), (SteerAnswer::Added(2), vec![]));
    let actions = up(&mut state, Event::Lost(id(0), Reason::WorkerExited(0)));
    let worker = WorkerId { slot: 0, generation: 2 };
    assert_eq!(actions, [Action::Spawn(worker), Action::Assign(worker, lease(1, 5))]);
    assert_eq!(state.waiting(), 1);
    let (answer, actions) = steer(&mut state, Steer::Stop);
    assert_eq!((answer, &actions[..]), (SteerAnswer::Stopping(1, 2_500), &[Action::AskStop(worker)][..]));
    for command in
        [Steer::Stop, Steer::Pause, Steer::Resume, Steer::Cancel(2), Steer::Next(2), Steer::Workers(9)]
    {
        assert_eq!(steer(&mut state, command), (SteerAnswer::Refused(SteerRefusal::Stopping), vec![]));
    }
    assert_eq!(steer(&mut state, Steer::Add(vec![ALONE])).0, SteerAnswer::Added(1));
    up(&mut state, Event::Failed(worker, lease(1, 5), Reason::Stopped));
    up(&mut state, Event::Recorded(lease(1, 5), RecordKind::Failure));
    let ended = up(&mut state, Event::Lost(worker, Reason::WorkerExited(0)));
    assert_eq!(ended, [Action::End(RunOutcome::Interrupted)]);
}

/// A stop waits for steps in progress for `grace` and no longer; a second stop does not wait.
#[test]
fn a_stop_waits_for_its_grace_and_a_second_one_does_not() {
    for at_once in [false, true] {
        let mut state = run(2, 2);
        up(&mut state, Event::Clock(700));
        assert_eq!(up(&mut state, Event::Interrupt), [Action::AskStop(id(0)), Action::AskStop(id(1))]);
        up(&mut state, Event::Failed(id(0), lease(0, 1), Reason::Stopped));
        up(&mut state, Event::Lost(id(0), Reason::WorkerExited(0)));
        assert_eq!(up(&mut state, Event::Clock(3_200)), [], "its step may end yet");
        let killed = if at_once { Event::Interrupt } else { Event::Clock(3_201) };
        assert_eq!(up(&mut state, killed), [Action::Kill(id(1))]);
        let last = up(&mut state, Event::Lost(id(1), Reason::WorkerKilled(9)));
        assert_eq!(last, [failed(1, Reason::Stopped, false)]);
    }
}

/// Shortages do not count against trials, which wait longer each time and stay pending; if a shortage lasts, the run ends. A
/// worker that ends, or progress of a trial, resets the wait.
#[test]
fn a_shortage_is_waited_out_and_charged_to_no_trial() {
    let mut state = run(1, 1);
    state.settings.retries = 2;
    let (mut now, mut attempt) = (0, 1);
    for wait in [500, 1000] {
        let short = up(&mut state, Event::Failed(id(0), lease(0, attempt), Reason::Shortage));
        assert!(matches!(short[..], [Action::RecordFailure { settled: false, .. }]), "{short:?}");
        up(&mut state, Event::Recorded(lease(0, attempt), RecordKind::Failure));
        assert_eq!(up(&mut state, Event::Clock(now + wait - 1)), []);
        now += wait;
        attempt += 1;
        assert_eq!(up(&mut state, Event::Clock(now)), [Action::Assign(id(0), lease(0, attempt))]);
    }
    let mut further = state.clone();
    let last = up(&mut state, Event::Failed(id(0), lease(0, attempt), Reason::Shortage));
    assert!(matches!(last[..], [Action::RecordFailure { settled: false, .. }, Action::Close(_)]), "{last:?}");
    up(&mut state, Event::Recorded(lease(0, attempt), RecordKind::Failure));
    let ended = up(&mut state, Event::Lost(id(0), Reason::WorkerExited(0)));
    assert_eq!(ended, [Action::End(RunOutcome::Unfit(Reason::Shortage))]);
    assert_eq!(state.phase(0), Phase::Pending);
    // after progress, the count of shortages starts again at one
    up(&mut further, Event::Step(id(0), lease(0, attempt), false, ()));
    up(&mut further, Event::Failed(id(0), lease(0, attempt), Reason::Shortage));
    assert_eq!(up(&mut further, Event::Clock(now + 500)), [Action::Assign(id(0), lease(0, attempt + 1))]);

    // two workers, but memory for one: when the other trial ends, the failed one is retried
    let mut state = run(2, 2);
    up(&mut state, Event::Failed(id(1), lease(1, 1), Reason::OutOfMemory));
    assert_eq!(up(&mut state, Event::Clock(499)), [], "nothing is handed out meanwhile");
    let done = finish(&mut state, 0, 0);
    assert!(matches!(done[1], Action::Assign(_, Lease { trial: 1, attempt: 2 })), "{done:?}");
    // exceeding the worker's own memory limit is no shortage
    let mut state = run(1, 1);
    state.settings.memory_limited = true;
    let own = up(&mut state, Event::Lost(id(0), Reason::OutOfMemory));
    assert_eq!(own[0], failed(0, Reason::OutOfMemory, true));
}
