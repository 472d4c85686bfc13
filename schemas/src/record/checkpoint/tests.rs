use super::*;
use crate::record::{NetworkRecord, ReadingRecord, SpreadRecord};

/// Fields up to the best design; other fields of the outer loop.
const HEAD: &str = "ac02 02 000000000000e03f 00000000000000c0 01 000000000000f03f 01 0000000000000040 07 \
    01 0000803e 01 0000003f 00 c801 01 01 000000000000f83f 0000000000002940 ab02";
const NAMED: &str = "000000000000e03f 02 01 000000000000d03f 01 000000000000c03f \
    01 05 02 000000000000f03f 000000000000f0bf";
/// The spread of the network and of the reading is 0.5 %, none, 300.
const COMPARISON: &str = "01 \
    0101000000000000e03f0101000000000000f03f00010000000000000040010000003f01010000000000001040010000803e \
    026f6b 01 01000000000000e03f 00 ac02 0100000000000000 00 0103c801000000000000e03f01000000000000f03f000100000000000000 \
    40 01 01000000000000e03f 00 ac02 0102ac02010100000 \
    03f010000803e01000080beac02010000004001c80100000000000020400102030405d804000000000000f03f0000000000 \
    0000400000000000000840000000000000104000000000000014400000000000001840";
const MOVES: &str = "01 c801 02 03 05";
const FOUND: &str = "02 0000000000002940 000000000000f07f";

/// Body 1: two readings (cast, reader, records, 2.0 %, ok, spread, λ, κ), the first without spread, λ, κ, the second with 0.5
/// %, none, 300; 0.25; 0.125. Body 2: none.
const CASTS: &str = "02 02 00076e6f6d696e616c00 010000000000000040 026f6b 00 00 00 01077265636f726473ac02 010000000000000040 026f6b \
    01 01000000000000e03f 00 ac02 01000000000000d03f 01000000000000c03f 00";

/// Body 1: a band without cast and one of cast 3. Body 2: none.
const BANDS: &str = "02 02 036f776e 00 00 09636f6e666f726d616c 07696e7374616e74 666666666666ee3f 63 01000000000000f03f 00 \
    01000000000000c03f 026f6b 056361737473 1e 0103 09636f6e666f726d616c 0673616d706c65 666666666666ee3f 63 00 \
    01000000000000d03f 00 026f6b 00";

fn bytes(digits: &str) -> Vec<u8> {
    let digits: Vec<u8> = digits.bytes().filter(u8::is_ascii_hexdigit).collect();
    let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap();
    digits.chunks(2).map(byte).collect()
}

/// If a change of `Checkpoint` or of a nested type fails this test, raise the version.
#[test]
fn a_checkpoint_is_these_bytes() {
    let mut whole = Checkpoint {
        step: 300,
        design: vec![0.5, -2.0],
        design_moments: Moments { first: vec![1.0], second: vec![2.0], steps: 7 },
        weights: vec![0.25],
        weight_moments: Moments { first: vec![0.5], second: Vec::new(), steps: 200 },
        best: Some(BestDesign { design: vec![1.5], error: 12.5, step: 299 }),
        caution: 0.5,
        setbacks: 2,
        trend: Some(0.25),
        ridge: Some(0.125),
        trail: vec![Waypoint { step: 5, design: vec![1.0, -1.0] }],
        moves: vec![(200, vec![3, 5])],
        found: vec![12.5, f64::INFINITY],
        ..Default::default()
    };
    let spread = Some(SpreadRecord { median: Some(0.5), p90: None, above: 300 });
    let network = NetworkRecord {
        error_train: Some(1.0),
        error_test: None,
        error_holdout: Some(2.0),
        losses: vec![0.5],
        errors: vec![(1, 4.0)],
        weights: vec![0.25],
        outcome: "ok".into(),
        spread,
    };
    let reading = ReadingRecord {
        before: 3,
        after: 200,
        ridge: 0.5,
        error_train: Some(1.0),
        error_test: None,
        error_holdout: Some(2.0),
        spread,
    };
    let body = BodyRecord {
        design: vec![0.5],
        long: vec![NetworkRecord::default()],
        networks: vec![network],
        readings: vec![reading],
        zero_samples: [1, 2, 300],
    };
    let training = NetworkInTraining {
        weights: vec![0.5],
        moments: Moments { first: vec![0.25], second: vec![-0.25], steps: 300 },
        losses: vec![2.0],
        errors: vec![(200, 8.0)],
    };
    let counters = WorkCounts {
        force_evaluations: 1,
        steps: 2,
        rejected: 3,
        brain_iterations: 4,
        hessian_products: 5,
        projection_iterations: 600,
    };
    let seconds = StepSeconds {
        simulate: 1.0,
        train: 2.0,
        differentiate: 3.0,
        implicit: 4.0,
        project: 5.0,
        store: 6.0,
    };
    let comparison = ComparisonProgress { bodies: vec![body], training: Some(training), counters, seconds };
    whole.comparison = Some(Box::new(comparison));
    let reading = |cast, reader: &str, records| CastRecord {
        cast,
        reader: reader.into(),
        records,
        error: Some(2.0),
        outcome: "ok".into(),
        ..CastRecord::default()
    };
    let calibrated =
        CastRecord { spread, ridge: Some(0.25), share: Some(0.125), ..reading(1, "records", 300) };
    whole.casts = vec![vec![reading(0, "nominal", 0), calibrated], Vec::new()];
    let band =
        |reader: &str, cast: Option<u32>, kind: &str, numbers: [Option<f64>; 2], half_width| BandRecord {
            reader: reader.into(),
            records: cast.map_or(0, |_| 30),
            cast,
            method: "conformal".into(),
            kind: kind.into(),
            level: 0.95,
            samples: 99,
            coverage: numbers[0],
            width: numbers[1],
            half_width,
            outcome: "ok".into(),
        };
    whole.bands = vec![
        vec![
            band("own", None, "instant", [Some(1.0), None], vec![0.125]),
            band("casts", Some(3), "sample", [None, Some(0.25)], Vec::new()),
        ],
        Vec::new(),
    ];
    let stored = bytes(&["08", HEAD, NAMED, COMPARISON, MOVES, FOUND, CASTS, BANDS].concat());
    assert_eq!(Checkpoint::from_bytes(&stored), Ok(whole.clone()));
    assert_eq!(whole.to_bytes(), stored);
    for version in [7, 99] {
        assert_eq!(Checkpoint::from_bytes(&[version, 1, 2]), Err(CheckpointError::Version(version)));
    }
    for broken in [&stored[..stored.len() - 1], &[&stored[..], &[0]].concat(), &[]] {
        assert!(matches!(Checkpoint::from_bytes(broken), Err(CheckpointError::Damaged(_))), "{broken:?}");
    }
}

/// Decoding ten thousand checkpoints with bytes changed, removed or added does not panic.
#[test]
fn no_stored_bytes_make_a_reader_panic() {
    let whole = Checkpoint {
        step: 3,
        design: vec![0.5; 6],
        weights: vec![0.25; 4],
        best: Some(BestDesign { design: vec![1.5; 6], error: 12.5, step: 2 }),
        trail: vec![Waypoint { step: 1, design: vec![3.0; 6] }],
        comparison: Some(Box::new(ComparisonProgress {
            bodies: vec![BodyRecord::default()],
            ..Default::default()
        })),
        ..Default::default()
    };
    let mut runner = proptest::test_runner::TestRunner::new(proptest::test_runner::Config {
        cases: 10_000,
        failure_persistence: None,
        ..Default::default()
    });
    let edits = (proptest::collection::vec((0usize..120, 0u8..=255), 0..6), 0usize..120);
    let read = |(edits, length): (Vec<(usize, u8)>, usize)| {
        let mut bytes = whole.to_bytes();
        bytes.resize(length.max(1), 0xff);
        for (at, value) in edits {
            let end = bytes.len() - 1;
            bytes[at.min(end)] = value;
        }
        let _ = Checkpoint::from_bytes(&bytes);
        Ok(())
    };
    runner.run(&edits, read).unwrap();
}
