//! Resolves the decoders of a trial, and removes keys that they do not use, so that equal trials have equal hashes.

use metasense_schemas::spec::{
    Brain, BrainKind, Evaluation, Feasible, Objective, Optimise, Protocol, Ridge, SweepSpec, Variation,
};
use metasense_source::{Source, SpecError};
use metasense_worker::problem::lags;

/// Kind of the decoder of the bodies, and of the decoder that trains them. Stacked and inverse decoders do not train; linear
/// ones replace them.
fn kinds(spec: &SweepSpec) -> [BrainKind; 2] {
    let own = match spec.brain.kind {
        BrainKind::Stacked | BrainKind::Inverse => BrainKind::Linear,
        kind => kind,
    };
    [spec.brain.kind, spec.optimise.brain.unwrap_or(own)]
}

fn has_network(kind: BrainKind) -> bool {
    matches!(kind, BrainKind::Cnn | BrainKind::Stacked)
}

fn has_linear(kind: BrainKind) -> bool {
    kind != BrainKind::Cnn
}

/// Whether a linear decoder estimates forces in the trial or its training.
fn estimates_forces_linearly(spec: &SweepSpec) -> bool {
    spec.brain.task.is_forces() && kinds(spec).into_iter().any(has_linear)
}

/// Whether readouts of sensing tasks are fitted in the trial or its training.
fn has_readouts(spec: &SweepSpec) -> bool {
    !spec.brain.task.is_forces() || spec.evaluation.tasks == Some(true)
}

/// Whether a causal network uses a linear decoder's estimates, which then must not look ahead either.
fn looks_back_alone(spec: &SweepSpec) -> bool {
    spec.brain.kind == BrainKind::Stacked && spec.brain.network().causal
}

/// Decoder, training, evaluation and deviations of a combination, with defaults, without keys that its decoders do not use.
pub(super) fn resolved(spec: &SweepSpec) -> (Brain, Optimise, Evaluation, Option<Variation>) {
    let ([reader, trainer], none) = (kinds(spec), Brain::default());
    let variation = spec.variation.and_then(Variation::resolved);
    let (mut brain, mut optimise, mut evaluation) = (
        spec.brain.clone().resolved(),
        spec.optimise.clone(),
        spec.evaluation.clone().resolved(variation.is_some(), &spec.stimuli),
    );
    // without training there is only one body
    evaluation.initial = evaluation.initial.filter(|compared| !compared && spec.optimise.steps() > 0);
    if !has_network(reader) && !has_network(trainer) {
        let Brain { kind, task, window, memory, ridge, .. } = brain;
        brain = Brain { kind, task, window, memory, ridge, ..none };
    }
    if !has_network(reader) {
        evaluation = evaluation.of_linear();
    }
    // a batch of all samples is no batch; with casts, a network has more samples
    let training_samples = spec.stimuli.samples.saturating_sub(spec.stimuli.test);
    evaluation.batch =
        evaluation.batch.filter(|batch| *batch < training_samples || evaluation.casts.is_some());
    // an inverse decoder calibrates a twin on the records
    let spared = evaluation.casts.is_some() && reader != BrainKind::Inverse;
    evaluation.records = evaluation.records.filter(|read| !read && spared);
    if !estimates_forces_linearly(spec) {
        (brain.memory, brain.ridge) = (None, None);
    }
    brain.window = brain.window.filter(|_| has_readouts(spec));
    if looks_back_alone(spec) {
        brain.memory.get_or_insert([spec.time.duration, 0.0]);
    }
    // one canonical form of equivalent settings
    brain.ridge = brain.ridge.filter(|ridge| matches!(ridge, Ridge::Given(_)));
    let whole = |memory: &[f64; 2]| lags(&spec.time, Some(*memory)) == lags(&spec.time, None);
    brain.memory =
        brain.memory.filter(|memory| memory.iter().any(|s| *s > spec.time.duration) || !whole(memory));
    // set only if it is not the paper's network
    optimise.brain = (trainer == BrainKind::Linear).then_some(trainer);
    if trainer == BrainKind::Linear {
        (optimise.brain_iterations, optimise.brain_learning_rate) = (None, None);
    }
    optimise.tie = optimise.tie.filter(|tie| *tie != [1, 1]);
    optimise.frozen = optimise.frozen.filter(|units| !units.is_empty()).map(|mut units| {
        units.sort_unstable();
        units
    });
    // without deviations, an objective runs over the parts of a mixture; by default, the parts share the batch of a single body
    if let (Some(_), None, Some(parts)) = (optimise.objective, variation, &spec.stimuli.mix) {
        optimise.casts.get_or_insert(parts.len());
        optimise.batch.get_or_insert(Optimise::BATCH.div_ceil(parts.len().max(1)));
    }
    if !brain.task.is_forces() && optimise.protocol == Protocol::Joint {
        optimise.batch.get_or_insert(Optimise::TASK_BATCH);
    }
    let optimise = optimise.resolved();
    let (optimise, robust) = match optimise.objective {
        Some(_) => (optimise, true),
        None => (Optimise { casts: None, ..optimise }, false),
    };
    // deviations matter only if an objective or the evaluation uses casts
    let variation = variation.filter(|_| robust || evaluation.casts.is_some());
    (brain, optimise, evaluation, variation)
}

/// Messages about keys that have no effect.
const NO_CNN: &str = "has no effect: no trial has brain.kind = \"cnn\"";
const NO_TRAINER: &str = "has no effect: no trial has optimise.brain = \"cnn\"";
const NO_LINEAR: &str = "has no effect: no trial has brain.kind = \"linear\" and brain.task = \"forces\"";
const NO_READOUTS: &str =
    "has no effect: no trial has evaluation.tasks = true or a brain.task other than \"forces\"";
const NO_OBJECTIVE: &str = "has no effect: no trial has an optimise.objective over casts";
const NO_VARIATION: &str = "has no effect: no trial has a [variation]";
const NO_CALIBRATION: &str = "has no effect: no trial has a [variation] and a decoder other than inverse";

/// Whether a spec sets a key.
type KeyPredicate<'a> = &'a dyn Fn(&SweepSpec) -> bool;

/// Rejects keys that no decoder of the sweep uses. The error names the first such key.
pub(super) fn refuse_unread<'a>(
    specs: impl Iterator<Item = &'a SweepSpec> + Clone,
    source: &Source,
) -> Result<(), SpecError> {
    let default_brain = Brain::default();
    let any_spec = |what: &dyn Fn(&SweepSpec) -> bool| specs.clone().any(what);
    if any_spec(&|spec| matches!(spec.optimise.brain, Some(BrainKind::Stacked | BrainKind::Inverse))) {
        let remedy = "stacked and inverse decoders cannot train bodies: must be \"cnn\" or \"linear\"";
        return Err(source.error("optimise.brain", remedy));
    }
    let ahead = |spec: &SweepSpec| spec.brain.memory.is_some_and(|[_, after]| after > 0.0);
    if any_spec(&|spec| looks_back_alone(spec) && ahead(spec)) {
        let remedy = "a causal network uses the estimates of this decoder: must be [before, 0]";
        return Err(source.error("brain.memory", remedy));
    }
    let robust = any_spec(&|spec| spec.optimise.objective.and_then(Objective::tail).is_some());
    let varied = any_spec(&|spec| spec.variation.is_some());
    let calibrates = varied && any_spec(&|spec| spec.brain.kind != BrainKind::Inverse);
    let linear = any_spec(&estimates_forces_linearly);
    let network = any_spec(&|spec| kinds(spec).into_iter().any(has_network));
    let read_by_network = any_spec(&|spec| has_network(spec.brain.kind));
    let trained_by_network = any_spec(&|spec| has_network(kinds(spec)[1]));
    let evaluation = Evaluation::default();
    let deviates = any_spec(&|spec| spec.variation.and_then(Variation::resolved).is_some());
    let keys: [(&str, bool, KeyPredicate, &str); 21] = [
        ("optimise.casts", robust, &|s| s.optimise.casts.is_some(), NO_OBJECTIVE),
        ("evaluation.casts", varied, &|s| s.evaluation.casts.is_some(), NO_VARIATION),
        ("evaluation.records", calibrates, &|s| s.evaluation.records.is_some(), NO_CALIBRATION),
        ("variation", deviates, &|s| s.variation.is_some(), "must contain at least one deviation"),
        ("brain.preset", network, &|s| s.brain.preset.is_some(), NO_CNN),
        ("brain.width", network, &|s| s.brain.width.is_some(), NO_CNN),
        ("brain.kernels", network, &|s| s.brain.kernels.is_some(), NO_CNN),
        ("brain.dilations", network, &|s| s.brain.dilations.is_some(), NO_CNN),
        ("brain.causal", network, &|s| s.brain.causal.is_some(), NO_CNN),
        ("brain.window", any_spec(&has_readouts), &|s| s.brain.window.is_some(), NO_READOUTS),
        ("brain.memory", linear, &|s| s.brain.memory.is_some(), NO_LINEAR),
        ("brain.ridge", linear, &|s| s.brain.ridge.is_some(), NO_LINEAR),
        ("brain.scaling", network, &|s| s.brain.scaling != default_brain.scaling, NO_CNN),
        ("brain.iterations", network, &|s| s.brain.iterations != default_brain.iterations, NO_CNN),
        ("brain.learning_rate", network, &|s| s.brain.learning_rate != default_brain.learning_rate, NO_CNN),
        ("evaluation.seeds", read_by_network, &|s| s.evaluation.seeds.is_some(), NO_CNN),
        ("evaluation.schedule", read_by_network, &|s| s.evaluation.schedule != evaluation.schedule, NO_CNN),
        ("evaluation.batch", read_by_network, &|s| s.evaluation.batch.is_some(), NO_CNN),
        ("evaluation.long_iterations", read_by_network, &|s| s.evaluation.long_iterations.is_some(), NO_CNN),
        (
            "optimise.brain_iterations",
            trained_by_network,
            &|s| s.optimise.brain_iterations.is_some(),
            NO_TRAINER,
        ),
        (
            "optimise.brain_learning_rate",
            trained_by_network,
            &|s| s.optimise.brain_learning_rate.is_some(),
            NO_TRAINER,
        ),
    ];
    if let Some((key, _, _, remedy)) = keys.iter().find(|(_, read, given, _)| !read && any_spec(*given)) {
        return Err(source.error(key, remedy));
    }
    let unlimited = Feasible { limits: false, ..Feasible::default() };
    let unread = |spec: &SweepSpec| !spec.feasible.limits && spec.feasible != unlimited;
    match any_spec(&unread) && !any_spec(&|spec| spec.feasible.limits) {
        true => Err(source.error("feasible", "other limits have no effect: no trial has limits = true")),
        false => Ok(()),
    }
}
