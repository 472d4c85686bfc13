use super::*;
use crate::body::Layout;
use crate::dynamics::Parameters;

/// Two units with a ligament.
fn pair() -> Layout {
    Layout::planar(2, 1, 15.0, 2.25)
}

fn variation() -> Deviations {
    let material =
        Parameters { stretch: 0.05, shear: 0.1, bend: 0.0, damping_ratio: 0.2, density: 0.03, contact: 0.4 };
    Deviations { material, nodes: 0.1, gain: 0.02, misalignment: 0.03, ..Deviations::default() }
}

/// Logarithms of factors, and shifts, have the given standard deviations and are independent; nothing else varies.
#[test]
fn casts_scatter_as_asked() {
    let count = 4000;
    let casts: Vec<Cast> =
        (0..count).map(|i| variation().cast(7, Casts::Unseen, i, (&pair(), 1), &[])).collect();
    let deviation = |of: &dyn Fn(&Cast) -> f64| {
        let values: Vec<f64> = casts.iter().map(of).collect();
        (values.iter().map(|x| x * x).sum::<f64>() / count as f64).sqrt()
    };
    for (i, asked) in variation().material.array().into_iter().enumerate() {
        let found = deviation(&|cast| cast.material.array()[i].ln());
        assert!((found - asked).abs() <= 0.05 * asked, "{i}: {found} {asked}");
    }
    let found = [0, 1].map(|i| deviation(&|cast| cast.shifts[i]));
    assert!(found.iter().all(|found| (found / 0.1 - 1.0).abs() < 0.05), "{found:?}");
    for (c, found) in [0, 1, 2].map(|c| deviation(&|cast| cast.chips.gain[c].ln())).into_iter().enumerate() {
        assert!((found / 0.02 - 1.0).abs() < 0.05, "channel {c}: {found}");
    }
    let found = deviation(&|cast| cast.chips.turn[0]);
    assert!((found / 0.03 - 1.0).abs() < 0.05, "{found}");
    let correlation = casts.iter().map(|cast| cast.shifts[0] * cast.shifts[1]).sum::<f64>();
    assert!((correlation / (0.01 * count as f64)).abs() < 0.05, "{correlation}");
}

/// Equal keys give equal casts; another seed, purpose or number gives another cast. Material draws do not depend on those of the
/// mould.
#[test]
fn a_cast_is_its_key() {
    let one = variation().cast(7, Casts::Step, 3, (&pair(), 2), &[]);
    assert_eq!(one, variation().cast(7, Casts::Step, 3, (&pair(), 2), &[]));
    for other in [(8, Casts::Step, 3), (7, Casts::Look, 3), (7, Casts::Step, 4)] {
        let other = variation().cast(other.0, other.1, other.2, (&pair(), 2), &[]);
        assert!(other.material.stretch != one.material.stretch && other.shifts[0] != one.shifts[0]);
    }
    let exact =
        Deviations { nodes: 0.0, gain: 0.0, ..variation() }.cast(7, Casts::Step, 3, (&pair(), 2), &[]);
    assert_eq!((exact.material, exact.shifts.len(), exact.chips.gain.len()), (one.material, 0, 0));
    assert_eq!(exact.chips.turn, one.chips.turn);
}

/// A chip rotated by φ measures a vector rotated by −φ, times its gains; (C a)·c = a·(Cᵀ c).
#[test]
fn chips_turn_and_amplify_and_their_pull_back_is_the_transpose() {
    let turn = vec![std::f64::consts::FRAC_PI_2, 0.0];
    let chips = Chips { gain: vec![2.0, 3.0, 5.0, 1.0, 1.0, 0.5], turn };
    let mut read = [1.0, 0.0, 1.0, 1.0, 2.0, 4.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0];
    chips.read(&mut read);
    let wanted = [0.0, -3.0, 5.0, 1.0, 2.0, 2.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    assert!(read.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-12), "{read:?}");
    let chips = variation().cast(3, Casts::Step, 0, (&pair(), 2), &[]).chips;
    let mut stream = Stream::new(Purpose::Design, 3, [0, 0]);
    let mut draw = || -> Vec<f64> { (0..4 * 6).map(|_| stream.normal()).collect() };
    let (a, c) = (draw(), draw());
    let (mut read, mut back) = (a.clone(), c.clone());
    chips.read(&mut read);
    chips.read_vjp(&mut back);
    let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
    let (left, right) = (dot(&read, &c), dot(&a, &back));
    assert!((left - right).abs() < 1e-12 * (1.0 + left.abs()) && read != a, "{left} {right}");
}

/// Logarithms of factors per ligament and unit have the given standard deviations and are independent; common factors stay the
/// same.
#[test]
fn parts_scatter_each_by_itself() {
    let (layout, count) = (Layout::planar(3, 1, 15.0, 2.25), 4000);
    let by_parts = Deviations { ligaments: [0.05, 0.0, 0.1], units: 0.03, ..variation() };
    let cast = |i| by_parts.cast(7, Casts::Unseen, i, (&layout, 1), &[]);
    let casts: Vec<Cast> = (0..count).map(cast).collect();
    let moment = |of: &dyn Fn(&Cast) -> f64| casts.iter().map(of).sum::<f64>() / count as f64;
    for (found, asked) in [
        (moment(&|c| c.parts.ligaments[1][0].ln().powi(2)).sqrt(), 0.05),
        (moment(&|c| c.parts.ligaments[0][2].ln().powi(2)).sqrt(), 0.1),
        (moment(&|c| c.parts.units[2].ln().powi(2)).sqrt(), 0.03),
    ] {
        assert!((found / asked - 1.0).abs() < 0.05, "{found} {asked}");
    }
    for (a, b) in [([0, 0], [1, 0]), ([0, 0], [0, 2]), ([1, 2], [0, 2])] {
        let deviations = [0.05, 0.0, 0.1];
        let of = |c: &Cast, at: [usize; 2]| c.parts.ligaments[at[0]][at[1]].ln() / deviations[at[1]];
        let found = moment(&|c| of(c, a) * of(c, b));
        assert!(found.abs() < 0.05, "{a:?} {b:?}: {found}");
    }
    assert!(casts.iter().all(|c| c.parts.ligaments.iter().all(|by| by[1] == 1.0)));
    let plain = variation().cast(7, Casts::Unseen, 5, (&layout, 1), &[]);
    assert_eq!((&plain.material, &plain.shifts), (&casts[5].material, &casts[5].shifts));
    assert_eq!(plain.parts, crate::dynamics::PartFactors::default());
    // The standard deviation of one stiffness does not affect the draws of another.
    let alone =
        Deviations { ligaments: [0.0, 0.0, 0.1], ..variation() }.cast(7, Casts::Unseen, 5, (&layout, 1), &[]);
    assert_eq!(alone.parts.ligaments[1][2], casts[5].parts.ligaments[1][2]);
}

/// The ligament length has one factor per cast; the grid stays.
#[test]
fn lengths_scatter_on_the_grid() {
    let (layout, count) = (pair(), 4000);
    let by = Deviations { ligament_length: 0.04, ..variation() };
    let cast = |i| by.cast(7, Casts::Unseen, i, (&layout, 1), &[]);
    let squares: f64 = (0..count).map(|i| cast(i).ligament_length.ln().powi(2)).sum();
    let found = (squares / count as f64).sqrt();
    assert!((found / 0.04 - 1.0).abs() < 0.05, "{found}");
    assert_eq!(variation().cast(7, Casts::Unseen, 0, (&layout, 1), &[]).ligament_length, 1.0);
    let longer = layout.with_ligament_length(2.5);
    assert_eq!(longer, Layout::planar(2, 1, 15.0, 2.5));
}

/// Shifts of groups r apart have the correlation exp(−r²/2c²) on each axis, none across axes, and the given standard deviation.
#[test]
fn near_nodes_scatter_alike() {
    let layout = Layout::planar(3, 2, 15.0, 2.25);
    let variation = Deviations { correlation: 15.0, ..variation() };
    let (likeness, count) = (variation.correlation_factor(&layout, &Pool::new(1).unwrap()), 4000);
    let casts: Vec<Cast> =
        (0..count).map(|i| variation.cast(7, Casts::Unseen, i, (&layout, 0), &likeness)).collect();
    let found = |a: usize, b: usize| {
        casts.iter().map(|cast| cast.shifts[a] * cast.shifts[b]).sum::<f64>() / (0.01 * count as f64)
    };
    // Groups of the ligaments between units 0, 1 and 1, 2: one spacing apart.
    let [first, second] = [layout.groups.of_nodes[0][0], layout.groups.of_nodes[1][0]].map(Option::unwrap);
    for axis in 0..2 {
        let [a, b] = [2 * first + axis, 2 * second + axis];
        for (pair, asked) in [([a, a], 1.0), ([b, b], 1.0), ([a, b], (-0.5f64).exp()), ([a, b ^ 1], 0.0)] {
            let found = found(pair[0], pair[1]);
            assert!((found - asked).abs() < 0.07, "{pair:?}: {found} {asked}");
        }
    }
    // A correlation length beyond the body's size shifts it as a whole.
    let rigid = Deviations { correlation: 1e4, ..variation };
    let cast = rigid.cast(
        7,
        Casts::Step,
        0,
        (&layout, 0),
        &rigid.correlation_factor(&layout, &Pool::new(1).unwrap()),
    );
    assert!(cast.shifts.chunks(2).all(|shift| (shift[0] - cast.shifts[0]).abs() < 2e-3), "{cast:?}");
    assert!(
        Deviations { correlation: 0.0, ..variation }
            .correlation_factor(&layout, &Pool::new(1).unwrap())
            .is_empty()
    );
}
