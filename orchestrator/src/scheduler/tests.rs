//! Simulates the scheduler's environment: workers that die, hang, lag, repeat messages, send them late or stop slowly, and
//! people who pause, cancel, add and change their minds.
//!
//! Events come from a queue ordered by time, drawn from a seed. After every event: no trial is lost, with two workers or
//! recorded twice; no attempt number is reused; no body is trained by two workers; nothing is assigned in a pause, after its
//! cancellation, or to more workers than requested; no shortage counts against a trial. Every run ends, within its grace after
//! a stop. A failing seed prints its history.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

use super::*;

/// SplitMix64.
struct Dice(u64);

impl Dice {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    fn below(&mut self, n: u64) -> u64 {
        self.next() % n
    }

    fn percent(&mut self, chance: u64) -> bool {
        self.below(100) < chance
    }
}

/// Records of the simulated store: trial and step.
#[derive(Debug, Clone, PartialEq)]
struct Simulated;

impl Payload for Simulated {
    type Step = (u32, u32);
    type Saved = (u32, u32);
    type Result = (u32, u32);
    type Asker = ();
}

/// A simulated worker process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Process {
    Starting,
    Up,
    Hung,
    Gone,
}

/// A body and the steps that train it.
#[derive(Debug, Clone, Copy)]
struct Body {
    number: u32,
    length: u32,
}

struct World {
    dice: Dice,
    state: SchedulerState,
    now: Millis,
    /// Future events, by time and order of scheduling.
    queue: BTreeMap<(Millis, u64), Event<Simulated>>,
    scheduled: u64,
    processes: HashMap<WorkerId, Process>,
    working: HashMap<WorkerId, Lease>,
    /// Steps on the simulated disk, by trial.
    steps: Vec<u32>,
    results: Vec<u32>,
    failed: Vec<Option<Reason>>,
    /// The body that each trial trains.
    bodies: Vec<Body>,
    leases: HashSet<Lease>,
    /// Percentages.
    chance_of_death: u64,
    chance_of_hanging: u64,
    chance_of_trouble: u64,
    chance_of_misfire: u64,
    chance_of_echo: u64,
    /// Chance that a worker stops late.
    chance_of_slowness: u64,
    chance_of_shortage: u64,
    /// Every trial dies at its first step on this machine.
    black_hole: bool,
    /// Shortages so far.
    shortages: u32,
    /// Trials whose workers have died since the last progress, one entry per death.
    deaths: Vec<u32>,
    interrupt: bool,
    interrupted: Option<Millis>,
    /// Cancelled trials, and the answers to commands.
    cancelled: BTreeSet<u32>,
    answers: Vec<SteerAnswer>,
    store_breaks: bool,
    /// Recorded when a failed seed runs again.
    history: Option<Vec<String>>,
    outcome: Option<RunOutcome>,
}

impl World {
    fn new(seed: u64) -> Self {
        let mut dice = Dice(seed);
        let trials = 1 + dice.below(12) as usize;
        let settings = Settings {
            workers: 1 + dice.below(4) as u32,
            paused: false,
            retries: dice.below(6) as u32,
            backoff: dice.below(2000),
            no_progress: 20_000,
            time_limit: dice.percent(30).then_some(60_000),
            memory_limited: false,
            grace: dice.below(4) * 1_000,
        };
        let (black_hole, mut bodies) = (dice.percent(3), Vec::new());
        let least = u32::from(black_hole);
        let priors: Vec<Prior> = (0..trials).map(|_| prior(&mut bodies, least, &mut dice)).collect();
        let calm = dice.percent(20);
        let chance = |dice: &mut Dice, most| if calm { 0 } else { dice.below(most) };
        let mut world = Self {
            state: SchedulerState::new(settings, &priors),
            now: 0,
            queue: BTreeMap::new(),
            scheduled: 0,
            processes: HashMap::new(),
            working: HashMap::new(),
            steps: Vec::new(),
            results: Vec::new(),
            failed: Vec::new(),
            bodies,
            leases: HashSet::new(),
            chance_of_death: chance(&mut dice, 30),
            chance_of_hanging: chance(&mut dice, 4),
            chance_of_trouble: chance(&mut dice, 6),
            chance_of_misfire: chance(&mut dice, 40),
            chance_of_echo: chance(&mut dice, 30),
            chance_of_slowness: chance(&mut dice, 100),
            chance_of_shortage: if dice.percent(3) { 100 } else { chance(&mut dice, 20) },
            black_hole,
            shortages: 0,
            deaths: Vec::new(),
            interrupt: dice.percent(25),
            interrupted: None,
            cancelled: BTreeSet::new(),
            answers: Vec::new(),
            store_breaks: dice.percent(5),
            history: None,
            outcome: None,
            dice,
        };
        if world.black_hole {
            (world.chance_of_death, world.chance_of_hanging, world.chance_of_shortage) = (100, 0, 0);
        }
        priors.iter().zip(0..).for_each(|(prior, trial)| world.add(prior, trial));
        if world.dice.percent(50) {
            world.command();
        }
        if world.interrupt {
            let first = world.dice.below(30_000);
            world.at(first, Event::Interrupt);
            if world.dice.percent(40) {
                let second = first + world.dice.below(3_000);
                world.at(second, Event::Interrupt);
            }
        }
        if world.store_breaks {
            let at = world.dice.below(30_000);
            world.at(at, Event::StoreBroken);
        }
        world
    }

    /// Adds a trial of the plan.
    fn add(&mut self, prior: &Prior, trial: u32) {
        self.leases.extend((1..=prior.attempts).map(|attempt| Lease { trial, attempt }));
        self.steps.push(0);
        self.results.push(0);
        self.failed.push(None);
    }

    fn length(&self, trial: u32) -> u32 {
        self.bodies[trial as usize].length
    }

    /// Largest number of steps on disk among the trials with the same body.
    fn trained(&self, trial: u32) -> u32 {
        let number = self.bodies[trial as usize].number;
        let mates = self.bodies.iter().zip(&self.steps).filter(|(body, _)| body.number == number);
        mates.map(|(_, steps)| *steps).max().unwrap_or(0)
    }

    /// Schedules random commands; the last one ends any pause. Their trials are drawn when they happen.
    fn command(&mut self) {
        for _ in 0..1 + self.dice.below(12) {
            let when = self.dice.below(30_000);
            let steer = match self.dice.below(20) {
                0..4 => Steer::Pause,
                4..8 => Steer::Resume,
                8..11 => Steer::Cancel(0),
                11..14 => Steer::Next(0),
                14..17 => Steer::Workers(1 + self.dice.below(6) as u32),
                17..19 => Steer::Add(Vec::new()),
                _ => Steer::Stop,
            };
            self.at(when, Event::Steer(steer, ()));
        }
        self.at(30_000, Event::Steer(Steer::Resume, ()));
    }

    /// The command with randomly drawn trials.
    fn drawn(&mut self, steer: Steer) -> Steer {
        let trials = self.bodies.len();
        match steer {
            Steer::Cancel(_) => Steer::Cancel(self.dice.below(trials as u64) as u32),
            Steer::Next(_) => Steer::Next(self.dice.below(trials as u64) as u32),
            Steer::Add(_) => {
                let more = trials..trials + self.dice.below(4) as usize;
                let least = u32::from(self.black_hole);
                let priors: Vec<Prior> =
                    more.map(|_| prior(&mut self.bodies, least, &mut self.dice)).collect();
                priors.iter().zip(trials as u32..).for_each(|(prior, trial)| self.add(prior, trial));
                Steer::Add(priors)
            }
            other => other,
        }
    }

    fn at(&mut self, when: Millis, event: Event<Simulated>) {
        self.scheduled += 1;
        self.queue.insert((when, self.scheduled), event);
    }

    fn soon(&mut self, most: Millis, event: Event<Simulated>) {
        let when = self.now + self.dice.below(most);
        self.at(when, event);
    }

    /// Schedules a message. Messages of a worker keep their order; an echo may come at any time, even after the worker's death.
    fn say(&mut self, when: Millis, event: Event<Simulated>) {
        if self.dice.percent(self.chance_of_echo) {
            let late = when + self.dice.below(30_000);
            self.at(late, event.clone());
        }
        self.at(when, event);
    }

    fn run(&mut self) {
        let mut clock = 0;
        while self.outcome.is_none() {
            assert!(self.now < 100_000_000, "the run does not end");
            // Time passes in ticks, as in the engine.
            let next = self.queue.first_key_value().map_or(Millis::MAX, |(&(when, _), _)| when);
            if next > clock {
                self.now = clock;
                let quiet = next > clock + 5_000 && self.interrupted.is_none();
                clock += if quiet { 1_000 } else { 200 };
                self.event(Event::Clock(self.now));
            } else {
                let ((when, _), event) = self.queue.pop_first().expect("looked at above");
                self.now = self.now.max(when);
                if self.happens(&event) {
                    self.event(event);
                }
            }
        }
        self.check_end();
    }

    /// Whether an event takes place: a dead process does nothing, but messages that it sent before arrive.
    fn happens(&mut self, event: &Event<Simulated>) -> bool {
        match event {
            Event::Lost(worker, _) => {
                let gone = self.processes.insert(*worker, Process::Gone);
                if let Some(lease) = self.working.remove(worker) {
                    self.deaths.push(lease.trial);
                }
                gone.is_some_and(|process| process != Process::Gone)
            }
            // A broken store confirms nothing more.
            Event::Recorded(..) => self.state.stop.stage != Stopping::Broken,
            Event::Up(worker) => {
                let process = self.processes.get_mut(worker).expect("was spawned");
                let comes_up = *process == Process::Starting;
                if comes_up {
                    *process = Process::Up;
                }
                comes_up
            }
            _ => true,
        }
    }

    fn event(&mut self, event: Event<Simulated>) {
        let event = match event {
            Event::Steer(steer, ()) => Event::Steer(self.drawn(steer), ()),
            event => event,
        };
        let command = match &event {
            Event::Steer(steer, ()) => Some(steer.clone()),
            _ => None,
        };
        let answered = self.answers.len();
        if let Some(history) = &mut self.history
            && !matches!(event, Event::Clock(_))
        {
            history.push(format!("{:>8} {event:?}", self.now));
        }
        if let Event::Recorded(lease, RecordKind::Failure) = event
            && let Phase::Failed(reason) = self.state.phase(lease.trial)
        {
            self.failed[lease.trial as usize] = Some(reason);
        }
        if event == Event::Interrupt {
            self.interrupted.get_or_insert(self.now);
        }
        for action in on_event(&mut self.state, event) {
            if let Some(history) = &mut self.history {
                history.push(format!("{:>8}     {action:?}", self.now));
            }
            self.act(action);
        }
        assert_eq!(self.answers.len(), answered + usize::from(command.is_some()), "one answer a command");
        match (command, self.answers.last()) {
            (Some(Steer::Cancel(trial)), Some(SteerAnswer::Cancelled(_))) => {
                self.cancelled.insert(trial);
            }
            (Some(Steer::Stop), Some(SteerAnswer::Stopping(..))) => {
                self.interrupt = true;
                self.interrupted = Some(self.now);
            }
            _ => {}
        }
        self.check();
    }

    fn act(&mut self, action: Action<Simulated>) {
        match action {
            Action::Spawn(worker) => {
                assert!(
                    self.processes.insert(worker, Process::Starting).is_none(),
                    "{worker} is started twice"
                );
                if self.dice.percent(self.chance_of_misfire) {
                    self.soon(500, Event::Lost(worker, Reason::WorkerExited(65)));
                } else {
                    self.soon(500, Event::Up(worker));
                }
            }
            Action::Assign(worker, lease) => self.work(worker, lease),
            Action::RecordStep(lease, (trial, step)) => {
                assert_eq!(lease.trial, trial, "a step of another trial");
                self.deaths.clear();
                let known = &mut self.steps[trial as usize];
                assert!(step <= *known, "trial {trial}: step {step} recorded after {known}");
                *known = (*known).max(step + 1);
                self.soon(50, Event::Recorded(lease, RecordKind::Step));
            }
            Action::RecordCheckpoint(lease, (trial, step)) => {
                assert_eq!(
                    self.steps[trial as usize], step,
                    "trial {trial} is compared before its last step"
                );
                self.soon(50, Event::Recorded(lease, RecordKind::Step));
            }
            Action::RecordResult(lease, (trial, _)) => {
                self.results[trial as usize] += 1;
                self.soon(50, Event::Recorded(lease, RecordKind::Result));
            }
            Action::RecordFailure { lease, reason, settled } => {
                assert!(
                    !(settled && reason == Reason::Shortage),
                    "trial {} is charged for a shortage",
                    lease.trial
                );
                self.shortages += u32::from(reason == Reason::Shortage);
                self.soon(50, Event::Recorded(lease, RecordKind::Failure));
            }
            Action::RecordCancelled(lease) => self.soon(50, Event::Recorded(lease, RecordKind::Failure)),
            Action::Answer((), answer) => self.answers.push(answer),
            Action::AskStop(worker) => {
                if let Some(lease) = self.working.get(&worker).copied()
                    && self.processes[&worker] == Process::Up
                {
                    let slow = self.dice.percent(self.chance_of_slowness);
                    let when = self.now + self.dice.below(if slow { 60_000 } else { 1_000 });
                    self.say(when, Event::Failed(worker, lease, Reason::Stopped));
                }
            }
            // A hung process, too, ends when its input is closed.
            Action::Close(worker) => self.soon(20, Event::Lost(worker, Reason::WorkerExited(0))),
            Action::Kill(worker) => self.soon(20, Event::Lost(worker, Reason::WorkerKilled(9))),
            Action::CountStale(_) => {}
            Action::End(outcome) => self.outcome = Some(outcome),
        }
    }

    /// Schedules the messages of a worker that runs a trial from its last step.
    fn work(&mut self, worker: WorkerId, lease: Lease) {
        assert_eq!(self.processes.get(&worker), Some(&Process::Up), "{worker} gets a trial");
        assert!(self.leases.insert(lease), "{lease:?} is given twice");
        assert!(!self.state.is_paused(), "{lease:?} is given in a pause");
        assert!(!self.cancelled.contains(&lease.trial), "{lease:?} is cancelled");
        assert!(self.state.busy() <= self.state.workers() as usize, "too many workers are busy");
        self.working.insert(worker, lease);
        let (trial, mut when) = (lease.trial, self.now);
        let Body { length, .. } = self.bodies[trial as usize];
        // it resumes from the last step of any trial with the same body
        let begun = self.trained(trial);
        self.steps[trial as usize] = begun;
        for step in begun..length {
            when += 1 + self.dice.below(3_000);
            if self.dice.percent(self.chance_of_death) {
                return self.at(when, Event::Lost(worker, Reason::WorkerKilled(9)));
            }
            if self.dice.percent(self.chance_of_hanging) {
                self.processes.insert(worker, Process::Hung);
                return;
            }
            if self.dice.percent(self.chance_of_trouble) {
                return self.say(
                    when,
                    Event::Failed(
                        worker,
                        lease,
                        Reason::Numerical(metasense_schemas::reason::Cause::Unstable),
                    ),
                );
            }
            if self.dice.percent(self.chance_of_shortage) {
                return self.say(when, Event::Failed(worker, lease, Reason::Shortage));
            }
            self.say(when, Event::Beat(worker, lease));
            self.say(when, Event::Step(worker, lease, step + 1 >= length, (trial, step)));
        }
        for _ in 0..self.dice.below(4) {
            when += 1 + self.dice.below(3_000);
            if self.dice.percent(self.chance_of_death) {
                return self.at(when, Event::Lost(worker, Reason::WorkerKilled(9)));
            }
            self.say(when, Event::Saved(worker, lease, (trial, length)));
        }
        when += self.dice.below(1_000);
        self.say(when, Event::Finished(worker, lease, (trial, 0)));
        if self.dice.percent(self.chance_of_death) {
            // The worker dies after its last message.
            self.at(when, Event::Lost(worker, Reason::WorkerKilled(11)));
        }
    }

    /// Checks invariants after every event.
    fn check(&mut self) {
        let (mut held, mut training) = (BTreeSet::new(), BTreeSet::new());
        for slot in &self.state.slots {
            let lease = match slot.work {
                SlotState::Busy { lease, .. } => Some(lease),
                SlotState::Ending { lease, .. } => lease,
                _ => None,
            };
            if let Some(lease) = lease {
                let (trial, Body { number, length, .. }) = (lease.trial, self.bodies[lease.trial as usize]);
                assert!(held.insert(trial), "trial {trial} is with two workers");
                if self.trained(trial) < length {
                    assert!(training.insert(number), "body {number} is trained by two workers");
                }
            }
        }
        for (trial, number) in self.state.trials.iter().zip(0u32..) {
            let waits = self.state.queues.ready.iter().any(|&(_, t)| t == number)
                || self.state.queues.delayed.iter().any(|&(_, t)| t == number);
            match trial.phase {
                Phase::Pending => assert!(waits && !held.contains(&number), "trial {number} is lost"),
                Phase::Running(_) => assert!(!waits && held.contains(&number), "trial {number} is lost"),
                _ => assert!(!waits && !held.contains(&number), "trial {number} is settled and goes on"),
            }
            assert!(self.results[number as usize] <= 1, "trial {number} is done twice");
        }
    }

    /// Checks invariants at the end of a run.
    fn check_end(&mut self) {
        let outcome = self.outcome.expect("the run has ended");
        let dead: HashSet<u32> = self.deaths.iter().copied().collect();
        if let RunOutcome::Unfit(reason) = outcome {
            let enough = match reason {
                Reason::Shortage => self.shortages > self.state.settings.retries,
                _ => self.deaths.len() >= UNFIT_DEATHS as usize && dead.len() >= UNFIT_TRIALS,
            };
            assert!(enough, "unfit after {} shortages and the deaths of {:?}", self.shortages, self.deaths);
            assert!(self.state.waiting() > 0, "nothing is left to be done elsewhere");
        }
        if self.black_hole {
            let most = UNFIT_DEATHS as usize + 2 * 6; // two trials die six times each before others are assigned
            assert!(self.deaths.len() <= most, "{} attempts were burned", self.deaths.len());
        }
        assert!(self.interrupt || outcome != RunOutcome::Interrupted, "nobody has interrupted");
        assert!(self.store_breaks || outcome != RunOutcome::StoreBroken, "the store was in order");
        let alive = self.processes.values().filter(|process| **process != Process::Gone).count();
        assert_eq!(alive, 0, "processes are left behind");
        let waited = self.now - self.interrupted.unwrap_or(self.now);
        let most = self.state.settings.grace + 1_000;
        assert!(waited <= most, "the run ended {waited} ms after it was asked to, of {most} at most");
        if outcome != RunOutcome::Complete {
            return;
        }
        for trial in 0..self.bodies.len() {
            match self.state.phase(trial as u32) {
                Phase::Done => {
                    assert_eq!(self.results[trial], 1, "trial {trial} has one result");
                    assert_eq!(
                        self.steps[trial],
                        self.length(trial as u32),
                        "trial {trial} has all its steps"
                    );
                }
                Phase::Failed(reason) => {
                    let cancelled = self.cancelled.contains(&(trial as u32));
                    assert!(cancelled || reason != Reason::Cancelled, "nobody has cancelled trial {trial}");
                    assert_eq!(self.results[trial], 0, "trial {trial} has failed");
                    assert_eq!(self.failed[trial], Some(reason), "the failure of trial {trial} is on disk");
                }
                phase => panic!("trial {trial} is {phase:?} at the end"),
            }
        }
    }
}

/// A further trial, with a new body or that of another trial.
fn prior(bodies: &mut Vec<Body>, least: u32, dice: &mut Dice) -> Prior {
    let trial = bodies.len() as u32;
    let body = if trial > 0 && dice.percent(40) {
        bodies[dice.below(trial.into()) as usize]
    } else {
        Body { number: trial, length: dice.below(8) as u32 + least }
    };
    bodies.push(body);
    Prior {
        attempts: dice.below(3) as u32,
        steps: dice.percent(20).then_some(0),
        body: body.number,
        trained: body.length == 0,
    }
}

/// Runs 4000 random worlds. To repeat one, set `METASENSE_SEED` to its seed.
#[test]
fn no_trial_is_lost_or_done_twice_and_every_run_ends_in_4000_random_worlds() {
    let seeds = match std::env::var("METASENSE_SEED").ok().and_then(|seed| seed.parse().ok()) {
        Some(seed) => seed..seed + 1_u64,
        None => 0..4000,
    };
    let run = |world: &mut World| std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| world.run()));
    let mut outcomes: BTreeMap<String, usize> = BTreeMap::new();
    let mut answers = BTreeMap::<String, usize>::new();
    for seed in seeds.clone() {
        let mut world = World::new(seed);
        if run(&mut world).is_err() {
            let mut again = World::new(seed);
            again.history = Some(Vec::new());
            let _ = run(&mut again);
            panic!("seed {seed} fails; its history:\n{}", again.history.unwrap().join("\n"));
        }
        for answer in &world.answers {
            let what = format!("{answer:?}").split(['(', '[']).next().unwrap_or_default().to_owned();
            *answers.entry(what).or_default() += 1;
        }
        let outcome = format!("{:?}", world.outcome.expect("the run has ended"));
        *outcomes.entry(outcome.split('(').next().unwrap_or_default().to_owned()).or_default() += 1;
    }
    if seeds.end - seeds.start > 1 {
        assert!(answers.len() == 8 && answers.values().all(|count| *count > 120), "{answers:?}");
        for outcome in ["Complete", "Interrupted", "StoreBroken", "NoWorkers", "Unfit"] {
            let count = outcomes.get(outcome).copied().unwrap_or(0);
            assert!(count > 8, "{outcome} was met in {count} worlds only: {outcomes:?}");
        }
    }
}
