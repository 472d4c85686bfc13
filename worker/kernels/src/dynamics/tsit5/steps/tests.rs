use super::*;

/// Numbers of one to ten bytes, decoded forwards, and located backwards between any two positions.
#[test]
fn numbers_come_back_from_either_side() {
    let numbers = [1, 127, 128, 300, 1, 16_383, 16_384, u64::from(u32::MAX), u64::MAX, 2];
    let mut codes = Vec::new();
    let mut begins = Vec::new();
    for n in numbers {
        begins.push(codes.len());
        push(&mut codes, n);
    }
    let mut at = 0;
    assert_eq!(numbers.map(|_| next(&codes, &mut at)), numbers);
    begins.push(codes.len());
    for (to, begin) in begins.iter().enumerate() {
        for (from, end) in begins.iter().enumerate().skip(to) {
            assert_eq!(back(&codes, *end, from - to), *begin, "{from} to {to}");
        }
    }
}
