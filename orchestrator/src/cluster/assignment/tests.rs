use proptest::prelude::*;

use super::*;

fn trials(costs: &[f64]) -> Vec<Trial> {
    let spec = crate::plan::Plan::new("s.toml", SPEC.into()).unwrap().trials.swap_remove(0);
    let hash = |i: usize| format!("{:016x}", (i as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    costs
        .iter()
        .enumerate()
        .map(|(i, &cost)| Trial { hash: hash(i), cost, weight: 1 + (cost * 1e3) as u64, ..spec.clone() })
        .collect()
}

const SPEC: &str = "name = \"s\"\n[body]\ncolumns = 4\nrows = 4\nspacing = 15.0\nligament_length = 2.25\n\
    density = 1e-8\nstiffness = { stretch = 3.0, shear = 0.5, bend = 1.0 }\n[stimuli]\nkind = \"bell\"\n\
    samples = 8\ntest = 2\n[sweep]\npanels = [2]\nsensors = [1]\n";

/// Longest over mean.
fn ratio(assignment: &Assignment, trials: &[Trial]) -> f64 {
    let costs = assignment.costs(trials);
    costs.iter().copied().fold(0.0, f64::max) * costs.len() as f64 / costs.iter().sum::<f64>()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]

    /// Costs over a factor of twenty, as over the sensors of a sweep: from 10 trials a shard on, no shard has more
    /// than 1.15 times the mean, also when half as many are added; what was assigned stays; the order of trials is nothing.
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

/// The two: four trials on two shards, thirty on twelve.
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
    std::fs::write(folder.path().join(former_name(2)), "hash,shard\nab,2\n").unwrap();
    assert_eq!(Assignment::in_folder(folder.path(), &[], 2).unwrap().shard("ab"), 2);
}
