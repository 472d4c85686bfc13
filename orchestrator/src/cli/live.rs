//! Progress of `run`: a bar with the remaining time on a terminal, plain lines elsewhere.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use metasense_schemas::reason::Reason;
use metasense_schemas::record::{BodyRecord, NetworkRecord, TrialResult};
use tokio::sync::Notify;

use super::point::point_in_words;
use super::{duration, is_live};
use crate::analysis::numbers::{most_above, network_mean};
use crate::control::Command;
use crate::engine::{View, Watch};
use crate::exit::remedy;
use crate::files::host;
use crate::look::short_hash;
use crate::plan::{PlannedTrial, counted};
use crate::provenance;
use crate::scheduler::{RunOutcome, UNFIT_DEATHS};

/// Number of positions of the bar.
const BAR: u64 = 10_000;
/// Time between two plain lines of progress.
const LINE_EVERY: Duration = Duration::from_secs(30);
/// Maximum number of characters of a failure message.
const MOST_TEXT: usize = 500;

/// Prints the progress of a run on standard error.
#[derive(Debug)]
pub struct Live<'a> {
    /// The bar, on a terminal.
    bar: Option<ProgressBar>,
    said: Instant,
    /// Message of the last failed attempt.
    failed: String,
    /// Notified when the user asks for the end of the run.
    stop_notify: &'a Notify,
    /// The keys that the sweep varies.
    axes: BTreeSet<&'a str>,
}

impl<'a> Live<'a> {
    /// For a run of `open` trials, besides `settled` ones.
    pub fn new(
        open: usize,
        settled: usize,
        workers: u32,
        asked: &'a Notify,
        axes: BTreeSet<&'a str>,
    ) -> Self {
        let bar = is_live(&std::io::stderr()).then(|| {
            let style =
                ProgressStyle::with_template("{bar:30} {percent:>3} %  {msg}").expect("the template is one");
            ProgressBar::with_draw_target(Some(BAR), ProgressDrawTarget::stderr_with_hz(5)).with_style(style)
        });
        let (said, failed) = (Instant::now(), String::new());
        let live = Self { bar, said, failed, stop_notify: asked, axes };
        let before = if settled > 0 { format!(", {settled} settled before") } else { String::new() };
        let (open, workers) = (counted(open, "trial"), counted(workers as usize, "worker"));
        live.say(&format!("{open} to run on {workers}{before}"));
        live
    }

    fn trial_label(&self, trial: &PlannedTrial) -> String {
        let spec = serde_json::to_value(&trial.spec).expect("a trial is JSON");
        let (point, units) = (point_in_words(&spec, &self.axes), counted(trial.units, "unit"));
        format!("{point}, {units} ({})", short_hash(&trial.hash))
    }

    fn say(&self, line: &str) {
        match &self.bar {
            Some(bar) => bar.println(line),
            None => say!("{line}"),
        }
    }
}

impl Watch for Live<'_> {
    fn done(&mut self, trial: &PlannedTrial, result: &TrialResult) {
        let before = match trial.spec.evaluation.initial {
            Some(false) => String::new(),
            _ => percent(&result.initial) + " -> ",
        };
        let (label, after) = (self.trial_label(trial), percent(&result.optimised));
        self.say(&format!("done: {label}: held-out error {before}{after}"));
        if let Some(caveat) = provenance::unresolved(&result.solver) {
            self.say(&format!("warning: {label}: {caveat}"));
        }
    }

    fn attempt_failed(
        &mut self,
        trial: &PlannedTrial,
        attempt: u32,
        reason: Reason,
        settled: bool,
        text: &str,
    ) {
        if reason == Reason::Cancelled {
            return self.say(&format!("cancelled: {}", self.trial_label(trial)));
        }
        let then = match settled {
            true => format!("not retried; {}", remedy(reason)),
            false => "retrying".into(),
        };
        self.failed = text.chars().take(MOST_TEXT).collect();
        self.say(&format!("attempt {attempt} failed: {}: {}; {then}", self.trial_label(trial), self.failed));
    }

    fn begins_anew(&mut self, trial: &PlannedTrial, why: &str) {
        let label = self.trial_label(trial);
        self.say(&format!("restarting, because the checkpoint cannot be used: {label}: {why}"));
    }

    fn warned(&mut self, text: &str) {
        self.say(text);
    }

    fn interrupted(&mut self, again: bool, grace: Duration) {
        self.stop_notify.notify_one();
        self.say(&match again {
            false => format!(
                "stopping: steps that end within {} s are recorded; the next run repeats the others (Ctrl-C again stops at \
                 once)",
                grace.as_secs_f64()
            ),
            true => "stopping at once".to_owned(),
        });
    }

    fn steered(&mut self, command: &Command, done: bool, said: &str) {
        if done && *command == Command::Stop {
            self.stop_notify.notify_one();
        }
        let refused = if done { "" } else { "refused: " };
        self.say(&format!("control: {command}: {refused}{said}"));
    }

    fn tick(&mut self, view: &View) {
        let (part, eta) = (view.fraction(), view.eta().filter(|_| !view.paused));
        let to_go = eta.map_or("ETA unknown yet".into(), |t| format!("ETA {}", duration(t.as_secs_f64())));
        let paused = if view.paused { "paused, " } else { "" };
        let (settled, busy, trials) = (view.settled(), view.busy, counted(view.total, "trial"));
        let workers = counted(view.workers as usize, "worker");
        let steps = counted(view.steps as usize, "step");
        let message = format!("{paused}{settled} of {trials}, {busy} of {workers} busy, {steps}, {to_go}");
        match &self.bar {
            Some(bar) => {
                bar.set_position((part * BAR as f64) as u64);
                bar.set_message(message);
            }
            None if self.said.elapsed() >= LINE_EVERY => {
                self.said = Instant::now();
                say!("{:3.0} %: {message}", 100.0 * part);
            }
            None => {}
        }
    }

    fn end(&mut self, view: &View, outcome: RunOutcome) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
        if outcome == RunOutcome::Interrupted {
            let open = view.total - view.settled();
            say!("stopped with {} open; the same command resumes them", counted(open, "trial"));
        }
        if let RunOutcome::Unfit(reason) = outcome {
            let open = counted(view.total - view.settled(), "trial");
            let remedy = match reason {
                Reason::OutOfMemory => "use fewer workers or threads, or a machine with more memory",
                reason => remedy(reason),
            };
            let why = match reason.is_shortage() {
                true => format!("no trial makes progress there: {}", self.failed),
                false => format!(
                    "{UNFIT_DEATHS} attempts in a row died there without a step, the last of {reason}"
                ),
            };
            say!(
                "{} is unfit: {why}; {remedy}. {open} still open; the same command resumes them, here or elsewhere",
                host()
            );
        }
    }
}

/// Mean held-out error, with the median over samples and the number of samples above 100 %, if any; or why it is unknown.
fn percent(body: &BodyRecord) -> String {
    let percent = |value: f64| format!("{value:.2} %");
    let mean = |of: fn(&NetworkRecord) -> Option<f64>| network_mean(&body.networks, of).map(percent);
    let above = most_above(&body.networks).filter(|above| *above > 0);
    let above = above.map_or(String::new(), |n| format!(", {} above 100 %", counted(n as usize, "sample")));
    let median = mean(|network| network.spread?.median);
    let median = median.map_or(String::new(), |median| format!(" (median {median}{above})"));
    let unknown = || match body.networks.first().map(|network| network.outcome.as_str()) {
        None | Some("ok") => "unknown (no held-out sample has a force)".to_owned(),
        Some(cause) => format!("unknown ({cause})"),
    };
    mean(|network| network.error_holdout).unwrap_or_else(unknown) + &median
}

#[cfg(test)]
mod tests;
