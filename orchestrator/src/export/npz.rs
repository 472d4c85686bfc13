//! A trial as a NumPy archive with all data for an independent evaluation.
//!
//! An npz file is a zip archive of npy files. Ours are uncompressed and have a fixed date, so that a trial always gives the same
//! bytes.

use std::io::{Cursor, Write};

use metasense_lab::replay::{drawing, linear};
use metasense_schemas::spec::{Brain, BrainKind, Network};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

use super::{bands, replays, unreadable};
use crate::analysis::BodyState;
use crate::reader::StoredTrial;
use crate::store::{StoreError, npy_bytes};

/// The archive of a trial, simulated again; `note` receives a message if no linear decoder can be fitted.
pub fn of_trial(
    stored: &StoredTrial,
    threads: usize,
    note: &mut dyn FnMut(String),
) -> Result<Vec<u8>, StoreError> {
    let drawn = |b: usize| drawing(&stored.specs[b], &stored.designs[b]).map_err(unreadable(stored));
    let (drawings, replays) = ([drawn(0)?, drawn(1)?], replays(stored, threads)?);
    let mut read = |b: usize| match linear(&stored.specs[b], &replays[b]) {
        Ok(brain) => brain,
        Err(why) => {
            note(format!("no linear decoder can be fitted: {why}"));
            None
        }
    };
    let linear = [read(0), read(1)];
    let (panels, instants) = (stored.spec().panel_units.len(), stored.spec().time.samples);
    let inputs = stored.spec().signals();
    let samples = replays[0].forces.samples;
    let mut zip = Zip::default();
    for body in BodyState::ALL {
        let (b, name) = (body as usize, body.name());
        let (drawing, replay) = (&drawings[b], &replays[b]);
        zip.array(&format!("alpha_{name}"), &[stored.designs[b].len()], &stored.designs[b]);
        let corners: Vec<f64> = drawing.units.iter().flatten().flatten().copied().collect();
        let of_each = drawing.units[0].len();
        if drawing.units.iter().all(|corners| corners.len() == of_each) {
            zip.array(&format!("vertices_{name}"), &[drawing.units.len(), of_each, 2], &corners);
        } else {
            let nodes: Vec<u64> = drawing.units.iter().map(|corners| corners.len() as u64).collect();
            zip.array(&format!("vertices_{name}"), &[corners.len() / 2, 2], &corners);
            zip.array(&format!("unit_nodes_{name}"), &[nodes.len()], &nodes);
        }
        zip.array(&format!("signals_{name}"), &[samples, instants, inputs], &replay.signals);
        let forces = [samples, instants, panels];
        if !replay.predictions.is_empty() {
            zip.array(&format!("predictions_{name}"), &forces, &replay.predictions);
            for (end, values) in bands(stored, replay, b) {
                zip.array(&format!("{end}_{name}"), &forces, &values);
            }
        }
        if let Some(brain) = &linear[b] {
            zip.array(&format!("linear_predictions_{name}"), &forces, &brain.predictions);
            zip.array(&format!("linear_w_{name}"), &[panels, brain.lags.count(), inputs], &brain.w);
            zip.array(&format!("linear_b_{name}"), &[panels], &brain.b);
        }
        if !stored.weights[b].is_empty() {
            let estimates = if stored.spec().brain.kind == BrainKind::Stacked { panels } else { 0 };
            for (part, shape, values) in
                parts(&stored.weights[b], &stored.spec().brain, inputs + estimates, panels)
            {
                zip.array(&format!("{part}_{name}"), &shape, values);
            }
        }
        zip.array(&format!("losses_{name}"), &[stored.losses[b].len()], &stored.losses[b]);
    }
    if let Some(brain) = linear.iter().flatten().next() {
        zip.array("linear_lags", &[2], &[-(brain.lags.before as i64), brain.lags.after as i64]);
    }
    let replay = &replays[0];
    zip.array("forces", &[samples, panels, instants + 1], &replay.forces.values);
    zip.array("split", &[samples], &replay.split);
    zip.array("signal_scale", &[inputs], &replay.signal_scale);
    if replay.has_offset() {
        zip.array("signal_offset", &[inputs], &replay.signal_offset);
    }
    if replays[1].signal_scale != replay.signal_scale {
        zip.array("signal_scale_optimised", &[inputs], &replays[1].signal_scale);
        let units: Vec<u64> = drawings[1].sensors.iter().map(|&unit| unit as u64).collect();
        zip.array("sensor_units_optimised", &[units.len()], &units);
    }
    zip.array("force_mean", &[panels], &replay.force_mean);
    zip.array("force_std", &[panels], &replay.force_deviation);
    zip.file("scene.npy", &text_array(&serde_json::to_string(stored.spec()).expect("a trial is JSON")));
    Ok(zip.finish())
}

/// Splits the flat weights b1 … bn, w1 … wn into parts with name and shape (kernel, in, out).
fn parts<'a>(
    weights: &'a [f32],
    brain: &Brain,
    inputs: usize,
    panels: usize,
) -> Vec<(String, Vec<usize>, &'a [f32])> {
    let Network { width, kernels, .. } = brain.network();
    let last = kernels.len() - 1;
    let outputs = |l: usize| if l == last { panels } else { width };
    let biases = (0..=last).map(|l| (format!("b{}", l + 1), vec![outputs(l)]));
    let kernels = kernels.iter().enumerate().map(|(l, &kernel)| {
        (format!("w{}", l + 1), vec![kernel, if l == 0 { inputs } else { width }, outputs(l)])
    });
    let mut rest = weights;
    biases
        .chain(kernels)
        .map(|(name, shape)| {
            let (part, after) = rest.split_at(shape.iter().product());
            rest = after;
            (name, shape, part)
        })
        .collect()
}

/// A 0-d array with one string.
fn text_array(text: &str) -> Vec<u8> {
    let count = text.chars().count();
    let mut header = format!("{{'descr': '<U{count}', 'fortran_order': False, 'shape': (), }}");
    // Magic, version and length are 10 bytes; the data start at a multiple of 64.
    let padded = (10 + header.len() + 1).next_multiple_of(64) - 10;
    header.push_str(&" ".repeat(padded - 1 - header.len()));
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.bytes());
    bytes.extend(text.chars().flat_map(|c| u32::from(c).to_le_bytes()));
    bytes
}

/// A zip archive under construction.
#[derive(Debug)]
pub struct Zip(ZipWriter<Cursor<Vec<u8>>>);

impl Default for Zip {
    fn default() -> Self {
        Self(ZipWriter::new(Cursor::new(Vec::new())))
    }
}

impl Zip {
    /// Adds an array as `name.npy`.
    ///
    /// # Panics
    /// If the shape does not match the number of values.
    pub fn array<T: npyz::AutoSerialize + Copy>(&mut self, name: &str, shape: &[usize], values: &[T]) {
        self.file(&format!("{name}.npy"), &npy_bytes(shape, values));
    }

    fn file(&mut self, name: &str, data: &[u8]) {
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
        let large = data.len() >= u32::MAX as usize;
        let options = options.last_modified_time(DateTime::default()).large_file(large);
        let begun = self.0.start_file(name, options);
        begun.and_then(|()| Ok(self.0.write_all(data)?)).expect("writing to memory");
    }

    /// The bytes of the archive.
    pub fn finish(self) -> Vec<u8> {
        self.0.finish().expect("writing to memory").into_inner()
    }
}

#[cfg(test)]
mod tests;
