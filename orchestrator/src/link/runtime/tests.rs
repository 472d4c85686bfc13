use super::*;

/// Writing to a full shared memory kills the writer: it is refused before, with what to do.
#[test]
fn too_little_shared_memory_is_an_error_before_anything_starts() {
    let error = Runtime::new(u32::MAX).unwrap_err();
    assert!(matches!(error, RuntimeError::Full { workers: u32::MAX, .. }), "{error}");
    assert!(error.to_string().contains("take fewer workers"), "{error}");
}

/// A run's directory, and what carries its name, go with it; another run's stay.
#[test]
fn a_place_is_removed_as_a_whole_and_alone() {
    let (first, second) = (Runtime::new(1).unwrap(), Runtime::new(1).unwrap());
    assert_ne!(first.name, second.name);
    let worker = WorkerId { slot: 3, generation: 12 };
    let domains = [first.domain(worker), second.domain(worker)];
    for domain in &domains {
        std::fs::create_dir(&domain.root).unwrap();
        File::create(format!("{SHARED_MEMORY}/{}x.data", domain.prefix)).unwrap();
    }
    drop(first);
    let there = |domain: &Domain| {
        (domain.root.exists(), Path::new(SHARED_MEMORY).join(format!("{}x.data", domain.prefix)).exists())
    };
    assert_eq!(domains.each_ref().map(there), [(false, false), (true, true)]);
    assert!(second.domain(worker).prefix.len() <= 49, "longer than iceoryx2 takes: {:?}", domains[1].prefix);
}
