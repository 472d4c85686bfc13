//! Arrays of a result, written once into shared memory on their way to the database, as consecutive NPY files.

use std::mem::MaybeUninit;

use metasense_schemas::record::TrialResult;
use metasense_schemas::wire::ArrayHead;

/// Values of a one-dimensional array.
#[derive(Debug, Clone, PartialEq)]
enum Values {
    /// Single precision.
    F32(Vec<f32>),
    /// Double precision.
    F64(Vec<f64>),
}

impl Values {
    fn len(&self) -> usize {
        match self {
            Self::F32(values) => values.len(),
            Self::F64(values) => values.len(),
        }
    }

    fn bytes(&self) -> usize {
        self.len() * if let Self::F32(_) = self { 4 } else { 8 }
    }

    fn header(&self) -> Vec<u8> {
        match self {
            Self::F32(values) => header::<f32>(values.len()),
            Self::F64(values) => header::<f64>(values.len()),
        }
    }
}

/// Header of an NPY file of `len` values.
fn header<T: npyz::AutoSerialize>(len: usize) -> Vec<u8> {
    use npyz::WriterBuilder;
    let mut bytes = Vec::with_capacity(128);
    let options = npyz::WriteOptions::<T>::new().default_dtype().shape(&[len as u64]);
    // `write` appends the values in shared memory; drop the writer without them.
    drop(options.writer(&mut bytes).begin_nd().expect("writing to memory"));
    bytes
}

/// The arrays of one result.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Arrays {
    parts: Vec<(String, Vec<u8>, Values)>,
}

impl Arrays {
    /// Moves designs, weights and losses out of a result, under their names in the database. Leaves a result with less than
    /// `least` bytes of arrays unchanged.
    pub fn of(result: &mut TrialResult, least: usize) -> Self {
        let mut arrays = Self::default();
        if bytes(result) < least {
            return arrays;
        }
        for (body, evaluation) in [("initial", &mut result.initial), ("optimised", &mut result.optimised)] {
            arrays.add(format!("alpha_{body}"), Values::F64(std::mem::take(&mut evaluation.design)));
            let ordinary = evaluation.networks.len();
            let networks = evaluation.networks.iter_mut().chain(&mut evaluation.long);
            for (seed, network) in networks.enumerate() {
                let losses = if seed < ordinary { "losses" } else { "long_losses" };
                for (name, values) in [("weights", &mut network.weights), (losses, &mut network.losses)] {
                    if !values.is_empty() {
                        let values = Values::F32(std::mem::take(values));
                        arrays.add(format!("{name}_{body}_{seed}"), values);
                    }
                }
            }
        }
        arrays
    }

    fn add(&mut self, name: String, values: Values) {
        self.parts.push((name, values.header(), values));
    }

    /// Total size, headers included (bytes).
    pub fn len(&self) -> usize {
        self.parts.iter().map(|(_, header, values)| header.len() + values.bytes()).sum()
    }

    /// Whether there are no arrays.
    pub fn is_empty(&self) -> bool {
        self.parts.is_empty()
    }

    /// Name, shape and byte range of each array.
    pub fn heads(&self) -> Vec<ArrayHead> {
        let mut end = 0;
        let head = |(name, header, values): &(String, Vec<u8>, Values)| {
            let start = end;
            end += header.len() + values.bytes();
            ArrayHead { name: name.clone(), shape: vec![values.len()], start, end }
        };
        self.parts.iter().map(head).collect()
    }

    /// Writes every byte of `target`.
    ///
    /// # Panics
    /// If `target.len()` differs from [`Arrays::len`].
    pub fn write(&self, target: &mut [MaybeUninit<u8>]) {
        assert_eq!(target.len(), self.len(), "room for the arrays");
        let mut rest = target;
        for (_, header, values) in &self.parts {
            let (head, after) = rest.split_at_mut(header.len());
            head.write_copy_of_slice(header);
            let (body, after) = after.split_at_mut(values.bytes());
            match values {
                Values::F32(values) => drop(body.write_copy_of_slice(bytemuck::cast_slice(values))),
                Values::F64(values) => drop(body.write_copy_of_slice(bytemuck::cast_slice(values))),
            }
            rest = after;
        }
    }
}

/// Size of the arrays of a result (bytes).
fn bytes(result: &TrialResult) -> usize {
    let body = |evaluation: &metasense_schemas::record::BodyRecord| {
        let networks = evaluation.networks.iter().chain(&evaluation.long);
        let networks = networks.map(|n| 4 * (n.losses.len() + n.weights.len()));
        8 * evaluation.design.len() + networks.sum::<usize>()
    };
    body(&result.initial) + body(&result.optimised)
}

#[cfg(test)]
mod tests;
