//! Checks the machine code of the kernels by disassembling this test binary.
//!
//! An intrinsic of `core::arch` compiles to one instruction if it is inlined, which requires code of the same instruction
//! set. Closures in `#[inline(always)]` code do not fulfil this: their intrinsics become calls with operands in memory.

#![cfg(target_arch = "x86_64")]

#[path = "../../../tests/common/skip.rs"]
mod skip;

use metasense_kernels::brain::Workspace;
use metasense_kernels::dynamics::{Simulation, repeat_kernel, run};
use std::collections::BTreeMap;
use std::hint::black_box;
use std::process::Command;

/// Entry points of every width by their mangled names. The test fails if it does not find them.
const ENTRIES: [&str; 11] = [
    "8dispatch8baseline8gradient",
    "8dispatch4avx28gradient",
    "8dispatch4avx27product",
    "8dispatch4avx27reverse",
    "8dispatch6avx5128gradient",
    "8dispatch6avx5127product",
    "8dispatch6avx5127reverse",
    "7kernels8avx2_f327product",
    "7kernels8avx2_f645pairs",
    "7kernels10avx512_f327product",
    "7kernels10avx512_f645pairs",
];

/// No floating-point intrinsic remains a function in the code of dynamics and decoders, which this binary contains because it
/// refers to it. (Excluded: integer intrinsics, used by random numbers, and functions of faer's products.)
#[test]
fn no_kernel_calls_an_intrinsic() {
    black_box((run as *const (), Simulation::vjp as *const (), repeat_kernel as *const ()));
    black_box((Workspace::<f32>::new as *const (), Workspace::<f64>::new as *const ()));
    let Ok(listing) = Command::new("objdump")
        .args(["--disassemble", "--no-show-raw-insn"])
        .arg(std::env::current_exe().expect("this binary"))
        .output()
    else {
        return skip::skipped("no_kernel_calls_an_intrinsic", "there is no objdump (Debian: binutils)");
    };
    assert!(listing.status.success(), "{}", String::from_utf8_lossy(&listing.stderr));
    let listing = String::from_utf8_lossy(&listing.stdout);

    let (mut function, mut seen) = ("", [false; ENTRIES.len()]);
    // callers of each intrinsic
    let mut left: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for line in listing.lines() {
        let Some((before, name)) = line.split_once('<') else { continue };
        let name = name.split(['>', '+']).next().unwrap_or(name);
        let is_intrinsic = |name: &str| name.contains("core_arch") && name.contains("_mm");
        let intrinsic = is_intrinsic(name) && !["epi", "_si"].iter().any(|integer| name.contains(integer));
        let ours = !is_intrinsic(function) && !function.contains("gemm");
        if line.ends_with(">:") {
            function = name;
            seen.iter_mut().zip(ENTRIES).for_each(|(seen, entry)| *seen |= name.contains(entry));
        } else if intrinsic && ours && (before.contains("call") || before.contains("jmp")) {
            left.entry(name).or_default().push(function);
        }
    }
    let missing: Vec<&str> =
        ENTRIES.into_iter().zip(seen).filter(|(_, seen)| !seen).map(|(entry, _)| entry).collect();
    assert!(missing.is_empty(), "kernels not found in this binary: {missing:#?}");
    left.values_mut().for_each(|callers| callers.dedup());
    assert!(left.is_empty(), "intrinsics that were not inlined, with their callers: {left:#?}");
}
