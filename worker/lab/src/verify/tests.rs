//! All committed cases, and checks without a reference: energy balance, Taylor tests of the gradient, equal bits for any number
//! of threads, stiff and extreme scenes with their outcomes.

use metasense_numerics::dynamics::Tolerance;
use metasense_schemas::spec::{Denser, Follow, Polygons, Struck};
use metasense_worker::invalid::as_written;

use super::*;

mod checks;
mod extreme;

fn pool() -> metasense_numerics::Pool {
    metasense_numerics::Pool::new(2).expect("threads")
}

fn hold(rows: &[ComparedQuantity], at_least: usize) {
    rows.iter()
        .for_each(|ComparedQuantity { quantity, error, note, .. }| println!("{quantity}: {error:?} {note}"));
    let failed: Vec<&ComparedQuantity> = rows.iter().filter(|row| !row.pass).collect();
    assert!(failed.is_empty() && rows.len() >= at_least, "{} rows: {failed:#?}", rows.len());
}

/// Prints its rows: `cargo test -p metasense-lab --lib verify -- --nocapture`.
#[test]
fn every_integrator_is_what_it_says() {
    let solvers = [
        IntegratorSettings::tsit5(Tolerance::both(1e-11)),
        IntegratorSettings::new(Integrator::Leapfrog, Accuracy(1e-3)),
        IntegratorSettings::new(Integrator::Nystrom4, Accuracy(1e-6)),
        IntegratorSettings::new(Integrator::Nystrom6, Accuracy(1e-7)),
    ];
    hold(&checks::rows(&solvers, &pool()), 30);
}

#[test]
fn extreme_scenes_are_solved_at_default_settings() {
    hold(&extreme::rows(DEFAULT, &pool()), 17);
}

/// Every quantity of every committed case.
#[test]
fn the_committed_cases_hold() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/cases");
    let rows = cases(Path::new(folder), &pool()).expect("cases");
    let kinds: std::collections::BTreeSet<&str> =
        rows.iter().filter_map(|r| r.case.split('_').next()).collect();
    assert_eq!(kinds.len(), 9, "{kinds:?}");
    hold(&rows, kinds.len());
}

/// Areas, masses and moments of the authors' body for two forces as their notebooks print them (commit 2c0b29e3,
/// notebooks/Forward_simulation.ipynb), and the numbers of units and design parameters of their bodies.
#[test]
fn bodies_of_the_authors_are_as_they_print_them() {
    let layout = |given| metasense_worker::polygons::layout(&given).expect("a body");
    let body = layout(authors::planar(5, 4, 2));
    let geometry =
        metasense_numerics::body::Geometry::new(&body, &vec![0.0; body.design_len()], 3.2325226e-8);
    for (unit, area, mass, moment) in [
        (0, 136.96231861, 4.4273379e-6, 1.01063077e-4),
        (20, 363.61875, 1.17540583e-5, 1.06243502e-3),
        (21, 363.61875, 1.17540583e-5, 1.20941048e-3),
        (22, 909.046875, 2.93851457e-5, 1.62106749e-2),
    ] {
        let found = [geometry.area[unit], geometry.mass[unit], geometry.moment[unit]];
        let off =
            found.iter().zip([area, mass, moment]).map(|(found, printed)| (found / printed - 1.0).abs());
        assert!(off.into_iter().all(|off| off < 5e-9), "{unit}: {found:?}");
    }
    for (given, units, numbers, ligaments) in [
        (authors::planar(5, 4, 2), 23, 98, 40),
        (authors::planar(11, 6, 4), 71, 298, 134),
        (authors::planar(23, 6, 8), 147, 610, 286),
    ] {
        let layout = layout(given);
        let found = (layout.units(), layout.design_len(), layout.ligaments.len());
        assert_eq!(found, (units, numbers, ligaments));
    }
    for (n, inside) in [(10, 32), (15, 97), (23, 241), (35, 577)] {
        assert_eq!(layout(authors::disc(n)).units(), inside + 8, "{n}");
    }
    assert_eq!(layout(authors::disc(15)).ligaments.len(), 216);
}

/// The body files of the authors' scenes match the generator. `METASENSE_UPDATE=1` rewrites them.
#[test]
fn body_files_of_the_authors_scenes_are_fresh() {
    let mut files = vec![
        ("authors-2".to_owned(), authors::planar(5, 4, 2)),
        ("authors-4".to_owned(), authors::planar(11, 6, 4)),
        ("authors-8".to_owned(), authors::planar(23, 6, 8)),
    ];
    for n in [10, 13, 15, 18, 20, 23, 25, 27, 30, 32, 35] {
        files.push((format!("authors-disc-{n}"), authors::disc(n)));
    }
    for (name, body) in files {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../schemas/scenes");
        let (path, text) = (Path::new(folder).join(name + ".body.toml"), file(&body));
        if std::env::var_os("METASENSE_UPDATE").is_some() {
            std::fs::write(&path, &text).expect("written");
        }
        let committed = std::fs::read_to_string(&path).unwrap_or_default();
        assert!(committed == text, "{}: stale; METASENSE_UPDATE=1 writes it anew", path.display());
        let read = metasense_worker::polygons::read(&path).expect("a body");
        metasense_worker::polygons::layout(&read).expect("a layout");
    }
}

/// A folder without a case, broken JSON, an unknown kind, a missing or truncated array, a wrong number: each is a failed row;
/// other cases still run.
#[test]
fn what_cannot_be_read_or_does_not_agree_fails() {
    let folder = tempfile::tempdir().expect("folder");
    let metric = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/cases/metric_p"));
    let make = |name: &str, spoil: &dyn Fn(&Path)| {
        let to = folder.path().join(name);
        std::fs::create_dir(&to).expect("folder");
        for file in std::fs::read_dir(metric).expect("case").map(|f| f.expect("file").path()) {
            std::fs::copy(&file, to.join(file.file_name().expect("name"))).expect("copy");
        }
        spoil(&to);
    };
    let write = |to: &Path, bytes: &[u8]| std::fs::write(to, bytes).expect("write");
    make("a_good", &|_| ());
    make("b_no_json", &|to| std::fs::remove_file(to.join("case.json")).expect("remove"));
    make("c_broken", &|to| write(&to.join("case.json"), b"{"));
    make("d_unknown", &|to| write(&to.join("case.json"), br#"{"kind": "weather"}"#));
    make("e_missing", &|to| std::fs::remove_file(to.join("force.npy")).expect("remove"));
    make("f_short", &|to| {
        let bytes = std::fs::read(to.join("force.npy")).expect("read");
        write(&to.join("force.npy"), &bytes[..bytes.len() - 8]);
    });
    make("g_wrong", &|to| {
        std::fs::copy(to.join("force.npy"), to.join("predicted.npy")).expect("copy");
    });
    let rows = cases(folder.path(), &pool()).expect("cases");
    let verdict = |name: &str| rows.iter().filter(|r| r.case.starts_with(name)).all(|r| r.pass);
    assert!(verdict("a_"), "{rows:#?}");
    assert!(["b_", "c_", "d_", "e_", "f_", "g_"].iter().all(|name| !verdict(name)), "{rows:#?}");
    assert!(cases(&folder.path().join("nowhere"), &pool()).is_err());
}

/// A body as TOML, one unit per line, coordinates to 1e-9 mm.
fn file(body: &Polygons) -> String {
    let place = |x: &f64| format!("{}", (x * 1e9).round() / 1e9 + 0.0);
    let point = |[x, y]: &[f64; 2]| format!("[{}, {}]", place(x), place(y));
    let lines = |name: &str, entries: Vec<String>| match entries.is_empty() {
        true => String::new(),
        false => format!("{name} = [\n  {},\n]\n", entries.join(",\n  ")),
    };
    let unit =
        |nodes: &Vec<[f64; 2]>| format!("[{}]", nodes.iter().map(point).collect::<Vec<_>>().join(", "));
    let ligaments: Vec<String> = body.ligaments.iter().map(|ends| format!("{ends:?}")).collect();
    let follow =
        |f: &Follow| format!("{{ node = {:?}, nodes = {:?}, by = {} }}", f.node, f.nodes, as_written(&f.by));
    let denser = |d: &Denser| format!("{{ units = {:?}, factor = {} }}", d.units, d.factor);
    let panel = |p: &Struck| {
        let (unit, direction) = (p.unit.unwrap_or_default(), p.direction.unwrap_or_default());
        format!("{{ unit = {unit}, direction = {} }}", point(&direction))
    };
    [
        "# Made by worker/lab/src/verify/authors.rs; `cargo test -p metasense-lab --lib authors` checks it.\n"
            .to_owned(),
        lines("units", body.units.iter().map(unit).collect()),
        lines("ligaments", ligaments.chunks(8).map(|row| row.join(", ")).collect()),
        format!("rigid = {:?}\n", body.rigid),
        lines("follow", body.follow.iter().map(follow).collect()),
        lines("density", body.density.iter().map(denser).collect()),
        format!("clamp = {:?}\n", body.clamp.clone().unwrap_or_default()),
        lines("panels", body.panels.iter().map(panel).collect()),
        body.sensors.as_ref().map_or(String::new(), |units| format!("sensors = {units:?}\n")),
    ]
    .concat()
}
