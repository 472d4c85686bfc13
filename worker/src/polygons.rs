//! Bodies of arbitrary polygons, read from files and converted to layouts.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use metasense_numerics::body::{End, FollowRule, Follower, Layout, moments};
use metasense_schemas::spec::{Denser, Follow, FollowBy, Polygons, Signal};

use crate::design::{self, DesignError};
use crate::files::{self, Array, Content, Form};
use crate::invalid::{Invalid, invalid};

/// Number of nodes of an ordinary and of a rigid unit.
const NODES: std::ops::RangeInclusive<usize> = 3..=12;
const NODES_OF_RIGID: std::ops::RangeInclusive<usize> = 3..=1000;
/// Largest number of units, as for lattices.
const UNITS_MAX: usize = 10_000;

/// Reads polygons: TOML of [`Polygons`], or an NPZ as DifFlexMM describes bodies: `block_centroids` (units, 2),
/// `centroid_node_vectors` (units, nodes, 2), `bond_connectivity` (ligaments, 2) of nodes counted over all units. [`layout`]
/// checks their consistency.
///
/// # Errors
/// Names the file and the fault.
pub fn read(path: &Path) -> Result<Polygons, DesignError> {
    let bytes = design::bytes_of(path)?;
    let content = |what: String| DesignError::Content { path: path.into(), what };
    match files::ending(path).as_str() {
        "toml" => toml::from_str(files::text(&bytes).map_err(content)?)
            .map_err(|e| content(e.to_string().trim_end().into())),
        "npz" => of_archive(path, &bytes).map_err(content),
        _ => Err(content("must be a .toml or .npz file".into())),
    }
}

/// The arrays that an NPZ must contain.
const ARRAYS: [&str; 3] = ["block_centroids", "centroid_node_vectors", "bond_connectivity"];

fn of_archive(path: &Path, bytes: &[u8]) -> Result<Polygons, String> {
    let names = ARRAYS.map(|name| Signal::Name(name.into()));
    let form = Form { read: Some(names.iter().collect()), ..Form::default() };
    let Content::Archive(arrays) = files::content(path, bytes, &form)? else {
        return Err("is not an archive".into());
    };
    let array = |name: &str| -> Result<&Array, String> {
        let found =
            arrays.get(name).and_then(Option::as_ref).ok_or_else(|| format!("has no array {name}"))?;
        found.as_ref().map_err(|what| format!("{name} {what}"))
    };
    let [centroids, nodes, bonds] = [array(ARRAYS[0])?, array(ARRAYS[1])?, array(ARRAYS[2])?];
    let [count, of_each] = match (&centroids.shape[..], &nodes.shape[..], &bonds.shape[..]) {
        (&[units, 2], &[other, each, 2], &[_, 2]) if units == other && each > 0 => [units, each],
        (units, nodes, bonds) => {
            return Err(format!(
                "block_centroids, centroid_node_vectors and bond_connectivity are of shapes {units:?}, {nodes:?}, {bonds:?}; must be \
                 [units, 2], [units, nodes, 2], [ligaments, 2]"
            ));
        }
    };
    let node = |u: usize, p: usize| {
        [0, 1].map(|d| centroids.values[2 * u + d] + nodes.values[2 * (u * of_each + p) + d])
    };
    let nodes_in_all = count * of_each;
    let end = |(n, number): (usize, &f64)| match number.fract() == 0.0
        && (0.0..nodes_in_all as f64).contains(number)
    {
        true => Ok([*number as usize / of_each, *number as usize % of_each]),
        false => Err(format!(
            "bond_connectivity[{}, {}] = {number}: must be the number of a node, from 0 to {}",
            n / 2,
            n % 2,
            nodes_in_all - 1
        )),
    };
    let ends = bonds.values.iter().enumerate().map(end).collect::<Result<Vec<_>, String>>()?;
    Ok(Polygons {
        units: (0..count).map(|u| (0..of_each).map(|p| node(u, p)).collect()).collect(),
        ligaments: ends
            .chunks_exact(2)
            .map(|ends| [ends[0][0], ends[0][1], ends[1][0], ends[1][1]])
            .collect(),
        ..Polygons::default()
    })
}

/// Layout of polygons. Does not check for overlaps and inverted units; feasibility does.
///
/// # Errors
/// Names the invalid unit, ligament or node.
pub fn layout(given: &Polygons) -> Result<Layout, Invalid> {
    let wrong = |at: String, remedy: String| Err(invalid("body.file", at, remedy));
    let count = given.units.len();
    if !(2..=UNITS_MAX).contains(&count) {
        return wrong(format!("{count} units"), format!("must be 2 to {UNITS_MAX} units"));
    }
    for (u, nodes) in given.units.iter().enumerate() {
        let counts = if given.rigid.contains(&u) { NODES_OF_RIGID } else { NODES };
        if !counts.contains(&nodes.len()) {
            let remedy =
                format!("has {} nodes, must have {} to {}", nodes.len(), counts.start(), counts.end());
            return wrong(format!("units[{u}]"), remedy);
        }
        if !nodes.iter().flatten().all(|x| x.is_finite()) {
            return wrong(format!("units[{u}]"), "must be finite numbers".into());
        }
        if moments(nodes).area <= 0.0 {
            return wrong(format!("units[{u}]"), "its nodes must run counter-clockwise".into());
        }
    }
    let exists = |[unit, node]: [usize; 2]| given.units.get(unit).is_some_and(|nodes| node < nodes.len());
    let (mut seen, mut taken) = (BTreeSet::new(), BTreeMap::new());
    for (l, &[a, p, b, q]) in given.ligaments.iter().enumerate() {
        let at = || format!("ligaments[{l}] = [{a}, {p}, {b}, {q}]");
        for [unit, node] in [[a, p], [b, q]] {
            if !exists([unit, node]) {
                return wrong(at(), format!("unit {unit} has no node {node}; both are counted from 0"));
            }
        }
        if a == b {
            return wrong(at(), "must join two units".into());
        }
        if !seen.insert(([a, p].min([b, q]), [a, p].max([b, q]))) {
            return wrong(at(), "is listed twice".into());
        }
        for [unit, node] in [[a, p], [b, q]] {
            if let Some(other) = taken.insert([unit, node], l) {
                let remedy =
                    "two ligaments at one node leave no clearance between them: use a separate node for each";
                let what = format!("node {node} of unit {unit} has ligaments[{other}] already; {remedy}");
                return wrong(at(), what);
            }
        }
        let [[x, y], [z, w]] = [given.units[a][p], given.units[b][q]];
        if (x - z).hypot(y - w) < 1e-9 {
            return wrong(at(), "has no length".into());
        }
    }
    for (group, ends) in given.together.iter().enumerate() {
        if let Some([unit, node]) = ends.iter().copied().find(|end| !exists(*end)) {
            return wrong(format!("together[{group}]"), format!("unit {unit} has no node {node}"));
        }
        if let Some(n) = (1..ends.len()).find(|n| ends[..*n].contains(&ends[*n])) {
            let [unit, node] = ends[n];
            return wrong(format!("together[{group}]"), format!("names node {node} of unit {unit} twice"));
        }
    }
    for (name, units) in [
        ("clamp", given.clamp.clone().unwrap_or_default()),
        ("sensors", given.sensors.clone().unwrap_or_default()),
        ("rigid", given.rigid.clone()),
        ("density", given.density.iter().flat_map(|denser| denser.units.clone()).collect()),
    ] {
        if let Some(unit) = units.iter().find(|unit| **unit >= count) {
            return wrong(format!("{name}: {unit}"), format!("the units are 0 to {}", count - 1));
        }
        if let Some(n) = (1..units.len()).find(|n| units[..*n].contains(&units[*n])) {
            return wrong(format!("{name}: {}", units[n]), "must be named once".into());
        }
    }
    for (d, Denser { factor, .. }) in given.density.iter().enumerate() {
        if !(*factor > 0.0 && factor.is_finite()) {
            return wrong(format!("density[{d}]"), format!("factor = {factor}: must be above 0"));
        }
    }
    followers(given, |end| taken.contains_key(end))?;
    if let Some(unit) = first_unconnected(given) {
        let remedy = "is not connected: no ligaments lead from it to unit 0";
        return wrong(format!("units[{unit}]"), remedy.into());
    }
    let ligaments: Vec<[End; 2]> = given
        .ligaments
        .iter()
        .map(|&[a, p, b, q]| [End { unit: a, node: p }, End { unit: b, node: q }])
        .collect();
    let ends = |ends: &Vec<[usize; 2]>| ends.iter().map(|&[unit, node]| End { unit, node }).collect();
    let together: Vec<Vec<End>> = given.together.iter().map(ends).collect();
    let followers: Vec<(usize, Follower)> = given.follow.iter().map(follower).collect();
    let mut layout = Layout::of_polygons(&given.units, &ligaments, &together, &given.rigid, &followers);
    if layout.half() <= 0.0 {
        let remedy = format!(
            "the mean ligament length, {:.3} mm, exceeds the mean distance of units, {:.3} mm",
            layout.ligament_length, layout.spacing
        );
        return wrong("ligaments".into(), remedy);
    }
    for Denser { units, factor } in &given.density {
        units.iter().for_each(|&unit| layout.density[unit] = *factor);
    }
    if let Some(sensors) = &given.sensors {
        layout.carriers = (0..count).map(|unit| sensors.contains(&unit)).collect();
    }
    Ok(layout)
}

fn follower(follow: &Follow) -> (usize, Follower) {
    let by = match follow.by {
        FollowBy::X => FollowRule::MeanX,
        FollowBy::Segment => FollowRule::Segment,
        FollowBy::Angle => FollowRule::Angle,
    };
    let Follow { node: [unit, node], nodes, .. } = *follow;
    (unit, Follower { node, of: nodes, by })
}

/// Checks which nodes stay or follow others; `joined` is true for nodes with ligaments.
fn followers(given: &Polygons, joined: impl Fn(&[usize; 2]) -> bool) -> Result<(), Invalid> {
    let is_rigid = |unit: &usize| given.rigid.contains(unit);
    for (group, ends) in given.together.iter().enumerate() {
        let stays = ends.iter().find(|end| is_rigid(&end[0]) && !joined(end));
        if let Some([unit, node]) = stays {
            let remedy = format!(
                "node {node} of the rigid unit {unit} has no ligament, so it cannot be shifted; remove it from the group"
            );
            return Err(invalid("body.file", format!("together[{group}]"), remedy));
        }
    }
    for (f, Follow { node, nodes, by }) in given.follow.iter().enumerate() {
        let [unit, place] = *node;
        let wrong = |remedy: String| Err(invalid("body.file", format!("follow[{f}]"), remedy));
        if !is_rigid(&unit) || place >= given.units[unit].len() {
            return wrong(format!("there is no rigid unit {unit} with a node {place}"));
        }
        if joined(node) {
            return wrong(format!(
                "node {place} of unit {unit} has a ligament, so it is part of the design and cannot follow others"
            ));
        }
        let leads = |other: &usize| joined(&[unit, *other]);
        if !nodes.iter().all(leads) || nodes[0] == nodes[1] {
            return wrong(format!("its nodes must be two nodes of unit {unit} with ligaments"));
        }
        if *by == FollowBy::Angle && nodes.iter().any(|other| given.units[unit][*other] == [0.0; 2]) {
            return wrong("a node at [0, 0] has no angle".into());
        }
        if given.follow[..f].iter().any(|other| other.node == *node) {
            return wrong(format!("node {place} of unit {unit} must be named once"));
        }
    }
    Ok(())
}

/// The first unit without a path of ligaments to unit 0.
fn first_unconnected(given: &Polygons) -> Option<usize> {
    let mut joined = vec![false; given.units.len()];
    let (mut next, mut neighbours) = (vec![0], vec![Vec::new(); given.units.len()]);
    for &[a, _, b, _] in &given.ligaments {
        neighbours[a].push(b);
        neighbours[b].push(a);
    }
    while let Some(unit) = next.pop() {
        if !std::mem::replace(&mut joined[unit], true) {
            next.extend(&neighbours[unit]);
        }
    }
    joined.iter().position(|joined| !joined)
}

/// Scales a vector to length 1.
pub(crate) fn unit_vector([x, y]: [f64; 2]) -> [f64; 2] {
    let length = x.hypot(y);
    [x / length, y / length]
}

#[cfg(test)]
mod tests;
