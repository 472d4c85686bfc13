//! Step sizes in a byte or two each, and exactly.
//!
//! A step is (Δ − τ)/n, where Δ is the interval, τ the time in it and n the number of equal steps that would fill the
//! rest: so the n of the steps give their sizes back to the bit. They are coded in seven bits a byte, the last without
//! the eighth.

/// Appends a number.
pub fn push(codes: &mut Vec<u8>, mut n: u64) {
    while n >= 128 {
        codes.push(n as u8 | 128);
        n >>= 7;
    }
    codes.push(n as u8);
}

/// The number that begins at `at`, which moves on to the next.
#[inline]
pub fn next(codes: &[u8], at: &mut usize) -> u64 {
    let (mut n, mut shift) = (0, 0);
    loop {
        let byte = codes[*at];
        *at += 1;
        n |= u64::from(byte & 127) << shift;
        if byte < 128 {
            return n;
        }
        shift += 7;
    }
}

/// Where the number begins that is `count` before the one at `at`.
pub fn back(codes: &[u8], mut at: usize, count: usize) -> usize {
    for _ in 0..count {
        at -= 1;
        while at > 0 && codes[at - 1] >= 128 {
            at -= 1;
        }
    }
    at
}

/// All sizes, of `counts` steps in the intervals of length `delta`.
pub fn sizes(codes: &[u8], counts: &[u32], delta: f64) -> Vec<f64> {
    let (mut sizes, mut at) = (Vec::new(), 0);
    for &count in counts {
        let mut tau = 0.0;
        for _ in 0..count {
            let h = (delta - tau) / next(codes, &mut at) as f64;
            tau += h;
            sizes.push(h);
        }
    }
    sizes
}

#[path = "steps/tests.rs"]
#[cfg(test)]
mod tests;
