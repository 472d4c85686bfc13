use metasense_schemas::spec::Body;
use metasense_source::Source;
use metasense_worker::problem;

use crate::plan::Plan;

const DISC: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../schemas/sweeps/fig5.toml");

fn plan(text: &str) -> Plan {
    Plan::new("s.toml", text.to_owned()).unwrap()
}

/// A disc with five to twelve units across has scaled lengths, limits and rate. With ten, its trial equals that without a given
/// size.
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

/// A trial's material reproduces its density and stiffnesses, although its lengths were scaled.
#[test]
fn a_trial_keeps_the_material_of_its_stiffnesses() {
    let text = "name = \"s\"\n[body]\ncolumns = 5\nrows = 4\nspacing = 30.0\nligament_length = 4.0\nwidth = 60.0\n\
                material = { rubber = \"Dragon Skin 10\", thickness = 10.0, ligament_width = 3.0 }\n\
                [stimuli]\nkind = \"bell\"\n[sweep]\npanels = [1]\nsensors = [1]\n";
    let trial = &plan(text).trials[0].spec.body;
    let again = problem::sheet(&Body { density: None, stiffness: None, ..trial.clone() }).unwrap();
    assert_eq!(trial.density, again.density);
    let [own, of_material] = [trial, &again].map(|body| body.stiffness.unwrap());
    for (own, other) in [
        (own.stretch, of_material.stretch),
        (own.shear, of_material.shear),
        (own.bend, of_material.bend),
        (trial.material.unwrap().ligament_width, 3.0 * 60.0 / 150.0),
    ] {
        assert!((own / other - 1.0).abs() < 1e-12, "{own} {other}");
    }
}
