//! Handles commands to a run: passes them to the scheduler as events and returns its answers.

use std::borrow::Cow;
use std::collections::HashSet;
use std::sync::Arc;

use super::writer::{Entry, NewTrials};
use super::{Engine, begin};
use crate::control::{Command, Reply, Request, in_words};
use crate::hashes::position_of;
use crate::plan::{Plan, PlannedTrial};
use crate::scheduler::{Event, Steer, SteerAnswer};

/// A request that waits for the scheduler's answer, and text to append to the answer.
#[derive(Debug)]
pub(super) struct PendingRequest {
    request: Request,
    note: String,
}

/// The result of a reload, with its request.
pub(super) type ReloadResult = (Result<Plan, String>, Request);

impl Engine<'_> {
    /// Handles a command.
    pub(super) fn handle_command(&mut self, request: Request, events: &mut super::Events) {
        if request.answer.is_closed() {
            return;
        }
        let steer = match &request.command {
            Command::State => return self.answer(request, true, in_words(&self.state, &self.view)),
            Command::Pause => Steer::Pause,
            Command::Resume => Steer::Resume,
            Command::Stop => Steer::Stop,
            Command::Workers { count } => Steer::Workers(*count),
            Command::Cancel { hash } | Command::Next { hash } => {
                match position_of(hash, self.agenda.trials.iter().map(|trial| trial.hash.as_str())) {
                    Ok(at) if matches!(request.command, Command::Next { .. }) => Steer::Next(at as u32),
                    Ok(at) => Steer::Cancel(at as u32),
                    Err(why) => return self.answer(request, false, why.to_string()),
                }
            }
            Command::Reload => {
                let (reread, read) = (Arc::clone(&self.control.reread), self.rereads.clone());
                // Reading 10⁵ trials takes seconds. If the receiver is gone, the run has ended, and the client gets that
                // answer.
                drop(tokio::task::spawn_blocking(move || drop(read.send((reread(), request)))));
                return;
            }
        };
        events.push_back(Event::Steer(steer, PendingRequest { request, note: String::new() }));
    }

    /// Sends a reloaded plan to the writer, which records new trials.
    pub(super) async fn read(&mut self, (plan, request): ReloadResult) {
        match plan {
            Err(why) => self.answer(request, false, why),
            Ok(plan) => self.enqueue(Entry::Plan(Arc::new(plan), request)).await,
        }
    }

    /// Adds the recorded new trials to the run.
    pub(super) fn planned(&mut self, fresh: NewTrials, request: Request, events: &mut super::Events) {
        let mut asker = PendingRequest { request, note: String::new() };
        let own: HashSet<&str> = fresh.plan.trials.iter().map(|trial| trial.hash.as_str()).collect();
        let vanished = self.agenda.trials.iter().filter(|trial| !own.contains(trial.hash.as_str())).count();
        if fresh.settled > 0 {
            asker.note += &format!("; finished before: {}", fresh.settled);
        }
        if vanished > 0 {
            asker.note += &format!("; no longer in the spec, but still run: {vanished}");
        }
        let mut priors = Vec::new();
        for (place, known) in fresh.trials {
            let trial: &PlannedTrial = &fresh.plan.trials[place];
            let prior = self.agenda.bodies.prior(trial, known, fresh.bodies.get(&trial.training));
            priors.push(prior);
            begin::show(&mut self.view, trial, &prior);
            self.agenda.trials.push(Cow::Owned(trial.clone()));
        }
        self.control.plans.borrow_mut().push(fresh.plan);
        self.agenda.priors.extend(&priors);
        events.push_back(Event::Steer(Steer::Add(priors), asker));
    }

    /// Sends the scheduler's answer to the client.
    pub(super) fn answered(&mut self, asker: PendingRequest, answer: SteerAnswer) {
        (self.view.workers, self.view.paused) = (self.state.workers(), self.state.is_paused());
        self.view.forecast.set_workers(self.view.workers);
        let text = format!("{answer}{}", asker.note);
        self.answer(asker.request, !matches!(answer, SteerAnswer::Refused(_)), text);
    }

    fn answer(&mut self, Request { command, answer }: Request, done: bool, text: String) {
        if command != Command::State {
            tracing::info!(%command, done, answer = text, "command to the run");
            self.watch.steered(&command, done, &text);
        }
        // The client may have disconnected.
        let _ = answer.send(Reply { done, text });
    }
}
