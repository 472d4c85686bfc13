use super::*;
use crate::problem::tests::trial;

/// The smallest limit of a group and its parents applies, in both versions of control groups; `max` means no limit.
#[test]
fn a_control_group_has_the_limits_of_those_above_it() {
    let folder = tempfile::tempdir().unwrap();
    let group = |path: &str, file: &str, limit: &str| {
        std::fs::create_dir_all(folder.path().join(path)).unwrap();
        std::fs::write(folder.path().join(path).join(file), limit).unwrap();
    };
    group("job/step", "memory.max", "max\n");
    group("job", "memory.max", "5000\n");
    group("memory/old", "memory.limit_in_bytes", "3000\n");
    let of = |text: &str| of_groups(&crate::limits::groups(text, folder.path(), "memory"));
    assert_eq!(of("0::/job/step\n"), Some(5000.0));
    assert_eq!(of("4:cpu,memory:/old\n1:name=systemd:/x\n0::/job/step\n"), Some(3000.0));
    assert_eq!(of("0::/\n3:cpu:/old\n"), None);
    assert!(
        limit(None).is_some() && limit(Some(64)).is_some_and(|limit| limit.name.starts_with("run.memory"))
    );
}

/// A trial that exceeds the limit is rejected with the key that multiplies its memory; a small trial is accepted.
#[test]
fn what_no_memory_holds_is_refused_by_its_key() {
    let limit = MemoryLimit { name: "this machine has", bytes: 1e11 };
    let refused = |change: &dyn Fn(&mut TrialSpec)| {
        let mut trial = trial(&[]);
        change(&mut trial);
        check(&trial, 36, Some(&limit)).map_err(|wrong| wrong.key)
    };
    assert_eq!(refused(&|_| ()), Ok(()));
    let asks = |key: &str| Err(key.to_owned());
    assert_eq!(
        refused(&|t| (t.stimuli.samples, t.time.samples) = (1_000_000, 100_000)),
        asks("stimuli.samples")
    );
    assert_eq!(
        refused(&|t| (t.stimuli.holdout, t.time.samples) = (1_000_000, 100_000)),
        asks("stimuli.holdout")
    );
    assert_eq!(
        refused(&|t| {
            t.optimise.protocol = Protocol::Joint;
            (t.optimise.batch, t.optimise.iterations) = (Some(1_000_000), Some(1));
        }),
        asks("optimise.batch")
    );
    assert_eq!(refused(&|t| t.brain.iterations = usize::MAX), asks("brain.iterations"));
    assert_eq!(
        refused(&|t| t.evaluation.long_iterations = Some(usize::MAX)),
        asks("evaluation.long_iterations")
    );
    assert_eq!(
        refused(&|t| (t.brain.kind, t.point.sensors, t.time.samples) = (BrainKind::Linear, 100, 1000)),
        asks("sweep.sensors")
    );
}
