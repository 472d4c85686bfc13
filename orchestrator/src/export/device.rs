//! A brain as one C file: readings in, forces out, one after the other, for a device without heap and operating system.

use std::fmt::Write;

use metasense_worker::replay::{Convolution, Replay, layers};

use super::unreadable;
use crate::analysis::Body;
use crate::store::{StoreError, Stored};

/// Samples that the file is tested with, of the holdout.
const TESTED: usize = 2;
/// Their forces may differ by so much of the largest: what 32-bit numbers cost.
const BOUND: f64 = 1e-3;

/// The C99 source of a body's brain.
///
/// # Errors
/// If the trial cannot be computed again.
pub fn c(stored: &Stored, body: usize, replay: &Replay) -> Result<String, StoreError> {
    let (spec, weights) = (&stored.specs[body], &stored.weights[body]);
    let layers = layers(spec, weights, replay).map_err(unreadable(stored))?;
    let [channels, panels] = [layers[0].inputs, layers[layers.len() - 1].outputs];
    let after = |layer: &Convolution| (layer.taps - 1) * layer.dilation - layer.before;
    let slots = |layer: &Convolution| (layer.taps - 1) * layer.dilation + 1;
    let widest = layers.iter().map(|layer| layer.outputs).max().unwrap_or(0);
    let numbers: usize = layers.iter().map(|layer| layer.weights.len() + layer.bias.len()).sum();
    let held: usize = layers.iter().map(|layer| slots(layer) * layer.inputs).sum();
    let products: usize = layers.iter().map(|layer| layer.weights.len()).sum();
    let delay: usize = layers.iter().map(after).sum();
    let interval = spec.time.duration / spec.time.samples as f64;
    let units = spec.sensors.read().iter().map(|channel| channel.name()).collect::<Vec<_>>().join(", ");
    let mut text = format!(
        "/* The brain of the {name} body of trial {hash}, by metasense {version}: C99, 32-bit numbers, no heap, no library.

   Every {interval} s one reading: {units} of each sensor, one sensor after the other, in mm/s^2 and rad/s.
   It answers with the forces (N) on {panels} panels, {delay} readings ({late:.3} s) later.

     void brain_reset(void);                           before the first reading
     int brain_read(const float *reading, float *force);  1: force is that of BRAIN_DELAY readings ago; 0: not yet
     int brain_end(float *force);                      after the last reading, until it returns 0: those that are left

   Constants {flash} bytes, memory {ram} bytes, {products} multiply-adds a reading.
   To test it: cc -std=c99 -O2 -DBRAIN_TEST brain.c -o brain && ./brain */

#define BRAIN_CHANNELS {channels}
#define BRAIN_PANELS {panels}
#define BRAIN_DELAY {delay}
",
        name = Body::ALL[body].name(),
        hash = stored.hash,
        version = env!("CARGO_PKG_VERSION"),
        late = delay as f64 * interval,
        flash = 4 * numbers,
        ram = 4 * (held + 2 * widest) + 12 * layers.len(),
    );
    for (l, layer) in layers.iter().enumerate() {
        array(&mut text, &format!("static const float W{l}[]"), layer.weights.iter().copied());
        array(&mut text, &format!("static const float B{l}[]"), layer.bias.iter().copied());
        writeln!(text, "static float R{l}[{}];", slots(layer) * layer.inputs).expect("text");
    }
    let row = |(l, layer): (usize, &Convolution)| {
        let Convolution { dilation, inputs, outputs, rectified, .. } = layer;
        let (taps, after, slots, rectified) =
            (layer.taps, after(layer), slots(layer), usize::from(*rectified));
        format!(
            "    {{{taps}, {dilation}, {after}, {slots}, {inputs}, {outputs}, {rectified}, W{l}, B{l}, R{l}}},\n"
        )
    };
    let rows: String = layers.iter().enumerate().map(row).collect();
    let count = layers.len();
    write!(text, "\n#define LAYERS {count}\n#define WIDEST {widest}\n{TYPE}static const layer LAYER[] = {{\n{rows}}};\n{CODE}")
        .expect("text");
    test(&mut text, replay, [channels, panels]);
    Ok(text)
}

/// Readings and forces of some samples, and a program that compares.
fn test(text: &mut String, replay: &Replay, [channels, panels]: [usize; 2]) {
    let samples = (0..replay.split.len()).filter(|&i| replay.split[i] == 2 && !replay.failed[i]);
    let samples: Vec<usize> = samples.take(TESTED).collect();
    let one = replay.signals.len() / replay.split.len();
    let instants = one / channels;
    let signals = samples.iter().flat_map(|i| &replay.signals[i * one..][..one]).copied();
    let one = instants * panels;
    let forces: Vec<f64> =
        samples.iter().flat_map(|i| &replay.predictions[i * one..][..one]).copied().collect();
    let most = forces.iter().fold(0.0_f64, |most, f| most.max(f.abs()));
    text.push_str("\n#ifdef BRAIN_TEST\n#include <stdio.h>\n\n");
    writeln!(text, "#define SAMPLES {}\n#define INSTANTS {instants}", samples.len()).expect("text");
    writeln!(text, "static const float BOUND = {:e}f; /* N */", (BOUND * most) as f32).expect("text");
    array(text, "static const float READINGS[]", signals);
    array(text, "static const float FORCES[]", forces.into_iter());
    text.push_str(TEST);
}

/// Numbers of a C array, so many a line.
fn array(text: &mut String, name: &str, values: impl Iterator<Item = f64>) {
    write!(text, "{name} = {{").expect("text");
    for (i, value) in values.enumerate() {
        text.push_str(if i % 8 == 0 { "\n    " } else { " " });
        write!(text, "{:e}f,", value as f32).expect("text");
    }
    text.push_str("\n};\n");
}

const TYPE: &str = "
/* A layer: taps, instants between them, instants that it looks ahead, inputs that it holds, widths, whether it cuts off what is negative. */
typedef struct {
    int taps, dilation, after, slots, in, out, rectified;
    const float *w, *b;
    float *ring;
} layer;

";

const CODE: &str = "
static int newest[LAYERS], known[LAYERS], ended[LAYERS];
static float made[2][WIDEST];

void brain_reset(void)
{
    for (int l = 0; l < LAYERS; l++) {
        newest[l] = known[l] = ended[l] = 0;
        for (int i = 0; i < LAYER[l].slots * LAYER[l].in; i++) LAYER[l].ring[i] = 0.0f;
    }
}

/* Takes one more input, zero if there is none, and makes an output once there are enough. */
static int push(int l, const float *input, float *output)
{
    const layer *of = &LAYER[l];
    newest[l] = (newest[l] + 1) % of->slots;
    for (int c = 0; c < of->in; c++) of->ring[newest[l] * of->in + c] = input ? input[c] : 0.0f;
    if (known[l] < of->after) {
        known[l]++;
        return 0;
    }
    for (int o = 0; o < of->out; o++) output[o] = of->b[o];
    int at = newest[l];
    for (int i = 0; i < of->taps; i++) {
        const float *x = of->ring + (at + 1) % of->slots * of->in, *w = of->w + i * of->in * of->out;
        for (int c = 0; c < of->in; c++)
            for (int o = 0; o < of->out; o++) output[o] += x[c] * w[c * of->out + o];
        at = (at + of->dilation) % of->slots;
    }
    for (int o = 0; o < of->out && of->rectified; o++) output[o] = output[o] > 0.0f ? output[o] : 0.0f;
    return 1;
}

static int through(int l, const float *input, float *force)
{
    for (; l < LAYERS; l++) {
        float *output = l + 1 == LAYERS ? force : made[l % 2];
        if (!push(l, input, output)) return 0;
        input = output;
    }
    return 1;
}

int brain_read(const float *reading, float *force)
{
    return through(0, reading, force);
}

int brain_end(float *force)
{
    for (int l = 0; l < LAYERS; l++)
        while (ended[l] < LAYER[l].after) {
            ended[l]++;
            if (through(l, 0, force)) return 1;
        }
    return 0;
}
";

const TEST: &str = "
int main(void)
{
    float greatest = 0.0f, force[BRAIN_PANELS];
    for (int s = 0; s < SAMPLES; s++) {
        const float *expected = FORCES + s * INSTANTS * BRAIN_PANELS;
        int told = 0;
        brain_reset();
        for (int n = 0; n < 2 * INSTANTS && told < INSTANTS; n++) {
            const float *reading = READINGS + (s * INSTANTS + n) * BRAIN_CHANNELS;
            if (!(n < INSTANTS ? brain_read(reading, force) : brain_end(force))) continue;
            for (int k = 0; k < BRAIN_PANELS; k++) {
                float off = force[k] - expected[told * BRAIN_PANELS + k];
                off = off < 0.0f ? -off : off;
                if (!(off <= greatest)) greatest = off;
            }
            told++;
        }
        if (told < INSTANTS || brain_end(force)) {
            printf(\"sample %d: %d of %d instants told\\n\", s, told, INSTANTS);
            return 1;
        }
    }
    printf(\"greatest difference %g N, allowed %g N\\n\", greatest, BOUND);
    return greatest <= BOUND ? 0 : 1;
}
#endif
";
