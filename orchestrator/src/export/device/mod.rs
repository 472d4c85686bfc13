//! A decoder as one C file: readings in, forces out, one after the other, for a device without heap and operating system.
//!
//! The C is in files beside this one: `layers.c`; `linear.c`, `network.c` or both; `floats.c` or `integers.c`; `readings.c`;
//! `test.c`.

pub mod readout;

use std::fmt::{Display, Write};

use clap::ValueEnum;
use metasense_lab::demands::Demands;
use metasense_lab::replay::{
    Convolution, Integers, Replay, ReplayDecoder, SinglePrecision, holdout_error, layers,
};

use super::{FitData, unreadable};
use crate::analysis::BodyState;
use crate::reader::StoredTrial;
use crate::store::StoreError;

/// Number of held-out samples in the file's test.
const TESTED: usize = 2;
/// Allowed difference from the trial's forces, relative to the largest: rounding in 32-bit floats; with integers, in the last
/// multiplication.
const BOUNDS: [f64; 2] = [1e-3, 1e-6];

/// Number format of a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Numbers {
    /// 32-bit floats
    F32,
    /// 16-bit integers
    I16,
    /// 8-bit weights, 16-bit signals and activations
    I8,
}

impl Numbers {
    /// Bytes of a weight, of a value between layers, and of a sum, which is `wide` or not.
    fn bytes(self, wide: bool) -> [usize; 3] {
        let sum = if wide { 8 } else { 4 };
        match self {
            Self::F32 => [4, 4, sum],
            Self::I16 => [2, 2, sum],
            Self::I8 => [1, 2, sum],
        }
    }

    /// The greatest integer weight.
    fn most(self) -> Option<i64> {
        match self {
            Self::F32 => None,
            Self::I16 => Some(i16::MAX.into()),
            Self::I8 => Some(i8::MAX.into()),
        }
    }
}

/// C99 source of a body's decoder, fitted to the body or to casts of it.
pub fn c(
    stored: &StoredTrial,
    body: usize,
    fit: FitData,
    (replay, own): &(Replay, ReplayDecoder),
    numbers: Numbers,
) -> Result<String, StoreError> {
    let spec = &stored.specs[body];
    let layers = layers(spec, own, replay).map_err(unreadable(stored))?;
    let [channels, panels] = [layers[0].inputs, layers[layers.len() - 1].outputs];
    let single = SinglePrecision::new(&layers);
    let integers = numbers.most().map(|most| Integers::new(&layers, most, replay));
    let error = |read: &dyn Fn(&[f64]) -> Vec<f32>| {
        holdout_error(replay, read).map_or("none".into(), |error| format!("{error:.3} %"))
    };
    let mut errors = format!("{} in f32", error(&|signals| single.read(signals)));
    let wide = integers.as_ref().is_some_and(|integers| integers.bound > i64::from(i32::MAX));
    let number_format = match &integers {
        None => "32-bit floats".to_owned(),
        Some(integers) => {
            write!(errors, ", {} in these integers", error(&|signals| integers.read(signals))).expect("text");
            let weights = if numbers == Numbers::I8 { 8 } else { 16 };
            let sums = if wide { 64 } else { 32 };
            format!(
                "{weights}-bit weights, 16-bit signals and activations, {sums}-bit sums (none exceeds {})",
                integers.bound
            )
        }
    };
    let linear = layers[0].linear;
    let Demands { delay, constants, memory, operations } = Demands::of(&layers, numbers.bytes(wide));
    let interval = spec.time.duration / spec.time.samples as f64;
    let units = spec.sensors.read().iter().map(|channel| channel.name()).collect::<Vec<_>>().join(", ");
    let mut text = format!(
        "/* The decoder {of}the {name} body of trial {hash}, by metasense {version}: C99, no heap, no library.

   Every {interval} s one reading: {units} of each sensor, one sensor after the other, in mm/s^2 and rad/s.
   Output: the forces (N) on {panels} panels, {delay} readings ({late:.3} s) later.

     void brain_reset(void);                           before the first reading
     int brain_read(const float *reading, float *force);  1: force is that of BRAIN_DELAY readings ago; 0: not yet
     int brain_end(float *force);                      after the last reading, until it returns 0: the remaining forces

   Numbers: {number_format}.
   Held-out error of the body as designed: {errors}.
   On a 32-bit device: constants {constants} bytes, memory {memory} bytes, {operations} multiply-adds per reading.
   To test: cc -std=c99 -O2 -DBRAIN_TEST brain.c -o brain && ./brain */
",
        of = if fit == FitData::Casts { "for all casts of " } else { "of " },
        name = BodyState::ALL[body].word(),
        hash = stored.hash,
        version = env!("CARGO_PKG_VERSION"),
        late = delay as f64 * interval,
    );
    let (count, widest) = (layers.len(), Convolution::widest(&layers));
    write!(
        text,
        "
#define BRAIN_CHANNELS {channels}
#define BRAIN_PANELS {panels}
#define BRAIN_DELAY {delay}
#define LAYERS {count}
#define LINEAR {} /* whether the first layer is a linear decoder */
#define WIDEST {widest}

{}{}
{}",
        u8::from(linear),
        if integers.is_some() { "#include <stdint.h>\n\n#define GREATEST 32767\n\n" } else { "" },
        types(numbers, wide),
        structure(integers.is_some()),
    )
    .expect("text");
    arrays(&mut text, &layers, integers.as_ref());
    text.push_str(include_str!("layers.c"));
    text.push_str(if linear { include_str!("linear.c") } else { "" });
    text.push_str(if count > usize::from(linear) { include_str!("network.c") } else { "" });
    text.push_str(if integers.is_some() { include_str!("integers.c") } else { include_str!("floats.c") });
    text.push_str(include_str!("readings.c"));
    test(&mut text, replay, integers.as_ref(), [channels, panels]);
    Ok(text)
}

/// C types of weights, values between layers, biases and sums.
fn types(numbers: Numbers, wide: bool) -> String {
    let names = match numbers {
        Numbers::F32 => return "typedef float weight, value, wide, sum;\n".into(),
        Numbers::I16 => ["int16_t", "int16_t", "int32_t"],
        Numbers::I8 => ["int8_t", "int16_t", "int32_t"],
    };
    let sum = if wide { "int64_t" } else { "int32_t" };
    let [weight, value, bias] = names;
    format!("typedef {weight} weight;\ntypedef {value} value;\ntypedef {bias} wide;\ntypedef {sum} sum;\n")
}

/// C type of a layer.
fn structure(integers: bool) -> String {
    let rescaled = if integers { "    const int32_t *factor;\n    const uint8_t *shift;\n" } else { "" };
    format!(
        "/* A layer: taps, instants between them, instants that it looks ahead, inputs that it holds, widths. */
typedef struct {{
    int taps, dilation, after, slots, in, out;
    const weight *w;
    const wide *b;
{rescaled}    value *ring;
}} layer;

"
    )
}

/// Constants, ring buffers, and the table of layers.
fn arrays(text: &mut String, layers: &[Convolution], integers: Option<&Integers>) {
    let mut rows = String::new();
    for (l, layer) in layers.iter().enumerate() {
        let mut rescaled = String::new();
        match integers {
            None => {
                floats(text, &format!("weight W{l}"), layer.weights.iter().map(|w| *w as f32));
                floats(text, &format!("wide B{l}"), layer.bias.iter().map(|b| *b as f32));
            }
            Some(integers) => {
                let of = &integers.layers[l];
                whole(text, &format!("weight W{l}"), &of.weights);
                whole(text, &format!("wide B{l}"), &of.bias);
                rescaled = " 0, 0,".into();
                if !of.factor.is_empty() {
                    whole(text, &format!("int32_t F{l}"), &of.factor);
                    whole(text, &format!("uint8_t S{l}"), &of.shift);
                    rescaled = format!(" F{l}, S{l},");
                }
            }
        }
        writeln!(text, "static value R{l}[{}];", layer.slots() * layer.inputs).expect("text");
        let Convolution { dilation, inputs, outputs, .. } = layer;
        let (taps, after, slots) = (layer.spans.len(), layer.after(), layer.slots());
        let sizes = format!("{taps}, {dilation}, {after}, {slots}, {inputs}, {outputs}");
        rows += &format!("    {{{sizes}, W{l}, B{l},{rescaled} R{l}}},\n");
        if layer.linear {
            writeln!(text, "#define TAPS {taps}").expect("text");
            whole(text, "unsigned char SPAN", &layer.spans);
        }
    }
    if let Some(integers) = integers {
        floats(text, "float HALF_STEPS", integers.half_steps.iter().copied());
        floats(text, "float FORCE", integers.forces.iter().copied());
    }
    write!(text, "\nstatic const layer LAYER[] = {{\n{rows}}};\n").expect("text");
}

/// Readings and forces of some samples, and a program that compares them.
fn test(text: &mut String, replay: &Replay, integers: Option<&Integers>, [channels, panels]: [usize; 2]) {
    let samples = (0..replay.split.len()).filter(|&i| replay.split[i] == 2 && !replay.failed[i]);
    let samples: Vec<usize> = samples.take(TESTED).collect();
    let one = replay.signals.len() / replay.split.len();
    let instants = one / channels;
    let signals = || samples.iter().map(|i| &replay.signals[i * one..][..one]);
    let sums: Option<Vec<i64>> = integers.map(|integers| signals().flat_map(|s| integers.sums(s)).collect());
    let forces: Vec<f32> = match (integers, &sums) {
        (Some(integers), Some(sums)) => integers.forces_of(sums),
        _ => {
            let one = instants * panels;
            let said = samples.iter().flat_map(|i| &replay.predictions[i * one..][..one]);
            said.map(|f| *f as f32).collect()
        }
    };
    let most = forces.iter().fold(0.0_f32, |most, f| most.max(f.abs()));
    let bound = BOUNDS[usize::from(integers.is_some())] as f32 * most;
    text.push_str("\n#ifdef BRAIN_TEST\n#include <stdio.h>\n\n");
    writeln!(text, "#define SAMPLES {}\n#define INSTANTS {instants}", samples.len()).expect("text");
    writeln!(text, "static const float BOUND = {bound:e}f; /* N */").expect("text");
    floats(text, "float READINGS", signals().flatten().map(|v| *v as f32));
    floats(text, "float FORCES", forces.into_iter());
    if let Some(sums) = &sums {
        whole(text, "sum SUMS", sums);
    }
    for line in include_str!("test.c").lines() {
        match line.strip_suffix(" //integers") {
            Some(_) if sums.is_none() => {}
            own => text.extend([own.unwrap_or(line), "\n"]),
        }
    }
}

/// A constant array of floats.
fn floats(text: &mut String, name: &str, values: impl Iterator<Item = f32>) {
    array(text, name, values.map(|value| format!("{value:e}f")));
}

/// A constant array of integers.
fn whole(text: &mut String, name: &str, values: &[impl Display]) {
    array(text, name, values.iter().map(ToString::to_string));
}

/// A constant C array, twelve numbers per line.
fn array(text: &mut String, name: &str, values: impl Iterator<Item = String>) {
    write!(text, "static const {name}[] = {{").expect("text");
    for (i, value) in values.enumerate() {
        text.push_str(if i % 12 == 0 { "\n    " } else { " " });
        write!(text, "{value},").expect("text");
    }
    text.push_str("\n};\n");
}
