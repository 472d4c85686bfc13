//! Decoders: a 1D CNN from signals to forces, its training and second derivatives, in f32 and f64, and a linear decoder.
//!
//! ```text
//! let data = Data::new(shape, &x, &y);                     x (N, T, 3M), y (N, T, K), normalised
//! train(&mut weights, &mut adam, data.all(), &cosine(1e-2, 1000), 1000, &mut losses, &mut ws, &pool)
//! let curvature = Curvature::new(&weights, data.all(), …)   then .product(…), .mixed_product(…), solve_implicit(…)
//! ```
//! Weights are flat: b₁ … b_n, w₁ … w_n (`shape`). Results do not depend on the number of threads.

mod curvature;
mod data;
mod kernels;
mod layout;
pub mod linear;
mod metric;
mod network;
mod shape;
mod solve;
mod tiles;
mod train;
mod winograd;

pub use curvature::Curvature;
pub use data::{Batch, Data};
pub use kernels::{Kernels, Real};
pub use metric::prediction_error;
pub use network::{Workspace, full_gradient, input_gradient, loss, loss_gradient, predict};
pub use shape::{Architecture, LAYERS_MAX, Layer, Shape, initial_weights, scale_inputs};
pub use solve::{Solve, SolveOutcome, conjugate_gradient, solve_implicit};
pub use train::{Adam, TrainOutcome, cosine, milestones, train, train_on};
