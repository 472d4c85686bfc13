use super::*;
use crate::body::Layout;
use crate::dynamics::{Accuracy, Frame, Method, Panel, Parts, Stiffness, Tangent};

fn scene() -> Scene {
    let layout = Layout::planar(3, 2, 15.0, 2.25);
    Scene {
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
    }
}

/// Each column against dual numbers with the same steps, and Jᵀr against the adjoint.
#[test]
fn tangents_are_those_of_dual_numbers_and_of_the_adjoint() {
    let scene = scene();
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
    let mut objective = Objective::new(&scene, &design, &forces, &signals, solver, (free, 0.0), &pool);
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

/// With clocks that may be off, of which the best offset is taken at each point, F has the gradient of the adjoint by central
/// differences; and the curvature without the offsets is that of F in them and the parameters, what they take up eliminated.
#[test]
fn gradient_and_curvature_hold_where_clocks_are_off() {
    let scene = scene();
    let design = scene.layout.initial_design(0.4363);
    let push = |n: usize| 0.3 * (0.5 * (n % 21) as f64).sin().powi(2) * f64::from(u8::from(n % 21 < 7));
    let values = (0..42).map(push).collect();
    let forces = Forces { samples: 2, panels: 1, instants: 20, values, strikes: Vec::new() };
    let pool = crate::Pool::new(1).expect("a pool");
    let solver = Solver::new(Method::Nystrom6, Accuracy(1e-6));
    let free = &Parameter::ALL[..5];
    let at = Parameters::of(&scene).array();
    let of = |signals: &[f64], then: &mut dyn FnMut(&mut Objective<'_>)| {
        let mut objective = Objective::new(&scene, &design, &forces, signals, solver, (free, 1e-3), &pool);
        objective.tune(&at, &solver);
        then(&mut objective);
    };
    // of a body that is 5 % stiffer, and 0.8 ms and −0.5 ms late
    let mut signals = Vec::new();
    of(&vec![0.0; 120], &mut |objective| {
        let stiffer = objective.moved(&at, &DVector::from_element(5, 0.05));
        let point = objective.at(&stiffer).expect("simulates");
        let clock = objective.clock.expect("a clock");
        let each = point.simulation.signals.chunks_exact(60 * clock.finer).zip([0.8e-3, -0.5e-3]);
        signals = each.flat_map(|(own, late)| clock.read(own, 3, late, 0)).collect();
    });
    of(&signals, &mut |objective| {
        let point = objective.at(&at).expect("simulates");
        objective.weigh(&point);
        let point = objective.again(point);
        assert!(point.offsets.iter().all(|offset| offset.abs() > 1e-5), "{:?}", point.offsets);
        let (gradient, jacobian) = (objective.gradient(&point), objective.jacobian(&point));
        let by_columns = -jacobian.tr_mul(&DVector::from_vec(objective.residual_before(&point)));
        for k in 0..5 {
            let mut cost = |by: f64| {
                let step = DVector::from_fn(5, |i, _| if i == k { by } else { 0.0 });
                let there = objective.moved(&at, &step);
                objective.at(&there).expect("simulates").cost(objective)
            };
            let difference = (cost(1e-4) - cost(-1e-4)) / 2e-4;
            let scale = gradient.amax();
            assert!((difference - gradient[k]).abs() < 1e-3 * scale, "{k}: {difference} {gradient}");
            assert!((by_columns[k] - gradient[k]).abs() < 1e-3 * scale, "{k}: {by_columns} {gradient}");
        }
    });
}
