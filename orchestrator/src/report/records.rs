//! Comparison of bodies on records: sentences, table, figures and page.

use maud::html;
use metasense_lab::evaluate::Evaluated;
use metasense_lab::inverse::Posterior;
use metasense_schemas::spec::{Channel, TrialSpec};

use super::casts::CLASSES;
use super::strips::{Curve, Errors, RESIDUAL, Strip, dots, histories, representative, strips};
use crate::analysis::Interval;
use crate::analysis::numbers::mean;
use crate::analysis::records::{Agreement, BodyErrors, InverseResults, SignalSource, mean_ratio, table};
use crate::analysis::trial::CurvePoint;
use crate::look::{Answer, Axis, Figure, Legend, Plot, Scale, Table, answers, legend, number, page, row};

/// A body's records, and the predictions of decoders from them.
#[derive(Debug, Clone)]
pub struct BodyRecords {
    /// Its name.
    pub name: String,
    /// Origin of the records: measured, or the trial's held-out set.
    pub by: SignalSource,
    /// Signals of the records (N, T, 3M) (mm/s², rad/s).
    pub signals: Vec<f64>,
    /// Evaluation of these signals.
    pub measured: Evaluated,
    /// If the design is known: the model's signals and their evaluation.
    pub simulated: Option<(Vec<f64>, Evaluated)>,
    /// If there is a twin: its signals, and the evaluation of the records by networks trained on it or by its inverse decoder.
    pub twin: Option<(Vec<f64>, Evaluated)>,
}

/// Bodies with the same clock, panels and sensors.
#[derive(Debug, Clone)]
pub struct ComparableBodies {
    /// The bodies; ratios are relative to the first.
    pub bodies: Vec<BodyRecords>,
    /// Whether all were recorded under the same forces.
    pub paired: bool,
    /// K, T, number of channels.
    pub shape: [usize; 3],
    /// Names of the channels.
    pub channels: Vec<String>,
    /// Length of a record (s).
    pub duration: f64,
    /// One entry per body and kind of signals, those of measured signals first.
    pub judged: Vec<BodyErrors>,
}

fn class(body: usize) -> &'static str {
    CLASSES[body.min(CLASSES.len() - 1)]
}

/// A body's errors with networks that were not trained on the records.
fn judged(body: &str, by: SignalSource, evaluated: &Evaluated, agreement: Option<Agreement>) -> BodyErrors {
    let Evaluated { folds, errors: by_seed, errors_train, progress, targets, posterior, .. } = evaluated;
    let of_record = |i: usize| -> Option<f64> {
        let errors: Option<Vec<f64>> = by_seed.iter().map(|errors| errors[i]).collect();
        mean(&errors?)
    };
    let errors: Vec<Option<f64>> = (0..folds.len()).map(of_record).collect();
    let count = folds.iter().max().map_or(0, |last| last + 1);
    let of_fold = |fold: usize| -> Vec<f64> {
        folds.iter().zip(&errors).filter(|(f, _)| **f == fold).filter_map(|(_, e)| *e).collect()
    };
    let sizes: Vec<_> = (0..count).map(|fold| folds.iter().filter(|f| **f == fold).count() as f64).collect();
    let networks = || progress.iter().flat_map(|networks| networks.iter().zip(&sizes));
    let milestones = networks().map(|(curve, _)| curve.len()).min().unwrap_or(0);
    let at = |i: usize| -> CurvePoint {
        let sum = networks().fold([0.0; 2], |[e, w], (curve, size)| [e + size * curve[i].1, w + size]);
        (progress[0][0][i].0, sum[0] / sum[1])
    };
    let known = |errors: &Vec<Option<f64>>| errors.iter().flatten().copied().collect::<Vec<f64>>();
    BodyErrors {
        body: body.to_owned(),
        by,
        error_train: mean(&errors_train.iter().flat_map(known).collect::<Vec<f64>>()),
        by_seed: by_seed.iter().filter_map(|errors| mean(&known(errors))).collect(),
        by_fold: (0..count).filter_map(|fold| mean(&of_fold(fold))).collect(),
        progress: (0..milestones).map(at).collect(),
        errors,
        agreement,
        posterior: posterior.as_ref().map(|posterior| InverseResults {
            coverage: 100.0 * posterior.coverage(targets),
            unconverged: posterior.unconverged,
            unexplained: posterior.unexplained,
            seconds: posterior.seconds / folds.len() as f64,
        }),
    }
}

impl ComparableBodies {
    /// Evaluates each body by its signals, and by those of its model and twin.
    pub fn new(bodies: Vec<BodyRecords>, paired: bool, trial: &TrialSpec) -> Self {
        let (instants, channels) = (trial.time.samples, trial.signals());
        let shape = [trial.panel_units.len(), instants, channels];
        let name = |m: usize, read: &Channel| format!("{}{m}", ["ax", "ay", "ω"][*read as usize]);
        let of_sensor = |m| trial.sensors.read().iter().map(move |read| name(m, read));
        let measured = bodies.iter().map(|body| judged(&body.name, body.by, &body.measured, None));
        let modelled = |body: &BodyRecords, by: SignalSource, model: &Option<(Vec<f64>, Evaluated)>| {
            let (signals, evaluated) = model.as_ref()?;
            let agreement = Agreement::of(&body.signals, signals, [instants, channels]);
            Some(judged(&body.name, by, evaluated, Some(agreement)))
        };
        let simulated =
            bodies.iter().filter_map(|body| modelled(body, SignalSource::Simulated, &body.simulated));
        let twins = bodies.iter().filter_map(|body| modelled(body, SignalSource::Twin, &body.twin));
        let judged = measured.chain(simulated).chain(twins).collect();
        let channels = (0..trial.point.sensors).flat_map(of_sensor).collect();
        Self { bodies, paired, shape, channels, duration: trial.time.duration, judged }
    }

    /// The comparison as a table.
    pub fn table(&self) -> Table {
        table(&self.judged, self.paired, self.duration / self.shape[1] as f64)
    }

    fn of(&self, body: &BodyRecords, by: SignalSource) -> Option<&BodyErrors> {
        self.judged.iter().find(|j| j.body == body.name && j.by == by)
    }

    /// Sentences about the comparison.
    pub fn answers(&self) -> Vec<Answer> {
        let mut said = Vec::new();
        for body in self.bodies.iter().skip(1) {
            let ratio = |by| mean_ratio(self.of(&self.bodies[0], by)?, self.of(body, by)?, self.paired);
            let Some(found) = ratio(body.by) else { continue };
            let verdict = found.interval.and_then(Interval::is_above_one);
            let interval = found.interval.map_or(String::new(), |i| {
                format!(" (95 % over records: {} to {})", number(i.low), number(i.high))
            });
            let promised = ratio(SignalSource::Simulated)
                .map_or(String::new(), |r| format!("; {} times with simulated signals", number(r.ratio)));
            let (first, name, ratio) = (&self.bodies[0].name, &body.name, number(found.ratio));
            let set = if body.by == SignalSource::Holdout { "the held-out set" } else { "unseen records" };
            let than = format!("{ratio} times that of the {name} body{interval}{promised}");
            let text = format!("On {set} the error of the {first} body is {than}.");
            said.push(Answer::new("", verdict, text));
        }
        for (body, judged) in self.bodies.iter().zip(&self.judged) {
            let shown = |error: Option<f64>| error.map_or("–".to_owned(), number);
            let held = |said: InverseResults| {
                let (n, left, held) = (judged.errors.len(), said.unconverged, number(said.coverage));
                format!(", {held} % of the true forces in its 95 % bands, {left} of {n} not converged")
            };
            let (name, error, n) = (&body.name, shown(judged.error()), judged.errors.len());
            let mut text = match judged.posterior {
                Some(said) => {
                    let held = held(said);
                    format!("The {name} body: error {error} % on {n} records with its model inverted{held}")
                }
                None => format!(
                    "The {name} body: error {error} % on {n} records not used to train its network, {} % on its training \
                     records",
                    shown(judged.error_train)
                ),
            };
            if let Some(promised) = self.of(body, SignalSource::Simulated) {
                text += &format!("; {} % with signals simulated by the model", shown(promised.error()));
            }
            if let Some(taught) = self.of(body, SignalSource::Twin) {
                let (error, whose) = (shown(taught.error()), taught.posterior);
                text += &match whose {
                    Some(said) => format!("; {error} % with its twin{}", held(said)),
                    None => format!("; {error} % with networks trained on its twin"),
                };
            }
            said.push(Answer::new("", None, text + "."));
        }
        said
    }

    /// Errors of every record; one row per body and record.
    pub fn records(&self) -> Table {
        let columns = "body record fold error error_simulated";
        let mut rows = Vec::new();
        for (body, measured) in self.bodies.iter().zip(&self.judged) {
            let promised = self.of(body, SignalSource::Simulated);
            rows.extend(measured.errors.iter().enumerate().map(|(i, error)| {
                let simulated = promised.and_then(|promised| promised.errors[i]);
                row![body.name, i, body.measured.folds[i], error, simulated]
            }));
        }
        Table::new(columns, rows)
    }

    /// Figures of forces, errors, progress of networks, and signals.
    pub fn figures(&self) -> Vec<Figure> {
        let mut figures = vec![self.forces(), self.errors()];
        figures.extend(self.progress().into_iter().chain(self.signals()));
        figures
    }

    /// The page.
    pub fn html(&self, figures: &[Figure]) -> String {
        let content = html! {
            (answers(&self.answers()))
            @for figure in figures { (figure.html(&[])) }
            h2 { "Table" }
            (self.table().html(Some("table")))
        };
        let question = match self.inverse() {
            true => "How well does the inverse decoder estimate forces?",
            false => "How well do new networks estimate forces from measured signals?",
        };
        page("metasense: bodies compared on records", question, content)
    }

    /// Whether the decoder is the inverse decoder.
    fn inverse(&self) -> bool {
        self.bodies.iter().any(|body| body.measured.posterior.is_some())
    }

    fn legend(&self) -> Legend {
        self.bodies.iter().enumerate().map(|(b, body)| (class(b), body.name.clone())).collect()
    }

    /// Forces of four records: of all bodies together under the same forces, else four of each body.
    fn forces(&self) -> Figure {
        let (panels, judged) = (self.shape[0], &self.judged);
        let mut rows = Vec::new();
        let mut strip = |record: usize, bodies: &[usize]| {
            let curves =
                |values: &[f64]| histories(values, record, [self.shape[1], panels], self.duration, |_| 1.0);
            let truth = curves(&self.bodies[bodies[0]].measured.targets);
            let (mut sources, mut errors) = (vec![("truth".to_owned(), truth.clone())], Vec::new());
            let mut bands = Vec::new();
            for &b in bodies {
                let Evaluated { predictions, posterior, .. } = &self.bodies[b].measured;
                let (predicted, style) = (curves(predictions), format!("fine {}", class(b)));
                let [low, high] = [|p: &Posterior| p.low.clone(), |p: &Posterior| p.high.clone()]
                    .map(|end| posterior.as_ref().map(|posterior| curves(&end(posterior))));
                let at = |end: &Option<Vec<Curve>>, k: usize, n: usize| end.as_ref().map(|end| end[k][n].1);
                errors.push(judged[b].errors[record].map_or("–".into(), number));
                for (k, (truth, predicted)) in truth.iter().zip(&predicted).enumerate() {
                    rows.extend(truth.iter().zip(predicted).enumerate().map(|(n, ((t, f), (_, p)))| {
                        row![self.bodies[b].name, record, k, t, f, p, at(&low, k, n), at(&high, k, n)]
                    }));
                }
                if let (Some(low), Some(high)) = (low, high) {
                    let half = |(low, high): (&Curve, &Curve)| {
                        low.iter().zip(high).map(|((_, low), (_, high))| 0.5 * (high - low)).collect()
                    };
                    bands.push((style.clone(), low.iter().zip(&high).map(half).collect()));
                }
                sources.push((style, predicted));
            }
            let whose =
                if self.paired { String::new() } else { format!("{}, ", self.bodies[bodies[0]].name) };
            Strip { title: format!("{whose}record {record}: {} %", errors.join(" → ")), sources, bands }
        };
        let all: Vec<usize> = (0..self.bodies.len()).collect();
        let mut samples = Vec::new();
        for some in all.chunks(if self.paired { all.len() } else { 1 }) {
            let errors = &judged[some[some.len() - 1]].errors;
            samples.extend(representative(errors, 0..errors.len()).into_iter().map(|r| strip(r, some)));
        }
        let names: Vec<String> = (0..panels).map(|k| format!("panel {k}")).collect();
        let (pictures, step) = strips(&samples, &names, " N", self.duration, true);
        let mut entries = legend(&[("truth", "true force")]);
        entries.extend(self.legend());
        let mut data = Table::new("body record panel seconds force predicted low high", rows);
        let by = match self.inverse() {
            true => "the inverse decoder, with its 95 % bands",
            false => {
                data.drop_columns(&["low", "high"]);
                "networks not trained on these records (first seed)"
            }
        };
        Figure::new(
            "forces",
            "True and predicted forces",
            format!(
                "True forces of four records{}, at the 12th, 37th, 62nd and 87th percentile of the error, and the \
                 predictions from their signals by {by}. Each panel's line is drawn {} N above the next. The titles give the \
                 errors, means over seeds.{RESIDUAL}",
                if self.paired { " of all bodies" } else { " of each body" },
                number(step)
            ),
            entries,
            pictures,
            data,
        )
    }

    fn errors(&self) -> Figure {
        let judged = &self.judged;
        let known = |b: usize| judged[b].errors.iter().enumerate().filter_map(|(i, e)| Some((i, (*e)?)));
        // if joined, only records with an error on all bodies
        let has_all_errors =
            |i: usize| (0..self.bodies.len()).all(|b| !self.paired || judged[b].errors[i].is_some());
        let of = |b: usize| {
            let errors = known(b).filter(|(i, _)| has_all_errors(*i)).collect();
            Errors { class: class(b), body: &self.bodies[b].name, errors }
        };
        let bodies: Vec<Errors> = (0..self.bodies.len()).map(of).collect();
        let label = match self.paired {
            true => format!("records, by the error of {}", self.bodies[0].name),
            false => "records of each body, by their error".to_owned(),
        };
        Figure::new(
            "errors",
            "Error of each record",
            format!(
                "Prediction error of each record by {}{}.",
                match self.inverse() {
                    true => "the inverse decoder",
                    false => "networks not trained on it, means over seeds",
                },
                if self.paired { "; the bodies' errors under the same blow are joined" } else { "" }
            ),
            self.legend(),
            vec![dots("Every record", &label, &bodies, self.paired)],
            self.records(),
        )
    }

    fn progress(&self) -> Option<Figure> {
        let judged = &self.judged;
        let curves = || {
            judged.iter().filter(|judged| judged.by == SignalSource::Measured).map(|judged| &judged.progress)
        };
        let points = || curves().flatten();
        let x = Axis::new("iterations of the decoder", Scale::Log, points().map(|p| f64::from(p.0)));
        let y = Axis::new("error on unseen records (%)", Scale::Log, points().map(|p| p.1));
        let mut plot = Plot::new("Networks during training, measured signals", x, y);
        for (b, curve) in curves().enumerate() {
            plot.line(class(b), curve.iter().map(|p| (f64::from(p.0), p.1)));
        }
        let row = |judged: &BodyErrors, p: &(u32, f64)| row![judged.body, judged.by.name(), p.0, p.1];
        let rows = judged.iter().flat_map(|judged| judged.progress.iter().map(move |p| row(judged, p)));
        // a linear decoder has no iterations
        points().next()?;
        Some(Figure::new(
            "progress",
            "Error of networks during training",
            "Error on unseen records against iterations of training, mean over folds and seeds.",
            self.legend(),
            vec![plot.picture()],
            Table::new("body signals iteration error", rows),
        ))
    }

    /// One record of each body whose design is known, with the model's signals.
    fn signals(&self) -> Option<Figure> {
        let (judged, channels, names) = (&self.judged, self.shape[2], &self.channels);
        let (mut pictures, mut rows) = (Vec::new(), Vec::new());
        for (b, body) in self.bodies.iter().enumerate() {
            let Some((simulated, _)) = &body.simulated else { continue };
            let typical = representative(&judged[b].errors, 0..judged[b].errors.len());
            let Some(&record) = typical.get(typical.len() / 2) else { continue };
            let rms = |c: usize| {
                let values = || body.signals[c..].iter().step_by(channels);
                (values().map(|x| x * x).sum::<f64>() / values().count() as f64).sqrt().max(f64::MIN_POSITIVE)
            };
            let factors: Vec<f64> = (0..channels).map(rms).collect();
            let [measured, model] = [&body.signals, simulated]
                .map(|v| histories(v, record, [self.shape[1], channels], self.duration, |c| factors[c]));
            for (c, (measured, model)) in measured.iter().zip(&model).enumerate() {
                rows.extend(measured.iter().zip(model).map(|((t, m), (_, s))| {
                    let [m, s] = [m, s].map(|x| x * factors[c]);
                    row![body.name, record, names[c], t, m, s]
                }));
            }
            let sources = vec![("truth".to_owned(), measured), ("front".to_owned(), model)];
            let strip = Strip { title: format!("{}, record {record}", body.name), sources, bands: vec![] };
            pictures.extend(strips(&[strip], names, " RMS", self.duration, false).0);
        }
        Figure::some(
            "signals",
            "Measured and modelled signals",
            "The sensors' signals under one record of each body, and those of the trial's model of the body under the \
                 same forces, each channel divided by its RMS.",
            legend(&[("truth", "measured"), ("front", "model")]),
            pictures,
            || Table::new("body record channel seconds measured simulated", rows),
        )
    }
}
