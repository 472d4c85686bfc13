use super::*;
use metasense_schemas::record::{BodyRecord, NetworkRecord};

fn result() -> TrialResult {
    let network =
        |weights: Vec<f32>| NetworkRecord { losses: vec![1.0, 0.5, 0.25], weights, ..Default::default() };
    let body = |x: f64| BodyRecord {
        design: vec![x; 5],
        networks: vec![network(vec![x as f32; 7]), network(Vec::new())],
        ..Default::default()
    };
    TrialResult { initial: body(1.0), optimised: body(2.0), ..Default::default() }
}

/// The written bytes are consecutive NPY files of the values that were moved out, without gaps.
#[test]
fn every_array_of_a_result_is_a_file_of_its_own_and_nothing_of_it_stays() {
    let mut taken = result();
    let arrays = Arrays::of(&mut taken, 0);
    assert_eq!(bytes(&taken), 0);
    let mut target = vec![MaybeUninit::new(0xffu8); arrays.len()];
    arrays.write(&mut target);
    // SAFETY: every byte is initialised above.
    let written: Vec<u8> = target.iter().map(|byte| unsafe { byte.assume_init() }).collect();
    let heads = arrays.heads();
    let names: Vec<_> = heads.iter().map(|head| head.name.as_str()).collect();
    let of = |body: &str| ["alpha", "weights", "losses"].map(|what| format!("{what}_{body}"));
    let [initial, optimised] = [of("initial"), of("optimised")];
    assert_eq!(
        names,
        [
            &initial[0],
            &*format!("{}_0", initial[1]),
            &format!("{}_0", initial[2]),
            &format!("{}_1", initial[2]),
            &optimised[0],
            &format!("{}_0", optimised[1]),
            &format!("{}_0", optimised[2]),
            &format!("{}_1", optimised[2]),
        ]
    );
    assert_eq!((heads[0].start, heads[7].end), (0, written.len()));
    assert!(heads.windows(2).all(|pair| pair[0].end == pair[1].start), "{heads:?}");
    let file = |i: usize| npyz::NpyFile::new(&written[heads[i].start..heads[i].end]).unwrap();
    assert_eq!(file(4).into_vec::<f64>().unwrap(), [2.0; 5]);
    assert_eq!(file(1).into_vec::<f32>().unwrap(), [1.0; 7]);
    assert_eq!(file(2).into_vec::<f32>().unwrap(), [1.0, 0.5, 0.25]);
}

#[test]
fn a_small_result_keeps_its_arrays() {
    let mut whole = result();
    assert!(Arrays::of(&mut whole, 4096).is_empty());
    assert_eq!(whole, result());
}
