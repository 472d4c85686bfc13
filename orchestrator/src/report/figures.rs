//! The figures that the analysis alone can draw.

use super::answers::interval;
use crate::analysis::data::{
    COMPLEXITY, DESIGN, FREEDOM, Group, SENSORS, TRAINING, groups, levels, observations, places,
};
use crate::analysis::kinds::brains;
use crate::analysis::numbers::{distinct, quantile};
use crate::analysis::placed::{Level, placed};
use crate::analysis::random::random;
use crate::analysis::run_time::{mean_history, pareto};
use crate::analysis::scaling::scaling;
use crate::analysis::trial::CurvePoint;
use crate::analysis::{Body, Question, Set, Terms, Trial, Verdict, elbow, paired};
use crate::look::{Axis, Figure, Plot, Scale, Table, legend, number, row};

/// The usual legend.
pub const BODIES: [(&str, &str); 2] = [("initial", "initial body"), ("optimised", "optimised body")];

/// At most so many trials of a setting have a line of their own; the data hold these.
const MOST_LINES: usize = 200;

/// At most so many plots of a kind; the data hold all.
const MOST_PLOTS: usize = 6;

/// Error of the optimised against that of the initial body, a dot a trial.
#[must_use]
pub fn pairs(trials: &[Trial]) -> Option<Figure> {
    let points: Vec<(&Trial, f64, f64)> = trials
        .iter()
        .filter_map(|t| {
            Some((t, t.error(Body::Initial, Set::Holdout)?, t.error(Body::Optimised, Set::Holdout)?))
        })
        .collect();
    if points.is_empty() {
        return None;
    }
    let all: Vec<f64> = points.iter().flat_map(|p| [p.1, p.2]).collect();
    let axis = |label| Axis::new(label, Scale::Log, all.iter().copied());
    let mut plot = Plot::new(
        "Each trial",
        axis("holdout error, initial body (%)"),
        axis("holdout error, optimised body (%)"),
    );
    let (low, high) = all.iter().fold((f64::INFINITY, 0.0f64), |(l, h), e| (l.min(*e), h.max(*e)));
    plot.line("equal", [(low, low), (high, high)]);
    for (class, from_random) in [("optimised", false), ("front", true)] {
        let drawn = points.iter().filter(|p| p.0.starts_random() == from_random);
        let dots = drawn.map(|(t, i, o)| {
            let text = format!(
                "K {} M {} placement {} seed {}, {} units: {} % → {} %",
                t.panels,
                t.sensors,
                t.cluster.placement,
                t.cluster.seed,
                t.units,
                number(*i),
                number(*o)
            );
            ((*i, *o), text)
        });
        plot.dots(class, dots);
    }
    let random = points.iter().any(|p| p.0.starts_random());
    let data = Table::new(
        "hash panels sensors placement seed units holdout_error_initial holdout_error_optimised",
        points.iter().map(|(t, i, o)| {
            row![t.hash, t.panels, t.sensors, t.cluster.placement, t.cluster.seed, t.units, i, o]
        }),
    );
    Some(Figure::new(
        "pairs",
        "Did the body get better?",
        "Prediction error on the holdout, which neither loop has seen: each dot is a trial, with \
             brains trained alike on its initial and on its optimised body. Below the dotted line the \
             optimised body is better.",
        if random {
            legend(&[("dot sensor", "from rotated squares"), ("dot front", "from a random body")])
        } else {
            vec![]
        },
        vec![plot.picture()],
        data,
    ))
}

/// Error against M, placements shaded, elbow marked.
#[must_use]
pub fn sensors(trials: &[Trial], terms: Terms) -> Option<Figure> {
    let refs: Vec<&Trial> = trials.iter().collect();
    let drawn: Vec<Group> = groups(&refs, SENSORS).into_iter().filter(|g| g.varies(|t| t.sensors)).collect();
    let mut pictures = Vec::new();
    for group in drawn.iter().take(MOST_PLOTS) {
        let curves = Body::ALL.map(|b| (b, observations(&group.trials, b, Set::Holdout, |t| t.sensors)));
        let errors = curves.iter().flat_map(|c| c.1.iter().map(|o| o.error));
        let values = distinct(group.trials.iter().map(|t| t.sensors));
        let values: Vec<f64> = values.into_iter().map(|m| m as f64).collect();
        let x = Axis::new("sensors M", Scale::Linear, values.iter().copied().chain([0.7])).with_ticks(values);
        let mut plot = Plot::new(&group.label, x, Axis::new("holdout error (%)", Scale::Log, errors));
        let mut marked = 0;
        for (body, points) in &curves {
            let curve = levels(points);
            plot.band(body.name(), &curve.iter().map(|l| (l.at, l.least, l.most)).collect::<Vec<_>>());
            plot.line(body.name(), curve.iter().map(|l| (l.at, l.mean)));
            plot.dots(
                body.name(),
                curve.iter().map(|l| {
                    let text = format!(
                        "{} body, M = {}: {} % ({} to {} %, {} trials)",
                        body.name(),
                        l.at,
                        number(l.mean),
                        number(l.least),
                        number(l.most),
                        l.trials
                    );
                    ((l.at, l.mean), text)
                }),
            );
            if let Ok(found) = elbow(points)
                && let Verdict::At(m) | Verdict::WithoutVote(Some(m)) = found.verdict
            {
                let vote = found.votes.iter().find(|v| v.0 == m && v.1 > 0.0);
                let vote = vote.map_or(String::new(), |v| format!(", {:.0} % of votes", 100.0 * v.1));
                plot.vertical(body.name(), m, &format!("elbow at M = {m}{vote}"), marked);
                marked += 1;
            }
        }
        pictures.push(plot.picture());
    }
    let left_out = drawn.len().saturating_sub(MOST_PLOTS);
    let rest =
        if left_out > 0 { format!(" {left_out} further settings are in the data.") } else { String::new() };
    (!pictures.is_empty()).then(|| {
        Figure::new(
            "sensors",
            "How many sensors are enough?",
            format!(
                "Prediction error on the holdout against the number of sensors: geometric mean over \
             placements and seeds, shaded from the best to the worst of them. A dotted line marks the \
             elbow where there is one (broken stick on ln error, votes by bootstrap over placements and \
             seeds).{rest}"
            ),
            legend(&BODIES),
            pictures,
            Question::Sensors.answer(trials, terms),
        )
    })
}

/// Error against M with sensors at random and placed, on both bodies.
#[must_use]
pub fn placed_sensors(trials: &[Trial]) -> Option<Figure> {
    let refs: Vec<&Trial> = trials.iter().collect();
    let mut pictures = Vec::new();
    for found in placed(&refs).iter().filter(|found| found.levels.len() > 1).take(MOST_PLOTS) {
        let curve = |searched, body| {
            let of = |l: &Level| Some((l.sensors as f64, l.error(searched, body, Set::Holdout)?));
            found.levels.iter().filter_map(of).collect::<Vec<_>>()
        };
        let ways = [false, true].into_iter().flat_map(|s| Body::ALL.map(|body| (s, body)));
        let curves: Vec<_> = ways.map(|(s, body)| (s, body, curve(s, body))).collect();
        let values: Vec<f64> = found.levels.iter().map(|l| l.sensors as f64).collect();
        let x = Axis::new("sensors M", Scale::Linear, values.iter().copied().chain([0.7])).with_ticks(values);
        let errors = curves.iter().flat_map(|c| c.2.iter().map(|point| point.1));
        let mut plot = Plot::new(&found.label, x, Axis::new("holdout error (%)", Scale::Log, errors));
        for (searched, body, points) in &curves {
            let way = if *searched { "placed" } else { "at random" };
            let class = format!("{}{}", body.name(), if *searched { "" } else { " thin" });
            plot.line(&class, points.iter().copied());
            let told = points.iter().map(|&(m, error)| {
                ((m, error), format!("{} body, M = {m} {way}: {} %", body.name(), number(error)))
            });
            plot.dots(&class, told);
        }
        pictures.push(plot.picture());
    }
    (!pictures.is_empty()).then(|| {
        Figure::new(
            "placed",
            "Place sensors well, or train the body?",
            "Prediction error on the holdout against the number of sensors: faint with sensors at random, \
             strong where a search puts them, by the training samples alone. Geometric mean over \
             placements and seeds.",
            legend(&BODIES),
            pictures,
            Question::Placed.answer(trials, Terms::default()),
        )
    })
}

/// Errors of random bodies beside those of the initial and the optimised one.
#[must_use]
pub fn random_bodies(trials: &[Trial]) -> Option<Figure> {
    let refs: Vec<&Trial> = trials.iter().collect();
    let mut pictures = Vec::new();
    for group in groups(&refs, DESIGN) {
        let Some(found) = random(&group.trials, Set::Holdout) else { continue };
        let [initial, optimised] = &found.others;
        let columns = [
            ("front", "random", &found.errors),
            ("initial", "initial", initial),
            ("optimised", "optimised", optimised),
        ];
        let names = columns.iter().zip(1..).map(|(c, i)| (f64::from(i), format!("{} {}", c.2.len(), c.1)));
        let x = Axis::new("bodies", Scale::Linear, [0.5, 3.5]).with_names(names.collect());
        let all = columns.iter().flat_map(|c| c.2.iter().copied());
        let mut plot = Plot::new(&group.label, x, Axis::new("holdout error (%)", Scale::Log, all));
        for ((class, name, errors), at) in columns.iter().zip(1..) {
            let dots = errors.iter().zip(spread(errors.len())).map(|(error, aside)| {
                ((f64::from(at) + aside, *error), format!("{name} body: {} %", number(*error)))
            });
            plot.dots(class, dots);
        }
        pictures.push(plot.picture());
    }
    (!pictures.is_empty()).then(|| {
        Figure::new(
            "random",
            "Would any other body have done?",
            "Prediction error on the holdout of random castable bodies, of the initial one and of the \
             optimised one, with equal sensors, stimuli and training of the network; a dot is a trial. \
             What training made of the random bodies is in the data.",
            vec![],
            pictures,
            Question::Random.answer(trials, Terms::default()),
        )
    })
}

/// Places side by side, so that equal errors do not hide one another.
fn spread(count: usize) -> impl Iterator<Item = f64> {
    (0..count).map(move |i| 0.5 * ((i as f64 + 0.5) / count as f64 - 0.5))
}

/// Training loss and holdout error against iterations: median over trials and networks, middle half shaded.
#[must_use]
pub fn losses(trials: &[Trial]) -> Option<Figure> {
    let drawn = |t: &&Trial| !t.starts_random() && t.curves.iter().all(|c| !c.is_empty());
    let refs: Vec<&Trial> = trials.iter().filter(drawn).collect();
    let mut rows = Vec::new();
    let mut pictures = Vec::new();
    type Curves = fn(&Trial) -> &[Vec<Vec<CurvePoint>>; 2];
    let ways: [(&str, &str, Curves); 3] = [
        ("", "training loss (normalised)", |t| &t.curves),
        ("", "holdout error (%)", |t| &t.error_curves),
        (", long training", "training loss (normalised)", |t| &t.long_curves),
    ];
    for group in groups(&refs, &[SENSORS, COMPLEXITY].concat()).iter().take(MOST_PLOTS) {
        for (way, quantity, of) in ways {
            let curves = Body::ALL.map(|body| {
                let networks: Vec<&Vec<CurvePoint>> =
                    group.trials.iter().flat_map(|trial| &of(trial)[body as usize]).collect();
                (body, middle(&networks))
            });
            if curves.iter().all(|c| c.1.is_empty()) {
                continue;
            }
            let label = format!("{}{way}", group.label);
            let all = || curves.iter().flat_map(|c| c.1.iter());
            let mut plot = Plot::new(
                &label,
                Axis::new("brain iterations", Scale::Log, all().map(|p| p.0)),
                Axis::new(quantity, Scale::Log, all().flat_map(|p| [p.1, p.3])),
            );
            for (body, curve) in &curves {
                plot.band(body.name(), &curve.iter().map(|p| (p.0, p.1, p.3)).collect::<Vec<_>>());
                plot.line(body.name(), curve.iter().map(|p| (p.0, p.2)));
                rows.extend(curve.iter().map(|p| row![label, quantity, body.name(), p.0, p.2, p.1, p.3]));
            }
            pictures.push(plot.picture());
        }
    }
    let schedules = paired::schedules(&refs);
    let of = |(rate, trials): &(&str, Vec<&Trial>), by: paired::Progress| {
        let ratio = paired::iterations(trials, by)?;
        let interval = interval(&ratio);
        let rate = if schedules.len() > 1 { format!(", {rate} rate") } else { String::new() };
        Some(format!("{} times ({interval}) by {}{rate}", number(ratio.ratio), by.name()))
    };
    let ratios: Vec<String> =
        schedules.iter().flat_map(|s| paired::Progress::ALL.map(|by| of(s, by))).flatten().collect();
    if ratios.is_empty() {
        return None;
    }
    Some(Figure::new(
        "losses",
        "Is the body easier to learn from?",
        format!(
            "Fresh networks of one architecture and budget on the initial and on the optimised body: \
             median over trials, the middle half shaded. To reach what the worse body ends at, the network \
             on the initial body takes so many times the iterations of that on the optimised one: {}.",
            ratios.join(", ")
        ),
        legend(&BODIES),
        pictures,
        Table::new("setting quantity body iteration median lower_quartile upper_quartile", rows),
    ))
}

/// (iteration, lower quartile, median, upper quartile) at some hundred iterations that all curves have, evenly spaced in
/// their logarithm.
fn middle(curves: &[&Vec<CurvePoint>]) -> Vec<(f64, f64, f64, f64)> {
    let Some(shortest) = curves.iter().min_by_key(|c| c.len()) else { return Vec::new() };
    let Some(last) = shortest.last().map(|p| f64::from(p.0)) else { return Vec::new() };
    let mut at: Vec<usize> = (0..100)
        .map(|i| last.powf(f64::from(i) / 99.0))
        .map(|n| shortest.partition_point(|p| f64::from(p.0) < n - 0.5).min(shortest.len() - 1))
        .collect();
    at.dedup();
    at.into_iter()
        .filter_map(|place| {
            let n = shortest[place].0;
            let value = |c: &&Vec<CurvePoint>| Some(c[c.binary_search_by_key(&n, |p| p.0).ok()?].1);
            let mut values: Vec<f64> = curves.iter().filter_map(value).filter(|v| v.is_finite()).collect();
            values.sort_by(f64::total_cmp);
            let of = |q| quantile(&values, q);
            (!values.is_empty()).then(|| (f64::from(n), of(0.25), of(0.5), of(0.75)))
        })
        .collect()
}

/// Error against design parameters, with the law where it is one.
#[must_use]
pub fn complexity(trials: &[Trial]) -> Option<Figure> {
    let refs: Vec<&Trial> = trials.iter().collect();
    let mut pictures = Vec::new();
    let mut laws: Vec<(String, String)> = Vec::new();
    let drawn: Vec<Group> = [COMPLEXITY, FREEDOM].into_iter().flat_map(|but| groups(&refs, but)).collect();
    for group in drawn.iter().filter(|g| g.varies(|t| t.design_parameters)).take(MOST_PLOTS) {
        let curves =
            Body::ALL.map(|b| (b, observations(&group.trials, b, Set::Holdout, |t| t.design_parameters)));
        let all = || curves.iter().flat_map(|c| c.1.iter());
        let mut x = Axis::new("design parameters N", Scale::Log, all().map(|o| o.at));
        let sizes = places(&curves[0].1);
        if sizes.len() <= 6 {
            x = x.with_ticks(sizes);
        }
        let y = Axis::new("holdout error (%)", Scale::Log, all().map(|o| o.error));
        let mut plot = Plot::new(&group.label, x, y);
        for (body, points) in &curves {
            let curve = levels(points);
            let who = format!("{}, {} body", group.label, body.name());
            match scaling(points) {
                Ok(found) if found.not_identifiable.is_none() => {
                    let (low, high) = (curve[0].at, curve[curve.len() - 1].at);
                    let places = (0..=40).map(|i| low * (high / low).powf(f64::from(i) / 40.0));
                    let band: Vec<(f64, f64, f64)> =
                        places.clone().filter_map(|n| found.band(n).map(|b| (n, b.low, b.high))).collect();
                    plot.band(body.name(), &band);
                    plot.line(body.name(), places.map(|n| (n, found.law.at(n))));
                    let b = found
                        .exponent
                        .map_or(String::new(), |i| format!(" ({} to {})", number(i.low), number(i.high)));
                    laws.push((
                        who,
                        format!("b = {}{b}, c = {} %", number(found.law.exponent), number(found.law.floor)),
                    ));
                }
                Ok(found) => {
                    plot.line(body.name(), curve.iter().map(|l| (l.at, l.mean)));
                    let why = found.not_identifiable.unwrap_or_default();
                    laws.push((who, format!("not identifiable, {why}")));
                }
                Err(why) => {
                    plot.line(body.name(), curve.iter().map(|l| (l.at, l.mean)));
                    laws.push((who, why.to_string()));
                }
            }
            plot.dots(
                body.name(),
                points.iter().map(|o| {
                    ((o.at, o.error), format!("{} body, N = {}: {} %", body.name(), o.at, number(o.error)))
                }),
            );
        }
        pictures.push(plot.picture());
    }
    (!pictures.is_empty()).then(|| {
        Figure::new(
            "complexity",
            "What does a more complex body buy?",
            format!(
                "Prediction error on the holdout against the number of design parameters of the body; task, \
             sensors and network stay. A dot is a trial; where the law L = a·(N/N₀)^(−b) + c is \
             identified, its fit is drawn with a 95 % band, elsewhere the means are joined. {}.",
                told(&laws)
            ),
            legend(&BODIES),
            pictures,
            Question::Sizes.answer(trials, Terms::default()),
        )
    })
}

/// Each verdict with whom it is about; once, where it is the same for all.
fn told(laws: &[(String, String)]) -> String {
    match laws {
        [first, rest @ ..] if !rest.is_empty() && rest.iter().all(|l| l.1 == first.1) => {
            format!("Every curve: {}", first.1)
        }
        _ => laws.iter().map(|(who, law)| format!("{who}: {law}")).collect::<Vec<_>>().join("; "),
    }
}

/// Best error so far against seconds.
#[must_use]
pub fn run_time(trials: &[Trial]) -> Option<Figure> {
    let drawn = |t: &&Trial| !t.starts_random() && !t.history.is_empty();
    let refs: Vec<&Trial> = trials.iter().filter(drawn).collect();
    let mut pictures = Vec::new();
    let mut rows = Vec::new();
    let mut sparsest = 1;
    for (i, group) in groups(&refs, &[TRAINING, SENSORS, COMPLEXITY].concat()).iter().enumerate() {
        let points: Vec<(f64, f64)> = group.trials.iter().flat_map(|t| t.history.iter().copied()).collect();
        let every = group.trials.len().div_ceil(MOST_LINES);
        sparsest = sparsest.max(every);
        rows.extend(
            group
                .trials
                .iter()
                .step_by(every)
                .flat_map(|t| t.history.iter().map(|p| row![t.hash, t.protocol(), p.0, p.1])),
        );
        if i >= MOST_PLOTS {
            continue;
        }
        let mut plot = Plot::new(
            &group.label,
            Axis::new("CPU seconds of the outer loop", Scale::Log, points.iter().map(|p| p.0)),
            Axis::new("best test error so far (%)", Scale::Log, points.iter().map(|p| p.1)),
        );
        // who reads the body in the end is nothing to the loop of a body trained with another brain
        let apart = group.trials.iter().all(|t| t.setting.contains_key("optimise.brain"));
        let readers: &[&str] = if apart { &["brain."] } else { &[] };
        let ways = groups(&group.trials, &[SENSORS, COMPLEXITY, readers].concat());
        let told = |way: &Group| {
            let [_, with] = brains(way.trials[0]);
            let protocol = Some(way.trials[0].protocol()).filter(|name| *name != "joint").unwrap_or_default();
            format!("{protocol} {with}").trim().to_owned()
        };
        let texts: Vec<String> = ways.iter().filter(|_| ways.len() > 1).map(told).collect();
        plot = plot.with_room(texts.iter().map(String::as_str));
        let mut notes = Vec::new();
        for trial in group.trials.iter().step_by(every) {
            plot.line("thin", steps(&trial.history));
        }
        for way in &ways {
            let histories: Vec<&[(f64, f64)]> = way.trials.iter().map(|t| t.history.as_slice()).collect();
            let mean = mean_history(&histories, 60);
            notes.extend(mean.last().map(|last| (*last, told(way))));
            plot.line("optimised", mean);
        }
        let front: Vec<(f64, f64)> = pareto(&points).into_iter().map(|i| points[i]).collect();
        plot.line("front", steps(&front));
        // over all lines
        for (end, text) in notes.iter().filter(|_| ways.len() > 1) {
            plot.note(*end, text);
        }
        pictures.push(plot.picture());
    }
    let key = [("thin", "trial"), ("optimised", "mean of a way of training"), ("front", "Pareto front")];
    let of_many = (sparsest > 1).then(|| format!(", of the many at most {MOST_LINES} a setting"));
    let of_many = of_many.unwrap_or_default();
    let caption = format!(
        "Best test error so far of the brains inside the outer loop, against the CPU seconds that the trial's steps \
         took (evaluation excluded). Thin: each trial{of_many}; thick: geometric mean of each way of training; the \
         front is what no trial beats in both."
    );
    let data = Table::new("hash protocol seconds best_error_test", rows);
    let title = "What did the error cost in time?";
    (!pictures.is_empty()).then(|| Figure::new("run_time", title, caption, legend(&key), pictures, data))
}

/// A history as a staircase.
fn steps(history: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut stairs = Vec::new();
    let mut last: Option<f64> = None;
    for &(seconds, error) in history {
        stairs.extend(last.map(|e| (seconds, e)));
        stairs.push((seconds, error));
        last = Some(error);
    }
    stairs
}
