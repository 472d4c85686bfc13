//! Compact, exact storage of step sizes, in one or two bytes each.
//!
//! A step is (Δ − τ)/n: Δ is the interval, τ the time since its start, and n the number of equal steps that would fill
//! the rest. The sequence of n therefore reproduces all sizes exactly. Numbers are coded with seven bits per byte; the
//! eighth bit is set except in the last byte.

/// Appends the code of n.
pub fn push(codes: &mut Vec<u8>, mut n: u64) {
    while n >= 128 {
        codes.push(n as u8 | 128);
        n >>= 7;
    }
    codes.push(n as u8);
}

/// Decodes the number at index `at`, and advances `at`.
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

/// Index of the number `count` numbers before `at`.
pub fn back(codes: &[u8], mut at: usize, count: usize) -> usize {
    for _ in 0..count {
        at -= 1;
        while at > 0 && codes[at - 1] >= 128 {
            at -= 1;
        }
    }
    at
}

/// Step sizes of all intervals, each of length `delta` with the given number of steps.
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
