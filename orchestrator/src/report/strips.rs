//! Histories of some samples, stacked, and the error of every sample; for trials and for records.

use crate::look::{Axis, Picture, Plot, Scale, number};

/// Points of a curve.
pub type Curve = Vec<(f64, f64)>;

/// Histories of one sample of `values` (N, T, width), divided by factors, at the ends of T intervals of `duration` (s).
pub fn histories(
    values: &[f64],
    sample: usize,
    [instants, width]: [usize; 2],
    duration: f64,
    factor: impl Fn(usize) -> f64,
) -> Vec<Curve> {
    let time = |n: usize| (n + 1) as f64 * duration / instants as f64;
    let of = &values[sample * instants * width..][..instants * width];
    let history =
        |k: usize| of[k..].iter().step_by(width).enumerate().map(|(n, x)| (time(n), x / factor(k))).collect();
    (0..width).map(history).collect()
}

/// Histories of a sample.
#[derive(Debug, Clone)]
pub struct Strip {
    /// Title above the plot.
    pub title: String,
    /// Per source: style of its lines, and one curve (s, value) per history. The first source is the truth.
    pub sources: Vec<(String, Vec<Curve>)>,
    /// Half-widths of shaded bands by history, for the sources that have some; styles are those of the sources.
    pub bands: Vec<(String, Vec<Vec<f64>>)>,
}

impl Strip {
    /// Points (s, low, high) of a history's band; empty if there is none.
    fn band(&self, class: &str, k: usize) -> Vec<(f64, f64, f64)> {
        let half_width = self.bands.iter().find(|(of, _)| of == class).map(|(_, bands)| &bands[k]);
        let curve = self.sources.iter().find(|(of, _)| of == class).map(|(_, curves)| &curves[k]);
        let both = curve.into_iter().flatten().zip(half_width.into_iter().flatten());
        both.map(|((t, value), h)| (*t, value - h, value + h)).collect()
    }
}

/// One plot per sample. Histories are stacked, the first at the top, at the returned distance, which fits the true values. One tick
/// marks each zero, one a value in `unit` above it. The truth is a thin line on top.
pub fn strips(samples: &[Strip], names: &[String], unit: &str, duration: f64) -> (Vec<Picture>, f64) {
    let count = names.len();
    let truth = samples.iter().flat_map(|s| s.sources[0].1.iter().flatten());
    let (least, most) = truth.fold((0.0f64, 1e-9f64), |(l, m), point| (l.min(point.1), m.max(point.1)));
    let step = 1.15 * (most - least);
    let zero = |k: usize| (count - 1 - k) as f64 * step;
    let ends = |pick: fn(f64, f64) -> f64, start: f64| {
        let curves = samples.iter().flat_map(|s| &s.sources).flat_map(|source| source.1.iter().enumerate());
        let values = curves.flat_map(|(k, curve)| curve.iter().map(move |point| zero(k) + point.1));
        let bands = samples.iter().flat_map(|s| s.bands.iter().map(move |(class, _)| (s, class)));
        let bands = bands.flat_map(|(s, class)| {
            (0..count).flat_map(move |k| s.band(class, k).into_iter().map(move |p| (k, p)))
        });
        let banded = bands.flat_map(|(k, (_, low, high))| [zero(k) + low, zero(k) + high]);
        values.chain(banded).fold(start, pick)
    };
    let range = [ends(f64::min, -0.1 * step), ends(f64::max, count as f64 * step)];
    let height = 80.0 + (200.0 / count as f64).max(45.0) * count as f64;
    let value = round_below(0.9 * most);
    let draw = |sample: &Strip| {
        let tick = |(k, name): (usize, &String)| {
            [(zero(k), name.clone()), (zero(k) + value, format!("{}{unit}", number(value)))]
        };
        let names = names.iter().enumerate().flat_map(tick).collect();
        let mut plot = Plot::new(
            &sample.title,
            Axis::new("time (s)", Scale::Linear, [0.0, duration]),
            Axis::new("", Scale::Linear, range).with_names(names),
        )
        .sized(400.0, height);
        for k in 0..count {
            for (class, _) in &sample.bands {
                let lifted = |(t, low, high)| (t, zero(k) + low, zero(k) + high);
                let band: Vec<_> = sample.band(class, k).into_iter().map(lifted).collect();
                plot.band(class, &band);
            }
            for (class, curves) in sample.sources.iter().rev() {
                plot.line(class, curves[k].iter().map(|(t, value)| (*t, zero(k) + value)));
            }
        }
        plot.picture()
    };
    (samples.iter().map(draw).collect(), step)
}

/// The largest of 1, 2 and 5 times a power of ten up to `most`.
fn round_below(most: f64) -> f64 {
    let power = 10f64.powf(most.log10().floor());
    [5.0, 2.0, 1.0].map(|d| d * power).into_iter().find(|v| *v <= most).unwrap_or(power)
}

/// Four of the samples given, at the 12th, 37th, 62nd and 87th percentile of their errors.
pub fn representative(errors: &[Option<f64>], among: impl Iterator<Item = usize>) -> Vec<usize> {
    let mut known: Vec<(f64, usize)> = among.filter_map(|n| errors[n].map(|e| (e, n))).collect();
    known.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut chosen: Vec<usize> =
        (0..4).filter_map(|q| known.get((2 * q + 1) * known.len() / 8)).map(|k| k.1).collect();
    chosen.dedup();
    chosen
}

/// Errors of a body's samples.
#[derive(Debug, Clone)]
pub struct Errors<'a> {
    /// Style of the dots.
    pub class: &'a str,
    /// Name of the body.
    pub body: &'a str,
    /// (Sample, error (%)).
    pub errors: Vec<(usize, f64)>,
}

/// One dot per sample and body, sorted by error. `joined`: all bodies have the same samples, in the order of the first body's
/// errors, with a line through the dots of each sample. Otherwise each body's samples have their own order.
pub fn dots(title: &str, label: &str, bodies: &[Errors], joined: bool) -> Picture {
    let ranked = |errors: &[(usize, f64)]| -> Vec<usize> {
        let mut order: Vec<usize> = (0..errors.len()).collect();
        order.sort_by(|a, b| errors[*a].1.total_cmp(&errors[*b].1));
        order
    };
    let first = bodies.first().map(|body| ranked(&body.errors)).unwrap_or_default();
    let sorted_errors = |body: &Errors| -> Vec<(usize, f64)> {
        let order = if joined { first.clone() } else { ranked(&body.errors) };
        order.into_iter().map(|i| body.errors[i]).collect()
    };
    let drawn: Vec<Vec<(usize, f64)>> = bodies.iter().map(sorted_errors).collect();
    let most = drawn.iter().map(Vec::len).max().unwrap_or(0);
    let x = Axis::new(label, Scale::Linear, [0.0, most as f64 + 1.0]).with_ticks(vec![]);
    let y = Axis::new("error (%)", Scale::Log, drawn.iter().flatten().map(|sample| sample.1));
    let mut plot = Plot::new(title, x, y).sized(480.0, 280.0);
    let place = |i: usize| i as f64 + 1.0;
    if joined {
        for i in 0..most {
            plot.line("thin", drawn.iter().map(|errors| (place(i), errors[i].1)));
        }
    }
    for (body, errors) in bodies.iter().zip(&drawn) {
        let text = |n: usize, error| format!("sample {n}, {} body: {} %", body.body, number(error));
        let dots = errors.iter().enumerate().map(|(i, &(n, error))| ((place(i), error), text(n, error)));
        plot.dots(body.class, dots);
    }
    plot.picture()
}
