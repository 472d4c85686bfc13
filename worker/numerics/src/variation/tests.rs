use super::*;
use crate::dynamics::Parameters;

fn variation() -> Variation {
    let material =
        Parameters { stretch: 0.05, shear: 0.1, bend: 0.0, damping_ratio: 0.2, density: 0.03, contact: 0.4 };
    Variation { material, nodes: 0.1 }
}

/// Logarithms of factors and shifts have the deviations asked for, and nothing else scatters; each is drawn by itself.
#[test]
fn casts_scatter_as_asked() {
    let count = 4000;
    let casts: Vec<Cast> = (0..count).map(|i| variation().cast(7, Casts::Unseen, i, 2)).collect();
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
    let correlation = casts.iter().map(|cast| cast.shifts[0] * cast.shifts[1]).sum::<f64>();
    assert!((correlation / (0.01 * count as f64)).abs() < 0.05, "{correlation}");
}

/// A cast is the same whoever asks, another for another seed, purpose or number, and the material's does not hang on the mould's.
#[test]
fn a_cast_is_its_key() {
    let one = variation().cast(7, Casts::Step, 3, 4);
    assert_eq!(one, variation().cast(7, Casts::Step, 3, 4));
    for other in [(8, Casts::Step, 3), (7, Casts::Look, 3), (7, Casts::Step, 4)] {
        let other = variation().cast(other.0, other.1, other.2, 4);
        assert!(other.material.stretch != one.material.stretch && other.shifts[0] != one.shifts[0]);
    }
    let exact = Variation { nodes: 0.0, ..variation() }.cast(7, Casts::Step, 3, 4);
    assert_eq!((exact.material, exact.shifts.len()), (one.material, 0));
}
