use super::*;

/// A sweep that was edited and run again is named once, where it was first.
#[test]
fn the_title_names_each_sweep_once() {
    let sweep = |name: &str| StoredSweep { name: name.into(), ..StoredSweep::default() };
    let story = ReportData { sweeps: ["b", "a", "b"].map(sweep).into(), ..ReportData::default() };
    assert!(html(story, &[], None).contains("<title>metasense: b, a</title>"));
}
