//! Geometry, energy, trajectories and gradients agree with the independent reference cases.

mod common;

use common::{Case, pool, relative};
use metasense_numerics::body::Geometry;
use metasense_numerics::dynamics::{
    Method, Outcome, Solver, energy, energy_design_gradient, energy_gradient, pull_back, simulate,
};

const ROUNDING: f64 = 1e-12;

#[test]
fn geometry_agrees_with_the_reference() {
    for name in ["geometry_5x3_p", "geometry_6x6_p"] {
        let case = Case::open(name);
        let scene = case.scene();
        let g = Geometry::new(&scene.layout, &case.array("alpha"), scene.density);
        let angle = case.about["scene"]["initial_angle"].as_f64().expect("angle");
        for (what, ours) in [
            ("alpha_initial", scene.layout.initial_design(angle)),
            ("vertices", g.vertices.as_flattened().as_flattened().to_vec()),
            ("centroids", g.centroids.as_flattened().to_vec()),
            ("r", g.arms.as_flattened().as_flattened().to_vec()),
            ("area", g.area.clone()),
            ("mass", g.mass.clone()),
            ("moment", g.moment.clone()),
            ("void_angles", g.void_angles(&scene.layout).as_flattened().to_vec()),
        ] {
            let error = relative(&ours, &case.array(what));
            assert!(error < ROUNDING, "{name} {what}: {error:e}");
        }
        for (ours, theirs) in
            scene.layout.ligaments.iter().zip(case.about["ligaments"].as_array().expect("list"))
        {
            let ends = [ours.a.unit, ours.a.node, ours.b.unit, ours.b.node];
            let expected =
                ["a", "node_a", "b", "node_b"].map(|k| theirs[k].as_u64().expect("index") as usize);
            assert_eq!(ends, expected, "{name}");
        }
    }
}

#[test]
fn energies_and_their_gradients_agree_with_the_reference() {
    for name in ["energy_moderate_p", "energy_large_p", "energy_linearised_p", "energy_contact_p"] {
        let case = Case::open(name);
        let scene = case.scene();
        let design = case.array("alpha");
        let (mut elastic, mut contact, mut dx, mut dalpha) = (vec![], vec![], vec![], vec![]);
        for state in case.states("displacement", scene.layout.units()) {
            let e = energy(&scene, &design, &state);
            elastic.push(e.elastic);
            contact.push(e.contact);
            dx.extend(energy_gradient(&scene, &design, &state).into_flattened());
            dalpha.extend(energy_design_gradient(&scene, &design, &state));
        }
        for (what, ours) in
            [("energy_elastic", elastic), ("energy_contact", contact), ("dU_dx", dx), ("dU_dalpha", dalpha)]
        {
            let error = relative(&ours, &case.array(what));
            assert!(error < ROUNDING, "{name} {what}: {error:e}");
        }
    }
}

#[test]
fn trajectories_agree_with_the_reference_as_far_as_it_agrees_with_itself() {
    let solver = Solver { method: Method::Tsit5, tolerance: 1e-11 };
    let pool = pool(2);
    for name in ["6x6_initial", "3x2", "8x4_contact", "body_frame", "linearised"] {
        let case = Case::open(&format!("trajectory_{name}_p"));
        let run = simulate(&case.scene(), &case.array("alpha"), &case.forces(), &solver, false, &pool);
        assert!(run.outcomes.iter().all(|o| *o == Outcome::Ok), "{name}: {:?}", run.outcomes);
        let error = relative(&run.signals, &case.array("sensors"));
        let own = case.about["self_consistency"]["sensors_relative_l2"].as_f64().expect("number");
        assert!(error < (3.0 * own).max(1e-7), "{name}: {error:e}, the reference's own {own:e}");
    }
}

#[test]
fn gradients_agree_with_automatic_differentiation() {
    let solver = Solver { method: Method::Tsit5, tolerance: 1e-10 };
    let pool = pool(2);
    for name in ["adjoint_3x2_p", "adjoint_6x6_perturbed_p"] {
        let case = Case::open(name);
        let (scene, design, forces) = (case.scene(), case.array("alpha"), case.forces());
        let run = simulate(&scene, &design, &forces, &solver, true, &pool);
        let all: Vec<usize> = (0..forces.samples).collect();
        let cotangent = case.array("cotangent");
        let gradient = pull_back(&scene, &design, &forces, &run, &all, &cotangent, &pool);
        let error = relative(&gradient.design, &case.array("gradient"));
        assert!(error < 1e-6, "{name}: {error:e}");
    }
}
