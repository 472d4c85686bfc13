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
    /// Time interval in which a true value exceeds 2 % of the largest (s), with a margin; `None` without one.
    fn blows(&self) -> Option<[f64; 2]> {
        let truth = || self.sources[0].1.iter().flatten();
        let most = truth().fold(0.0, |most: f64, (_, value)| most.max(value.abs()));
        let times = || truth().filter(|(_, value)| value.abs() > 0.02 * most).map(|(t, _)| *t);
        let (first, last) = (times().reduce(f64::min)?, times().reduce(f64::max)?);
        let margin = 0.2 * (last - first);
        Some([first - margin, last + margin])
    }

    /// Points (s, low, high) of a history's band; empty if there is none.
    fn band(&self, class: &str, k: usize) -> Vec<(f64, f64, f64)> {
        let half_width = self.bands.iter().find(|(of, _)| of == class).map(|(_, bands)| &bands[k]);
        let curve = self.sources.iter().find(|(of, _)| of == class).map(|(_, curves)| &curves[k]);
        let both = curve.into_iter().flatten().zip(half_width.into_iter().flatten());
        both.map(|((t, value), h)| (*t, value - h, value + h)).collect()
    }
}

/// One plot per sample. Histories are stacked, the first at the top, at the returned distance, which fits the true values. One tick
/// marks each zero, one a value in `unit` with the sign of the largest true one. The truth is a thin line on top. If the other sources
/// are `estimates` of the truth, residuals and a second plot are added, as [`RESIDUAL`] explains.
pub fn strips(
    samples: &[Strip],
    names: &[String],
    unit: &str,
    duration: f64,
    estimates: bool,
) -> (Vec<Picture>, f64) {
    let count = names.len() + usize::from(estimates);
    let truth = samples.iter().flat_map(|s| s.sources[0].1.iter().flatten());
    let (least, most) = truth.fold((0.0f64, 1e-9f64), |(l, m), point| (l.min(point.1), m.max(point.1)));
    let step = 1.15 * (most - least);
    let zero = |k: usize| (count - 1 - k) as f64 * step;
    let residuals = |sample: &Strip| -> Vec<(String, Curve)> {
        let truth = &sample.sources[0].1;
        let off = |(truth, curve): (&Curve, &Curve)| -> Curve {
            let pairs = curve.iter().zip(&truth[truth.len() - curve.len()..]);
            pairs.map(|((t, found), (_, truth))| (*t, found - truth)).collect()
        };
        let of = |(class, curves): &(String, Vec<Curve>)| -> Vec<(String, Curve)> {
            truth.iter().zip(curves).map(|both| (class.clone(), off(both))).collect()
        };
        if estimates { sample.sources[1..].iter().flat_map(of).collect() } else { Vec::new() }
    };
    let wrong = samples.iter().flat_map(&residuals).flat_map(|(_, curve)| curve);
    let worst = wrong.map(|(_, off)| off.abs()).filter(|off| off.is_finite()).fold(1e-12, f64::max);
    let part = 0.45 * step / worst;
    let ends = |pick: fn(f64, f64) -> f64, start: f64| {
        let curves = samples.iter().flat_map(|s| &s.sources).flat_map(|source| source.1.iter().enumerate());
        let values = curves.flat_map(|(k, curve)| curve.iter().map(move |point| zero(k) + point.1));
        let bands = samples.iter().flat_map(|s| s.bands.iter().map(move |(class, _)| (s, class)));
        let bands = bands.flat_map(|(s, class)| {
            (0..names.len()).flat_map(move |k| s.band(class, k).into_iter().map(move |p| (k, p)))
        });
        let banded = bands.flat_map(|(k, (_, low, high))| [zero(k) + low, zero(k) + high]);
        values.chain(banded).fold(start, pick)
    };
    let range =
        [ends(f64::min, if estimates { -0.5 } else { -0.1 } * step), ends(f64::max, count as f64 * step)];
    let height = 80.0 + (200.0 / count as f64).max(45.0) * count as f64;
    let largest = if -least > most { least } else { most };
    let mark = |most: f64| round_below(most).copysign(largest);
    let value = mark(0.9 * largest.abs());
    let draw = |sample: &Strip, title: &str, window: [f64; 2]| {
        let seen = |time: f64| (window[0]..=window[1]).contains(&time);
        let tick = |(k, name): (usize, &String)| {
            [(zero(k), name.clone()), (zero(k) + value, format!("{}{unit}", number(value)))]
        };
        let mut ticks: Vec<(f64, String)> = names.iter().enumerate().flat_map(tick).collect();
        if estimates {
            let value = mark(worst);
            ticks.extend([(0.0, "residual".into()), (part * value, format!("{}{unit}", number(value)))]);
        }
        let x = Axis::new("time (s)", Scale::Linear, window);
        let y = Axis::new("", Scale::Linear, range).with_names(ticks);
        let mut plot = Plot::new(title, x, y).sized(400.0, height);
        for k in 0..names.len() {
            for (class, _) in &sample.bands {
                let lifted = |(t, low, high)| (t, zero(k) + low, zero(k) + high);
                let band = sample.band(class, k).into_iter().filter(|(t, ..)| seen(*t));
                plot.band(class, &band.map(lifted).collect::<Vec<_>>());
            }
            for (class, curves) in sample.sources.iter().rev() {
                let drawn = curves[k].iter().filter(|(t, _)| seen(*t));
                plot.line(class, drawn.map(|(t, value)| (*t, zero(k) + value)));
            }
        }
        for (class, curve) in residuals(sample) {
            let drawn = curve.into_iter().filter(|(t, _)| seen(*t));
            plot.line(&class, drawn.map(|(t, off)| (t, part * off)));
        }
        plot.picture()
    };
    let both = |sample: &Strip| {
        let near = sample.blows().filter(|[from, to]| estimates && to - from < 0.7 * duration);
        let title = format!("{}, at the blows", sample.title);
        let near = near.map(|[from, to]| draw(sample, &title, [from.max(0.0), to.min(duration)]));
        std::iter::once(draw(sample, &sample.title, [0.0, duration])).chain(near)
    };
    (samples.iter().flat_map(both).collect(), step)
}

/// Explains residuals and second plots of [`strips`] in a caption.
pub const RESIDUAL: &str = " The lowest lines are the residuals of all panels, prediction minus true force. A second plot \
    shows the time of the blows alone.";

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

/// Positions of the least, median and greatest of `count` values, each once.
pub fn least_median_greatest(count: usize, value: impl Fn(usize) -> f64) -> Vec<usize> {
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|a, b| value(*a).total_cmp(&value(*b)));
    let mut chosen = vec![order[0], order[count / 2], order[count - 1]];
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
    let mut plot = Plot::new(title, x, y);
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

#[cfg(test)]
mod tests;
