use metasense_schemas::spec::Search;

use super::*;
use crate::replay::tests::small_trial;

/// A stored twin can be read again, for given and for searched sensors, but not for another design.
#[test]
fn a_twin_is_read_as_it_was_written() {
    let given = small_trial();
    let mut searched = given.clone();
    searched.sensors.search = Some(Search::Greedy);
    searched.sensor_units.clear();
    for trial in [given, searched] {
        let (layout, design) = body(&trial).unwrap();
        let near = |count: usize, around: f64| (0..count).map(|i| around + 0.125 * i as f64).collect();
        let ligament = |i: usize| [1.0 + 0.25 * i as f64, 1.5, 0.5];
        let cast = Cast {
            material: Parameters::from_array([1.25, 0.75, 1.5, 2.0, 0.5, 1.0]),
            parts: PartFactors {
                ligaments: (0..layout.ligaments.len()).map(ligament).collect(),
                units: near(layout.units(), 1.0),
            },
            ligament_length: 1.125,
            relaxation: None,
            shifts: near(layout.design_len(), -0.5),
            chips: Chips { gain: near(3, 1.0), turn: vec![0.0] },
        };
        let twin = Twin { cast, misfit: 1.5, noise: near(3, 10.0) };
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), toml::to_string(&store(&trial, &design, &twin)).unwrap()).unwrap();
        assert_eq!(read(file.path(), &trial, &design).unwrap(), twin);
        let other: Vec<f64> = design.iter().map(|a| a + 0.1).collect();
        let said = read(file.path(), &trial, &other).unwrap_err().to_string();
        assert!(said.contains("belongs to another body"), "{said}");
    }
}
