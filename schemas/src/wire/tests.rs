use super::*;
use crate::record::TrialResult;

/// Messages contain no field names: omitting an empty field would shift all later fields.
#[test]
fn a_result_of_empty_lists_comes_through() {
    let given = TrialResult::default();
    let found: TrialResult = postcard::from_bytes(&encode(&given)).unwrap();
    assert_eq!(found, given);
}
