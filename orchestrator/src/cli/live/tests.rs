use super::*;

/// A done trial whose error is unknown says why.
#[test]
fn unknown_errors_have_a_cause() {
    let of = |outcome: &str| {
        let network = NetworkRecord { outcome: outcome.into(), ..NetworkRecord::default() };
        percent(&BodyRecord { networks: vec![network], ..BodyRecord::default() })
    };
    assert_eq!(of("non_finite"), "unknown (non_finite)");
    assert_eq!(of("ok"), "unknown (no held-out sample has a force)");
}
