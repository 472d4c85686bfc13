//! The exported body moves like the simulated one: the test measures the exported outline with its own readers and simulates the
//! result.

use crate::common::{Bench, TINY};
use crate::exports::between;

type Point = [f64; 2];

/// Midpoints of the short sides of a ligament's rectangle, and its width (mm).
type Ligament = ([Point; 2], f64);

/// Measurements of an export.
struct Measured {
    units: Vec<Vec<Point>>,
    ligaments: Vec<Ligament>,
    /// README.md.
    notes: String,
}

fn middle(a: Point, b: Point) -> Point {
    [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])]
}

fn apart(a: Point, b: Point) -> f64 {
    (b[0] - a[0]).hypot(b[1] - a[1])
}

/// Polylines on a layer of a DXF, from its pairs of code and value.
fn polylines(dxf: &str, layer: &str) -> Vec<Vec<Point>> {
    let lines: Vec<&str> = dxf.lines().map(str::trim).collect();
    let mut found: Vec<Vec<Point>> = Vec::new();
    let (mut entity, mut on) = ("", "");
    for pair in lines.chunks(2) {
        match (pair[0], pair[1]) {
            ("0", name) => entity = name,
            ("8", name) => {
                on = name;
                if (entity, on) == ("POLYLINE", layer) {
                    found.push(Vec::new());
                }
            }
            ("10", x) if (entity, on) == ("VERTEX", layer) => {
                found.last_mut().unwrap().push([x.parse().unwrap(), f64::NAN]);
            }
            ("20", y) if (entity, on) == ("VERTEX", layer) => {
                found.last_mut().unwrap().last_mut().unwrap()[1] = y.parse().unwrap();
            }
            _ => {}
        }
    }
    found
}

/// Width (mm) of a mould's cavity through a point in a direction: distance between the nearest upright walls.
fn across(walls: &[[Point; 2]], [x, y]: Point, [dx, dy]: Point) -> f64 {
    let (mut ahead, mut behind) = (f64::INFINITY, f64::INFINITY);
    for [[ax, ay], [bx, by]] in walls {
        let (ex, ey) = (bx - ax, by - ay);
        let det = dx * ey - dy * ex;
        let (t, s) = (((ax - x) * ey - (ay - y) * ex) / det, ((ax - x) * dy - (ay - y) * dx) / det);
        if (-1e-6..=1.0 + 1e-6).contains(&s) {
            if t > 0.0 { ahead = ahead.min(t) } else { behind = behind.min(-t) }
        }
    }
    ahead + behind
}

/// Upright walls of a binary STL in plan view.
fn walls(stl: &[u8]) -> Vec<[Point; 2]> {
    let number = |at: usize| f64::from(f32::from_le_bytes(stl[at..at + 4].try_into().unwrap()));
    let triangles = (84..stl.len()).step_by(50);
    let upright = triangles.filter_map(|at| {
        let [a, b, c] = [12, 24, 36].map(|k| [number(at + k), number(at + k + 4)]);
        // two of the three corners coincide in plan view
        let lines = [[a, b], [b, c], [c, a]].into_iter().filter(|[p, q]| p != q).collect::<Vec<_>>();
        (lines.len() == 2).then(|| lines[0])
    });
    upright.collect()
}

fn measured(bench: &Bench, folder: &str) -> Measured {
    let read = |name: &str| std::fs::read(bench.path(&format!("{folder}/{name}"))).unwrap();
    let text = |name: &str| String::from_utf8(read(name)).unwrap();
    let (dxf, notes) = (text("body.dxf"), text("README.md"));
    let ligaments = polylines(&dxf, "ligaments").into_iter().map(|c| {
        let [short, long] = [[0, 3, 1, 2], [0, 1, 3, 2]].map(|c4| c4.map(|i| c[i]));
        assert!((apart(short[0], short[1]) / apart(short[2], short[3]) - 1.0).abs() < 1e-6 && c.len() == 4);
        assert!((apart(long[0], long[1]) / apart(long[2], long[3]) - 1.0).abs() < 1e-6);
        ([middle(c[0], c[3]), middle(c[1], c[2])], apart(c[0], c[3]))
    });
    let ligaments: Vec<Ligament> = ligaments.collect();
    // the mould has these widths, except for the ligaments that the notes list
    let walls = walls(&read("mould.stl"));
    let differs = |&&([a, b], width): &&Ligament| {
        let normal = [(a[1] - b[1]) / apart(a, b), (b[0] - a[0]) / apart(a, b)];
        (across(&walls, middle(a, b), normal) / width - 1.0).abs() > 0.01
    };
    let merged = match notes.split_once(" ligaments merge with a unit") {
        None => 0,
        Some((before, _)) => {
            let words: Vec<&str> = before.rsplit(' ').take(3).collect();
            words[2].parse().unwrap()
        }
    };
    assert_eq!(ligaments.iter().filter(differs).count(), merged, "{notes}");
    Measured { units: polylines(&dxf, "units"), ligaments, notes }
}

impl Measured {
    fn number(&self, before: &str, after: &str) -> f64 {
        between(&self.notes, before, after).parse().unwrap()
    }

    /// The body as polygons with the stiffnesses of Timoshenko beams (MODEL.md, Material) of this height (mm).
    fn body(&self, height: f64, shear: Option<f64>) -> (String, String) {
        let count = self.ligaments.len() as f64;
        let length = self.ligaments.iter().map(|l| apart(l.0[0], l.0[1])).sum::<f64>() / count;
        let width = self.ligaments.iter().map(|l| l.1).sum::<f64>() / count;
        let et = self.number("the material needs E = ", " MPa") * height;
        let bend = et * width.powi(3) / 12.0 / length;
        let slender = length / width;
        let shear = shear.unwrap_or(12.0 * bend / (length * length) / (1.0 + 3.5 / (slender * slender)));
        let joint = |at: Point| {
            let all = self.units.iter().enumerate().flat_map(|(u, corners)| {
                corners.iter().enumerate().map(move |(n, corner)| (apart(*corner, at), u, n))
            });
            let (off, u, n) = all.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
            assert!(off < 1e-6, "no corner at {at:?}");
            format!("{u}, {n}")
        };
        let ends = |l: &Ligament| format!("[{}, {}]", joint(l.0[0]), joint(l.0[1]));
        let ligaments: Vec<String> = self.ligaments.iter().map(ends).collect();
        let rows =
            self.notes.lines().filter(|line| line.starts_with("| chip") || line.starts_with("| force"));
        let (mut chips, mut forces) = (Vec::new(), Vec::new());
        for cells in rows.map(|row| row.split('|').map(str::trim).collect::<Vec<_>>()) {
            match cells[1].starts_with("chip") {
                true => chips.push(cells[2].to_owned()),
                false => {
                    let along = between(cells[5], "along (", ")");
                    forces.push(format!("{{ unit = {}, direction = [{along}] }}", cells[2]));
                }
            }
        }
        let body = format!(
            "units = {:?}\nligaments = [{}]\nclamp = [{}]\npanels = [{}]\nsensors = [{}]\n",
            self.units,
            ligaments.join(", "),
            between(&self.notes, "- Held units: ", "."),
            forces.join(", "),
            chips.join(", ")
        );
        let density = 1e-9 * self.number("for Shore A 20 to 80) and ", " g/ml") * height;
        let stretch = et * width / length;
        let stiffness = format!("stiffness = {{ stretch = {stretch}, shear = {shear}, bend = {bend} }}");
        (body, format!("density = {density}\n{stiffness}\n"))
    }
}

/// An outline does not determine damping: both bodies have these coefficients (N·s/mm, N·mm·s).
const DAMPING: &str = "damping = [5e-5, 5e-5, 3e-3]\n";

const LATTICE: &str = "columns = 4\nrows = 4\nspacing = 15.0\nligament_length = 2.25\n";
const MATERIAL: &str = "density = 4e-8\nstiffness = { stretch = 3.0, shear = 0.5, bend = 1.0 }\n";

/// The body of the quickstart.
const QUICKSTART: [&str; 2] = [
    "columns = 6\nrows = 6\nspacing = 15.0\nligament_length = 2.25\n",
    "density = 1e-8\nstiffness = { stretch = 3.0, shear = 0.5, bend = 1.0 }\n",
];

/// A trial with this lattice and material.
fn spec(lattice: &str, material: &str) -> String {
    let spec = TINY.replace(LATTICE, &format!("{lattice}{DAMPING}")).replace(MATERIAL, material);
    let spec = spec.replace("iterations = 10\nwidth = 16\n", "kind = \"linear\"\n");
    spec.replace("tolerance = 1e-3", "tolerance = 1e-5").replace("sensors = [1, 2]", "sensors = [1]")
}

/// RMS difference between the signals of an exported body and of its measured copy, relative to the former, with `shear` (N/mm) or
/// the shear stiffness of the ligaments; and the notes.
fn deviation(bench: &Bench, hash: &str, design: &str, spec: &str, shear: Option<f64>) -> (f64, String) {
    bench.output(&["export", "s.sqlite", hash, "--format", "device", "--design", design, "--out", "d"]);
    bench.output(&["export", "s.sqlite", hash, "--format", "npz", "--out", "t.npz"]);
    let found = measured(bench, "d");
    let (body, material) = found.body(10.0, shear);
    let keys = between(spec, "[body]\n", "[time]");
    bench.file("cast.body.toml", &body);
    bench.file("cast.toml", &spec.replace(keys, &format!("file = \"cast.body.toml\"\n{DAMPING}{material}")));
    let forces = bench.member("t.npz", "forces");
    bench.write_array("f.npy", &[forces.len() as u64 / 42, 2, 21], &forces);
    bench.output(&["body", "simulate", "cast.toml", "--forces", "f.npy", "--out-dir", "out"]);
    let (own, other) =
        (bench.member("t.npz", &format!("signals_{design}")), bench.array("out/signals.npy").1);
    assert_eq!(own.len(), other.len());
    // per channel, because accelerations and rotation rates differ in units
    let off = (0..3).map(|c| {
        let channel = || own.iter().zip(&other).skip(c).step_by(3);
        (channel().map(|(a, b)| (a - b).powi(2)).sum::<f64>() / channel().map(|(a, _)| a * a).sum::<f64>())
            .sqrt()
    });
    (off.fold(0.0, f64::max), found.notes)
}

fn trained(bench: &Bench, spec: &str) -> String {
    bench.file("s.toml", spec);
    let csv = bench.output(&["expand", "s.toml", "--format", "csv"]);
    bench.output(&["run", "s.toml", "--db", "s.sqlite"]);
    csv.lines().nth(1).unwrap().split(',').next().unwrap().to_owned()
}

/// Squares and triangles of a material, before and after training, and the quickstart's stiffnesses with the shear stiffness of a
/// beam.
#[test]
fn the_outline_moves_as_the_body_that_was_simulated() {
    let rubber = "material = { modulus = 0.3375, density = 4e-9, thickness = 10, ligament_width = 2 }\n";
    let straight = QUICKSTART[1].replace("shear = 0.5", "shear = 0.62955");
    let [kagome, random] = ["lattice = \"kagome\"", "design = { random = 1, spread = 0.4 }"]
        .map(|key| format!("{key}\n{LATTICE}"));
    let wide = rubber.replace("ligament_width = 2", "ligament_width = 3.5");
    for (lattice, material) in
        [(QUICKSTART[0], &straight[..]), (LATTICE, rubber), (&random, &wide), (&kagome, rubber)]
    {
        let bench = Bench::new();
        let spec = spec(lattice, material);
        let hash = trained(&bench, &spec);
        for design in ["initial", "optimised"] {
            let (off, notes) = deviation(&bench, &hash, design, &spec, None);
            assert!(off < 0.01, "{lattice}{material}{design}: {off}\n{notes}");
            assert!(!notes.contains("shear stiffness"), "{notes}");
        }
    }
}

/// The quickstart's shear stiffness is not that of a straight ligament. The notes give the latter, and a body with it moves
/// differently; with the model's shear stiffness, the measured copy moves like the model.
#[test]
fn a_shear_that_no_ligament_has_is_told() {
    let bench = Bench::new();
    let spec = spec(QUICKSTART[0], QUICKSTART[1]);
    let hash = trained(&bench, &spec);
    for design in ["initial", "optimised"] {
        let (off, notes) = deviation(&bench, &hash, design, &spec, Some(0.5));
        assert!(off < 0.01, "{design}: {off}");
        let (beam, notes) = (deviation(&bench, &hash, design, &spec, None).0, notes);
        assert!(
            beam > 0.05 && notes.contains("has a shear stiffness of 0.63 N/mm, the model 0.5"),
            "{beam} {notes}"
        );
    }
}

/// No cast has stiffnesses whose ligaments are as wide as units: `expand` prints a warning, and there is no mould.
#[test]
fn stiffnesses_that_no_ligament_has_are_told() {
    let bench = Bench::new();
    for (bend, possible) in [(1.0, true), (60.0, false)] {
        bench.file("s.toml", &spec(LATTICE, &MATERIAL.replace("bend = 1.0", &format!("bend = {bend}"))));
        let run = bench.metasense(&["expand", "s.toml"]);
        let said = String::from_utf8_lossy(&run.stderr).into_owned();
        let told = said.lines().filter(|line| line.contains("no cast body has the stiffnesses")).count();
        assert_eq!((run.status.code(), told), (Some(0), usize::from(!possible)), "{said}");
    }
    let hash = trained(&bench, &std::fs::read_to_string(bench.path("s.toml")).unwrap());
    let refused = bench.metasense(&["export", "s.sqlite", &hash, "--format", "stl", "--out", "m.stl"]);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(2) && said.contains("reduce body.stiffness.bend"), "{said}");
}
