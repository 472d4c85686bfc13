use super::*;
use crate::body::Layout;
use crate::dynamics::{Accuracy, Frame, Method, Panel, Parts, Stiffness, Tangent};

/// Each column against dual numbers with the same steps, and Jᵀr against the adjoint.
#[test]
fn tangents_are_those_of_dual_numbers_and_of_the_adjoint() {
    let layout = Layout::planar(3, 2, 15.0, 2.25);
    let scene = Scene {
        density: 1e-8,
        stiffness: Stiffness { stretch: 3.0, shear: 0.5, bend: 1.0 },
        parts: Parts::default(),
        relaxation: None,
        damping_ratio: 0.02,
        damping: None,
        inertia: None,
        contact: None,
        linearised: false,
        clamped: layout.bottom(),
        guided: Vec::new(),
        pressed: Vec::new(),
        panels: vec![Panel::central(4, [0.0, -1.0])],
        sensors: vec![3],
        chip: None,
        mount: None,
        frame: Frame::Body,
        duration: 0.1,
        instants: 20,
        layout,
    };
    let design = scene.layout.initial_design(0.4363);
    let push = |n: usize| 0.3 * (0.3 * n as f64).sin().powi(2);
    let forces = Forces {
        samples: 2,
        panels: 1,
        instants: 20,
        values: (0..42).map(push).collect(),
        strikes: Vec::new(),
    };
    let pool = crate::Pool::new(1).expect("a pool");
    let signals: Vec<f64> = (0..120).map(|i| (0.9 * i as f64).sin()).collect();
    let solver = Solver::new(Method::Nystrom6, Accuracy(1e-4));
    let free = &Parameter::ALL[..5];
    let mut objective = Objective::new(&scene, &design, &forces, &signals, solver, free, &pool);
    let at = Parameters::of(&scene).array();
    let point = objective.at(&at).expect("simulates");
    let jacobian = objective.jacobian(&point);
    for k in 0..free.len() {
        let along = Parameters::from_array(std::array::from_fn(|i| if i == k { at[i] } else { 0.0 }));
        let theirs: Vec<f64> = (0..2)
            .flat_map(|i| point.simulation.jvp(i, Tangent { parameters: along, ..Tangent::default() }).1)
            .collect();
        let theirs = DVector::from_vec(theirs);
        let error = (jacobian.column(k) - &theirs).norm() / theirs.norm();
        assert!(error < 1e-4 && theirs.norm() > 0.0, "{}: {error:e}", free[k].name());
    }
    let ours = objective.gradient(&point);
    let theirs = -jacobian.tr_mul(&DVector::from_vec(objective.residual(point.signals())));
    let error = (&ours - &theirs).norm() / theirs.norm();
    assert!(error < 1e-4, "{ours} {theirs}");
}
