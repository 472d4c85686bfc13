//! Readouts of sensing tasks as one C file: the readings of a sample in, one after the other, its labels out. The C is in `readout.c`.

use std::fmt::Write;

use metasense_lab::capacity::hold;
use metasense_lab::tasks::{Readout, TaskReadouts, readouts};
use metasense_worker::run::NoResult;

use super::super::unreadable;
use super::{Numbers, floats, whole};
use crate::analysis::BodyState;
use crate::reader::StoredTrial;
use crate::store::StoreError;

/// Number of held-out samples in the file's test.
const TESTED: usize = 20;
/// Allowed difference from the estimates, relative to the largest of their kind: rounding in 32-bit floats.
const BOUND: f64 = 1e-3;

/// A readout as the device holds it.
struct Rounded<'a> {
    of: &'a Readout,
    outputs: Vec<Output>,
}

/// An output: constant + step · Σ weight · sum / scale, of the sums of the signals over blocks of instants.
struct Output {
    weights: Vec<f64>,
    step: f64,
    constant: f64,
}

impl Output {
    fn new((weights, constant): &(Vec<f64>, f64), numbers: Numbers) -> Self {
        let most = weights.iter().fold(0.0_f64, |most, w| most.max(w.abs()));
        let step = numbers.most().filter(|_| most > 0.0).map_or(1.0, |levels| most / levels as f64);
        let round = |w: f64| if numbers == Numbers::F32 { f64::from(w as f32) } else { w.round() };
        Self { weights: weights.iter().map(|w| round(w / step)).collect(), step, constant: *constant }
    }

    fn value(&self, sums: &[f64], scales: &[f64]) -> f64 {
        let products = self.weights.iter().zip(sums).zip(scales.iter().cycle());
        self.constant + self.step * products.map(|((w, x), scale)| w * x / scale).sum::<f64>()
    }
}

impl<'a> Rounded<'a> {
    fn new(of: &'a Readout, numbers: Numbers) -> Self {
        Self { of, outputs: of.outputs.iter().map(|output| Output::new(output, numbers)).collect() }
    }

    /// Label of a sample with these sums (blocks · channels).
    fn estimate(&self, sums: &[f64], scales: &[f64]) -> Vec<f64> {
        let values = self.outputs.iter().map(|output| output.value(sums, scales));
        self.of.label(&values.collect::<Vec<_>>())
    }
}

/// C99 source of the readouts of a trial's tasks, fitted to one of its bodies.
///
/// # Errors
/// If the trial cannot be computed again, or no held-out sample has a whole window.
pub fn c(stored: &StoredTrial, body: usize, numbers: Numbers, threads: usize) -> Result<String, StoreError> {
    let spec = &stored.specs[body];
    let found = readouts(spec, &stored.designs[body], threads).map_err(unreadable(stored))?;
    let TaskReadouts { readouts, window, thresholds, block, scales, signals, contacts, sums, labels } =
        &found;
    let (channels, instants, triggered) = (scales.len(), spec.time.samples, thresholds[0] >= 0.0);
    let blocks = window.div_ceil(*block);
    let has_window = |(s, _): &(usize, &[f64])| contacts[*s].is_some_and(|start| start + window <= instants);
    let records = signals.chunks_exact(instants * channels).enumerate();
    let tested: Vec<(usize, &[f64])> = records.filter(has_window).take(TESTED).collect();
    if tested.is_empty() {
        let why = "after contact, no held-out sample is as long as brain.window: shorten it, or lengthen time.duration";
        return Err(unreadable(stored)(NoResult::Rejected(why.into())));
    }
    // a body that still moves has no quiet period of its first natural frequency; without one, a sample's duration
    let rest = if triggered { hold(spec).map_or(instants, |quarter| 4 * quarter).max(*window) } else { 0 };
    let rounded: Vec<Rounded> = readouts.iter().map(|of| Rounded::new(of, numbers)).collect();
    let of_all =
        |of: &Rounded| sums.chunks_exact(blocks * channels).map(|own| of.estimate(own, scales)).collect();
    let estimated: Vec<Vec<Vec<f64>>> = rounded.iter().map(of_all).collect();
    let described = readouts.iter().zip(labels).zip(&estimated).map(|((of, truth), estimated)| {
        let ((name, unit), count) = (of.task.name(), estimated.first().map_or(0, Vec::len));
        let what = match of.classes.is_empty() {
            true => format!("{count} value{}", if count == 1 { "" } else { "s" }),
            false => "class".into(),
        };
        format!("     {name}: {what}; held-out error {:.4} {unit}\n", of.error(truth, estimated))
    });
    let described: String = described.collect();
    let all = || rounded.iter().flat_map(|of| &of.outputs);
    let outputs = all().count();
    let classes: Vec<f64> = readouts.iter().flat_map(|of| of.classes.iter().copied()).collect();
    let bytes = numbers.bytes(false)[0] * outputs * blocks * channels;
    let tables = 4 * (2 * outputs + 2 * channels + classes.len() + 2 * readouts.len());
    let units = spec.sensors.read().iter().map(|channel| channel.name()).collect::<Vec<_>>().join(", ");
    let mut text = format!(
        "/* Readouts of sensing tasks on the {name} body of trial {hash}, by metasense {version}: C99, no heap, no library.

   Every {interval} s one reading: {units} of each sensor, one sensor after the other, in mm/s^2 and rad/s.
   Output: the estimates after {window} readings{from}, in this order (panels are numbered from 0):

{described}
     void brain_reset(void);                               before the first reading, if a window was not completed
     int brain_read(const float *reading, float *estimates);  1: that was the last reading of a window; 0: not yet

   On a 32-bit device: constants {constants} bytes, memory {memory} bytes, {operations} multiply-adds per reading.
   To test: cc -std=c99 -O2 -DBRAIN_TEST brain.c -o brain && ./brain */

#define BRAIN_INSTANTS {window}
#define REST {rest} /* quiet readings before the next contact */
#define BRAIN_CHANNELS {channels}
#define BRAIN_ESTIMATES {estimates}
#define BLOCK {block}
#define BLOCKS {blocks}
#define TASKS {tasks}
#define OUTPUTS {outputs}

",
        name = BodyState::ALL[body].word(),
        hash = stored.hash,
        version = env!("CARGO_PKG_VERSION"),
        interval = spec.time.duration / spec.time.samples as f64,
        constants = bytes.next_multiple_of(4) + tables,
        memory = 4 * (outputs + 2),
        operations = outputs * channels,
        estimates = estimated.iter().filter_map(|of| of.first()).map(Vec::len).sum::<usize>(),
        tasks = readouts.len(),
        from = if triggered { " from the first one above TRIGGER on" } else { "" },
    );
    text.push_str(match numbers {
        Numbers::F32 => "typedef float weight;\n",
        Numbers::I16 => "#include <stdint.h>\n\ntypedef int16_t weight;\n",
        Numbers::I8 => "#include <stdint.h>\n\ntypedef int8_t weight;\n",
    });
    let weights = || all().flat_map(|output| &output.weights);
    match numbers {
        Numbers::F32 => floats(&mut text, "weight W", weights().map(|w| *w as f32)),
        _ => whole(&mut text, "weight W", &weights().map(|w| *w as i64).collect::<Vec<_>>()),
    }
    let single = |text: &mut String, name: &str, values: &mut dyn Iterator<Item = f64>| {
        floats(text, &format!("float {name}"), values.map(|value| value as f32));
    };
    single(&mut text, "B", &mut all().map(|output| output.constant));
    single(&mut text, "STEP", &mut all().map(|output| output.step));
    single(&mut text, "SCALE", &mut scales.iter().copied());
    single(&mut text, "TRIGGER", &mut thresholds.iter().copied());
    // C has no empty arrays
    single(&mut text, "CLASS", &mut classes.into_iter().chain([0.0]));
    text.push_str("/* outputs and classes (0: values) of each task */\n");
    whole(&mut text, "int COUNT", &rounded.iter().map(|of| of.outputs.len()).collect::<Vec<_>>());
    whole(&mut text, "int KIND", &readouts.iter().map(|of| of.classes.len()).collect::<Vec<_>>());
    test(&mut text, &tested, readouts, &estimated);
    text.push_str(include_str!("readout.c"));
    Ok(text)
}

/// Signals and estimates of some samples.
fn test(text: &mut String, samples: &[(usize, &[f64])], readouts: &[Readout], estimated: &[Vec<Vec<f64>>]) {
    let values = samples.iter().map(|(_, record)| record.len()).sum::<usize>();
    writeln!(text, "\n#ifdef BRAIN_TEST\n#define SAMPLES {}\n#define VALUES {values}", samples.len())
        .expect("text");
    floats(text, "float SIGNALS", samples.iter().flat_map(|(_, record)| record.iter()).map(|x| *x as f32));
    let labels = samples.iter().flat_map(|(s, _)| estimated.iter().flat_map(move |of| &of[*s]));
    floats(text, "float ESTIMATES", labels.map(|label| *label as f32));
    let bounds = readouts.iter().zip(estimated).flat_map(|(of, estimated)| {
        let most = estimated.iter().flatten().fold(0.0_f64, |most, label| most.max(label.abs()));
        // classes must be equal
        let bound = if of.classes.is_empty() { BOUND * most } else { 1e-6 };
        vec![bound as f32; estimated.first().map_or(0, Vec::len)]
    });
    floats(text, "float BOUND", bounds);
    text.push_str("#endif\n");
}
