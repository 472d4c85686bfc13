//! Bodies of arbitrary polygons: both file formats, and rejected files.

use super::*;

const TWO: &str =
    "units = [[[0, 0], [10, 0], [0, 9]], [[14, 0], [24, 0], [24, 8], [14, 8]]]\nligaments = [[0, 1, 1, 0]]\n";

fn file(name: &str, content: &[u8]) -> (tempfile::TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, content).unwrap();
    (folder, path)
}

#[test]
fn a_toml_of_polygons_is_a_layout() {
    let (_folder, path) = file("two.toml", TWO.as_bytes());
    let given = read(&path).unwrap();
    assert_eq!(given.units[0].len() + given.units[1].len(), 7);
    let layout = layout(&given).unwrap();
    assert_eq!((layout.units(), layout.groups.count(), layout.ligament_length), (2, 6, 4.0));
    assert_eq!(layout.ligaments[0].reference, [4.0, 0.0]);
    assert_eq!(layout.groups.of_nodes[0][1], layout.groups.of_nodes[1][0]);
    let corners = layout.vertices(&vec![0.0; layout.design_len()]);
    for (ours, theirs) in corners.iter().flatten().zip(given.units.iter().flatten()) {
        assert!((ours[0] - theirs[0]).hypot(ours[1] - theirs[1]) < 1e-12);
    }
    // Sensors as in the file.
    let given = Polygons { sensors: Some(vec![1]), ..given };
    assert_eq!(super::layout(&given).unwrap().carriers, [false, true]);
}

/// Each error names its location.
#[test]
fn bad_polygons_are_refused_by_name() {
    for (from, to, at, what) in [
        ("[10, 0], [0, 9]", "[0, 9], [10, 0]", "units[0]", "counter-clockwise"),
        ("[10, 0], [0, 9]", "[10, 0]", "units[0]", "has 2 nodes"),
        ("[24, 8]", "[nan, 8]", "units[1]", "finite"),
        ("[[0, 1, 1, 0]]", "[[0, 3, 1, 0]]", "ligaments[0]", "unit 0 has no node 3"),
        ("[[0, 1, 1, 0]]", "[[0, 1, 2, 0]]", "ligaments[0]", "unit 2 has no node 0"),
        ("[[0, 1, 1, 0]]", "[[0, 1, 0, 2]]", "ligaments[0]", "two units"),
        ("[[0, 1, 1, 0]]", "[[0, 1, 1, 0], [1, 0, 0, 1]]", "ligaments[1]", "twice"),
        ("[[0, 1, 1, 0]]", "[[0, 1, 1, 0], [0, 1, 1, 3]]", "ligaments[1]", "has ligaments[0] already"),
        ("[[0, 1, 1, 0]]", "[[0, 1, 1, 0], [1, 0, 0, 2]]", "ligaments[1]", "node 0 of unit 1"),
        ("[14, 0]", "[10, 0]", "ligaments[0]", "no length"),
        ("[[0, 1, 1, 0]]", "[]", "units[1]", "is not connected"),
        ("[[0, 1, 1, 0]]", "[[0, 1, 1, 0]]\ntogether = [[[0, 0], [1, 4]]]", "together[0]", "no node 4"),
        ("[[0, 1, 1, 0]]", "[[0, 1, 1, 0]]\nclamp = [2]", "clamp: 2", "0 to 1"),
        ("[[0, 1, 1, 0]]", "[[0, 1, 1, 0]]\ntogether = [[[0, 0], [1, 1], [0, 0]]]", "together[0]", "twice"),
        ("[[0, 1, 1, 0]]", "[[0, 1, 1, 0]]\nsensors = [1, 1]", "sensors: 1", "once"),
        ("[[0, 1, 1, 0]]", "[[0, 1, 1, 0]]\nclamp = [0, 0]", "clamp: 0", "once"),
        ("[[0, 1, 1, 0]]", "[[0, 1, 1, 0]]\ndensity = [{ units = [2], factor = 2 }]", "density: 2", "0 to 1"),
        (
            "[[0, 1, 1, 0]]",
            "[[0, 1, 1, 0]]\ndensity = [{ units = [1], factor = 0 }]",
            "density[0]",
            "above 0",
        ),
        ("[[0, 1, 1, 0]]", "[[0, 1, 1, 0]]\nrigid = [2]", "rigid: 2", "0 to 1"),
        (
            "[[0, 1, 1, 0]]",
            "[[0, 1, 1, 0]]\nrigid = [1]\ntogether = [[[0, 0], [1, 1]]]",
            "together[0]",
            "cannot be shifted",
        ),
        (
            "[[0, 1, 1, 0]]",
            "[[0, 1, 1, 0]]\nfollow = [{ node = [1, 1], nodes = [0, 2], by = \"x\" }]",
            "follow[0]",
            "no rigid unit 1 with a node 1",
        ),
        (
            "[[0, 1, 1, 0]]",
            "[[0, 1, 1, 0]]\nrigid = [1]\nfollow = [{ node = [1, 0], nodes = [0, 2], by = \"x\" }]",
            "follow[0]",
            "cannot follow others",
        ),
        (
            "[[0, 1, 1, 0]]",
            "[[0, 1, 1, 0]]\nrigid = [1]\nfollow = [{ node = [1, 1], nodes = [0, 2], by = \"x\" }]",
            "follow[0]",
            "two nodes of unit 1",
        ),
    ] {
        let text = TWO.replacen(from, to, 1);
        assert_ne!(text, TWO, "{from}");
        let given: Polygons = toml::from_str(&text).unwrap();
        let Err(e) = layout(&given) else { panic!("{to} passes") };
        assert!(e.key == "body.file" && e.value.starts_with(at) && e.remedy.contains(what), "{to}: {e}");
    }
    let (_folder, path) = file("two.toml", TWO.replace("ligaments", "ligament").as_bytes());
    let told = read(&path).unwrap_err().to_string();
    assert!(told.contains("two.toml") && told.contains("ligament") && told.contains("line 2"), "{told}");
    let (_folder, path) = file("two.txt", TWO.as_bytes());
    assert!(read(&path).unwrap_err().to_string().contains(".toml or .npz"));
}

/// Reads DifFlexMM's geometries as `numpy.savez` writes them; rejects other shapes, missing arrays and invalid node numbers.
#[test]
fn an_npz_of_blocks_is_polygons() {
    let arms = [-1.0, -1.0, 2.0, -1.0, -1.0, 2.0, -1.0, -2.0, 1.0, 1.0, -1.0, 1.0];
    let archive = |arrays: &[(&str, &[usize], &[f64])]| {
        let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
        for (name, shape, values) in arrays {
            zip.start_file(format!("{name}.npy"), zip::write::SimpleFileOptions::default()).unwrap();
            std::io::Write::write_all(&mut zip, &files::npy_bytes(shape, values)).unwrap();
        }
        zip.finish().unwrap().into_inner()
    };
    let centroids: (&str, &[usize], &[f64]) = ("block_centroids", &[2, 2], &[0.0, 0.0, 5.0, 0.0]);
    let nodes: (&str, &[usize], &[f64]) = ("centroid_node_vectors", &[2, 3, 2], &arms);
    let whole = archive(&[
        centroids,
        nodes,
        ("bond_connectivity", &[1, 2], &[1.0, 3.0]),
        ("more", &[1], &[f64::NAN]),
    ]);
    let (_folder, path) = file("blocks.NPZ", &whole);
    let given = read(&path).unwrap();
    assert_eq!(given.units[1], [[4.0, -2.0], [6.0, 1.0], [4.0, 1.0]]);
    assert_eq!(given.ligaments, [[0, 1, 1, 0]]);
    assert_eq!(layout(&given).unwrap().ligament_length, 2f64.hypot(1.0));
    for (arrays, said) in [
        (
            archive(&[centroids, nodes, ("bond_connectivity", &[1, 2], &[1.0, 2.5])]),
            "bond_connectivity[0, 1] = 2.5: must be",
        ),
        (
            archive(&[centroids, nodes, ("bond_connectivity", &[1, 2], &[-1.0, 3.0])]),
            "bond_connectivity[0, 0] = -1: must be",
        ),
        (
            archive(&[centroids, nodes, ("bond_connectivity", &[1, 2], &[1.0, 1e300])]),
            "bond_connectivity[0, 1] = 1",
        ),
        (
            archive(&[centroids, nodes, ("bond_connectivity", &[1, 2], &[1.0, f64::NAN])]),
            "bond_connectivity[0, 1] = NaN",
        ),
        (archive(&[centroids, nodes, ("bond_connectivity", &[2, 1], &[1.0, 3.0])]), "must be [units, 2]"),
        (
            archive(&[
                centroids,
                ("centroid_node_vectors", &[3, 2, 2], &arms),
                ("bond_connectivity", &[1, 2], &[1.0, 3.0]),
            ]),
            "must be [units, 2]",
        ),
        (archive(&[centroids, nodes]), "has no array bond_connectivity"),
        (whole[..whole.len() / 2].to_vec(), "is not an NPZ file"),
    ] {
        let (_folder, path) = file("blocks.npz", &arrays);
        let error = read(&path).unwrap_err().to_string();
        assert!(error.contains("blocks.npz") && error.contains(said), "{error}\n{said}");
    }
}
