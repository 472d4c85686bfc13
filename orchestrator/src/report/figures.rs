//! Figures that need only the analysis.

use super::words::{interval, left_out};
use crate::analysis::data::{
    COMPLEXITY, FREEDOM, Group, SENSORS, TRAINING, groups, groups_by_objective, levels, observations, places,
};
use crate::analysis::kinds::{brains, brains_by_trial, format_brains};
use crate::analysis::numbers::{distinct, quantile};
use crate::analysis::placed::{SensorLevel, placed};
use crate::analysis::random::{random, random_groups};
use crate::analysis::run_time::{mean_history, pareto};
use crate::analysis::scaling::scaling;
use crate::analysis::trial::CurvePoint;
use crate::analysis::{
    BodyState, Cluster, DecisionTerms, ErrorScale, Interval, Question, Set, Trial, Verdict, elbow, paired,
};
use crate::look::{Axis, Figure, Plot, Scale, Table, legend, number, row};

/// Legend of both bodies.
pub const BODIES: [(&str, &str); 2] = [("initial", "initial body"), ("optimised", "trained body")];

/// Classes of dots, one per way of training; further ways share one class.
const DOTS: [&str; 5] = ["dot optimised", "dot front", "dot fourth", "dot fifth", "dot truth"];

/// Maximum number of trials per setting with a line of their own; the data contain only these.
const MOST_LINES: usize = 200;

/// Maximum number of plots of a kind; the data contain all.
const MOST_PLOTS: usize = 6;

/// Position on an axis, and an error (%).
type Point = (f64, f64);

fn errors(values: impl IntoIterator<Item = f64>) -> Axis {
    Axis::new("held-out error (%)", Scale::Log, values)
}

/// Axis of M with a tick at each value that occurs.
fn sensors_axis(trials: &[&Trial]) -> Axis {
    let values: Vec<f64> = distinct(trials.iter().map(|t| t.sensors)).into_iter().map(|m| m as f64).collect();
    Axis::new("sensors M", Scale::Linear, values.iter().copied().chain([0.7])).with_ticks(values)
}

/// Error of the trained body against that of the initial body, one dot per trial.
pub fn pairs(trials: &[Trial]) -> Option<Figure> {
    let error = |t: &Trial, body| t.error(body, Set::Holdout);
    let pair = |t| Some((t, error(t, BodyState::Initial)?, error(t, BodyState::Optimised)?));
    let points: Vec<(&Trial, f64, f64)> = trials.iter().filter_map(pair).collect();
    if points.is_empty() {
        return None;
    }
    let all: Vec<f64> = points.iter().flat_map(|p| [p.1, p.2]).collect();
    let axis = |label| Axis::new(label, Scale::Log, all.iter().copied());
    let (x, y) = (axis("held-out error, initial body (%)"), axis("held-out error, trained body (%)"));
    let mut plot = Plot::new("Each trial", x, y);
    let (low, high) = all.iter().fold((f64::INFINITY, 0.0f64), |(l, h), e| (l.min(*e), h.max(*e)));
    plot.line("equal", [(low, low), (high, high)]);
    let of_trials = brains_by_trial(&points.iter().map(|p| p.0).collect::<Vec<_>>());
    let who = |(of, point): (&[String; 2], &(&Trial, f64, f64))| {
        let from = if point.0.starts_random() { ", from a random body" } else { "" };
        format!("{}{from}", format_brains(of))
    };
    let whose: Vec<String> = of_trials.iter().zip(&points).map(who).collect();
    let names = distinct(&whose);
    for (n, name) in names.iter().enumerate() {
        let drawn = points.iter().zip(&whose).filter(|(_, of)| of == name);
        let dots = drawn.map(|((t, i, o), _)| {
            let Trial { panels: k, sensors: m, units, cluster: Cluster { placement, seed }, .. } = t;
            let (of, [from, to]) = (format!("placement {placement} seed {seed}"), [*i, *o].map(number));
            ((*i, *o), format!("K {k} M {m} {of}, {units} units: {from} % → {to} %"))
        });
        plot.dots(DOTS.get(n).map_or("thin", |key| &key["dot ".len()..]), dots);
    }
    let keys = names.iter().enumerate().filter(|_| names.len() > 1);
    let keys = keys.map(|(n, name)| (DOTS.get(n).copied().unwrap_or("dot thin"), (*name).clone())).collect();
    let data = Table::new(
        "hash panels sensors placement seed units holdout_error_initial holdout_error_optimised",
        points.iter().map(|(t, i, o)| {
            row![t.hash, t.panels, t.sensors, t.cluster.placement, t.cluster.seed, t.units, i, o]
        }),
    );
    Some(Figure::new(
        "pairs",
        "Does training improve the body?",
        "Held-out error: on samples used neither to train the decoder nor to select the body. Each dot is \
         a trial; the same kind of decoder was trained on its initial and on its trained body. Below the dotted line \
         the trained body is better.",
        keys,
        vec![plot.picture()],
        data,
    ))
}

/// Error against M; the range over placements is shaded, the elbow marked.
pub fn sensors(trials: &[Trial], terms: DecisionTerms) -> Option<Figure> {
    let refs: Vec<&Trial> = trials.iter().collect();
    let drawn: Vec<Group> = groups(&refs, SENSORS).into_iter().filter(|g| g.varies(|t| t.sensors)).collect();
    let picture = |group: &Group| {
        let curves = BodyState::ALL.map(|b| (b, observations(&group.trials, b, Set::Holdout, |t| t.sensors)));
        let all = curves.iter().flat_map(|c| c.1.iter().map(|o| o.error));
        let mut plot = Plot::new(&group.label, sensors_axis(&group.trials), errors(all));
        let mut marked = 0;
        for (body, points) in &curves {
            let (name, word, curve) = (body.name(), body.word(), levels(points));
            plot.band(name, &curve.iter().map(|l| (l.at, l.least, l.most)).collect::<Vec<_>>());
            plot.line(name, curve.iter().map(|l| (l.at, l.mean)));
            let dots = curve.iter().map(|l| {
                let [mean, least, most] = [l.mean, l.least, l.most].map(number);
                let text =
                    format!("{word} body, M = {}: {mean} % ({least} to {most} %, {} trials)", l.at, l.trials);
                ((l.at, l.mean), text)
            });
            plot.dots(name, dots);
            if let Ok(found) = elbow(points, ErrorScale::Logarithm)
                && let Verdict::At(m) | Verdict::WithoutVote(Some(m)) = found.verdict
            {
                let by_fit = || " by the fit".to_owned();
                let vote =
                    found.share(Some(m)).map_or_else(by_fit, |v| format!(", {:.0} % of votes", 100.0 * v));
                plot.vertical(name, m, &format!("elbow at M = {m}{vote}"), marked);
                marked += 1;
            }
        }
        plot.picture()
    };
    let rest = left_out(drawn.len(), MOST_PLOTS);
    Figure::some(
        "sensors",
        "How many sensors are enough?",
        format!(
            "Held-out error against the number of sensors: geometric mean over placements and seeds, \
             shaded from the best to the worst of them. A dotted line marks the elbow, if there is one (broken stick \
             on ln error; votes by bootstrap over placements and seeds).{rest}"
        ),
        legend(&BODIES),
        drawn.iter().take(MOST_PLOTS).map(picture).collect(),
        || Question::Sensors.answer(trials, terms),
    )
}

/// Error against M with random and with placed sensors, on both bodies.
pub fn placed_sensors(trials: &[Trial]) -> Option<Figure> {
    let refs: Vec<&Trial> = trials.iter().collect();
    let mut pictures = Vec::new();
    for found in placed(&refs).iter().filter(|found| found.levels.len() > 1).take(MOST_PLOTS) {
        let ways = [false, true].into_iter().flat_map(|s| BodyState::ALL.map(|body| (s, body)));
        let curve = |(searched, body)| -> (bool, BodyState, Vec<Point>) {
            let of = |l: &SensorLevel| Some((l.sensors as f64, l.error(searched, body, Set::Holdout)?));
            (searched, body, found.levels.iter().filter_map(of).collect())
        };
        let curves: Vec<_> = ways.map(curve).collect();
        let x = sensors_axis(&found.levels.iter().map(|level| level.trials[0][0]).collect::<Vec<_>>());
        let y = errors(curves.iter().flat_map(|c| c.2.iter().map(|point| point.1)));
        let mut plot = Plot::new(&found.label, x, y);
        for (searched, body, points) in &curves {
            let (way, style) = if *searched { ("placed", "") } else { ("at random", " thin") };
            let class = format!("{}{style}", body.name());
            plot.line(&class, points.iter().copied());
            let text = |m, error| format!("{} body, M = {m} {way}: {} %", body.word(), number(error));
            plot.dots(&class, points.iter().map(|&(m, error)| ((m, error), text(m, error))));
        }
        pictures.push(plot.picture());
    }
    Figure::some(
        "placed",
        "Place sensors well, or train the body?",
        "Held-out error against the number of sensors. Faint: sensors at random. Strong: sensors placed by \
         a search that uses only training samples. Geometric means over placements and seeds.",
        legend(&BODIES),
        pictures,
        || Question::Placed.answer(trials, DecisionTerms::default()),
    )
}

/// Errors of random bodies, and of the initial and the trained body.
pub fn random_bodies(trials: &[Trial]) -> Option<Figure> {
    let refs: Vec<&Trial> = trials.iter().collect();
    let picture = |group: Group| {
        let found = random(&group.trials, Set::Holdout)?;
        let [initial, optimised] = &found.others;
        let columns = [
            ("front", "random", &found.errors),
            ("initial", "initial", initial),
            ("optimised", "optimised", optimised),
        ];
        let names = columns.iter().zip(1..).map(|(c, i)| (f64::from(i), format!("{} {}", c.2.len(), c.1)));
        let x = Axis::new("bodies", Scale::Linear, [0.5, 3.5]).with_names(names.collect());
        let mut plot = Plot::new(&group.label, x, errors(columns.iter().flat_map(|c| c.2.iter().copied())));
        for ((class, name, errors), at) in columns.iter().zip(1..) {
            // side by side, so that equal errors do not hide each other
            let aside = |i: usize| 0.5 * ((i as f64 + 0.5) / errors.len() as f64 - 0.5);
            let dot = |(i, error): (usize, &f64)| {
                ((f64::from(at) + aside(i), *error), format!("{name} body: {} %", number(*error)))
            };
            plot.dots(class, errors.iter().enumerate().map(dot));
        }
        Some(plot.picture())
    };
    Figure::some(
        "random",
        "Are random bodies as good?",
        "Held-out error of random castable bodies, of the initial and of the trained body, with equal \
         sensors, stimuli and training of the network. Each dot is a trial. The data also contain the errors of the random \
         bodies after training.",
        vec![],
        random_groups(&refs).into_iter().filter_map(picture).collect(),
        || Question::Random.answer(trials, DecisionTerms::default()),
    )
}

/// Training loss and held-out error against iterations: median over trials and networks, middle half shaded.
pub fn losses(trials: &[Trial]) -> Option<Figure> {
    let drawn = |t: &&Trial| !t.starts_random() && t.curves.iter().all(|c| !c.is_empty());
    let refs: Vec<&Trial> = trials.iter().filter(drawn).collect();
    let schedules = paired::schedules(&refs);
    let of = |(rate, trials): &(&str, Vec<&Trial>), by: paired::TrainingMeasure| {
        let ratio = paired::iterations(trials, by)?;
        let interval = interval(&ratio);
        let rate = if schedules.len() > 1 { format!(", {rate} rate") } else { String::new() };
        Some(format!("{} times ({interval}) by {}{rate}", number(ratio.ratio), by.name()))
    };
    let ratios: Vec<String> =
        schedules.iter().flat_map(|s| paired::TrainingMeasure::ALL.map(|by| of(s, by))).flatten().collect();
    if ratios.is_empty() {
        return None;
    }
    let mut rows = Vec::new();
    let mut pictures = Vec::new();
    type Curves = fn(&Trial) -> &[Vec<Vec<CurvePoint>>; 2];
    let ways: [(&str, &str, Curves); 3] = [
        ("", "training loss (normalised)", |t| &t.curves),
        ("", "held-out error (%)", |t| &t.error_curves),
        (", long training", "training loss (normalised)", |t| &t.long_curves),
    ];
    let groups = groups(&refs, &[SENSORS, COMPLEXITY].concat());
    let drawn = groups.iter().take(MOST_PLOTS).flat_map(|group| ways.map(|way| (group, way)));
    for (group, (way, quantity, of)) in drawn {
        let curve = |body: BodyState| {
            quartile_curve(group.trials.iter().flat_map(|trial| &of(trial)[body as usize]).collect())
        };
        let curves = BodyState::ALL.map(|body| (body.name(), curve(body)));
        if curves.iter().all(|c| c.1.is_empty()) {
            continue;
        }
        let label = format!("{}{way}", group.label);
        let all = || curves.iter().flat_map(|c| c.1.iter());
        let x = Axis::new("decoder iterations", Scale::Log, all().map(|p| p.0));
        let y = Axis::new(quantity, Scale::Log, all().flat_map(|p| [p.1, p.3]));
        let mut plot = Plot::new(&label, x, y);
        for (body, curve) in &curves {
            plot.band(body, &curve.iter().map(|p| (p.0, p.1, p.3)).collect::<Vec<_>>());
            plot.line(body, curve.iter().map(|p| (p.0, p.2)));
            rows.extend(curve.iter().map(|p| row![label, quantity, body, p.0, p.2, p.1, p.3]));
        }
        pictures.push(plot.picture());
    }
    Some(Figure::new(
        "losses",
        "Does the network need fewer iterations?",
        format!(
            "New networks of one architecture and budget, trained on the initial and on the trained body: median and \
             interquartile range over trials. The target is the best value that the worse of the two bodies reaches. \
             Iterations to the target, initial / trained body: {}.",
            ratios.join(", ")
        ),
        legend(&BODIES),
        pictures,
        Table::new("setting quantity body iteration median lower_quartile upper_quartile", rows),
    ))
}

/// (iteration, lower quartile, median, upper quartile) at about a hundred iterations that all curves contain, evenly spaced in
/// their logarithm.
fn quartile_curve(curves: Vec<&Vec<CurvePoint>>) -> Vec<(f64, f64, f64, f64)> {
    let Some(shortest) = curves.iter().min_by_key(|c| c.len()) else { return Vec::new() };
    let Some(last) = shortest.last().map(|p| f64::from(p.0)) else { return Vec::new() };
    let nearest = |n: f64| shortest.partition_point(|p| f64::from(p.0) < n - 0.5).min(shortest.len() - 1);
    let mut at: Vec<usize> = (0..100).map(|i| nearest(last.powf(f64::from(i) / 99.0))).collect();
    at.dedup();
    let quartiles = |place: usize| {
        let n = shortest[place].0;
        let value = |c: &&Vec<CurvePoint>| Some(c[c.binary_search_by_key(&n, |p| p.0).ok()?].1);
        let mut values: Vec<f64> = curves.iter().filter_map(value).filter(|v| v.is_finite()).collect();
        values.sort_by(f64::total_cmp);
        let of = |q| quantile(&values, q);
        (!values.is_empty()).then(|| (f64::from(n), of(0.25), of(0.5), of(0.75)))
    };
    at.into_iter().filter_map(quartiles).collect()
}

/// Error against design parameters, with the law if it is identified.
pub fn complexity(trials: &[Trial]) -> Option<Figure> {
    let refs: Vec<&Trial> = trials.iter().collect();
    let mut pictures = Vec::new();
    let mut laws: Vec<(String, String)> = Vec::new();
    let drawn: Vec<Group> = [COMPLEXITY, FREEDOM].into_iter().flat_map(|but| groups(&refs, but)).collect();
    for group in drawn.iter().filter(|g| g.varies(|t| t.design_parameters)).take(MOST_PLOTS) {
        let curves = BodyState::ALL
            .map(|b| (b, observations(&group.trials, b, Set::Holdout, |t| t.design_parameters)));
        let all = || curves.iter().flat_map(|c| c.1.iter());
        let mut x = Axis::new("design parameters N", Scale::Log, all().map(|o| o.at));
        let sizes = places(&curves[0].1);
        if sizes.len() <= 6 {
            x = x.with_ticks(sizes);
        }
        let mut plot = Plot::new(&group.label, x, errors(all().map(|o| o.error)));
        for (body, points) in &curves {
            let (name, word, curve) = (body.name(), body.word(), levels(points));
            let found = scaling(points);
            let law = match &found {
                Err(why) => why.to_string(),
                Ok(found) if let Some(why) = &found.not_identifiable => format!("not identifiable, {why}"),
                Ok(found) => {
                    let ends = |i: Interval| format!(" ({} to {})", number(i.low), number(i.high));
                    let exponent = found.exponent.map_or(String::new(), ends);
                    format!("b = {}{exponent}, c = {} %", number(found.law.exponent), number(found.law.floor))
                }
            };
            laws.push((format!("{}, {word} body", group.label), law));
            match found.ok().filter(|found| found.not_identifiable.is_none()) {
                Some(found) => {
                    let (low, high) = (curve[0].at, curve[curve.len() - 1].at);
                    let places = (0..=40).map(|i| low * (high / low).powf(f64::from(i) / 40.0));
                    let band = |n| found.band(n).map(|b| (n, b.low, b.high));
                    plot.band(name, &places.clone().filter_map(band).collect::<Vec<_>>());
                    plot.line(name, places.map(|n| (n, found.law.at(n))));
                }
                None => plot.line(name, curve.iter().map(|l| (l.at, l.mean))),
            }
            let text = |at, error| format!("{word} body, N = {at}: {} %", number(error));
            plot.dots(name, points.iter().map(|o| ((o.at, o.error), text(o.at, o.error))));
        }
        pictures.push(plot.picture());
    }
    Figure::some(
        "complexity",
        "Does a more complex body have less error?",
        format!(
            "Held-out error against the number of design parameters of the body, for one task, its \
             sensors and its network. Each dot is a trial. Where the law L = a·(N/N₀)^(−b) + c is identified, its fit is \
             drawn with a 95 % band; elsewhere a line joins the means. {}.",
            format_laws(&laws)
        ),
        legend(&BODIES),
        pictures,
        || Question::Sizes.answer(trials, DecisionTerms::default()),
    )
}

/// Each law with its curve; only once if all laws are equal.
fn format_laws(laws: &[(String, String)]) -> String {
    match laws {
        [first, rest @ ..] if !rest.is_empty() && rest.iter().all(|l| l.1 == first.1) => {
            format!("Every curve: {}", first.1)
        }
        _ => laws.iter().map(|(who, law)| format!("{who}: {law}")).collect::<Vec<_>>().join("; "),
    }
}

/// Best error so far against seconds.
pub fn run_time(trials: &[Trial]) -> Option<Figure> {
    let drawn = |t: &&Trial| !t.starts_random() && !t.history.is_empty();
    let refs: Vec<&Trial> = trials.iter().filter(drawn).collect();
    let mut pictures = Vec::new();
    let mut rows = Vec::new();
    let mut sparsest = 1;
    let settings = groups_by_objective(&refs, &[TRAINING, SENSORS, COMPLEXITY].concat());
    for (i, group) in settings.iter().enumerate() {
        let points: Vec<Point> = group.trials.iter().flat_map(|t| t.history.iter().copied()).collect();
        let every = group.trials.len().div_ceil(MOST_LINES);
        sparsest = sparsest.max(every);
        let shown = || group.trials.iter().step_by(every);
        rows.extend(shown().flat_map(|t| t.history.iter().map(|p| row![t.hash, t.protocol(), p.0, p.1])));
        if i >= MOST_PLOTS {
            continue;
        }
        let x = Axis::new("CPU seconds of the outer loop", Scale::Log, points.iter().map(|p| p.0));
        let y = Axis::new("best test error so far (%)", Scale::Log, points.iter().map(|p| p.1));
        // for a body trained with another decoder, the decoder of the evaluation has no effect on the loop
        let apart = group.trials.iter().all(|t| t.setting.contains_key("optimise.brain"));
        let readers: &[&str] = if apart { &["brain."] } else { &[] };
        let ways = groups(&group.trials, &[SENSORS, COMPLEXITY, readers].concat());
        let told = |way: &Group| {
            let [_, with] = brains(&way.trials[0].setting);
            let protocol = Some(way.trials[0].protocol()).filter(|name| *name != "joint").unwrap_or_default();
            format!("{protocol} {with}").trim().to_owned()
        };
        let texts: Vec<String> = ways.iter().filter(|_| ways.len() > 1).map(told).collect();
        let mut plot = Plot::new(&group.label, x, y).with_room(texts.iter().map(String::as_str));
        let mut notes = Vec::new();
        for trial in shown() {
            plot.line("thin", steps(&trial.history));
        }
        for way in &ways {
            let histories: Vec<&[Point]> = way.trials.iter().map(|t| t.history.as_slice()).collect();
            let mean = mean_history(&histories, 60);
            notes.extend(mean.last().map(|last| (*last, told(way))));
            plot.line("optimised", mean);
        }
        let front: Vec<Point> = pareto(&points).into_iter().map(|i| points[i]).collect();
        plot.line("front", steps(&front));
        // above all lines
        for (end, text) in notes.iter().filter(|_| ways.len() > 1) {
            plot.note(*end, text);
        }
        pictures.push(plot.picture());
    }
    let key = [("thin", "trial"), ("optimised", "mean of a training method"), ("front", "Pareto front")];
    let of_many = if sparsest > 1 { format!(" (at most {MOST_LINES} per setting)") } else { String::new() };
    let caption = format!(
        "Best test error so far of the decoder in the outer loop, against the CPU seconds of training its body, as if \
         each trial had trained its body itself (without the evaluation). Thin: single trials{of_many}. Thick: geometric mean of each training method. For a trial on the Pareto front, \
         no other trial has both less error and less time.{}",
        left_out(settings.len(), MOST_PLOTS)
    );
    let data = || Table::new("hash protocol seconds best_error_test", rows);
    Figure::some("run_time", "How much CPU time did each error take?", caption, legend(&key), pictures, data)
}

/// A history as a step function.
fn steps(history: &[Point]) -> Vec<Point> {
    let mut stairs = Vec::new();
    let mut last: Option<f64> = None;
    for &(seconds, error) in history {
        stairs.extend(last.map(|e| (seconds, e)));
        stairs.push((seconds, error));
        last = Some(error);
    }
    stairs
}
