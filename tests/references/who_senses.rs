//! Table, picture and finding of `who-senses`, from its rows.

use metasense::analysis::numbers::{geometric_mean, median};
use metasense::look::{Axis, Plot, Scale, file, legend};

use super::rows::{number, of, only_row, rows, short};
use super::table;

/// Decoders of who-senses, the simplest first: words, `brain` of their trials, reader, number of records.
const DECODERS: [Decoder; 9] = [
    ("linear, fitted to the design", "inverse", "nominal", "0"),
    ("linear, fitted to many casts", "inverse", "casts", "0"),
    ("linear, 30 records of the cast", "inverse", "records", "30"),
    ("linear, 140 records of the cast", "inverse", "records", "140"),
    ("long network, trained on the design", "cnn", "network", "0"),
    ("long network, trained on many casts", "cnn", "network_casts", "0"),
    ("the design's model, inverted", "inverse", "inverse", "0"),
    ("a twin from 10 records, inverted", "inverse", "twin", "10"),
    ("a twin from 30 records, inverted", "inverse", "twin", "30"),
];
type Decoder = (&'static str, &'static str, &'static str, &'static str);
/// Their bodies: words, body, training objective.
const SENSING: [(&str, &str, &str); 3] = [
    ("initial body", "initial", "nominal"),
    ("trained as designed", "optimised", "nominal"),
    ("trained over casts", "optimised", "mean"),
];

/// Errors (%) of a decoder on a body: as designed (geometric mean over seeds), median over casts, and largest over casts.
fn sensed((_, brain, reader, records): Decoder, (_, body, objective): (&str, &str, &str)) -> [f64; 3] {
    let all = rows("who-senses/casts.csv");
    let wanted = [
        ("brain", brain),
        ("reader", reader),
        ("records", records),
        ("body", body),
        ("objective", objective),
    ];
    let casts: Vec<f64> = of(&all, &wanted).map(|row| number(row, "error")).collect();
    let largest = casts.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let all = rows("who-senses/trials.csv");
    let wanted = [("brain", brain), ("objective", objective)];
    let of_linear =
        if ["network", "network_casts", "inverse", "twin"].contains(&reader) { "" } else { "linear_" };
    let name = format!("{of_linear}holdout_error_{body}");
    let trials: Vec<f64> = of(&all, &wanted).map(|row| number(row, &name)).collect();
    [geometric_mean(&trials), median(casts), largest]
}

/// CPU time per sample (s).
fn seconds(reader: &str) -> f64 {
    let kind = match reader {
        "network" | "network_casts" => "network",
        "inverse" | "twin" => "inverse",
        _ => "linear",
    };
    number(only_row(&rows("who-senses/costs.csv"), &[("decoder", kind)]), "seconds")
}

/// The same as text.
fn takes(reader: &str) -> String {
    match seconds(reader) {
        s if s < 1e-3 => format!("{} µs", short(&(1e6 * s).to_string())),
        s => format!("{} s", short(&s.to_string())),
    }
}

/// Bodies against decoders: as designed and on casts.
pub fn all() -> String {
    let mut head = vec!["decoder".to_owned(), "time per sample".to_owned()];
    head.extend(
        SENSING.iter().flat_map(|(words, ..)| [format!("{words}: as designed"), "on casts".to_owned()]),
    );
    let line = |decoder: &Decoder| {
        let cells = |body: &(&str, &str, &str)| {
            let [designed, median, largest] = sensed(*decoder, *body).map(|error| short(&error.to_string()));
            // decoders with records of a cast have no error on the design
            let designed = if decoder.3 == "0" { format!("{designed} %") } else { String::new() };
            [designed, format!("{median} [{largest}] %")]
        };
        let cells = SENSING.iter().flat_map(cells).collect();
        [vec![decoder.0.to_owned(), takes(decoder.2)], cells].concat()
    };
    let head: Vec<&str> = head.iter().map(String::as_str).collect();
    table(&head, DECODERS.iter().map(line))
}

/// Error on the median cast against CPU time per sample, with the line below which there is no decoder.
pub fn front() -> String {
    let error = |decoder: &Decoder, body| sensed(*decoder, body)[1];
    let all = DECODERS.iter().flat_map(|decoder| SENSING.map(|body| error(decoder, body)));
    let x = Axis::new("CPU time per sample (s)", Scale::Log, DECODERS.map(|decoder| seconds(decoder.2)));
    let y = Axis::new("held-out error on the median cast (%)", Scale::Log, all);
    let mut plot = Plot::new("K = 2, M = 1, 3 % noise", x, y).sized(560.0, 340.0);
    let classes = ["initial", "optimised", "front"];
    for (body, class) in SENSING.into_iter().zip(classes) {
        let dot = |decoder: &Decoder| {
            ((seconds(decoder.2), error(decoder, body)), format!("{}: {}", body.0, decoder.0))
        };
        plot.dots(class, DECODERS.iter().map(dot));
        let mut best: Vec<(f64, f64)> = DECODERS.iter().map(|decoder| dot(decoder).0).collect();
        best.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let mut least = f64::INFINITY;
        best.retain(|&(_, error)| {
            let better = error < least;
            least = least.min(error);
            better
        });
        plot.line(class, best);
    }
    let legend =
        legend(&[(classes[0], SENSING[0].0), (classes[1], SENSING[1].0), (classes[2], SENSING[2].0)]);
    file(&[plot.picture()], 1, 560.0, &legend) + "\n"
}

/// The finding in a few sentences.
pub fn finding() -> String {
    let share = |error: f64| format!("{} %", short(&error.to_string()));
    let [linear, model, twin] = [DECODERS[0], DECODERS[6], DECODERS[8]];
    let reads = |decoder, body: usize, on: usize| share(sensed(decoder, SENSING[body])[on]);
    format!(
        "- **One sensor of the initial body records nearly all the information; training lets a cheap decoder use it.** Two forces, 3 % \
         noise, initial → trained body: linear decoder ({}) {} → {}; inverted model ({}) {} → {}. On casts: linear decoder {} → {}; model \
         calibrated on 30 records of the cast {} → {}, and {} if the body was trained over casts ([details](results/README.md#body-decoder-and-model)).",
        takes(linear.2),
        reads(linear, 0, 0),
        reads(linear, 1, 0),
        takes(model.2),
        reads(model, 0, 0),
        reads(model, 1, 0),
        reads(linear, 0, 1),
        reads(linear, 1, 1),
        reads(twin, 0, 1),
        reads(twin, 1, 1),
        reads(twin, 2, 1),
    )
}
