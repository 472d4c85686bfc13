//! Design files: α as NPY (flat, in the order of MODEL.md) or as CSV of nodes (`unit,node,x,y` in mm).

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

pub use metasense_numerics::body::{Layout, Pattern};
pub use metasense_numerics::feasible::{
    Active, FeasibleSet, Limits, Projection, Stage, Status, Violation, ViolationKind, overlaps,
};
pub use metasense_numerics::random::{Purpose, Stream};

use metasense_schemas::spec::Signal;

use crate::files::{self, Array, ColumnTable, Form};

/// Largest difference between the shifts of the two ends of a ligament in a CSV of nodes (mm).
const AGREE: f64 = 1e-6;

/// A design file that cannot be read, or has an invalid name or content.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum DesignError {
    /// The file cannot be read.
    #[error("reading {}", path.display())]
    Io { path: PathBuf, source: std::io::Error },
    /// The name ends in neither `.npy` nor `.csv`.
    #[error("{}: a design must be an .npy or a .csv file", path.display())]
    Ending { path: PathBuf },
    /// The content is not a design of this layout.
    #[error("{}: {what}", path.display())]
    Content { path: PathBuf, what: String },
}

/// Reads a design: NPY of α, or CSV of nodes, by the file's extension.
///
/// # Errors
/// Names the file and the fault.
pub fn read(path: &Path, layout: &Layout) -> Result<Vec<f64>, DesignError> {
    let content = |what| DesignError::Content { path: path.into(), what };
    match files::ending(path).as_str() {
        "npy" => read_array(path, layout.design_len()),
        "csv" => from_csv(&bytes_of(path)?, layout).map_err(content),
        _ => Err(DesignError::Ending { path: path.into() }),
    }
}

/// Reads a design of so many numbers from an NPY file.
///
/// # Errors
/// Names the file and the fault.
pub fn read_array(path: &Path, numbers: usize) -> Result<Vec<f64>, DesignError> {
    let found = files::array(&bytes_of(path)?).and_then(|Array { shape, values }| {
        check("the array", &shape, &values, numbers)?;
        Ok(values)
    });
    found.map_err(|what| DesignError::Content { path: path.into(), what })
}

/// Checks that an array is a design of `length` numbers: of shape (n), or (n/2, 2) with one shift (x, y) per row.
///
/// # Errors
/// Names the shape, or the first number that is not finite.
pub fn check(what: &str, shape: &[usize], values: &[f64], length: usize) -> Result<(), String> {
    if shape != [length] && shape != [length / 2, 2] {
        return Err(format!(
            "{what} has shape {shape:?} and {} numbers; α of this body has {length} numbers, in shape [{length}] or [{}, 2]",
            values.len(),
            length / 2
        ));
    }
    finite(what, values)
}

/// Rejects NaN and infinity; names the index of the first.
pub fn finite(what: &str, values: &[f64]) -> Result<(), String> {
    match values.iter().position(|x| !x.is_finite()) {
        None => Ok(()),
        Some(at) => Err(format!("{what}: number {at} is {}, which is not finite", values[at])),
    }
}

/// Contents of a design file.
pub(crate) fn bytes_of(path: &Path) -> Result<Vec<u8>, DesignError> {
    files::read(path).map_err(|source| DesignError::Io { path: path.into(), source })
}

/// Encodes a design in the format of the file's extension.
///
/// # Errors
/// If the extension is neither `.npy` nor `.csv`.
pub fn bytes(path: &Path, layout: &Layout, design: &[f64]) -> Result<Vec<u8>, DesignError> {
    match files::ending(path).as_str() {
        "npy" => Ok(files::npy_bytes(&[design.len()], design)),
        "csv" => Ok(to_csv(layout, design).into_bytes()),
        _ => Err(DesignError::Ending { path: path.into() }),
    }
}

fn to_csv(layout: &Layout, design: &[f64]) -> String {
    let mut text = String::from("unit,node,x,y\n");
    for (unit, corners) in layout.vertices(design).iter().enumerate() {
        for (node, [x, y]) in corners.iter().enumerate() {
            let _ = writeln!(text, "{unit},{node},{x},{y}");
        }
    }
    text
}

fn from_csv(bytes: &[u8], layout: &Layout) -> Result<Vec<f64>, String> {
    let names = ["unit", "node", "x", "y"].map(|name| Signal::Name(name.into()));
    let table = ColumnTable::parse(bytes, &Form { read: Some(names.iter().collect()), ..Form::default() })
        .map_err(|what| format!("{what} (a design has the columns unit, node, x, y)"))?;
    let [units, nodes, xs, ys] =
        names.each_ref().map(|name| table.column(name).map(|column| table.values(column)));
    let (units, nodes, xs, ys) = (units?, nodes?, xs?, ys?);
    let undisplaced = layout.vertices(&vec![0.0; layout.design_len()]);
    let mut shifts: Vec<Option<[f64; 2]>> = vec![None; layout.groups.count()];
    for (row, ((unit, node), (x, y))) in units.iter().zip(nodes).zip(xs.iter().zip(ys)).enumerate() {
        let at = |what: &str| format!("{}: {what}", table.place(row));
        let whole = |name: &str, number: f64, count: usize| match number.fract() == 0.0
            && (0.0..count as f64).contains(&number)
        {
            true => Ok(number as usize),
            false => Err(at(&format!("{name} = {number}: must be an integer from 0 to {}", count - 1))),
        };
        let unit = whole("unit", *unit, layout.units())?;
        let node = whole("node", *node, layout.shape[unit].len())?;
        let [x0, y0] = undisplaced[unit][node];
        let shift = [x - x0, y - y0];
        // Nodes of rigid units that stay or follow other nodes have no shift.
        let Some(group) = layout.groups.of_nodes[unit][node] else { continue };
        match &shifts[group] {
            Some(group_shift) if (0..2).any(|c| (group_shift[c] - shift[c]).abs() > AGREE) => {
                return Err(at(
                    "its shift differs from that of the other end of its ligament, or of the same node in another line",
                ));
            }
            Some(_) => {}
            None => shifts[group] = Some(shift),
        }
    }
    let missing = |g: usize| {
        let of = |unit: &usize| layout.groups.of_nodes[*unit].contains(&Some(g));
        let unit = (0..layout.units()).find(of).unwrap_or(0);
        let node = layout.groups.of_nodes[unit].iter().position(|h| *h == Some(g)).unwrap_or(0);
        format!("unit {unit}, node {node} is missing")
    };
    let shifts: Result<Vec<[f64; 2]>, String> =
        shifts.into_iter().enumerate().map(|(g, shift)| shift.ok_or_else(|| missing(g))).collect();
    Ok(shifts?.into_iter().flatten().collect())
}

#[cfg(test)]
mod tests;
