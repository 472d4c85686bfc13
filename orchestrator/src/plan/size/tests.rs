use metasense_schemas::source::Source;
use metasense_worker::problem;

use crate::plan::Plan;

const DISC: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../schemas/claims/disc.toml");

fn plan(text: &str) -> Plan {
    Plan::new("s.toml", text.to_owned()).unwrap()
}

/// Five to twelve units across the same disc: similar units of proportional lengths, limits and rate, and ten across
/// are the trial that is written without a size.
#[test]
fn a_disc_keeps_its_size_while_its_units_grow_in_number() {
    let disc = std::fs::read_to_string(DISC).unwrap();
    let disc = Source::spec(DISC, disc, &["optimise.learning_rate=0.3".to_owned()]).unwrap().text;
    let sized = plan(&disc);
    for trial in &sized.trials {
        let (body, limits) = (&trial.spec.body, &trial.spec.feasible);
        let stiffness = body.stiffness.unwrap();
        let scale = 150.0 / (body.columns() as f64 * 15.0);
        let [spacing, ligament_length] = body.lengths();
        let lengths = [spacing / 15.0, ligament_length / 2.25, limits.min_edge / 3.0];
        let others = [limits.clearance, limits.ligament_clearance / 0.5, stiffness.bend.sqrt()];
        let rate = trial.spec.optimise.learning_rate.unwrap() / 0.3;
        let all = [&lengths[..], &others[..], &[rate]].concat();
        assert!(all.iter().all(|part| (part / scale - 1.0).abs() < 1e-12), "{scale}: {all:?}");
        assert_eq!((stiffness.stretch, stiffness.shear, body.diameter), (3.0, 0.5, None));
        problem::problem(&trial.spec).unwrap();
    }
    let free = plan(&disc.replace("\ndiameter =", "\n# diameter ="));
    for (sized, free) in sized.trials.iter().zip(&free.trials) {
        assert_eq!(sized.hash == free.hash, sized.spec.body.columns() == 10);
        assert_eq!((sized.units, sized.design_parameters), (free.units, free.design_parameters));
    }
}
