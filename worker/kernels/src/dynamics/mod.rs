//! Motion of the body under forces, signals of its sensors, and gradients of functions of the signals.
//!
//! ```text
//! M s̈ = −∂U/∂s − C ṡ + f(t),   s = (u, v, θ) of each unit; clamped units fixed; at rest at t = 0
//! ```
//! Vectors integrate several samples at once, one per lane. The result of a sample does not depend on other samples or on the
//! number of threads. Gradients are those of the discrete method.

mod balance;
mod choose;
mod dispatch;
mod energy;
mod equilibrium;
mod forces;
mod integrate;
mod jobs;
mod jvp;
mod ligaments;
mod loads;
mod model;
mod readings;
mod relaxing;
mod rest;
mod scene;
mod schemes;
mod simulation;
mod solver;
mod splitting;
mod stiffness;
mod system;
mod trigonometry;
mod tsit5;
mod tune;

pub use choose::{choose, highest_frequency};
pub use dispatch::repeat_kernel;
pub use energy::{Energy, energy, energy_gradients};
pub use equilibrium::{start, touches};
pub use forces::{Forces, Strike};
pub use integrate::{planned, run, simulate};
pub use jvp::Tangent;
pub use model::{damping, unwrapped_void};
pub use rest::Rest;
pub use scene::{
    AccelerationFrame, AddedMass, EdgeContact, LigamentStiffness, MaxwellBranch, Mount, Panel, Parameters,
    PartFactors, PrescribedMotion, Scene,
};
pub use simulation::{Gradient, Outcome, Simulation, SimulationCounts, Tape, Wrt};
pub use solver::{Accuracy, IntegrationPlan, Integrator, IntegratorSettings, Precision, Steps, Tolerance};
pub use stiffness::sparse;
pub use tune::{Tuned, keeps_error, signal_error, tune};
