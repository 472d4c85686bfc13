use super::*;

/// A complete state survives the conversion to a checkpoint and back; a checkpoint of another trial is rejected.
#[test]
fn a_state_survives_its_checkpoint() {
    let problem = crate::problem::problem(&crate::problem::tests::trial(&[])).unwrap();
    let (parameters, weights) = (problem.initial.len(), problem.reader_shape().weights());
    let numbers = |n: usize| (0..n).map(|i| 0.1 * i as f64).collect::<Vec<f64>>();
    let few = |n: usize| (0..n).map(|i| 0.1 * i as f32).collect::<Vec<f32>>();
    let design = numbers(parameters);
    let full = State {
        step: 7,
        design: design.clone(),
        design_adam: Adam { m: numbers(parameters), v: numbers(parameters), t: 7 },
        decoder_state: DecoderState {
            weights: few(weights),
            adam: Adam { m: few(weights), v: few(weights), t: 70 },
            ridge: None,
        },
        best: Some(Best { design: design.clone(), error: 12.5, step: 5 }),
        rate_factor: 0.5,
        consecutive_undone: 2,
        trend: Some(0.01),
        recent_designs: vec![
            PastDesign { step: 5, design: design.clone() },
            PastDesign { step: 6, design: design.clone() },
        ],
        comparison: nested::Comparison::default(),
        fitness: Vec::new(),
    };
    let learnt = DecoderState { weights: Vec::new(), ..full.decoder_state.clone() };
    let bare = State {
        best: None,
        trend: None,
        recent_designs: Vec::new(),
        decoder_state: learnt.clone(),
        ..full.clone()
    };
    let linear = State { decoder_state: DecoderState { ridge: Some(1e-4), ..learnt }, ..full.clone() };
    let spread = Some(trial::Spread { median: 1.5, p90: f64::INFINITY, above: 7 });
    let network = nested::NetworkEvaluation {
        error_test: Some(3.0),
        spread,
        losses: vec![0.5, 0.25],
        errors: vec![(1, 9.0)],
        weights: few(weights),
        trouble: trial::Trouble::named("diverged"),
        ..Default::default()
    };
    let reading = brains::Reading {
        lags: Lags { before: 3, after: 0 },
        ridge: 1e-6,
        error_train: None,
        error_test: Some(1.0),
        error_holdout: Some(2.0),
        spread,
    };
    let body = nested::BodyEvaluation {
        design,
        networks: vec![network.clone(), nested::NetworkEvaluation { trouble: None, ..network.clone() }],
        long: vec![network],
        readings: vec![reading],
        zero_samples: [1, 2, 3],
    };
    let adam = Adam { m: few(weights), v: few(weights), t: 2 };
    let fresh = NetworkTraining { weights: few(weights), adam, losses: vec![0.5], errors: Vec::new() };
    let brains = [
        CastDecoder::Network,
        CastDecoder::NetworkCasts,
        CastDecoder::Nominal,
        CastDecoder::Casts,
        CastDecoder::Records(10),
        CastDecoder::Records(30),
    ];
    let reading = |by| nested::CastEvaluation {
        cast: 7,
        decoder: by,
        error: Some(2.5),
        spread,
        regularisation: nested::Regularisation { ridge: Some(1e-4), kappa: by.records().map(|_| 1e-2) },
        trouble: trial::Trouble::named("diverged").filter(|_| by == CastDecoder::Casts),
    };
    let casts = brains.map(reading).to_vec();
    let band = |kind, cast: Option<(u32, CastDecoder)>, half_width: &[f64]| nested::BandCoverage {
        cast,
        band: Band { kind, samples: 99, half_width: half_width.to_vec() },
        width: Some(0.25).filter(|_| cast.is_some() || !half_width.is_empty()),
        coverage: Some(0.9),
    };
    let bands = vec![
        band(BandKind::Instant, None, &[0.125; 4]),
        band(BandKind::Sample, None, &[]),
        band(BandKind::Sample, Some((7, CastDecoder::NetworkCasts)), &[]),
        band(BandKind::Posterior, Some((7, CastDecoder::Twin(10))), &[]),
    ];
    let compared = |training| State {
        comparison: nested::Comparison {
            bodies: vec![body.clone(), nested::BodyEvaluation { long: Vec::new(), ..body.clone() }],
            casts: vec![casts.clone(), casts[..2].to_vec()],
            bands: vec![bands.clone(), Vec::new()],
            tasks: Vec::new(),
            training,
            counters: trial::Counters { brain_iterations: 5, ..Default::default() },
            seconds: nested::Seconds { train: 2.0, ..Default::default() },
        },
        ..full.clone()
    };
    let wrong = NetworkTraining { weights: few(3), ..fresh.clone() };
    let search = State { fitness: vec![12.5, f64::INFINITY], ..bare.clone() };
    for original in [full.clone(), bare, linear, search, compared(None), compared(Some(fresh))] {
        let read = Checkpoint::from_bytes(&checkpoint(&original).to_bytes()).unwrap();
        let other = Checkpoint { design: vec![0.5; 3], ..read.clone() };
        assert!(state(other, &problem).is_err());
        assert_eq!(state(read, &problem).unwrap(), original);
    }
    assert!(state(checkpoint(&compared(Some(wrong))), &problem).is_err());
}
