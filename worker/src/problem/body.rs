//! A body from its spec: units and ligaments, clamps and guides, panels, and the initial design.

use metasense_numerics::body::{Layout, Pattern};
use metasense_numerics::dynamics::{Panel, PrescribedMotion};
use metasense_numerics::feasible::{FeasibleSet, Limits};
use metasense_schemas::spec::{self, Clamp, ClampRule, Design, Guide, LayoutKind, Struck, TrialSpec};
use std::collections::BTreeMap;

use crate::invalid::{Invalid, as_written, at_least, invalid, positive, require, within};
use crate::polygons;

/// Greatest number of units of a body.
const UNITS_MAX: usize = 10_000;

/// The layout of a body; of an external one a layout without units.
///
/// # Errors
/// If the sizes are invalid.
pub fn layout(body: &spec::Body) -> Result<Layout, Invalid> {
    if !body.kind.is_polygons() {
        return Ok(Layout::default());
    }
    if let Some(spec::Own::File(file)) = &body.file {
        let remedy = "must be left out: a trial contains the polygons themselves";
        return Err(invalid("body.file", file.display(), remedy));
    }
    if let Some(given) = body.polygons() {
        return polygons::layout(given);
    }
    let columns = given("body.columns", body.columns)?;
    within("body.columns", columns, 2, 1000)?;
    let (key, value) = match body.layout {
        LayoutKind::Planar => ("body.rows", body.rows()),
        LayoutKind::Circular => ("body.columns", columns),
    };
    let units = columns.saturating_mul(body.rows());
    let remedy = format!("gives {units} units; a body has at most {UNITS_MAX}");
    require(units <= UNITS_MAX, key, value, &remedy)?;
    let [spacing, ligament_length] = lengths(body)?;
    let remedy = "must be less than body.spacing";
    require(ligament_length < spacing, "body.ligament_length", ligament_length, remedy)?;
    let angle = body.initial_angle;
    require(angle.abs() < 45.0, "body.initial_angle", angle, "must lie between -45 and 45 degrees")?;
    let angle = angle.to_radians();
    let pattern = match body.lattice {
        spec::Lattice::Square => Pattern::square(),
        spec::Lattice::Kagome => Pattern::kagome(),
        spec::Lattice::Triangular => Pattern::triangular(angle),
        spec::Lattice::Chiral => Pattern::chiral(angle),
    };
    match body.layout {
        LayoutKind::Planar => {
            let rows = body.rows.ok_or_else(|| invalid("body.rows", "", "must be set for a planar body"))?;
            let remedy = "must be at least 2: the bottom row is clamped, and forces act on the top row";
            require(rows >= 2, "body.rows", rows, remedy)?;
            Ok(Layout::sheet(&pattern, columns, rows, spacing, ligament_length))
        }
        LayoutKind::Circular => {
            let rows = body.rows();
            let remedy = "must equal body.columns, or be left out, for a circular body";
            require(rows == columns, "body.rows", rows, remedy)?;
            at_least("body.columns", columns, 4)?;
            Ok(Layout::circular(&pattern, columns, spacing, ligament_length))
        }
    }
}

/// The value of a key that must be set unless a file defines the body.
fn given<T>(key: &str, value: Option<T>) -> Result<T, Invalid> {
    value.ok_or_else(|| invalid(key, "", "must be set if body.file is not"))
}

/// `spacing` and `ligament_length` (mm); for a body from a file, the plan sets both.
///
/// # Errors
/// If a length is missing or not above 0.
pub(super) fn lengths(body: &spec::Body) -> Result<[f64; 2], Invalid> {
    let length = |key: &str, length: Option<f64>| {
        let length = given(key, length)?;
        positive(key, length).map(|()| length)
    };
    Ok([length("body.spacing", body.spacing)?, length("body.ligament_length", body.ligament_length)?])
}

/// The panels at the units of `panel_units`, with forces by `body.panels` or the body's file. Default: along −y on planar bodies;
/// along the rule's direction, or towards the centre, on circular ones.
pub fn panels(body: &spec::Body, units: &[usize], layout: &Layout) -> Vec<Panel> {
    let ruled = layout.circular_panels(units.len()).unwrap_or_default();
    let by_rule = ruled.iter().map(|panel| &panel.0).eq(units.iter());
    let listed = PanelList::new(body, layout);
    let (in_turn, driven) = (listed.begins_with(units), driven(body));
    let panel = |(k, &unit): (usize, &usize)| {
        let given_panel = match in_turn {
            true => Some(&listed.panels[k]),
            false => listed.panels.iter().find(|struck| struck.unit == Some(unit)),
        };
        let Struck { direction, node, at, couple, base, .. } = given_panel.cloned().unwrap_or_default();
        if let Some(moment) = couple {
            return Panel { moment, ..Panel::central(unit, [0.0; 2]) };
        }
        let direction = match body.layout {
            _ if direction.is_some() => polygons::unit_vector(direction.unwrap_or_default()),
            LayoutKind::Planar => [0.0, -1.0],
            LayoutKind::Circular if by_rule => ruled[k].1,
            LayoutKind::Circular => {
                let [x, y] = layout.centres[unit];
                let radius = x.hypot(y).max(f64::MIN_POSITIVE);
                [-x / radius, -y / radius]
            }
        };
        let [p, q] = at.unwrap_or_default();
        let moves = base.map(|mass| {
            if driven.contains(&unit) { PrescribedMotion::Unit(mass) } else { PrescribedMotion::Base(mass) }
        });
        Panel { unit, direction, node, moment: p * direction[1] - q * direction[0] + 0.0, moves }
    };
    units.iter().enumerate().map(panel).collect()
}

/// All driven units, for any number of panels.
pub fn driven(body: &spec::Body) -> Vec<usize> {
    listed(body).1.iter().filter(|panel| panel.base.is_some()).filter_map(|panel| panel.unit).collect()
}

/// The panels that a spec lists, and their key.
pub(super) fn listed(body: &spec::Body) -> (&'static str, &[Struck]) {
    match body.polygons() {
        Some(given) if body.panels.is_empty() => ("body.file", &given.panels),
        _ => ("body.panels", &body.panels),
    }
}

/// Panels listed in `body.panels` or, if this is empty, in the body's file.
struct PanelList {
    /// The key of the list.
    key: &'static str,
    /// Panels that shake the base get the first held unit.
    panels: Vec<Struck>,
}

impl PanelList {
    fn new(body: &spec::Body, layout: &Layout) -> Self {
        let (key, list) = listed(body);
        let mut panels = list.to_vec();
        for panel in panels.iter_mut().filter(|panel| panel.base.is_some() && panel.unit.is_none()) {
            panel.unit = held(body, layout).ok().and_then(|held| held.first().copied());
        }
        Self { key, panels }
    }

    fn units(&self, count: usize) -> Vec<usize> {
        self.panels.iter().take(count).filter_map(|panel| panel.unit).collect()
    }

    /// Whether the first panels have these units.
    fn begins_with(&self, units: &[usize]) -> bool {
        self.panels.len() >= units.len() && self.units(units.len()) == units
    }

    /// Rejects panels that the layout cannot have, and panels with indistinguishable forces.
    fn check(&self, body: &spec::Body, layout: &Layout) -> Result<(), Invalid> {
        let given = listed(body).1;
        for (k, struck) in given.iter().enumerate() {
            let Struck { unit, direction, node, at, couple, base } = struck;
            let wrong = |remedy: String| Err(invalid(self.key, format!("panels[{k}]"), remedy));
            let beside =
                [unit.is_some(), direction.is_some(), node.is_some(), at.is_some(), couple.is_some()];
            if direction.is_some_and(|way| polygons::unit_vector(way).iter().any(|x| !x.is_finite())) {
                return wrong("its direction must be finite and not zero".into());
            }
            if let Some(mass) = base {
                if !(*mass > 0.0 && mass.is_finite()) {
                    return wrong("its base must be a mass above 0 (Mg)".into());
                }
                if beside[2..] != [false; 3] {
                    return wrong(
                        "base cannot be combined with node, at and couple: the unit does not rotate".into(),
                    );
                }
                let held_units = held(body, layout)?;
                if unit.is_none() && held_units.is_empty() {
                    return wrong(
                        "a base without unit moves the held units, but none is held: set body.clamp or unit"
                            .into(),
                    );
                }
                if let Some(unit) = unit.filter(|unit| held_units.contains(unit)) {
                    let remedy = "leave it out of body.clamp and body.guides to drive it";
                    return wrong(format!("unit {unit} is held: {remedy}"));
                }
            } else if unit.is_none() {
                return wrong("its unit must be given".into());
            }
            if let Some(unit) = unit {
                if *unit >= layout.units() {
                    return wrong(format!(
                        "unit {unit} does not exist: the units are 0 to {}",
                        layout.units() - 1
                    ));
                }
                let driven = |other: &Struck| other.unit == Some(*unit) && other.base.is_some();
                if let Some(other) = given.iter().position(driven).filter(|_| base.is_none()) {
                    return wrong(format!(
                        "unit {unit} moves as panels[{other}] prescribes; a force has no effect on it"
                    ));
                }
                let nodes = layout.shape[*unit].len();
                if let Some(node) = node.filter(|node| *node >= nodes) {
                    return wrong(format!(
                        "unit {unit} has no node {node}: its nodes are numbered from 0 to {}",
                        nodes - 1
                    ));
                }
                if at.is_some_and(|at| at.iter().any(|x| !x.is_finite())) {
                    return wrong("its at must be two finite numbers".into());
                }
                if couple.is_some_and(|arm| arm == 0.0 || !arm.is_finite()) {
                    return wrong("its couple must be finite and not zero".into());
                }
                if couple.is_some() && beside != [true, false, false, false, true] {
                    return wrong(
                        "couple cannot be combined with direction, node and at: its effect does not depend on them".into(),
                    );
                }
            }
            if let Some(other) = given[..k].iter().position(|other| other == struck) {
                return wrong(format!("repeats panels[{other}]: their forces could not be distinguished"));
            }
        }
        Ok(())
    }
}

/// The panels of a trial.
///
/// # Errors
/// If a panel has no unit, a held unit, or repeats another panel.
pub(super) fn build_panels(
    trial: &TrialSpec,
    layout: &Layout,
    held: &[usize],
) -> Result<Vec<Panel>, Invalid> {
    let TrialSpec { body, panel_units: units, .. } = trial;
    let listed = PanelList::new(body, layout);
    listed.check(body, layout)?;
    let told = listed.begins_with(units);
    for (k, unit) in units.iter().enumerate() {
        if told && listed.panels[k].base.is_some() {
            continue;
        }
        let others = if told { &[][..] } else { &units[..k] };
        let key = if told { listed.key } else { "body.panel_units" };
        check_units(key, &[others, &[*unit]].concat(), layout, &[])?;
        let by_default = || panel_units(body, layout, units.len()).is_ok_and(|default| default == *units);
        if held.contains(unit) && !told && by_default() {
            let remedy =
                format!("holds unit {unit}, on which a panel acts: set body.panel_units to free units");
            return Err(invalid("body.clamp", bare(&clamp(body)), remedy));
        }
        require(!held.contains(unit), key, unit, "is clamped and cannot move")?;
    }
    Ok(panels(body, units, layout))
}

/// The rule or list of held units, with the default.
pub fn clamp(body: &spec::Body) -> Clamp {
    let own = body.polygons().and_then(|given| given.clamp.clone()).map(Clamp::Units);
    body.clamp.clone().or(own).unwrap_or(Clamp::Rule(match body.layout {
        LayoutKind::Planar => ClampRule::Bottom,
        LayoutKind::Circular => ClampRule::Hub,
    }))
}

/// The units of K panels: from `body.panels`, `body.panel_units`, the body's file, or the layout's rule.
///
/// # Errors
/// If there are not K panels, or units do not exist.
pub fn panel_units(body: &spec::Body, layout: &Layout, panels: usize) -> Result<Vec<usize>, Invalid> {
    if let Some(description) = &body.description {
        return super::external::panel_units(body, description, panels);
    }
    let none = |remedy: String| invalid("sweep.panels", panels, remedy);
    if let Some(units) = &body.panel_units {
        let remedy = "cannot be set together with body.panels";
        require(body.panels.is_empty(), "body.panel_units", format!("{units:?}"), remedy)?;
        check_units("body.panel_units", units, layout, &[])?;
        let remedy = format!("body.panel_units names {} units: name as many units as panels", units.len());
        return if units.len() == panels { Ok(units.clone()) } else { Err(none(remedy)) };
    }
    let listed = PanelList::new(body, layout);
    listed.check(body, layout)?;
    if !listed.panels.is_empty() {
        let (units, remedy) =
            (listed.units(panels), format!("{} names {} panels", listed.key, listed.panels.len()));
        return if units.len() == panels { Ok(units) } else { Err(none(remedy)) };
    }
    require(panels <= layout.units(), "sweep.panels", panels, "must be at most the number of units")?;
    match body.layout {
        LayoutKind::Planar => layout.top_panels(panels).ok_or_else(|| {
            let top = layout.top().len();
            none(format!("the top row of {top} units has no room for {panels} panels"))
        }),
        LayoutKind::Circular => layout
            .circular_panels(panels)
            .map(|ruled| ruled.into_iter().map(|(unit, _)| unit).collect())
            .ok_or_else(|| none("must be 1, 2, 4 or 8 for a circular body that is large enough to have them on different units".into())),
    }
}

/// The clamped units.
///
/// # Errors
/// If units do not exist, or no unit is free.
pub fn clamped(body: &spec::Body, layout: &Layout) -> Result<Vec<usize>, Invalid> {
    if !body.kind.is_polygons() {
        return Ok(Vec::new());
    }
    let clamp = clamp(body);
    let units = named("body.clamp", &clamp, body, layout)?;
    let shown = bare(&clamp);
    require(units.len() < layout.units(), "body.clamp", shown, "must leave a unit free to move")?;
    Ok(units)
}

/// As in a spec, without quotes.
fn bare(clamp: &Clamp) -> String {
    as_written(clamp).replace('"', "")
}

/// The units that the value of a key names.
fn named(key: &str, clamp: &Clamp, body: &spec::Body, layout: &Layout) -> Result<Vec<usize>, Invalid> {
    let rule = match clamp {
        Clamp::Units(units) => return check_units(key, units, layout, &[]),
        Clamp::Rule(rule) => *rule,
    };
    let circular = body.layout == LayoutKind::Circular;
    let remedy = match circular {
        true => "must be \"hub\", \"none\" or a list of units for a circular body",
        false => "must be \"bottom\", \"ends\", \"sides\", \"none\" or a list of units for a planar body",
    };
    let fits = rule == ClampRule::None || circular == (rule == ClampRule::Hub);
    require(fits, key, bare(clamp), remedy)?;
    Ok(match rule {
        ClampRule::Bottom => layout.bottom(),
        ClampRule::Ends => layout.ends(),
        ClampRule::Sides => layout.sides(),
        ClampRule::Hub => layout.hub(),
        ClampRule::None => Vec::new(),
    })
}

/// The clamped units, then the guided ones.
///
/// # Errors
/// As [`clamped`] and [`guided`].
pub fn held(body: &spec::Body, layout: &Layout) -> Result<Vec<usize>, Invalid> {
    let guided = guided(body, layout)?;
    Ok(clamped(body, layout)?.into_iter().chain(guided.into_iter().map(|guided| guided.0)).collect())
}

/// The guided units in order, and whether u, v, θ are held. Clamped units that a rule names are left out.
///
/// # Errors
/// If units do not exist, a list contains a clamped unit, or none or all coordinates are held.
pub fn guided(body: &spec::Body, layout: &Layout) -> Result<Vec<(usize, [bool; 3])>, Invalid> {
    let (clamped, mut guided) = (clamped(body, layout)?, BTreeMap::new());
    for (k, Guide { units, holds }) in body.guides.iter().enumerate() {
        let key = "body.guides";
        let wrong = |remedy: &str| Err(invalid(key, format!("guides[{k}]"), remedy));
        let mut held = [false; 3];
        holds.iter().for_each(|way| held[*way as usize] = true);
        if held.iter().filter(|held| **held).count() < holds.len().max(1) {
            return wrong("its holds must name \"x\", \"y\" or \"turn\", each once");
        }
        if *units == Clamp::Units(Vec::new()) {
            return wrong("its units must contain a unit");
        }
        if held == [true; 3] {
            return wrong("holds all motions of its units: list them in body.clamp");
        }
        let of = named(key, units, body, layout)?;
        if matches!(units, Clamp::Units(_)) {
            check_units(key, &of, layout, &clamped)?;
        }
        for unit in of.into_iter().filter(|unit| !clamped.contains(unit)) {
            let all: &mut [bool; 3] = guided.entry(unit).or_default();
            (0..3).for_each(|d| all[d] |= held[d]);
        }
    }
    Ok(guided.into_iter().collect())
}

/// Greatest compression or extension, as a fraction of the distance between the outermost held units.
const COMPRESSION_MAX: f64 = 0.5;

/// Displacement of each clamped, then of each guided unit in its held coordinates, before a sample (mm): towards the middle between
/// the outermost. Empty: none.
pub(super) fn compression_shifts(
    body: &spec::Body,
    layout: &Layout,
    clamped: &[usize],
    guided: &[(usize, [bool; 3])],
) -> Result<Vec<[f64; 2]>, Invalid> {
    let Some(parts) = body.compression.filter(|parts| *parts != [0.0; 2]) else { return Ok(Vec::new()) };
    let (key, shown) = ("body.compression", format!("{parts:?}"));
    let sound = parts.iter().all(|part| part.abs() <= COMPRESSION_MAX);
    let remedy = format!("must be two fractions from -{COMPRESSION_MAX} to {COMPRESSION_MAX}");
    require(sound, key, &shown, &remedy)?;
    let held: Vec<_> = clamped.iter().map(|unit| (*unit, [true; 3])).chain(guided.iter().copied()).collect();
    let mut by = vec![[0.0; 2]; held.len()];
    for d in 0..2 {
        let at = |unit: usize| layout.centres[unit][d];
        let own = || held.iter().filter(|(_, held)| held[d]).map(|(unit, _)| at(*unit));
        let (least, most) = (own().fold(f64::INFINITY, f64::min), own().fold(f64::NEG_INFINITY, f64::max));
        let apart = most - least > 1e-6 * layout.spacing;
        let axis = ["x", "y"][d];
        let remedy =
            format!("all held units have the same {axis}: body.clamp must contain units at different {axis}");
        require(parts[d] == 0.0 || apart, key, &shown, &remedy)?;
        let middle = 0.5 * (least + most);
        let moving = by.iter_mut().zip(&held).filter(|(_, (_, held))| held[d]);
        moving.for_each(|(by, (unit, _))| by[d] = parts[d] * (middle - at(*unit)));
    }
    Ok(by)
}

/// The units, if all exist, each appears once and none is held.
///
/// # Errors
/// Names the invalid unit.
pub fn check_units(
    key: &str,
    units: &[usize],
    layout: &Layout,
    held: &[usize],
) -> Result<Vec<usize>, Invalid> {
    for (n, &unit) in units.iter().enumerate() {
        let remedy = format!("the layout's units are 0 to {}", layout.units() - 1);
        require(unit < layout.units(), key, unit, &remedy)?;
        require(!units[..n].contains(&unit), key, unit, "must not be repeated")?;
        require(!held.contains(&unit), key, unit, "is clamped and cannot move")?;
    }
    Ok(units.to_vec())
}

/// Greatest number of violated limits in an error message.
const SHOWN: usize = 10;

/// Rejects an infeasible initial design, with the first violated limits.
pub(super) fn check_castable(
    body: &spec::Body,
    layout: &Layout,
    limits: Limits,
    initial: &[f64],
) -> Result<(), Invalid> {
    let broken = FeasibleSet::new(layout, limits, &[]).violations(initial);
    if broken.is_empty() {
        return Ok(());
    }
    let mut list: String = broken.iter().take(SHOWN).map(|violation| format!("\n  {violation}")).collect();
    if broken.len() > SHOWN {
        list += &format!("\n  … and {} more", broken.len() - SHOWN);
    }
    Err(match body.design {
        None if body.file.is_some() => {
            invalid("body.file", "", format!("the body is not feasible; change it or [feasible]:{list}"))
        }
        None => {
            let remedy = format!("the initial body is not feasible; change [body] or [feasible]:{list}");
            invalid("body.initial_angle", body.initial_angle, remedy)
        }
        Some(_) => {
            let remedy = format!("this design is not feasible; `metasense body project` repairs it:{list}");
            invalid("body.design", shown(body), remedy)
        }
    })
}

fn shown(body: &spec::Body) -> String {
    match &body.design {
        None => "absent".into(),
        Some(Design::File(path)) => path.display().to_string(),
        Some(Design::Random { random, spread }) => format!("{{ random = {random}, spread = {spread} }}"),
        Some(Design::Shifts { shifts }) => format!("{} shifts", shifts.len()),
    }
}

/// The initial design α (mm), not checked for feasibility.
///
/// # Errors
/// If its length is wrong, it is not finite, still a file, or no random feasible design was found.
pub fn initial_design(body: &spec::Body, layout: &Layout, limits: Limits) -> Result<Vec<f64>, Invalid> {
    let regular = layout.initial_design(body.initial_angle.to_radians());
    let wrong = |remedy: String| invalid("body.design", shown(body), remedy);
    match &body.design {
        None => Ok(regular),
        Some(Design::Random { spread, .. }) if !(*spread > 0.0 && *spread <= 1.0) => {
            Err(wrong("spread must be above 0 and at most 1".into()))
        }
        Some(Design::Random { random, spread }) => FeasibleSet::new(layout, limits, &[])
            .random_design(&regular, *random, spread * layout.spacing)
            .ok_or_else(|| wrong("no feasible design was found near the rotated squares".into())),
        Some(Design::Shifts { shifts }) if shifts.len() == layout.design_len() => {
            match shifts.iter().all(|x| x.is_finite()) {
                true => Ok(shifts.clone()),
                false => Err(wrong("must be finite numbers".into())),
            }
        }
        Some(Design::Shifts { .. }) => {
            Err(wrong(format!("must contain {} numbers, the length of α of this body", layout.design_len())))
        }
        Some(Design::File(_)) => Err(wrong("must be left out: a trial contains the design itself".into())),
    }
}
