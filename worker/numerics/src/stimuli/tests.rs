use super::*;

const BELL: Bell = Bell {
    amplitude: [0.15, 0.5],
    width: [0.06, 0.25],
    onset: [0.0, 0.5],
    peak: [0.35, 0.65],
    power: [1.5, 4.0],
};

fn draw(purpose: Purpose, samples: Range<u64>) -> Forces {
    bells(&BELL, purpose, 5, samples, 2, 1.0, 200)
}

/// At onset + peak·width the argument of the sine is π/2; outside (onset, onset + width) the force is 0.
#[test]
fn a_pulse_peaks_where_it_says_and_is_zero_outside() {
    let pulse = Pulse { amplitude: 0.4, width: 0.2, onset: 0.1, peak: 0.37, power: 2.5 };
    let top = pulse.force(0.1 + 0.37 * 0.2);
    assert!((top - 0.4).abs() < 1e-12, "{top}");
    for t in [0.0, 0.1, 0.3, 0.31, 1.0] {
        assert!(pulse.force(t) < 1e-9, "f({t}) = {}", pulse.force(t));
    }
    assert!(pulse.force(0.3 - 1e-17).is_finite());
}

/// Histories of an independent program (numpy): four instants of each pulse, and the sum over all.
#[test]
fn pulses_agree_with_reference_histories() {
    let cases = [
        (
            [
                0.46611013382020117,
                0.17215282410323732,
                0.44845303275542514,
                0.6062561822296717,
                2.083297772953328,
            ],
            [
                (91, 0.00040462080296318055),
                (101, 0.173733525274119),
                (113, 0.4342028482962448),
                (123, 0.007793951818864544),
            ],
            7.119741278194201,
        ),
        (
            [
                0.3153906470927328,
                0.09990641545545569,
                0.29766187526280385,
                0.3622343613321756,
                1.6041376883714724,
            ],
            [
                (61, 0.1051706519915069),
                (66, 0.3119897846436915),
                (73, 0.1680948463398519),
                (78, 0.017306030903874163),
            ],
            3.5571924161122355,
        ),
    ];
    for ([amplitude, width, onset, peak, power], instants, sum) in cases {
        let mut history = [0.0; 201];
        Pulse { amplitude, width, onset, peak, power }.history_into(1.0, &mut history);
        for (n, f) in instants {
            assert!((history[n] - f).abs() < 1e-13, "f[{n}] = {}, not {f}", history[n]);
        }
        let total: f64 = history.iter().sum();
        assert!((total - sum).abs() < 1e-11, "{total}, not {sum}");
    }
}

/// A sample does not depend on others that are drawn with it; other purposes give other samples.
#[test]
fn a_sample_depends_on_its_number_and_purpose_alone() {
    let all = draw(Purpose::Stimulus, 0..6);
    assert_eq!(draw(Purpose::Stimulus, 2..4).values, all.select(&[2, 3]).values);
    assert_ne!(draw(Purpose::Holdout, 0..6).values, all.values);
    assert_ne!(draw(Purpose::Fresh, 0..6).values, all.values);
}

/// Training and test set are disjoint and complete, with the requested sizes; another seed gives another split.
#[test]
fn a_split_is_a_partition() {
    let (training, test) = split(3, 300, 30, false);
    assert_eq!((training.len(), test.len()), (270, 30));
    let mut all = [training.clone(), test.clone()].concat();
    all.sort_unstable();
    assert_eq!(all, (0..300).collect::<Vec<_>>());
    assert_ne!(split(4, 300, 30, false).1, test);
}

/// With replacement, the test set may contain a sample twice; the training set contains all others.
#[test]
fn a_split_with_replacement_trains_on_what_does_not_test() {
    let (training, test) = split(3, 300, 30, true);
    let distinct: std::collections::BTreeSet<usize> = test.iter().copied().collect();
    assert_eq!((test.len(), training.len()), (30, 300 - distinct.len()));
    assert!(training.iter().all(|sample| !distinct.contains(sample)));
    let repeats = |seed| split(seed, 30, 20, true).0.len() > 10;
    assert!((0..4).all(repeats));
}

/// A Gaussian pulse has its amplitude at the centre and e^(−½) of it at a distance of σ. Panels are silent as often as requested,
/// but never all.
#[test]
fn gaussian_pulses_and_silent_panels() {
    let kind = Gauss { amplitude: [0.2, 0.2], sigma: [0.02, 0.02], centre: [0.5, 0.5] };
    let forces = gauss(&kind, Purpose::Stimulus, 1, 0..2, 2, 1.0, 100);
    let own = forces.sample(1);
    for (n, f) in [(50, 0.2), (52, 0.2 * (-0.5f64).exp()), (46, 0.2 * (-2f64).exp())] {
        assert!((own[n] - f).abs() < 1e-12, "{n}: {}", own[n]);
    }
    let masks: Vec<Vec<bool>> = (0..4000).map(|i| silenced(0.5, Purpose::Stimulus, 1, i, 2)).collect();
    assert!(masks.iter().all(|mask| mask.contains(&false)));
    let silent = masks.iter().flatten().filter(|silent| **silent).count() as f64 / 8000.0;
    // One of the four cases of two panels is excluded.
    assert!((silent - 1.0 / 3.0).abs() < 0.02, "{silent}");
    assert_eq!(silenced(0.0, Purpose::Stimulus, 1, 7, 3), [false; 3]);
}

/// Targets exclude instant 0; panels are the last axis.
#[test]
fn targets_are_the_forces_at_the_instants_of_the_signals() {
    let forces = Forces {
        samples: 1,
        panels: 2,
        instants: 2,
        values: vec![0.0, 1.0, 2.0, 0.0, 10.0, 20.0],
        strikes: Vec::new(),
    };
    assert_eq!(targets(&forces, 2, false), [1.0, 10.0, 2.0, 20.0]);
    assert_eq!(targets(&forces, 1, false), [2.0, 20.0]);
}

/// Records are dealt once each; fresh samples are training records with a factor and a shift.
#[test]
fn records_are_dealt_out_once_and_varied_when_drawn_afresh() {
    let (records, instants) = (12, 50);
    let mut values = vec![0.0; records * (instants + 1)];
    for (i, history) in values.chunks_exact_mut(instants + 1).enumerate() {
        history[20] = 1.0 + i as f64;
    }
    let histories = Forces { samples: records, panels: 1, instants, values, strikes: Vec::new() };
    let source = RecordedForces {
        histories: std::sync::Arc::new(histories),
        struck: None,
        scale: [0.9, 1.1],
        shift: [-0.1, 0.1],
        low_pass: true,
    };
    let deal = RecordSplit { seed: 3, samples: 8, test: 2, replacement: false };
    let draw = |purpose, count| source.forces(deal, purpose, 0, count, 2, 1.0);
    let peaks = |forces: &Forces| -> Vec<f64> {
        (0..forces.samples).map(|i| forces.sample(i).iter().copied().fold(0.0, f64::max)).collect()
    };
    let both = [peaks(&draw(Purpose::Stimulus, 8)), peaks(&draw(Purpose::Holdout, 4))].concat();
    let mut sorted = both.clone();
    sorted.sort_by(f64::total_cmp);
    assert_eq!(sorted, (1..=12).map(f64::from).collect::<Vec<_>>());
    assert_ne!(both, sorted, "not shuffled");

    let training: Vec<f64> = split(3, 8, 2, false).0.iter().map(|&i| both[i]).collect();
    let fresh = draw(Purpose::Fresh, 100);
    let mut places = std::collections::HashSet::new();
    for (i, peak) in peaks(&fresh).iter().enumerate() {
        let nearest = training.iter().map(|t| peak / t).find(|ratio| (0.9..=1.1).contains(ratio));
        assert!(nearest.is_some(), "{peak} of {training:?}");
        let place = fresh.sample(i).iter().position(|f| f == peak).unwrap();
        places.insert((place / 51, place % 51));
    }
    assert!(places.iter().all(|(_, n)| (15..=25).contains(n)) && places.len() > 15, "{places:?}");
}

/// On a target clock coarser than the forces', a tone above half its rate is not aliased.
#[test]
fn targets_of_a_finer_clock_are_read_without_what_they_cannot_say() {
    let tone = |hertz: f64| -> Vec<f64> {
        (0..=1600).map(|n| (std::f64::consts::TAU * hertz * n as f64 / 1600.0).sin()).collect()
    };
    let size = |v: Vec<f64>| v[40..160].iter().map(|x| x * x).sum::<f64>().sqrt();
    let of = |hertz, low_pass| {
        size(targets(
            &Forces { samples: 1, panels: 1, instants: 1600, values: tone(hertz), strikes: Vec::new() },
            200,
            low_pass,
        ))
    };
    let (kept, left, aliased) = (of(20.0, true) / of(20.0, false), of(170.0, true), of(170.0, false));
    assert!((kept - 1.0).abs() < 1e-3 && left < 1e-2 && aliased > 5.0, "{kept} {left} {aliased}");
}

#[test]
fn folds_are_equal_but_for_one_and_follow_the_seed() {
    let found = folds(3, 32, 5);
    let mut sizes: Vec<usize> = (0..5).map(|f| found.iter().filter(|&&g| g == f).count()).collect();
    sizes.sort_unstable();
    assert_eq!(sizes, [6, 6, 6, 7, 7], "{found:?}");
    assert_eq!(found, folds(3, 32, 5));
    assert_ne!(found, folds(4, 32, 5));
}
