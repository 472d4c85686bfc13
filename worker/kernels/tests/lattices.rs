//! Bodies with other units than squares: lattices of every pattern, and polygons with any number of nodes.

mod common;

use common::{norm, pool, relative, scene};
use metasense_kernels::body::{End, FollowRule, Follower, Geometry, Layout, Pattern};
use metasense_kernels::dynamics::{
    AccelerationFrame, EdgeContact, Forces, IntegrationPlan, Integrator, Panel, PrescribedMotion, Scene,
    Tangent, Wrt, run,
};

/// Four polygons: a triangle, a hexagon (rigid or not), a square above the first triangle, and a triangle above the hexagon.
fn mixed(rigid: bool) -> Layout {
    let regular = |count: usize, [x, y]: [f64; 2], from: f64| -> Vec<[f64; 2]> {
        let turn = |p: usize| (from + 360.0 * p as f64 / count as f64).to_radians().sin_cos();
        (0..count).map(|p| [x + 6.0 * turn(p).1, y + 6.0 * turn(p).0]).collect()
    };
    let units = [
        regular(3, [0.0, 0.0], 0.0),
        regular(6, [15.0, 1.0], 0.0),
        regular(4, [1.0, 14.0], 20.0),
        regular(3, [15.0, 16.0], -90.0),
    ];
    let joint = |[a, p, b, q]: [usize; 4]| [End { unit: a, node: p }, End { unit: b, node: q }];
    let joints = [[0, 0, 1, 3], [0, 1, 2, 3], [1, 1, 3, 0], [2, 0, 3, 2], [1, 2, 2, 3]].map(joint);
    if rigid {
        let follower = |(node, of, by)| (1, Follower { node, of, by });
        let followers = [
            (0, [1, 3], FollowRule::Segment),
            (4, [2, 1], FollowRule::Angle),
            (5, [1, 2], FollowRule::MeanX),
        ];
        return Layout::of_polygons(&units, &joints, &[], &[1], &followers.map(follower));
    }
    let together = [vec![End { unit: 1, node: 4 }, End { unit: 1, node: 5 }]];
    Layout::of_polygons(&units, &joints, &together, &[], &[])
}

/// A pattern as a function of its rotation angle (rad).
type Turned = fn(f64) -> Pattern;

/// All patterns; those with equally rotated units use the angle.
const PATTERNS: [(&str, Turned); 4] = [
    ("square", |_| Pattern::square()),
    ("kagome", |_| Pattern::kagome()),
    ("triangular", Pattern::triangular),
    ("chiral", Pattern::chiral),
];

fn bodies() -> Vec<(&'static str, Layout)> {
    let sheet = |pattern: Pattern| Layout::sheet(&pattern, 4, 3, 15.0, 2.25);
    vec![
        ("disc of kagome", Layout::circular(&Pattern::kagome(), 4, 15.0, 2.25)),
        ("square", sheet(Pattern::square())),
        ("kagome", sheet(Pattern::kagome())),
        ("triangular", sheet(Pattern::triangular(0.4))),
        ("chiral", sheet(Pattern::chiral(0.4))),
        ("mixed", mixed(false)),
        ("rigid", mixed(true)),
    ]
}

fn shaken(layout: &Layout, size: f64) -> Vec<f64> {
    let shake = |(i, a): (usize, f64)| a + size * (1.7 * i as f64).sin();
    layout.initial_design(0.4).into_iter().enumerate().map(shake).collect()
}

/// A scene with a force on a node of the last unit and a shaken base; sensors on the last and on the first free unit.
fn struck(layout: Layout) -> (Scene, Forces) {
    let (clamped, last) = (layout.bottom(), layout.units() - 1);
    let free = (0..last).find(|u| !clamped.contains(u)).expect("a unit that moves");
    let base = scene(3, 3, 20);
    let panels = vec![
        Panel { node: Some(1), moment: 0.5, ..Panel::central(last, [0.6, -0.8]) },
        Panel { moves: Some(PrescribedMotion::Base(1e-4)), ..Panel::central(clamped[0], [0.8, 0.6]) },
    ];
    let scene =
        Scene { clamped, panels, sensors: vec![free, last], frame: AccelerationFrame::Body, layout, ..base };
    let values = (0..6 * 21).map(|i| 0.3 * (0.15 * f64::from(i % 21) + f64::from(i / 21)).sin().powi(2));
    (scene, Forces { samples: 3, panels: 2, instants: 20, values: values.collect(), strikes: Vec::new() })
}

/// Both ends of a ligament shift equally: in every design their distance is the reference vector, and every node has a group.
#[test]
fn ligaments_have_their_length_in_every_design() {
    for (name, layout) in bodies() {
        let vertices = layout.vertices(&shaken(&layout, 0.5));
        for ligament in &layout.ligaments {
            let [a, b] = [ligament.a, ligament.b].map(|end| vertices[end.unit][end.node]);
            let off = (b[0] - a[0] - ligament.reference[0]).hypot(b[1] - a[1] - ligament.reference[1]);
            assert!(off < 1e-12 * layout.spacing, "{name}: {off}");
        }
        let exists =
            |group: &Option<usize>| group.map_or(name == "rigid", |group| group < layout.groups.count());
        assert!(layout.groups.of_nodes.iter().flatten().all(exists), "{name}");
        assert_eq!(layout.nodes(), layout.groups.of_nodes.iter().map(Vec::len).sum::<usize>());
    }
    // nodes declared to shift together do so
    let mixed = mixed(false);
    assert_eq!(mixed.groups.of_nodes[1][4], mixed.groups.of_nodes[1][5]);
    assert_eq!(mixed.groups.of_nodes[1][2], mixed.groups.of_nodes[2][3]);
    assert_eq!(mixed.groups.of_nodes[0][1], mixed.groups.of_nodes[2][3], "two ligaments meet there");
    assert_eq!(mixed.groups.count(), 16 - 5 - 1);
}

/// Kagome triangles have three neighbours, rotated in the opposite direction; hexagons have six, rotated equally.
#[test]
fn units_have_the_neighbours_of_their_lattice() {
    for (pattern, nodes, turn) in
        [(Pattern::kagome(), 3, -1.0), (Pattern::triangular(0.0), 6, 0.0), (Pattern::chiral(0.3), 4, 0.0)]
    {
        let layout = Layout::sheet(&pattern, 8, 6, 15.0, 2.25);
        assert!(layout.shape.iter().all(|shape| shape.len() == nodes));
        let inner = layout.boundary().iter().filter(|edge| !**edge).count();
        let ends =
            |u: usize| layout.ligaments.iter().flat_map(|l| [l.a, l.b]).filter(|end| end.unit == u).count();
        assert_eq!((0..48).filter(|&u| ends(u) == nodes).count(), inner);
        assert!(inner >= 16, "{nodes}: {inner}");
        let away = |unit: usize, other: usize| {
            let (p, q) = (layout.centres[unit], layout.centres[other]);
            (p[0] - q[0]).hypot(p[1] - q[1])
        };
        assert!(layout.ligaments.iter().all(|l| (away(l.a.unit, l.b.unit) - 15.0).abs() < 1e-9));
        // rotation of a unit, from its first node
        let design = layout.initial_design(0.3);
        let turned = |u: usize| {
            let (mut at, from) = (vec![[0.0; 2]; nodes], layout.shape[u][0]);
            layout.place(&design, u, &mut at);
            let at = at[0];
            (from[0] * at[1] - from[1] * at[0]).atan2(from[0] * at[0] + from[1] * at[1])
        };
        let pairs = layout.ligaments.iter().map(|l| turned(l.a.unit) * turned(l.b.unit));
        assert!(pairs.into_iter().all(|product| (product - turn * 0.09).abs() < 1e-12), "{nodes}");
    }
}

/// In every lattice, a disc contains all units within its radius and no others, is connected, and is symmetric under rotation. The hub is
/// the central unit, or the units around the central void. From five units across, panels in all eight directions are different units.
#[test]
fn discs_are_whole_and_turn_into_themselves() {
    for (name, pattern) in PATTERNS {
        let upright = pattern(0.0);
        for across in 4..14 {
            let layout = Layout::circular(&upright, across, 15.0, 2.25);
            let rim = 7.5 * across as f64 + 1e-9;
            let radius = |[x, y]: [f64; 2]| x.hypot(y);
            assert!(layout.centres.iter().all(|c| radius(*c) <= rim), "{name}, {across}");
            let at = |place: [f64; 2]| {
                layout.centres.iter().position(|c| radius([c[0] - place[0], c[1] - place[1]]) < 1e-9)
            };
            // a free node points to a position outside the disc; every other node is joined to a unit
            let mut reached = vec![layout.hub()[0]];
            for n in 0..layout.units() {
                let unit = *reached.get(n).unwrap_or_else(|| panic!("{name}, {across}: not connected"));
                for (node, [x, y]) in layout.shape[unit].iter().enumerate() {
                    let [p, q] = layout.centres[unit];
                    let beyond = [p + 15.0 * x, q + 15.0 * y];
                    let ends = layout.ligaments.iter().map(|l| [l.a, l.b]);
                    let joined = ends
                        .flat_map(|[a, b]| [(a, b), (b, a)])
                        .find(|(a, _)| (a.unit, a.node) == (unit, node));
                    assert_eq!(joined.map(|(_, b)| b.unit), at(beyond), "{name}, {across}: {unit}, {node}");
                    assert!(joined.is_some() || radius(beyond) > rim, "{name}, {across}: {unit}, {node}");
                    let next = joined.map(|(_, b)| b.unit).filter(|next| !reached.contains(next));
                    reached.extend(next);
                }
            }
            assert_eq!(layout.groups.count(), layout.nodes() - layout.ligaments.len(), "{name}, {across}");

            let odd = across % 2 == 1;
            let (hub, turns) = match name {
                "kagome" => (6, if odd { 3.0 } else { 6.0 }),
                "triangular" => (3, if odd { 6.0 } else { 3.0 }),
                _ => (4, 4.0),
            };
            assert_eq!(layout.hub().len(), if odd { 1 } else { hub }, "{name}, {across}");
            let (sin, cos) = (std::f64::consts::TAU / turns).sin_cos();
            let turned = |[x, y]: [f64; 2]| [cos * x - sin * y, sin * x + cos * y];
            assert!(layout.centres.iter().all(|c| at(turned(*c)).is_some()), "{name}, {across}");
            let (panels, boundary) = (layout.circular_panels(8), layout.boundary());
            assert!(across < 5 || panels.is_some(), "{name}, {across}");
            for (unit, [x, y]) in panels.into_iter().flatten() {
                let [p, q] = layout.centres[unit];
                assert!(boundary[unit] && p * x + q * y < -0.8 * radius([p, q]), "{name}, {across}: {unit}");
            }
        }
    }
}

/// Only the nodes of a rigid unit that have ligaments belong to the design. The others are fixed or follow: in x by the mean of two shifts,
/// at a fixed place beside the segment of two nodes, or at a fixed radius by the mean of two rotations.
#[test]
fn nodes_of_rigid_units_stay_or_follow() {
    let layout = mixed(true);
    let free = |unit: usize| layout.groups.of_nodes[unit].iter().map(Option::is_some).collect::<Vec<_>>();
    assert_eq!((free(0), free(1)), (vec![true; 3], vec![false, true, true, true, false, false]));
    let design = shaken(&layout, 0.5);
    let [before, after] = [vec![0.0; design.len()], design].map(|design| layout.vertices(&design)[1].clone());
    let shift = |node: usize| [0, 1].map(|d| after[node][d] - before[node][d]);
    assert!((shift(5)[0] - 0.5 * (shift(1)[0] + shift(2)[0])).abs() < 1e-12 && shift(5)[1].abs() < 1e-12);
    let beside = |at: &[[f64; 2]]| {
        let [a, b] = [at[1], at[3]];
        let from = [0, 1].map(|d| at[0][d] - 0.5 * (a[d] + b[d]));
        let (x, y) = (b[0] - a[0], b[1] - a[1]);
        [from[0] * x + from[1] * y, x * from[1] - y * from[0]].map(|part| part / x.hypot(y))
    };
    let (was, is) = (beside(&before), beside(&after));
    assert!((0..2).all(|d| (was[d] - is[d]).abs() < 1e-12) && was[1].abs() > 1.0, "{was:?} {is:?}");
    let turn = |node: usize| after[node][1].atan2(after[node][0]) - before[node][1].atan2(before[node][0]);
    let radius = |at: [f64; 2]| at[0].hypot(at[1]);
    assert!((turn(4) - 0.5 * (turn(2) + turn(1))).abs() < 1e-12 && turn(4).abs() > 1e-3);
    assert!((radius(after[4]) - radius(before[4])).abs() < 1e-12);
}

/// Creating a lattice with longer ligaments is equivalent to lengthening its ligaments.
#[test]
fn longer_ligaments_make_the_lattice_of_their_length() {
    for (name, pattern) in PATTERNS {
        for of in [
            |p: &Pattern, l| Layout::sheet(p, 4, 3, 15.0, l),
            |p: &Pattern, l| Layout::circular(p, 5, 15.0, l),
        ] {
            assert_eq!(of(&pattern(0.4), 2.25).with_ligament_length(2.5), of(&pattern(0.4), 2.5), "{name}");
        }
    }
}

/// Squares given by their corners are equivalent to the square sheet: same signals, and same gradient group by group.
#[test]
fn squares_from_corners_are_the_planar_body() {
    let planar = Layout::planar(4, 3, 15.0, 2.25);
    let ligaments: Vec<[End; 2]> = planar.ligaments.iter().map(|l| [l.a, l.b]).collect();
    let given =
        Layout::of_polygons(&planar.vertices(&vec![0.0; planar.design_len()]), &ligaments, &[], &[], &[]);
    assert_eq!((planar.groups.count(), &planar.boundary()), (given.groups.count(), &given.boundary()));
    let (area, round) = given.mean_unit();
    assert!((area / planar.mean_unit().0 - 1.0).abs() < 1e-12 && (round - 1.0).abs() < 1e-12);
    let design = shaken(&planar, 0.3);
    let mut same = vec![0.0; design.len()];
    let numbers = |layout: &Layout| -> Vec<usize> {
        layout.groups.of_nodes.iter().flatten().flatten().copied().collect()
    };
    let groups: Vec<(usize, usize)> = numbers(&planar).into_iter().zip(numbers(&given)).collect();
    for (ours, theirs) in &groups {
        same[2 * theirs..][..2].copy_from_slice(&design[2 * ours..][..2]);
    }
    let plan = IntegrationPlan::equal(Integrator::Nystrom6, 24);
    let of = |layout: &Layout, design: &[f64]| {
        let (scene, forces) = struck(layout.clone());
        let simulation = run(&scene, design, &forces, &plan, true, &pool(1));
        let gradient = simulation.vjp(&simulation.signals, Wrt::Design, &pool(1)).design;
        (simulation.signals, gradient)
    };
    let ((signals, gradient), (others, other)) = (of(&planar, &design), of(&given, &same));
    assert!(norm(&signals) > 0.0 && relative(&others, &signals) < 1e-9);
    let mut back = vec![0.0; gradient.len()];
    for (ours, theirs) in &groups {
        back[2 * ours..][..2].copy_from_slice(&other[2 * theirs..][..2]);
    }
    assert!(relative(&back, &gradient) < 1e-9, "{}", relative(&back, &gradient));
}

/// Gradients in the design equal differences for every lattice and for mixed polygons, with contact, and with masses of another design and
/// units of different densities. The forward derivative is adjoint to the gradient.
#[test]
fn gradients_in_the_design_are_those_of_differences() {
    let touching = Some(EdgeContact { stiffness: 1.0, min_angle: 0.0, cutoff_angle: 0.9 });
    for (name, layout) in bodies() {
        for (contact, masses) in [(None, false), (touching, false), (None, true)] {
            let (scene, forces) = struck(layout.clone());
            let mut scene = Scene { contact, ..scene };
            if masses {
                scene.inertia = Some(shaken(&layout, 0.1));
                scene.layout.density[1] = 3.0;
            }
            let design = shaken(&scene.layout, 0.3);
            let plan = IntegrationPlan::equal(Integrator::Nystrom6, 60);
            let at = |design: &[f64]| run(&scene, design, &forces, &plan, true, &pool(1));
            let here = at(&design);
            let size = norm(&here.signals).powi(2);
            let cotangent: Vec<f64> = here.signals.iter().map(|s| s / size).collect();
            let gradient = here.vjp(&cotangent, Wrt::Design, &pool(1)).design;
            let along: Vec<f64> = (0..design.len()).map(|i| (0.3 + 2.3 * i as f64).cos()).collect();
            let slope: f64 = gradient.iter().zip(&along).map(|(g, a)| g * a).sum();
            let energy = |by: f64| {
                let moved: Vec<f64> = design.iter().zip(&along).map(|(a, d)| a + by * d).collect();
                0.5 * norm(&at(&moved).signals).powi(2) / size
            };
            // so small that no contact begins or ends; with masses of another design, rounding would dominate at this step
            let near = if masses { 1e-5 } else { 1e-6 };
            let difference = (energy(near) - energy(-near)) / (2.0 * near);
            assert!(
                (difference / slope - 1.0).abs() < 1e-5,
                "{name}, {contact:?}, {masses}: {difference} {slope}"
            );

            let readings = here.signals.len() / forces.samples;
            let forward: f64 = (0..forces.samples)
                .map(|sample| {
                    let tangent = Tangent { design: &along, ..Tangent::default() };
                    let (_, signals) = here.jvp(sample, tangent);
                    let own = &cotangent[sample * readings..][..readings];
                    signals.iter().zip(own).map(|(s, c)| s * c).sum::<f64>()
                })
                .sum();
            assert!((forward / slope - 1.0).abs() < 1e-6, "{name}: {forward} {slope}");
        }
    }
}

/// Area, centroid and moment of inertia of a right-angled triangle (textbook): A = ab/2, J = A (a² + b²)/18.
#[test]
fn a_triangle_has_its_moments() {
    let (a, b) = (12.0, 7.0);
    let corners = vec![[1.0, 2.0], [1.0 + a, 2.0], [1.0, 2.0 + b]];
    let other = vec![[20.0, 0.0], [30.0, 0.0], [20.0, 9.0]];
    let joint = [[End { unit: 0, node: 1 }, End { unit: 1, node: 0 }]];
    let layout = Layout::of_polygons(&[corners, other], &joint, &[], &[], &[]);
    let geometry = Geometry::new(&layout, &vec![0.0; layout.design_len()], 2.0);
    let area = 0.5 * a * b;
    assert!((geometry.area[0] / area - 1.0).abs() < 1e-12);
    assert!((geometry.moment[0] / (2.0 * area * (a * a + b * b) / 18.0) - 1.0).abs() < 1e-12);
    let [x, y] = geometry.centroids[0];
    assert!((x - 1.0 - a / 3.0).abs() < 1e-12 && (y - 2.0 - b / 3.0).abs() < 1e-12);
}
