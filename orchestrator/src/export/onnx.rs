//! A decoder as an ONNX graph from signals of whole samples to forces.
//!
//! ```text
//! signals (samples, instants, channels) → Transpose → [Conv → Relu]… → Conv → Transpose → forces (samples, instants, panels)
//! ```
//! A linear decoder before a network is a Conv, and a Concat of its input and its output.

use metasense_lab::replay::{Convolution, Replay, ReplayDecoder, layers};
use onnx_rs::ast::{
    Attribute, AttributeType, DataType, Dimension, Graph, Model, Node, OpType, OperatorSetId,
    StringStringEntry, TensorProto, TensorShape, TensorShapeDimension, TensorTypeProto, TypeProto, TypeValue,
    ValueInfo,
};

use super::unreadable;
use crate::analysis::BodyState;
use crate::reader::StoredTrial;
use crate::store::StoreError;

/// IR version and opset that runtimes since ONNX 1.9 (2021) read.
const FORMAT: (i64, i64) = (7, 13);

/// The encoded graph of a body's decoder.
pub fn onnx(
    stored: &StoredTrial,
    body: usize,
    (replay, own): &(Replay, ReplayDecoder),
) -> Result<Vec<u8>, StoreError> {
    let spec = &stored.specs[body];
    let layers = layers(spec, own, replay).map_err(unreadable(stored))?;
    let channels = spec.sensors.read().iter().map(|channel| channel.name()).collect::<Vec<_>>().join(", ");
    let interval = (spec.time.duration / spec.time.samples as f64).to_string();
    let name = BodyState::ALL[body].name();
    let said = format!(
        "signals: of each sensor {channels}, one sensor after the other (mm/s^2, rad/s), every {interval} s; forces: N, at the same instants"
    );
    let about =
        [("trial", stored.hash.as_str()), ("body", name), ("interval", &interval), ("channels", &channels)];
    let names: Vec<[String; 4]> =
        (0..layers.len()).map(|l| ["w", "b", "y", "x"].map(|what| format!("{what}{}", l + 1))).collect();
    let (first, last) = (&layers[0], &layers[layers.len() - 1]);
    let (input, output) = (vec![series("signals", first.inputs)], vec![series("forces", last.outputs)]);
    let node = vec![turned("signals", "x0")];
    let mut graph = Graph { name: "brain", input, output, node, ..Default::default() };
    let mut x = "x0";
    for (l, (layer, [w, b, y, after])) in layers.iter().zip(&names).enumerate() {
        let (shape, weights) = kernel(layer);
        graph.initializer.push(TensorProto::from_f32(w, shape, weights));
        let bias = layer.bias.iter().map(|b| *b as f32).collect();
        graph.initializer.push(TensorProto::from_f32(b, vec![layer.outputs as i64], bias));
        graph.node.push(Node {
            input: vec![x, w, b],
            output: vec![y],
            op_type: OpType::Conv,
            attribute: vec![
                integers("dilations", &[layer.dilation]),
                integers("pads", &[layer.before, layer.after()]),
            ],
            ..Default::default()
        });
        if l + 1 == layers.len() {
            x = y;
            break;
        }
        let axis = Attribute { name: "axis", r#type: AttributeType::Int, i: 1, ..Default::default() };
        let (input, op_type, attribute): (Vec<&str>, _, _) = match layer.linear {
            true => (vec![x, y], OpType::Concat, vec![axis]),
            false => (vec![y], OpType::Relu, Vec::new()),
        };
        graph.node.push(Node { input, output: vec![after], op_type, attribute, ..Default::default() });
        x = after;
    }
    graph.node.push(turned(x, "forces"));
    Ok(onnx_rs::encode(&Model {
        ir_version: FORMAT.0,
        opset_import: vec![OperatorSetId { domain: "", version: FORMAT.1 }],
        producer_name: "metasense",
        producer_version: env!("CARGO_PKG_VERSION"),
        doc_string: &said,
        metadata_props: about.map(|(key, value)| StringStringEntry { key, value }).to_vec(),
        graph: Some(graph),
        ..Default::default()
    }))
}

/// Weights (outputs, inputs, instants); instants that share a weight each get it.
fn kernel(layer: &Convolution) -> (Vec<i64>, Vec<f32>) {
    let reach: usize = layer.spans.iter().sum();
    let mut weights = vec![0.0; layer.outputs * layer.inputs * reach];
    for (i, w) in layer.weights.iter().enumerate() {
        let [input, output, tap] = layer.of_weight(i);
        let first: usize = layer.spans[..tap].iter().sum();
        weights[(output * layer.inputs + input) * reach + first..][..layer.spans[tap]].fill(*w as f32);
    }
    ([layer.outputs, layer.inputs, reach].map(|n| n as i64).to_vec(), weights)
}

/// Transposes (samples, instants, channels) to (samples, channels, instants), or back.
fn turned<'a>(from: &'a str, to: &'a str) -> Node<'a> {
    let attribute = vec![integers("perm", &[0, 2, 1])];
    Node { input: vec![from], output: vec![to], op_type: OpType::Transpose, attribute, ..Default::default() }
}

fn integers<'a>(name: &'a str, values: &[usize]) -> Attribute<'a> {
    let ints = values.iter().map(|n| *n as i64).collect();
    Attribute { name, r#type: AttributeType::Ints, ints, ..Default::default() }
}

/// A value (samples, instants, width).
fn series(name: &str, width: usize) -> ValueInfo<'_> {
    let dims = [Dimension::Param("samples"), Dimension::Param("instants"), Dimension::Value(width as i64)];
    let dim = dims.map(|value| TensorShapeDimension { value, denotation: "" }).to_vec();
    let tensor = TensorTypeProto { elem_type: DataType::Float, shape: Some(TensorShape { dim }) };
    let r#type = Some(TypeProto { value: Some(TypeValue::Tensor(tensor)), denotation: "" });
    ValueInfo { name, r#type, ..Default::default() }
}
