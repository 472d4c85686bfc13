use std::path::Path;

use super::*;

/// Dropping a run's place removes its directory and segments, but not those of another run.
#[test]
fn a_place_is_removed_as_a_whole_and_alone() {
    let (first, second) = (Runtime::new().unwrap(), Runtime::new().unwrap());
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
