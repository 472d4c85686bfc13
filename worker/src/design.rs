//! Design files: α as NPY (flat, the order of MODEL.md) or as CSV of nodes (`unit,node,x,y` in mm).

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

pub use metasense_numerics::body::{Layout, Pattern};
pub use metasense_numerics::feasible::{
    Active, Feasible, Kind, Limits, Projection, Stage, Status, Violation,
};
pub use metasense_numerics::random::{Purpose, Stream};

use crate::files;

/// Ends of one ligament may disagree by this much in a CSV of nodes (mm).
const AGREE: f64 = 1e-6;

/// A design file that cannot be read, written or understood.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DesignError {
    /// The file cannot be read or written.
    #[error("{doing} {}", path.display())]
    Io {
        /// "reading" or "writing".
        doing: &'static str,
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The name ends in neither `.npy` nor `.csv`.
    #[error("{}: a design is an .npy or a .csv file", path.display())]
    Ending {
        /// The file.
        path: PathBuf,
    },
    /// The content is not a design of this layout.
    #[error("{}: {what}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong, and what it should be.
        what: String,
    },
}

/// The design in a file, by its ending. NaN and infinity pass: what to do about them is the projection's business.
///
/// # Errors
/// Names the file, and what is wrong with it.
pub fn read(path: &Path, layout: &Layout) -> Result<Vec<f64>, DesignError> {
    let bytes = || std::fs::read(path).map_err(|e| io("reading", path, e));
    match ending(path) {
        Some("npy") => from_npy(&bytes()?, layout).map_err(|what| content(path, what)),
        Some("csv") => {
            let text = String::from_utf8(bytes()?).map_err(|e| content(path, e.to_string()))?;
            from_csv(&text, layout).map_err(|what| content(path, what))
        }
        _ => Err(DesignError::Ending { path: path.into() }),
    }
}

/// A design as the bytes of a file, by the ending of its name.
///
/// # Errors
/// Where it is another ending.
pub fn bytes(path: &Path, layout: &Layout, design: &[f64]) -> Result<Vec<u8>, DesignError> {
    match ending(path) {
        Some("npy") => Ok(files::npy_bytes(&[design.len()], design)),
        Some("csv") => Ok(to_csv(layout, design).into_bytes()),
        _ => Err(DesignError::Ending { path: path.into() }),
    }
}

fn ending(path: &Path) -> Option<&str> {
    path.extension().and_then(|e| e.to_str())
}

fn io(doing: &'static str, path: &Path, source: std::io::Error) -> DesignError {
    DesignError::Io { doing, path: path.into(), source }
}

fn content(path: &Path, what: String) -> DesignError {
    DesignError::Content { path: path.into(), what }
}

fn from_npy(bytes: &[u8], layout: &Layout) -> Result<Vec<f64>, String> {
    let values = files::array(bytes)?.values;
    match (values.len(), layout.design_len()) {
        (count, wanted) if count == wanted => Ok(values),
        (count, wanted) => Err(format!("holds {count} numbers; α of this body has {wanted}")),
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

fn from_csv(text: &str, layout: &Layout) -> Result<Vec<f64>, String> {
    let head = text.lines().next().unwrap_or_default();
    if head.trim_start_matches('\u{feff}').split(',').map(str::trim).ne(["unit", "node", "x", "y"]) {
        return Err(format!("line 1: {head:?}; must be unit,node,x,y"));
    }
    let undisplaced = layout.vertices(&vec![0.0; layout.design_len()]);
    let mut shifts: Vec<Option<[f64; 2]>> = vec![None; layout.group_count];
    for (number, line) in text.lines().enumerate().skip(1).filter(|(_, line)| !line.trim().is_empty()) {
        let at = |what: &str| format!("line {}: {what}", number + 1);
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        let [unit, node, x, y] = fields[..] else { return Err(at("must be unit,node,x,y")) };
        let (Ok(unit), Ok(node), Ok(x), Ok(y)) =
            (unit.parse::<usize>(), node.parse::<usize>(), x.parse::<f64>(), y.parse::<f64>())
        else {
            return Err(at("must be unit,node,x,y: two whole numbers and two lengths in mm"));
        };
        if !(x.is_finite() && y.is_finite()) {
            return Err(at("x and y must be finite"));
        }
        if unit >= layout.units() || node >= layout.shape[unit].len() {
            let nodes = layout.shape.get(unit).unwrap_or(&layout.shape[0]).len();
            return Err(at(&format!("units are 0 to {}, nodes 0 to {}", layout.units() - 1, nodes - 1)));
        }
        let [x0, y0] = undisplaced[unit][node];
        let shift = [x - x0, y - y0];
        match &shifts[layout.groups[unit][node]] {
            Some(other) if (0..2).any(|c| (other[c] - shift[c]).abs() > AGREE) => {
                return Err(at(
                    "is shifted otherwise than its ligament's other end, or than the same node in another line",
                ));
            }
            Some(_) => {}
            None => shifts[layout.groups[unit][node]] = Some(shift),
        }
    }
    let missing = |g: usize| {
        let of = |unit: &usize| layout.groups[*unit].contains(&g);
        let unit = (0..layout.units()).find(of).unwrap_or(0);
        let node = layout.groups[unit].iter().position(|&h| h == g).unwrap_or(0);
        format!("unit {unit}, node {node} is missing")
    };
    let shifts: Result<Vec<[f64; 2]>, String> =
        shifts.into_iter().enumerate().map(|(g, shift)| shift.ok_or_else(|| missing(g))).collect();
    Ok(shifts?.into_iter().flatten().collect())
}

#[cfg(test)]
mod tests;
