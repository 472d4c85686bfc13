//! Long computations report progress by heartbeats.

use metasense_kernels::Pool;
use metasense_kernels::body::Layout;
use metasense_kernels::brain::linear::{FactoredEquations, Lags, Normal, Order, Sizes};
use metasense_kernels::brain::{Adam, Architecture, Data, Shape, Workspace, train};
use metasense_kernels::dynamics::{
    Accuracy, Forces, Integrator, IntegratorSettings, LigamentStiffness, Panel, Scene, Tolerance, Wrt,
    simulate,
};

/// Runs `work` and returns its result and the number of heartbeats.
fn beats<T>(pool: &Pool, work: impl FnOnce() -> T) -> (T, u64) {
    let before = pool.heartbeat().count();
    let found = work();
    (found, pool.heartbeat().count() - before)
}

/// At least one heartbeat per interval of eight samples, forwards and backwards, per iteration, per set of moments and
/// per factorisation.
#[test]
fn simulations_gradients_trainings_and_factors_beat_on_the_way() {
    let (samples, instants) = (20, 30);
    let pool = Pool::new(2).unwrap();
    let layout = Layout::planar(3, 3, 15.0, 2.25);
    let scene = Scene {
        density: 1e-8,
        stiffness: LigamentStiffness { stretch: 3.0, shear: 0.5, bend: 1.0 },
        damping_ratio: 0.02,
        clamped: vec![0, 1, 2],
        panels: vec![Panel::central(7, [0.0, -1.0])],
        sensors: vec![4],
        duration: 0.1,
        instants,
        layout,
        ..Scene::default()
    };
    let design = scene.layout.initial_design(0.4363);
    let push = |n: usize| 0.2 * (0.3 * n as f64).sin();
    let values = (0..samples * (instants + 1)).map(push).collect();
    let forces = Forces { samples, panels: 1, instants, values, strikes: Vec::new() };
    let mut signals = Vec::new();
    for method in [Integrator::Tsit5, Integrator::Nystrom4] {
        let solver = match method {
            Integrator::Tsit5 => IntegratorSettings::tsit5(Tolerance::both(1e-4)),
            method => IntegratorSettings::new(method, Accuracy(1e-4)),
        };
        let (simulation, forwards) =
            beats(&pool, || simulate(&scene, &design, &forces, &solver, true, &pool));
        let cotangent = vec![1.0; simulation.signals.len()];
        let (_, backwards) = beats(&pool, || simulation.vjp(&cotangent, Wrt::Design, &pool));
        let least = (instants * samples.div_ceil(8)) as u64;
        // one sweep of Tsit5 includes several vectors of samples
        assert!(forwards >= least && backwards >= instants as u64, "{method:?}: {forwards}, {backwards}");
        signals = simulation.signals;
    }

    let shape = Shape { instants, inputs: 3, outputs: 1, architecture: Architecture::paper(8) };
    let x: Vec<f32> = signals.iter().map(|x| 1e-4 * *x as f32).collect();
    let y: Vec<f32> = (0..samples * instants).map(|n| push(n) as f32).collect();
    let data = Data::new(shape, &x, &y);
    let (mut weights, mut losses) = (vec![0.1f32; shape.weights()], Vec::new());
    let (mut adam, mut ws) = (Adam::new(weights.len()), Workspace::new(shape, pool.width()));
    let (_, iterations) = beats(&pool, || {
        train(&mut weights, &mut adam, data.all(), &|_| 1e-3, 12, &mut losses, &mut ws, &pool)
    });
    assert!(losses.len() == 12 && iterations >= 12, "{iterations} heartbeats in {} iterations", losses.len());

    let sizes = Sizes { instants, channels: 3, outputs: 1 };
    let y: Vec<f64> = y.iter().map(|y| f64::from(*y)).collect();
    let (lags, weights) = (Lags::whole(instants), vec![1.0; samples]);
    let (normal, summed) =
        beats(&pool, || Normal::new(sizes, [&signals, &y, &weights], lags, lags.groups(), &pool));
    let (fit, factored) = beats(&pool, || FactoredEquations::new(normal, 1e-3, Order::Ascending));
    assert!(fit.is_ok() && summed > 0 && factored > 0, "{summed}, {factored}");
}
