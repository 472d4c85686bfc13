use proptest::prelude::*;

use metasense_schemas::record::Parts;

use super::*;

fn trials(costs: &[f64]) -> Vec<PlannedTrial> {
    let spec = crate::plan::Plan::new("s.toml", SPEC.into()).unwrap().trials.swap_remove(0);
    let hash = |i: usize| format!("{:016x}", (i as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    costs
        .iter()
        .enumerate()
        .map(|(i, &cost)| {
            let of = |cost: f64| (cost, 1 + (cost * 1e3) as u64);
            let [(steps, steps_weigh), (comparison, comparison_weighs)] = [of(0.7 * cost), of(0.3 * cost)];
            PlannedTrial {
                hash: hash(i),
                training: hash(i),
                cost: Parts { steps, comparison },
                weight: Parts { steps: steps_weigh, comparison: comparison_weighs },
                ..spec.clone()
            }
        })
        .collect()
}

const SPEC: &str = "name = \"s\"\n[body]\ncolumns = 4\nrows = 4\nspacing = 15.0\nligament_length = 2.25\n\
    density = 1e-8\nstiffness = { stretch = 3.0, shear = 0.5, bend = 1.0 }\n[stimuli]\nkind = \"bell\"\n\
    samples = 8\ntest = 2\n[sweep]\npanels = [2]\nsensors = [1]\n";

/// Largest load divided by the mean.
fn ratio(assignment: &Assignment, trials: &[PlannedTrial]) -> f64 {
    let costs = assignment.costs(trials);
    costs.iter().copied().fold(0.0, f64::max) * costs.len() as f64 / costs.iter().sum::<f64>()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]

    /// Costs vary by a factor of twenty. With at least 10 trials per shard, no shard exceeds 1.15 times the mean, even if half
    /// as many are added later. Assignments never change, and the order of trials has no effect.
    #[test]
    fn shards_are_even_and_trials_stay_in_theirs(
        shards in 2_u32..40,
        logs in prop::collection::vec(0.0..3.0_f64, 600),
        a_shard in 10_usize..16,
    ) {
        let count = (shards as usize * a_shard).min(logs.len() * 2 / 3);
        prop_assume!(count >= 10 * shards as usize);
        let all = trials(&logs.iter().map(|x| x.exp()).collect::<Vec<_>>());
        let first = &all[..count];
        let assignment = Assignment::new(first, shards);
        prop_assert!(ratio(&assignment, first) <= 1.15, "{} of {shards}", ratio(&assignment, first));
        let backwards: Vec<_> = first.iter().rev().cloned().collect();
        prop_assert_eq!(&Assignment::new(&backwards, shards), &assignment);

        let folder = tempfile::tempdir().unwrap();
        assignment.write(folder.path()).unwrap();
        let more = &all[..count * 3 / 2];
        let later = Assignment::in_folder(folder.path(), more, shards).unwrap();
        prop_assert!(first.iter().all(|t| later.shard(&t.hash) == assignment.shard(&t.hash)));
        prop_assert!(ratio(&later, more) <= 1.15, "{} of {shards}, later", ratio(&later, more));
    }
}

/// Groups trials so that each `each` share a body.
fn readers(mut trials: Vec<PlannedTrial>, each: usize) -> Vec<PlannedTrial> {
    let firsts: Vec<PlannedTrial> = trials.chunks(each).map(|group| group[0].clone()).collect();
    for (i, trial) in trials.iter_mut().enumerate() {
        let PlannedTrial { training, cost, weight, .. } = firsts[i / each].clone();
        (trial.training, trial.cost, trial.weight) = (training, cost, weight);
    }
    trials
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]

    /// If trials share bodies, no shard exceeds what a list of whole groups could give it, and several shards train a body only
    /// if that pays; also when trials are added to each body.
    #[test]
    fn trials_of_a_body_stay_together_where_that_pays(
        shards in 1_u32..30,
        logs in prop::collection::vec(0.0..2.0_f64, 240),
        each in 1_usize..12,
    ) {
        let all = readers(trials(&logs.iter().map(|x| x.exp()).collect::<Vec<_>>()), each);
        let some: Vec<PlannedTrial> = all.iter().enumerate().filter(|(i, _)| i % each < each.div_ceil(2)).map(|(_, t)| t.clone()).collect();
        let folder = tempfile::tempdir().unwrap();
        for dealt in [&some, &all] {
            let assignment = Assignment::in_folder(folder.path(), dealt, shards).unwrap();
            assignment.write(folder.path()).unwrap();
            let costs = assignment.costs(dealt);
            let (sum, most) = (costs.iter().sum::<f64>(), costs.iter().copied().fold(0.0, f64::max));
            let longest = dealt.iter().map(|t| 3.0 * t.cost.steps + t.cost.comparison).fold(0.0, f64::max);
            prop_assert!(most <= 1.01 * (sum / f64::from(shards) + longest), "{most} of {sum} on {shards}");
            let once = cost::total(dealt);
            prop_assert!(sum <= once + f64::from(shards) * longest, "{sum} for {once} on {shards}");
            if shards == 1 {
                prop_assert!((sum / once - 1.0).abs() < 1e-9);
            }
        }
    }
}

/// Four trials on two shards, and thirty on twelve.
#[test]
fn small_sweeps_are_dealt_evenly() {
    let sizes = |count: usize, shards: u32| {
        let trials = trials(&vec![0.0; count]);
        let assignment = Assignment::new(&trials, shards);
        (1..=shards)
            .map(|s| trials.iter().filter(|t| assignment.shard(&t.hash) == s).count())
            .collect::<Vec<_>>()
    };
    assert_eq!(sizes(4, 2), [2, 2]);
    assert_eq!(sizes(30, 12), [3, 3, 3, 3, 3, 3, 2, 2, 2, 2, 2, 2]);
}

#[test]
fn what_cannot_be_read_is_no_deal() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("assignment-of-2.csv");
    for text in
        ["hash,shard\nab,3\n", "hash,shard\nab\n", "hash,shard\nxy,1\n", "hash,shard\nab,0\n", "\u{0}"]
    {
        std::fs::write(&file, text).unwrap();
        let read = Assignment::in_folder(folder.path(), &[], 2);
        assert!(matches!(read, Err(AssignmentError::Line { .. })), "{text:?}: {read:?}");
    }
    std::fs::remove_file(&file).unwrap();
    std::fs::write(folder.path().join("shard-1-of-2.sqlite"), "").unwrap();
    assert!(matches!(Assignment::in_folder(folder.path(), &[], 2), Err(AssignmentError::Lost { .. })));
    assert!(Assignment::in_folder(folder.path(), &[], 3).is_ok());
}
