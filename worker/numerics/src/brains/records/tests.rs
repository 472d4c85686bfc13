use super::*;
use crate::brain::Architecture;
use crate::random::{Purpose, Stream};
use crate::stimuli::folds;
use crate::trial::{Decoder, DecoderKind, RateSchedule};

/// One record has false signals: a decoder that was fitted to it reproduces its forces, the decoder of its own fold does not.
#[test]
fn a_fold_s_network_has_not_seen_its_records() {
    let (samples, instants) = (12, 16);
    let mut stream = Stream::new(Purpose::Design, 5, [0, 0]);
    let mut forces = Forces { samples, panels: 1, instants, values: Vec::new(), strikes: Vec::new() };
    let mut signals = Vec::new();
    for _ in 0..samples {
        let f: Vec<f64> = (0..=instants).map(|_| stream.uniform()).collect();
        f[1..].iter().for_each(|f| signals.extend([3e3 * f, -1e3 * f, 0.1 * f]));
        forces.values.extend(f);
    }
    // The false record.
    signals[..instants * 3].iter_mut().for_each(|x| *x = -*x);
    let pool = crate::Pool::new(1).unwrap();
    let architecture = Architecture::paper(64);
    let records = records(&forces, signals, instants, false);
    let dealt = folds(1, samples, 4);
    let inside: Vec<usize> = (0..samples).filter(|&i| dealt[i] == dealt[0]).collect();
    let inside_of = |record: usize| inside.iter().position(|&i| i == record).unwrap();
    let (decoder, schedule) = (Decoder::whole(instants, 3), RateSchedule::Cosine);
    let by = |kind, fold: usize| {
        let recipe = Recipe { kind, architecture, rate: 1e-2, schedule, batch: None, decoder, seed: 1 };
        let (unseen, known): (Vec<usize>, Vec<usize>) = (0..samples).partition(|&i| dealt[i] == fold);
        let [unseen, known] = [unseen, known].map(|numbers| records.select(&numbers));
        HeldOutEstimates::of(&known, &unseen, recipe, 0, 150, &pool)
    };
    let fold = |fold| by(DecoderKind::Network, fold);
    let linear = |fold| by(DecoderKind::Linear, fold);
    let stacked = |fold| by(DecoderKind::Stacked, fold);
    assert!(stacked(dealt[0]).errors[inside_of(0)].unwrap() > 50.0);
    let read = [fold(dealt[0]), linear(dealt[0])];
    let seen = [fold((dealt[0] + 1) % 4), linear((dealt[0] + 1) % 4)];
    let (own, other) = (read[0].clone(), seen[0].clone());
    assert!(read[1].errors[inside_of(0)].unwrap() > 50.0 && seen[1].trouble.is_none(), "{:?}", read[1]);
    let first = own.errors[inside_of(0)].unwrap();
    let train = other.error_train.unwrap();
    assert!(first > 50.0 && train < 10.0, "unseen {first} %, seen {train} %");
    assert_eq!((own.errors.len(), own.predictions.len()), (3, 3 * instants));
    assert_eq!(own, fold(dealt[0]));
}
