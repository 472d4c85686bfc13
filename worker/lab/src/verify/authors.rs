//! The scenes of the paper's authors, from their published code (github.com/KM-Na/sensing-intelligence-metamaterial, commit
//! 8277565b: forward_simulation/structures.py, blockymetamaterials/geometry.py), and cases that an independent program computed.
//!
//! Squares of pitch S = 16.125 mm alternately rotate by ±25°. Planar bodies lie between force plates, each two columns wide, and
//! one clamped plate. The disc, cut out of a square lattice, lies in eight rigid shells of twice its density; nothing is clamped.

use metasense_numerics::body::Layout;
use metasense_numerics::dynamics::{AddedMass, Forces, LigamentStiffness, Panel, Scene, damping, simulate};
use metasense_schemas::spec::{Denser, Follow, FollowBy, Polygons, Struck};
use metasense_worker::polygons;

use super::body::{States, TIGHT, outcomes, states};
use super::case::{Case, CaseError};
use super::{ComparedQuantity, relative};

type Point = [f64; 2];

/// S and l₀ (mm), and half of S − l₀.
const PITCH: f64 = 16.125;
const LIGAMENT: f64 = 1.125;
const HALF: f64 = 0.5 * (PITCH - LIGAMENT);
/// Mass (Mg) and sides (mm) of the chip.
const CHIP: f64 = 8.58e-6;
const SIDES: [f64; 2] = [32.0, 23.0];

/// Position of node 0 right, 1 top, 2 left, 3 bottom of the square in cell (i, j); even cells rotate by `angle` (rad).
fn corner([i, j]: [i32; 2], node: usize, angle: f64) -> Point {
    // The sign of a node's rotation follows its joint: column i + 1 for the right node, row j + 1 for the top node.
    let own = if node < 2 { 1 } else { 0 };
    let turn = HALF * (if (i + j + own).rem_euclid(2) == 0 { angle } else { -angle }).tan();
    let [x, y] = [[HALF, turn], [-turn, HALF], [-HALF, turn], [-turn, -HALF]][node];
    [f64::from(i) * PITCH + x, f64::from(j) * PITCH + y]
}

fn square(cell: [i32; 2], angle: f64) -> Vec<Point> {
    (0..4).map(|node| corner(cell, node, angle)).collect()
}

/// Joints of neighbouring cells: (cell, node, cell, node), horizontal ones row by row, then vertical ones.
fn joints(columns: i32, rows: i32) -> Vec<([i32; 2], usize, [i32; 2], usize)> {
    let cells = |columns: i32, rows: i32| (0..rows).flat_map(move |j| (0..columns).map(move |i| [i, j]));
    let right = cells(columns - 1, rows).map(|[i, j]| ([i, j], 0, [i + 1, j], 2));
    right.chain(cells(columns, rows - 1).map(|[i, j]| ([i, j], 1, [i, j + 1], 3))).collect()
}

/// The planar body for K forces: `columns` × `rows` squares, K plates above columns 3k and 3k + 1, and the clamped plate, in this
/// order.
///
/// # Panics
/// If there are fewer than 3K − 1 columns.
pub fn planar(columns: usize, rows: usize, panels: usize) -> Polygons {
    assert!(columns + 1 >= 3 * panels, "{columns} columns for {panels} panels");
    let (angle, n, high) = ((-25f64).to_radians(), columns * rows, 7.0 / 15.0 * PITCH);
    let [wide, tall] = [columns, rows].map(|count| i32::try_from(count).expect("a few columns and rows"));
    let unit = |[i, j]: [i32; 2]| (j * wide + i) as usize;
    let mut units: Vec<Vec<Point>> =
        (0..tall).flat_map(|j| (0..wide).map(move |i| square([i, j], angle))).collect();
    let mut ligaments: Vec<[usize; 4]> =
        joints(wide, tall).into_iter().map(|(a, p, b, q)| [unit(a), p, unit(b), q]).collect();
    let mut follow = Vec::new();
    let beside = |i: f64| (i - 0.5) * PITCH;
    for k in 0..panels {
        let (left, y) = (3 * k, f64::from(tall) * PITCH);
        let anchor = |i: usize| {
            let [x, y] = corner([i as i32, tall - 1], 1, angle);
            [x, y + LIGAMENT]
        };
        let (a, b) = (anchor(left), anchor(left + 1));
        let ends = [beside(left as f64), beside(left as f64 + 2.0)];
        let middle = [0.5 * (a[0] + b[0]), y];
        units.push(vec![[ends[0], y + high], [ends[0], y], a, middle, b, [ends[1], y], [ends[1], y + high]]);
        ligaments.extend([(left, 2), (left + 1, 4)].map(|(i, q)| [(rows - 1) * columns + i, 1, n + k, q]));
        follow.push(Follow { node: [n + k, 3], nodes: [2, 4], by: FollowBy::X });
    }
    let (held, y) = (n + panels, -PITCH);
    let (left, right) = (beside(0.0), beside(columns as f64));
    let mut plate = vec![[right, y - high], [right, y]];
    for i in (0..wide).rev() {
        let [x, below] = corner([i, 0], 3, angle);
        plate.push([x, below - LIGAMENT]);
        if i > 0 {
            follow.push(Follow {
                node: [held, plate.len()],
                nodes: [plate.len() - 1, plate.len() + 1],
                by: FollowBy::X,
            });
            plate.push([0.5 * (x + corner([i - 1, 0], 3, angle)[0]), y]);
        }
    }
    plate.extend([[left, y], [left, y - high]]);
    units.push(plate);
    ligaments.extend((0..columns).map(|i| [i, 3, held, 2 * (columns - i)]));
    Polygons {
        units,
        ligaments,
        rigid: (n..=held).collect(),
        follow,
        clamp: Some(vec![held]),
        panels: (n..held).map(|unit| struck(unit, [0.0, 1.0])).collect(),
        ..Polygons::default()
    }
}

fn struck(unit: usize, direction: Point) -> Struck {
    Struck { unit: Some(unit), direction: Some(direction), ..Struck::default() }
}

/// The units of the authors' four sensors in discs of n × n squares (commit 2c0b29e3,
/// notebooks/082625_new_simulation_circular_structure_large_size_train_nn.ipynb).
const SENSORS: [(usize, [usize; 4]); 11] = [
    (10, [5, 8, 17, 20]),
    (13, [14, 18, 41, 45]),
    (15, [14, 18, 78, 82]),
    (18, [37, 42, 105, 110]),
    (20, [33, 40, 117, 124]),
    (23, [50, 56, 168, 174]),
    (25, [67, 75, 217, 225]),
    (27, [66, 74, 247, 255]),
    (30, [79, 88, 298, 307]),
    (32, [100, 110, 358, 368]),
    (35, [150, 162, 414, 426]),
];

/// Number of shells of a disc.
const SHELLS: usize = 8;

/// The disc cut out of n × n squares, centred at the origin: the squares inside, then the shells. Negative forces push the shells
/// inward.
pub fn disc(n: usize) -> Polygons {
    let (angle, count) = (25f64.to_radians(), i32::try_from(n).expect("a few columns"));
    let (size, middle) = (n as f64 * PITCH, 0.5 * f64::from(count - 1) * PITCH);
    let centred = |[x, y]: Point| [x - middle, y - middle];
    let centre = |[i, j]: [i32; 2]| centred([f64::from(i) * PITCH, f64::from(j) * PITCH]);
    let is_inside = |cell: &[i32; 2]| {
        let [x, y] = centre(*cell);
        x.hypot(y) < 0.4 * size - 0.5 * PITCH
    };
    let cells: Vec<[i32; 2]> =
        (0..count).flat_map(|j| (0..count).map(move |i| [i, j])).filter(is_inside).collect();
    let inside = |cell: &[i32; 2]| cells.iter().position(|other| other == cell);
    let mut units: Vec<Vec<Point>> =
        cells.iter().map(|cell| square(*cell, angle).into_iter().map(centred).collect()).collect();
    let joints = joints(count, count);
    let both = |(a, p, b, q): &([i32; 2], usize, [i32; 2], usize)| Some([inside(a)?, *p, inside(b)?, *q]);
    let mut ligaments: Vec<[usize; 4]> = joints.iter().filter_map(both).collect();
    let turned = joints.iter().map(|&(a, p, b, q)| (b, q, a, p));
    // (unit, node, outer cell, node) of each ligament that leaves the disc.
    let outward: Vec<(usize, usize, [i32; 2], usize)> = (joints.iter().copied().chain(turned))
        .filter(|(_, _, b, _)| inside(b).is_none())
        .filter_map(|(a, p, b, q)| Some((inside(&a)?, p, b, q)))
        .collect();
    let (first, part) = (units.len(), 360.0 / SHELLS as f64);
    let mut follow = Vec::new();
    for k in 0..SHELLS {
        let (top, shell) = (180.0 - part * k as f64, first + k);
        let degrees = |[x, y]: Point| y.atan2(x).to_degrees();
        let is_own = |cell: [i32; 2]| {
            let at = degrees(centre(cell));
            top - part < at && at <= top
        };
        let mut own: Vec<_> = outward.iter().filter(|(_, _, cell, _)| is_own(*cell)).collect();
        let falling = |(_, _, cell, node): &(usize, usize, [i32; 2], usize)| {
            -degrees(centred(corner(*cell, *node, 0.0)))
        };
        own.sort_by(|a, b| falling(a).total_cmp(&falling(b)));
        let corners: Vec<Point> =
            own.iter().map(|(_, _, cell, node)| centred(corner(*cell, *node, angle))).collect();
        let mut nodes = Vec::new();
        for (m, [x, y]) in corners.iter().copied().enumerate() {
            let (unit, node, ..) = *own[m];
            ligaments.push([unit, node, shell, nodes.len()]);
            nodes.push([x, y]);
            if let Some([z, w]) = corners.get(m + 1) {
                let (along, across) = (z - x, w - y);
                let out = 0.3 * PITCH / along.hypot(across);
                follow.push(Follow {
                    node: [shell, nodes.len()],
                    nodes: [nodes.len() - 1, nodes.len() + 1],
                    by: FollowBy::Segment,
                });
                nodes.push([0.5 * (x + z) - out * across, 0.5 * (y + w) + out * along]);
            }
        }
        let last = nodes.len() - 1;
        let [from, to] = [nodes[last], nodes[0]].map(degrees);
        let mean = 0.5 * (from + if to < from { to + 360.0 } else { to });
        for step in [-0.5, -1.0 / 6.0, 1.0 / 6.0, 0.5] {
            let (sin, cos) = (mean + step * (part - 5.0)).to_radians().sin_cos();
            follow.push(Follow { node: [shell, nodes.len()], nodes: [last, 0], by: FollowBy::Angle });
            nodes.push([cos, sin].map(|x| (0.4 + 1.0 / 15.0) * size * x));
        }
        units.push(nodes);
    }
    let shells: Vec<usize> = (first..units.len()).collect();
    let outward = |(k, &unit): (usize, &usize)| {
        let (sin, cos) = (180.0 - part * (k as f64 + 0.5)).to_radians().sin_cos();
        struck(unit, [cos, sin])
    };
    Polygons {
        units,
        ligaments,
        rigid: shells.clone(),
        follow,
        density: vec![Denser { units: shells.clone(), factor: 2.0 }],
        clamp: Some(Vec::new()),
        panels: shells.iter().enumerate().map(outward).collect(),
        sensors: SENSORS.iter().find(|(size, _)| *size == n).map(|(_, units)| units.to_vec()),
        ..Polygons::default()
    }
}

/// The body of a case: as the authors build it or, if the nodes differ, from the case's own polygons.
fn body(case: &Case, corners: &[Vec<Point>], rigid: &[usize]) -> Result<Polygons, CaseError> {
    let built = match case.size("scene.n") {
        Ok(n) => disc(n),
        Err(_) => {
            planar(case.size("scene.columns")?, case.size("scene.rows")?, case.list("scene.panels")?.len())
        }
    };
    if built.units.iter().map(Vec::len).eq(corners.iter().map(Vec::len)) {
        return Ok(built);
    }
    let bonds = case.array("bonds")?;
    let ligament = |ends: &[f64; 4]| ends.map(|end| end as usize);
    Ok(Polygons {
        units: corners.to_vec(),
        ligaments: bonds.as_chunks::<4>().0.iter().map(ligament).collect(),
        rigid: rigid.to_vec(),
        follow: Vec::new(),
        ..built
    })
}

/// Geometry, masses and damping of a case, and its motion at instants 1 … T; at instant 0 it is at rest.
pub fn trajectory(case: &Case, pool: &metasense_numerics::Pool) -> Result<Vec<ComparedQuantity>, CaseError> {
    let number = |key: &str| case.number(&format!("scene.{key}"));
    let offsets: Vec<usize> = case.array("vertex_offsets")?.into_iter().map(|n| n as usize).collect();
    let units = offsets.len() - 1;
    let [panels, held, sensors] =
        ["panels", "held", "sensors"].map(|key| case.units(&format!("scene.{key}"), units));
    let (panels, held, sensors) = (panels?, held?, sensors?);
    let flat = case.array_of("vertices", 2 * offsets[units])?;
    let corners: Vec<Vec<Point>> =
        offsets.windows(2).map(|ends| flat.as_chunks::<2>().0[ends[0]..ends[1]].to_vec()).collect();
    let given = body(case, &corners, &[&panels[..], &held].concat())?;
    let mut layout = polygons::layout(&given).map_err(|e| case.wrong(e))?;
    // Our disc is centred at the origin, the case's half a lattice away from it.
    let away = case.size("scene.n").map_or(0.0, |n| 0.5 * (n as f64 - 1.0) * PITCH);
    let design = shifts(&layout, &corners, away);
    let density = number("density")?;
    sensors
        .iter()
        .for_each(|&unit| layout.density[unit] *= 1.0 + number("sensor_density").unwrap_or(0.0) / density);
    let pushes = case.array_of("push", 3 * panels.len())?;
    let panel = |(&unit, [x, y, moment]): (&usize, &[f64; 3])| Panel {
        moment: *moment,
        ..Panel::central(unit, [*x, *y])
    };
    let resisted = case.array_of("damping", 3 * units)?;
    let moment = CHIP * SIDES.map(|side| side * side).iter().sum::<f64>() / 12.0;
    let scene = Scene {
        density,
        stiffness: LigamentStiffness {
            stretch: number("k_stretch")?,
            shear: number("k_shear")?,
            bend: number("k_rot")?,
        },
        damping_ratio: 1.0,
        damping: Some([resisted[0], resisted[1], resisted[2]]),
        linearised: case.flag("scene.linearised")?,
        clamped: held,
        panels: panels.iter().zip(pushes.as_chunks::<3>().0).map(panel).collect(),
        // The disc's sensors have no chip.
        chip: case.size("scene.n").is_err().then_some(AddedMass { mass: CHIP, moment }),
        sensors,
        duration: number("duration")?,
        instants: case.size("scene.instants")? - 1,
        layout,
        ..Scene::default()
    };
    let kinks = scene.instants + 1;
    let values = case.array("forces")?;
    let samples = values.len() / (scene.panels.len() * kinks).max(1);
    case.array_of("forces", samples * scene.panels.len() * kinks)?;
    let forces =
        Forces { samples, panels: scene.panels.len(), instants: scene.instants, values, strikes: Vec::new() };

    let geometry = scene.geometry(&design);
    let shifted =
        |points: &[Point]| points.iter().flat_map(|[x, y]| [x + away, y + away]).collect::<Vec<f64>>();
    let references: Vec<f64> = scene.layout.ligaments.iter().flat_map(|l| l.reference).collect();
    let ends = |l: &[usize; 4]| l.map(|n| n as f64);
    let joined: Vec<f64> = given.ligaments.iter().flat_map(ends).collect();
    let damped: Vec<f64> = (0..units).flat_map(|_| damping(&scene)).collect();
    let mut rows = vec![
        case.row("nodes", &shifted(&geometry.vertices.concat()), "vertices", 1e-12)?,
        case.row("centroids", &shifted(&geometry.centroids), "centroids", 1e-12)?,
        case.row("arms", geometry.arms.as_flattened(), "node_vectors", 1e-12)?,
        case.row("ligaments", &joined, "bonds", 0.0)?,
        case.row("d₀", &references, "reference_vectors", 1e-12)?,
        case.row("damping", &damped, "damping", 1e-12)?,
    ];
    rows.extend(motion(case, &scene, &design, &forces, "", pool)?);
    if case.array("sensors_frozen").is_ok() {
        let kept = Scene { inertia: Some(vec![0.0; design.len()]), ..scene };
        rows.extend(motion(case, &kept, &design, &forces, "_frozen", pool)?);
    }
    Ok(rows)
}

/// α from node positions, which are offset by `away` from our origin.
fn shifts(layout: &Layout, corners: &[Vec<Point>], away: f64) -> Vec<f64> {
    let mut design = vec![0.0; layout.design_len()];
    let undisplaced = layout.vertices(&design);
    let nodes = corners.iter().flatten().zip(undisplaced.iter().flatten());
    for ((now, was), group) in nodes.zip(layout.groups.of_nodes.iter().flatten()) {
        if let Some(group) = group {
            (0..2).for_each(|d| design[2 * group + d] = now[d] - away - was[d]);
        }
    }
    design
}

/// Masses and motion; arrays whose names end in `_frozen` have the masses of the initial body.
fn motion(
    case: &Case,
    scene: &Scene,
    design: &[f64],
    forces: &Forces,
    of: &str,
    pool: &metasense_numerics::Pool,
) -> Result<Vec<ComparedQuantity>, CaseError> {
    let named = |quantity: &str| {
        if of.is_empty() { quantity.to_owned() } else { format!("{quantity}, masses of the initial body") }
    };
    let file = |name: &str| format!("{name}{of}");
    let mut geometry = scene.geometry(design);
    if let Some(chip) = scene.chip {
        for &unit in &scene.sensors {
            geometry.mass[unit] += chip.mass;
            geometry.moment[unit] += chip.moment;
        }
    }
    let run = simulate(scene, design, forces, &TIGHT, true, pool);
    let width = 3 * scene.sensors.len();
    let rest = vec![0.0; width];
    let per_sample = run.signals.chunks(scene.instants * width);
    let signals: Vec<f64> = per_sample.flat_map(|own| [&rest, own].concat()).collect();
    let mut rows = vec![
        case.row(&named("masses"), &geometry.mass, &file("mass"), 1e-12)?,
        case.row(&named("moments of inertia"), &geometry.moment, &file("moment"), 1e-12)?,
        case.row(&named("sensors"), &signals, &file("sensors"), 1e-6)?.noted(outcomes(&run)),
    ];
    let States { last, kinetic, elastic } = states(scene, design, forces, &run, &geometry);
    let mut theirs = case.array(&file("final_x"))?;
    theirs.extend(case.array(&file("final_v"))?);
    rows.push(ComparedQuantity::new(named("final state"), relative(&last, &theirs), 1e-6));
    if of.is_empty() {
        let later = |name: &str| -> Result<Vec<f64>, CaseError> {
            let all = case.array_of(name, forces.samples * (scene.instants + 1))?;
            Ok(all.chunks(scene.instants + 1).flat_map(|own| own[1..].to_vec()).collect())
        };
        let net_work: Vec<f64> =
            later("external")?.iter().zip(later("dissipated")?).map(|(work, lost)| work - lost).collect();
        let gained: Vec<f64> = kinetic.iter().zip(&elastic).map(|(k, e)| k + e).collect();
        rows.extend([
            ComparedQuantity::new("kinetic energy", relative(&kinetic, &later("kinetic")?), 1e-6),
            ComparedQuantity::new("elastic energy", relative(&elastic, &later("elastic")?), 1e-6),
            ComparedQuantity::new("work done minus dissipation", relative(&gained, &net_work), 1e-6),
        ]);
    }
    Ok(rows)
}
