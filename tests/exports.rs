//! Each export format is read back by an independent reader.

use std::path::Path;
use std::process::Command;

use crate::common::{Bench, TINY, skip};
use crate::synthetic;
use metasense_worker::files::{Form, content};

fn export(db: &Path, what: &str, format: &str, out: &Path) {
    let run = Command::new(env!("CARGO_BIN_EXE_metasense"))
        .args(["export", db.to_str().unwrap(), what, "--format", format, "--out", out.to_str().unwrap()])
        .output()
        .unwrap();
    assert!(run.status.success(), "{what} {format}: {}", String::from_utf8_lossy(&run.stderr));
}

/// numpy, pyarrow, ezdxf, trimesh and onnxruntime if Python has them; arrays are always read by npyz.
#[test]
fn what_is_exported_is_read_back_by_others() {
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("synthetic.sqlite");
    synthetic::write(&db);
    // The second trial: K = 4, M = 2, 8 × 6 units.
    let trial = format!("{:032x}", 1);
    let file = |name: &str| folder.path().join(name);
    for format in ["npz", "csv", "parquet", "svg", "dxf", "stl", "onnx"] {
        export(&db, &trial, format, &file(&format!("t.{format}")));
    }
    export(&db, "v_trial", "parquet", &file("v.parquet"));
    let asked = Command::new(env!("CARGO_BIN_EXE_metasense"))
        .args(["query", db.to_str().unwrap(), "SELECT * FROM v_trial", "--format", "parquet"])
        .output()
        .unwrap();
    assert!(asked.stdout == std::fs::read(file("v.parquet")).unwrap(), "query and export differ");

    // More rows than a row group has, and a column in which a text appears late.
    let many = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 70000)
        SELECT i, 0.5 * i AS half, CASE i WHEN 70000 THEN 'much' ELSE i END AS either, NULL AS none FROM n";
    let asked = Command::new(env!("CARGO_BIN_EXE_metasense"))
        .args(["query", db.to_str().unwrap(), many, "--format", "parquet", "--out"])
        .arg(file("many.parquet"))
        .status()
        .unwrap();
    assert!(asked.success());

    let arrays = npz_arrays(&std::fs::read(file("t.npz")).unwrap());
    let shape = |name: &str| arrays.iter().find(|a| a.0 == name).map(|a| a.1.clone());
    assert_eq!(shape("forces.npy"), Some(vec![25, 4, 41]));
    assert_eq!(shape("w1_optimised.npy"), Some(vec![3, 6, 64]));
    assert_eq!(shape("scene.npy"), Some(vec![]));
    let csv = std::fs::read_to_string(file("t.csv")).unwrap();
    assert!(csv.starts_with("sample,set,time,force_0,") && csv.lines().count() == 1 + 25 * 40);
    assert!(std::fs::read_to_string(file("t.svg")).unwrap().starts_with("<svg xmlns"));

    let test = "what_is_exported_is_read_back_by_others";
    match Command::new("python3").args(["-c", "import numpy"]).output() {
        Ok(run) if run.status.success() => {}
        _ => return skip::skipped(test, "there is no Python with numpy"),
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/readback.py");
    let run = Command::new("python3").arg(script).arg(folder.path()).output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let readers = String::from_utf8_lossy(&run.stdout);
    let ours =
        |name: &str| content(Path::new(name), &std::fs::read(file(name)).unwrap(), &Form::default()).unwrap();
    assert!(ours("t.npz") == ours("packed.npz"), "what numpy.savez_compressed wrote reads otherwise");
    if !in_onnxruntime(folder.path()) {
        skip::skipped(test, "there is no Python with onnxruntime");
    }
    for reader in ["numpy", "pyarrow", "ezdxf", "trimesh"] {
        if !readers.lines().any(|line| line == reader) {
            skip::skipped(test, &format!("there is no {reader}"));
        }
    }
}

/// Names and shapes of an archive's arrays.
fn npz_arrays(bytes: &[u8]) -> Vec<(String, Vec<u64>)> {
    let mut zip = zip::ZipArchive::new(std::io::Cursor::new(bytes)).unwrap();
    let files = zip.len();
    let mut array = |i: usize| {
        let file = zip.by_index(i).unwrap();
        let name = file.name().unwrap().into_owned();
        (name, npyz::NpyFile::new(file).unwrap().shape().to_vec())
    };
    (0..files).map(&mut array).collect()
}

/// Whether ONNX Runtime is installed; if so, checks that a graph gives the trial's predictions.
fn in_onnxruntime(folder: &Path) -> bool {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/onnx.py");
    match Command::new("python3").args(["-c", "import numpy, onnxruntime"]).output() {
        Ok(run) if run.status.success() => {}
        _ => return false,
    }
    Command::new("python3").arg(script).arg(folder).succeed();
    true
}

/// Compiles an exported decoder with its test, without warnings, and runs it. Returns whether it gives the trial's predictions.
/// With a sanitizer, undefined behaviour is a failure.
pub fn holds(compiler: &str, source: &str, folder: &Path) -> (bool, String) {
    // gcc finds some problems only when it optimises
    let level = if compiler == "clang" { "-O1" } else { "-O2" };
    let strict = [level, "-Wall", "-Wextra", "-pedantic", "-Werror"].into_iter();
    compiled(compiler, strict.chain(SANITIZED.into_iter().filter(|_| compiler != "cc")), source, folder)
}

/// The same with any options.
pub fn compiled<'a>(
    compiler: &str,
    options: impl Iterator<Item = &'a str>,
    source: &str,
    folder: &Path,
) -> (bool, String) {
    let (file, program) = (folder.join("brain.c"), folder.join("brain"));
    std::fs::write(&file, source).unwrap();
    let mut command = Command::new(compiler);
    command.args(["-std=c99", "-DBRAIN_TEST"]).args(options).args([&file, Path::new("-o"), &program]);
    let compiled = command.output().unwrap();
    assert!(compiled.status.success(), "{compiler}: {}", String::from_utf8_lossy(&compiled.stderr));
    let run = Command::new(&program).output().unwrap();
    (run.status.success(), String::from_utf8(run.stdout).unwrap())
}

const SANITIZED: [&str; 2] = ["-fsanitize=undefined", "-fno-sanitize-recover=all"];

/// Whether the compiler and its sanitizer are installed.
fn sanitizes(compiler: &str, folder: &Path) -> bool {
    let (file, program) = (folder.join("none.c"), folder.join("none"));
    std::fs::write(&file, "int main(void) { return 0; }\n").unwrap();
    let built = Command::new(compiler).args(SANITIZED).arg(&file).arg("-o").arg(&program).output();
    built.is_ok_and(|run| run.status.success())
}

/// The text between two others.
pub fn between<'a>(text: &'a str, before: &str, after: &str) -> &'a str {
    let text = text.split_once(before).unwrap_or_else(|| panic!("no `{before}` in {text}")).1;
    text.split_once(after).unwrap_or_else(|| panic!("no `{after}` after `{before}`")).0
}

/// The source with another value as the first bias of the last layer.
fn with_another_bias(source: &str) -> String {
    let last = source.split("#ifdef").next().unwrap().rfind("static const wide B").unwrap();
    let begin = last + source[last..].find("{\n    ").unwrap() + 6;
    let end = begin + source[begin..].find(',').unwrap();
    let other = if source[begin..end].ends_with('f') { "7e0f" } else { "70707" };
    format!("{}{other}{}", &source[..begin], &source[end..])
}

/// Bytes of constants and of memory of a compiled decoder, from the device's `size`.
fn sections(source: &Path) -> [usize; 2] {
    let object = source.with_extension("o");
    // unoptimised, because optimisation moves small constants into the code
    device_compiler().args(["-O0", "-c", "-o"]).args([&object, source]).succeed();
    let said = Command::new("arm-none-eabi-size").arg("-A").arg(&object).succeed();
    let of = |section: &str| {
        let lines = said.lines().filter_map(|line| line.strip_prefix(section));
        lines.map(|line| line.split_whitespace().next().unwrap().parse::<usize>().unwrap()).sum()
    };
    [of(".rodata"), of(".bss")]
}

/// The compiler of docs/reference/exports.md for a Cortex-M4, with warnings as errors.
fn device_compiler() -> Command {
    let mut compiler = Command::new("arm-none-eabi-gcc");
    compiler.args(["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror"]);
    compiler.args(["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]);
    compiler
}

trait Succeed {
    /// Output of a command that must succeed.
    fn succeed(&mut self) -> String;
}

impl Succeed for Command {
    fn succeed(&mut self) -> String {
        let run = self.output().unwrap();
        assert!(run.status.success(), "{self:?}: {}", String::from_utf8_lossy(&run.stderr));
        String::from_utf8(run.stdout).unwrap()
    }
}

/// Compiles an exported decoder's test for a Cortex-M4, runs it in QEMU with an instruction count, and returns its output.
fn on_a_cortex_m4(source: &Path) -> String {
    let start = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/cortex-m4/start.c");
    let program = source.with_extension("elf");
    device_compiler()
        .args(["-DBRAIN_TEST", "-DBRAIN_CLOCK=instructions", "--specs=rdimon.specs"])
        .args(["-Wl,--section-start=.vectors=0", "-o"])
        .args([&program, source, Path::new(start)])
        .succeed();
    Command::new("timeout")
        .args([
            "300",
            "qemu-system-arm",
            "-M",
            "mps2-an386",
            "-nographic",
            "-semihosting",
            "-icount",
            "shift=3",
            "-kernel",
        ])
        .arg(&program)
        .succeed()
}

fn there_is(program: &str) -> bool {
    Command::new(program).arg("--version").output().is_ok_and(|run| run.status.success())
}

/// Exports these decoders as C, in floats and in integers: linear with a memory, linear with far lags that share weights, the
/// paper's network, a dilated causal network, and networks on linear decoders. Each gives the trial's predictions, reading by
/// reading: floats to a few parts in 10⁵, integers to the bit. With another bias its own test fails; other decoders are refused. On
/// a Cortex-M4 in QEMU the results are the same, with the constants and memory that the file's head states.
#[test]
fn a_brain_in_c_says_what_it_said_in_the_trial() {
    let bench = Bench::new();
    let kinds = "points = [
        { \"brain.kind\" = \"linear\", \"brain.memory\" = [0.1, 0.03] },
        { \"brain.kind\" = \"linear\", \"time.samples\" = 60 },
        { \"brain.kind\" = \"cnn\" },
        { \"brain.kind\" = \"cnn\", \"brain.kernels\" = [2, 3, 2], \"brain.dilations\" = [1, 2, 4], \"brain.causal\" = true },
        { \"brain.kind\" = \"stacked\", \"brain.memory\" = [0.2, 0.05] },
        { \"brain.kind\" = \"stacked\", \"brain.kernels\" = [2, 3], \"brain.causal\" = true, \"brain.memory\" = [0.1, 0.0] },
        { \"brain.kind\" = \"inverse\" },
    ]\n";
    bench.file("s.toml", &(TINY.replace("sensors = [1, 2]", "sensors = [1]") + kinds));
    bench.output(&["run", "s.toml", "--workers", "2"]);
    let trials =
        bench.output(&["query", "results/tiny.sqlite", "SELECT hash, brain FROM v_trial", "--format", "csv"]);
    let export = |hash: &str, more: &[&str]| {
        let call = ["export", "results/tiny.sqlite", hash, "--format", "c", "--out", "b.c"];
        bench.metasense(&[&call, more].concat())
    };
    let test = "a_brain_in_c_says_what_it_said_in_the_trial";
    let folder = bench.path("");
    let mut compilers: Vec<&str> =
        ["gcc", "clang"].into_iter().filter(|name| sanitizes(name, &folder)).collect();
    let device = there_is("arm-none-eabi-gcc")
        && device_compiler().arg("-print-file-name=rdimon.specs").succeed().contains('/')
        && there_is("qemu-system-arm");
    if !device {
        skip::skipped(test, "there is no arm-none-eabi-gcc with newlib, or no qemu-system-arm");
    }
    if compilers.len() < 2 {
        skip::skipped(test, &format!("of gcc and clang with their sanitizers there is {compilers:?}"));
        compilers.push("cc");
    }
    let mut found: Vec<(String, &str, usize)> = Vec::new();
    for (hash, kind) in trials.lines().skip(1).map(|line| line.split_once(',').unwrap()) {
        if kind == "inverse" {
            let refused = export(hash, &[]);
            let said = String::from_utf8_lossy(&refused.stderr);
            assert!(
                refused.status.code() == Some(2) && said.contains("linear decoders and networks"),
                "{said}"
            );
            continue;
        }
        for numbers in ["f32", "i16", "i8"] {
            let more: &[&str] = if numbers == "f32" { &[] } else { &["--numbers", numbers] };
            let what = format!("{kind} in {numbers}");
            assert!(export(hash, more).status.success(), "{what}");
            let source = std::fs::read_to_string(bench.path("b.c")).unwrap();
            let state =
                |before: &str, after: &str| -> usize { between(&source, before, after).parse().unwrap() };
            // in turn, so that each kind meets both compilers in every number format
            let compiler =
                compilers[found.iter().filter(|(other, ..)| other == kind).count() % compilers.len()];
            let (good, said) = holds(compiler, &source, &folder);
            assert!(good, "{what} by {compiler}: {said}");
            let off: Vec<f64> = said.split_whitespace().filter_map(|w| w.parse().ok()).collect();
            assert!(off[0] < 0.05 * off[1], "{what}: {said}");
            assert_eq!(said.contains("sums that differ: 0 of"), more.len() == 2, "{what}: {said}");
            // compiled without optimisation, to save time
            let (passes, _) = compiled("cc", std::iter::empty(), &with_another_bias(&source), &folder);
            assert!(!passes, "{what}, another bias");
            if device {
                let [constants, memory] = sections(&bench.path("b.c"));
                let stated = [state("constants ", " bytes"), state("memory ", " bytes")];
                let padding = [constants.abs_diff(stated[0]), memory.abs_diff(stated[1])];
                assert!(padding.iter().all(|bytes| *bytes <= 8), "{what}: {constants} {memory}, {stated:?}");
                let said = on_a_cortex_m4(&bench.path("b.c"));
                let taken: f64 = between(&said, "an answer: ", " in").parse().unwrap();
                let products = state(&format!("memory {} bytes, ", stated[1]), " multiply-adds") as f64;
                assert!((1.0..40.0).contains(&(taken / products)), "{what}: {said}");
            }
            found.push((kind.to_owned(), numbers, state("#define BRAIN_DELAY ", "\n")));
        }
        for (format, file) in [("npz", "t.npz"), ("onnx", "t.onnx")] {
            bench.output(&["export", "results/tiny.sqlite", hash, "--format", format, "--out", file]);
        }
        if !in_onnxruntime(&folder) {
            skip::skipped(test, "there is no Python with onnxruntime");
        }
    }
    found.sort();
    let expected =
        [("cnn", [0, 2]), ("linear", [3, 59]), ("stacked", [0, 7])].into_iter().flat_map(|(kind, delays)| {
            let of = move |numbers| delays.map(|delay| (kind.to_owned(), numbers, delay));
            ["f32", "i16", "i8"].into_iter().flat_map(of)
        });
    assert_eq!(found, expected.collect::<Vec<_>>());
    let call = "export results/tiny.sqlite 0 --format npy --numbers i8 --out b";
    let refused = bench.metasense(&call.split(' ').collect::<Vec<_>>());
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(2) && said.contains("--format c"), "{said}");
}

/// A device is a folder. Its decoder is the one for all casts, which differs from that of the design and passes its test.
#[test]
fn a_device_is_a_folder_with_all_that_is_built() {
    let bench = Bench::new();
    let scatter = "[variation]\nstretch = 0.2\nnodes = 0.1\n[evaluation]\ncasts = 1\n";
    let kinds = "points = [{ \"brain.kind\" = \"linear\" }, { \"brain.kind\" = \"cnn\" }, { \"brain.kind\" = \"stacked\" }]\n";
    bench.file("s.toml", &(TINY.replace("sensors = [1, 2]", "sensors = [1]") + kinds + scatter));
    bench.output(&["run", "s.toml", "--workers", "2"]);
    let sql = "SELECT hash FROM v_trial";
    for hash in bench.output(&["query", "results/tiny.sqlite", sql, "--format", "csv"]).lines().skip(1) {
        let [casts, design] = ["casts", "design"].map(|reader| {
            let call = ["export", "results/tiny.sqlite", hash, "--format", "device", "--reader", reader];
            bench.output(&[&call[..], &["--mould", "pocket=3x2x1", "--out", reader]].concat());
            let read = |name: &str| std::fs::read_to_string(bench.path(&format!("{reader}/{name}"))).unwrap();
            let (notes, source) = (read("README.md"), read("brain.c"));
            assert!(
                notes.contains("The volume of the cavity is ") && notes.contains("| chip 0 |"),
                "{notes}"
            );
            for name in ["mould.stl", "body.dxf", "body.svg", "design.npy", "brain.onnx"] {
                assert!(notes.contains(name) && bench.path(&format!("{reader}/{name}")).is_file());
            }
            let (good, said) = holds("cc", &source, &bench.path(""));
            assert!(good, "{said}");
            source
        });
        assert!(casts.contains("The decoder for all casts of the trained body"));
        assert_ne!(between(&casts, "W0[]", "}"), between(&design, "W0[]", "}"));
    }
    bench.file("s.toml", TINY);
    bench.output(&["run", "s.toml", "--db", "plain.sqlite"]);
    let hash = bench.output(&["query", "plain.sqlite", sql, "--format", "csv"]);
    let hash = hash.lines().nth(1).unwrap();
    let call = ["export", "plain.sqlite", hash, "--format", "device", "--reader", "casts", "--out", "d"];
    let refused = bench.metasense(&call);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(2) && said.contains("no [variation]"), "{said}");
    assert!(!bench.path("d").exists());
}
