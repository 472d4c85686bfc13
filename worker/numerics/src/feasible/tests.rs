//! Properties of the projection and of the exact check.

use super::*;
use crate::body::{End, FollowRule, Follower, Pattern};
use crate::random::{Purpose, Stream};
use proptest::prelude::*;

const PATTERNS: [fn(f64) -> Pattern; 4] =
    [|_| Pattern::square(), |_| Pattern::kagome(), Pattern::triangular, Pattern::chiral];
const ANGLE: f64 = 25.0 * std::f64::consts::PI / 180.0;

fn body(columns: usize, rows: usize) -> (Layout, Vec<f64>, FeasibleSet) {
    let layout = Layout::planar(columns, rows, 15.0, 2.25);
    let start = layout.initial_design(ANGLE);
    let feasible = FeasibleSet::new(&layout, Limits::default(), &[]);
    (layout, start, feasible)
}

fn noisy(start: &[f64], size: f64, seed: u64) -> Vec<f64> {
    let mut stream = Stream::new(Purpose::Design, seed, [7, 7]);
    start.iter().map(|x| x + stream.between([-size, size])).collect()
}

/// A feasible target is returned with the same bits, and no program is solved.
#[test]
fn a_feasible_target_comes_back_bit_for_bit() {
    let (_, start, mut feasible) = body(6, 6);
    for seed in 0..20 {
        let target = noisy(&start, 1.0, seed);
        assert!(feasible.violations(&target).is_empty(), "seed {seed}");
        let out = feasible.project(&start, &target, None);
        assert_eq!((out.status, out.programs), (Status::Untouched, 0));
        assert!(out.design.iter().zip(&target).all(|(a, b)| a.to_bits() == b.to_bits()));
    }
}

/// For small to very large steps and several sizes, the exact check accepts every result.
#[test]
fn what_comes_back_satisfies_every_constraint() {
    for (columns, rows) in [(2, 2), (3, 5), (6, 6)] {
        let (_, start, mut feasible) = body(columns, rows);
        for (seed, size) in [(1, 2.5), (2, 3.0), (3, 4.0), (4, 6.0), (5, 7.5), (6, 12.0)] {
            let out = feasible.project(&start, &noisy(&start, size, seed), None);
            let broken = feasible.violations(&out.design);
            assert!(broken.is_empty() && out.status.is_feasible(), "{size}: {:?} {}", out.status, broken[0]);
            assert!(size > 4.0 || out.status != Status::Kept, "{columns}×{rows}, ±{size} mm: kept");
        }
    }
}

/// For every lattice, in a sheet and in discs, the initial design and projections of random steps are feasible.
#[test]
fn every_lattice_starts_castable_and_stays_so() {
    for (number, pattern) in PATTERNS.into_iter().enumerate() {
        let of = |columns: usize| Layout::circular(&pattern(ANGLE), columns, 15.0, 2.25);
        for layout in [Layout::sheet(&pattern(ANGLE), 4, 3, 15.0, 2.25), of(4), of(5)] {
            let start = layout.initial_design(ANGLE);
            let mut feasible = FeasibleSet::new(&layout, Limits::default(), &[]);
            let what = format!("lattice {number}, {} units", layout.units());
            assert_eq!(feasible.violations(&start), [], "{what}");
            for (seed, size) in [(1, 1.0), (2, 2.5), (3, 4.0)] {
                let out = feasible.project(&start, &noisy(&start, size, seed), None);
                assert_eq!(feasible.violations(&out.design), [], "{what}, ±{size} mm");
                let moved = matches!(out.status, Status::Untouched | Status::Projected);
                assert!(moved, "{what}, ±{size} mm: {:?}", out.status);
            }
        }
    }
}

/// Steps of an optimiser's size into the constraints are projected, never rejected, and never worse than the previous design.
#[test]
fn small_steps_are_projected_never_refused() {
    let (_, start, mut feasible) = body(5, 4);
    let direction: Vec<f64> = noisy(&vec![0.0; start.len()], 1.0, 3).iter().map(|x| x.signum()).collect();
    let mut x = start;
    let mut projected = 0;
    for step in 0..60 {
        let target: Vec<f64> = x.iter().zip(&direction).map(|(x, d)| x + 0.12 * d).collect();
        let out = feasible.project(&x, &target, None);
        assert!(matches!(out.status, Status::Untouched | Status::Projected), "step {step}: {:?}", out.status);
        assert!(out.distance <= distance(&x, &target) + 1e-9, "step {step}: {} mm", out.distance);
        assert!(feasible.violations(&out.design).is_empty(), "step {step}");
        projected += usize::from(out.status == Status::Projected);
        x = out.design;
    }
    assert!(projected > 20, "{projected} of 60 were projected");
}

/// Projecting a result changes nothing; equal calls give equal bits.
#[test]
fn a_projection_is_idempotent_and_repeats_bit_for_bit() {
    let (_, start, mut feasible) = body(4, 4);
    let target = noisy(&start, 4.0, 11);
    let first = feasible.project(&start, &target, None);
    assert_eq!(first.status, Status::Projected);
    assert_eq!(feasible.project(&start, &first.design, None).status, Status::Untouched);
    let (_, _, mut other) = body(4, 4);
    assert_eq!(other.project(&start, &target, None), first);
}

/// NaN or infinity in target or weights returns the previous design with the right status.
#[test]
fn what_is_not_finite_keeps_the_previous_design() {
    let (_, start, mut feasible) = body(3, 3);
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut target = start.clone();
        target[5] = bad;
        let out = feasible.project(&start, &target, None);
        assert_eq!((out.status, &out.design), (Status::NotFinite, &start));
        assert_eq!(feasible.violations(&target)[0].kind, ViolationKind::NotFinite);
        let weights = vec![bad; start.len()];
        let out = feasible.project(&start, &noisy(&start, 6.0, 1), Some(&weights));
        assert_eq!(out.status, Status::NotFinite);
    }
    let out = feasible.project(&vec![f64::NAN; start.len()], &vec![f64::NAN; start.len()], None);
    assert_eq!(out.status, Status::Infeasible);
    // A finite but absurd target.
    let out = feasible.project(&start, &noisy(&start, 1e300, 1), None);
    assert!(feasible.violations(&out.design).is_empty(), "{:?}", out.status);
}

/// Contradictory limits give the status `Infeasible`.
#[test]
fn contradictory_limits_are_named() {
    let layout = Layout::planar(3, 3, 15.0, 2.25);
    let start = layout.initial_design(ANGLE);
    for limits in [
        Limits { clearance: 3.0, ..Limits::default() },
        Limits { min_block_angle: 1.6, ..Limits::default() },
        Limits { min_edge: 200.0, clearance: 200.0, ..Limits::default() },
    ] {
        let out = FeasibleSet::new(&layout, limits, &[]).project(&start, &start, None);
        assert_eq!(out.status, Status::Infeasible, "{limits:?}");
    }
}

/// Fixed units keep their nodes for any target.
#[test]
fn fixed_units_stay() {
    let layout = Layout::planar(4, 4, 15.0, 2.25);
    let start = layout.initial_design(ANGLE);
    let mut feasible = FeasibleSet::new(&layout, Limits::default(), &[0, 13]);
    let out = feasible.project(&start, &noisy(&start, 5.0, 2), None);
    assert_eq!(out.status, Status::Projected);
    let (before, after) = (layout.vertices(&start), layout.vertices(&out.design));
    assert_eq!([&before[0], &before[13]], [&after[0], &after[13]]);
    assert!(before[5] != after[5]);
}

/// Squares below a rigid plate with a notch between its two anchors.
fn plated() -> (Layout, Vec<f64>) {
    let (squares, start, _) = body(2, 3);
    let mut units = squares.vertices(&start);
    let ([x, y], [z, w]) = (units[4][1], units[5][1]);
    let (level, top) = (45.0, 52.0);
    units.push(vec![
        [-7.5, top],
        [-7.5, level],
        [x, y + 2.25],
        [0.5 * (x + z), level],
        [z, w + 2.25],
        [22.5, level],
        [22.5, top],
    ]);
    let mut ligaments: Vec<[End; 2]> = squares.ligaments.iter().map(|l| [l.a, l.b]).collect();
    let joint = |unit, node| [End { unit, node: 1 }, End { unit: 6, node }];
    ligaments.extend([joint(4, 2), joint(5, 4)]);
    let follower = Follower { node: 3, of: [2, 4], by: FollowRule::MeanX };
    let layout = Layout::of_polygons(&units, &ligaments, &[], &[6], &[(6, follower)]);
    let start = vec![0.0; layout.design_len()];
    (layout, start)
}

/// Reflex corners of a rigid plate violate no limit, its anchors are shifted, and other parts keep their distance.
#[test]
fn a_rigid_plate_is_taken_as_it_is_and_kept_clear_of() {
    let (layout, start) = plated();
    let mut feasible = FeasibleSet::new(&layout, Limits::default(), &[]);
    assert_eq!(feasible.violations(&start), []);
    for (seed, size) in [(1, 4.0), (2, 5.0), (3, 6.0), (4, 7.5)] {
        let out = feasible.project(&start, &noisy(&start, size, seed), None);
        assert_eq!((out.status, feasible.violations(&out.design)), (Status::Projected, vec![]), "{size}");
        let [was, is] = [&start, &out.design].map(|design| layout.vertices(design)[6].clone());
        assert!(was[2] != is[2] && was[3] != is[3] && [0, 1, 5, 6].iter().all(|&node| was[node] == is[node]));
    }
    // A square that extends through the plate.
    let mut wrong = start.clone();
    let free = layout.groups.of_nodes[4][2].unwrap();
    wrong[2 * free + 1] += 22.0;
    let kinds: Vec<_> = feasible.violations(&wrong).iter().map(|v| (v.kind, v.units)).collect();
    assert!(kinds.contains(&(ViolationKind::Overlap, [4, 6])), "{kinds:?}");
}

/// Without limits every finite design is returned unchanged; its overlaps are counted: a square moved onto its neighbour, and an
/// inverted one.
#[test]
fn without_limits_all_designs_pass_and_their_overlaps_are_counted() {
    let square = |[x, y]: [f64; 2]| vec![[x, y], [x + 4.0, y], [x + 4.0, y + 4.0], [x, y + 4.0]];
    // An L-shape with a reflex corner: 4 × 4 less 2 × 2.
    let angle = [[9.0, 0.0], [13.0, 0.0], [13.0, 2.0], [11.0, 2.0], [11.0, 4.0], [9.0, 4.0]].to_vec();
    let joint = [
        [End { unit: 0, node: 2 }, End { unit: 1, node: 3 }],
        [End { unit: 1, node: 0 }, End { unit: 2, node: 0 }],
    ];
    let body = [square([0.0, 0.0]), square([4.5, 0.0]), angle];
    let layout = Layout::of_polygons(&body, &joint, &[], &[2], &[]);
    let still = vec![0.0; layout.design_len()];
    assert_eq!(overlaps(&layout, &still), Overlaps::default());
    // The second square's right side moved by 6.5 mm, over the whole L-shape.
    let mut wide = still.clone();
    for node in [1, 2] {
        wide[2 * layout.groups.of_nodes[1][node].unwrap()] += 6.5;
    }
    let limits = Limits { enforced: false, ..Limits::default() };
    let mut feasible = FeasibleSet::new(&layout, limits, &[]);
    let out = feasible.project(&still, &wide, None);
    assert_eq!((out.status, &out.design, out.active.len()), (Status::Untouched, &wide, 0));
    let Overlaps { pairs, area, inverted, .. } = overlaps(&layout, &wide);
    assert!(pairs == 1 && inverted == 0 && (area - 12.0).abs() < 1e-12, "{pairs} {inverted} {area}");
    let mut over = still.clone();
    for node in [0, 3] {
        over[2 * layout.groups.of_nodes[0][node].unwrap()] += 5.0;
    }
    let Overlaps { inverted, inverted_area, .. } = overlaps(&layout, &over);
    assert!(inverted == 1 && (inverted_area - 4.0).abs() < 1e-12, "{inverted_area}");
}

/// Each kind of violation is found with its kind and units.
#[test]
fn the_judge_names_what_is_broken() {
    let (layout, start, feasible) = body(3, 3);
    let seen = |unit: usize, node: usize, shift: [f64; 2]| {
        let mut design = start.clone();
        let group = layout.groups.of_nodes[unit][node].unwrap();
        design[2 * group] += shift[0];
        design[2 * group + 1] += shift[1];
        feasible.violations(&design).iter().map(|v| (v.kind, v.units)).collect::<Vec<_>>()
    };
    assert!(seen(4, 0, [0.0, 0.0]).is_empty());
    // A free corner moved across its own unit, which inverts it.
    assert!(seen(0, 2, [16.0, 0.0]).contains(&(ViolationKind::NotSimple, [0, 0])));
    // Stretched to a needle.
    assert!(seen(0, 2, [-30.0, 0.0]).contains(&(ViolationKind::BlockAngleLow, [0, 0])));
    // Moved far across the neighbour above.
    assert!(seen(0, 2, [0.0, 22.0]).contains(&(ViolationKind::Overlap, [0, 3])));
}

/// Random designs are feasible, equal for equal seeds, and far from each other.
#[test]
fn random_designs_are_feasible_and_named_by_their_seed() {
    let layout = Layout::circular(&Pattern::square(), 5, 15.0, 2.25);
    let start = layout.initial_design(ANGLE);
    let mut feasible = FeasibleSet::new(&layout, Limits::default(), &[]);
    let designs: Vec<Vec<f64>> =
        (0..6).map(|seed| feasible.random_design(&start, seed, 3.75).expect("a design")).collect();
    for (seed, design) in designs.iter().enumerate() {
        assert!(feasible.violations(design).is_empty(), "seed {seed}");
        assert_eq!(Some(design), feasible.random_design(&start, seed as u64, 3.75).as_ref());
        assert!(designs[..seed].iter().all(|other| distance(design, other) > 10.0));
    }
}

/// Adam on ½ Σ h (α − a)² with a distant optimum, followed by the projection. The constrained optimum is the projection of a in
/// the metric h. With the weights √v̂ the loop converges to it, with the Euclidean projection it does not.
#[test]
fn adam_with_the_weighted_projection_ends_at_the_constrained_optimum() {
    let (_, start, mut feasible) = body(3, 3);
    let goal = noisy(&start, 6.0, 5);
    let mut stream = Stream::new(Purpose::Design, 6, [0, 0]);
    let h: Vec<f64> = start.iter().map(|_| 10_f64.powf(stream.between([-2.0, 0.0]))).collect();
    let cost =
        |x: &[f64]| x.iter().zip(&goal).zip(&h).map(|((x, a), h)| 0.5 * h * (x - a).powi(2)).sum::<f64>();
    let best = cost(&feasible.project(&start, &goal, Some(&h)).design);
    let mut run = |weighted: bool| {
        let mut x = start.clone();
        let (mut m, mut v) = (vec![0.0; x.len()], vec![0.0; x.len()]);
        for t in 1..=800 {
            let rate = 0.1 * (1.0 - f64::from(t) / 801.0);
            let (c1, c2) = (1.0 - 0.9_f64.powi(t), 1.0 - 0.999_f64.powi(t));
            let mut target = x.clone();
            for i in 0..x.len() {
                let g = h[i] * (x[i] - goal[i]);
                m[i] = 0.9 * m[i] + 0.1 * g;
                v[i] = 0.999 * v[i] + 0.001 * g * g;
                target[i] -= rate * m[i] / c1 / ((v[i] / c2).sqrt() + 1e-8);
            }
            let weights: Vec<f64> = v.iter().map(|v| (v / c2).sqrt()).collect();
            let out = feasible.project(&x, &target, weighted.then_some(&weights));
            assert!(
                matches!(out.status, Status::Untouched | Status::Projected),
                "step {t}: {:?}",
                out.status
            );
            x = out.design;
        }
        cost(&x)
    };
    let (weighted, plain) = (run(true), run(false));
    assert!(weighted < 1.001 * best, "weighted: {weighted}, optimum {best}");
    assert!(plain > 1.2 * best, "plain: {plain}, optimum {best}");
}

/// Distances that Ipopt (casadi 3.8, with its own formulation: one separating line per pair, from the rotated squares) found for
/// random steps of 6 × 6 units: (largest shift, seed, mm). The first four also have a more distant local optimum.
#[test]
fn the_nearest_design_is_as_near_as_an_independent_solver_finds() {
    let cases = [
        (6.0, 15, 8.99744),
        (7.5, 15, 15.65306),
        (7.5, 33, 15.70999),
        (7.5, 35, 11.80738),
        (4.0, 0, 0.01083),
        (4.0, 1, 2.21617),
        (4.0, 2, 1.31134),
        (5.0, 0, 1.91360),
        (5.0, 1, 4.60933),
        (5.0, 2, 3.47542),
        (6.0, 0, 5.61115),
        (6.0, 1, 8.16091),
        (7.5, 0, 11.95294),
        (7.5, 1, 14.99875),
    ];
    let (_, start, mut feasible) = body(6, 6);
    for (size, seed, nearest) in cases {
        let mut stream = Stream::new(Purpose::Design, 5, [seed, 0]);
        let target: Vec<f64> = start.iter().map(|x| x + size * stream.between([-1.0, 1.0])).collect();
        let out = feasible.project(&start, &target, None);
        assert!(
            out.distance < 1.001 * nearest,
            "±{size} mm, seed {seed}: {} mm, {nearest} mm found",
            out.distance
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

    /// For any layout, limits and step, the result is feasible or the previous design, as the status states.
    #[test]
    fn the_promise_holds_for_any_body_limits_and_step(
        columns in 2_usize..6, rows in 2_usize..5, family in 0_usize..5, ligament in 1.0..4.0_f64,
        angle in 0.0..0.6_f64, block in 10.0..40.0_f64, flat in 150.0..178.0_f64, void in 0.0..20.0_f64,
        beside in 0.0..25.0_f64, min_edge in 0.5..5.0_f64, clearance in 0.0..2.5_f64, bar in 0.0..1.0_f64,
        size in 0.05..12.0_f64, seed in 0_u64..1000, fixed in proptest::option::of(0_usize..4),
    ) {
        let layout = match family {
            0 => Layout::circular(&PATTERNS[rows % 4](angle), columns, 15.0, ligament),
            1 => Layout::planar(columns, rows, 15.0, ligament),
            2 => Layout::sheet(&Pattern::kagome(), columns, rows, 15.0, ligament),
            3 => Layout::sheet(&Pattern::triangular(angle), columns, rows, 15.0, ligament),
            _ => Layout::sheet(&Pattern::chiral(angle), columns, rows, 15.0, ligament),
        };
        let limits = Limits {
            enforced: true,
            min_block_angle: block.to_radians(), max_block_angle: flat.to_radians(),
            min_void_angle: void.to_radians(), min_ligament_angle: beside.to_radians(),
            min_edge, clearance, ligament_clearance: bar,
        };
        // Small discs have three units.
        let fixed: Vec<usize> = fixed.into_iter().map(|unit| unit % layout.units()).collect();
        let mut feasible = FeasibleSet::new(&layout, limits, &fixed);
        let start = layout.initial_design(angle);
        let target = noisy(&start, size, seed);
        let weights: Vec<f64> = noisy(&vec![1.0; start.len()], 0.99, seed + 1);
        let out = feasible.project(&start, &target, (seed % 2 == 0).then_some(&weights));
        let broken = feasible.violations(&out.design);
        match out.status {
            Status::Untouched | Status::Projected => prop_assert!(broken.is_empty(), "{:?}: {}", out.stage, broken[0]),
            Status::Kept => prop_assert!(broken.is_empty() && out.design == start),
            Status::Infeasible => prop_assert!(!broken.is_empty() && out.design == start),
            Status::NotFinite => prop_assert!(false, "all was finite"),
        }
        prop_assert!(out.distance.is_finite() && out.active.iter().all(|a| a.slack.is_finite()));
        for unit in fixed {
            prop_assert_eq!(&layout.vertices(&out.design)[unit], &layout.vertices(&start)[unit]);
        }
    }
}
