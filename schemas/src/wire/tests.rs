use super::*;
use crate::record::TrialResult;

/// Messages carry no names: a field that is left out where it is empty would shift all that comes after it.
#[test]
fn a_result_of_empty_lists_comes_through() {
    let given = TrialResult::default();
    let found: TrialResult = postcard::from_bytes(&encode(&given)).unwrap();
    assert_eq!(found, given);
}
