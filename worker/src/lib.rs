//! The worker process: receives jobs, sends records and heartbeats, stops on request.

pub mod arrays;
pub mod bound;
pub mod casts;
pub mod check;
pub mod clock;
pub mod convert;
pub mod demands;
pub mod design;
pub mod evaluate;
pub mod external;
pub mod files;
pub mod identify;
mod invalid;
pub mod inverse;
pub mod limits;
pub mod measured;
pub mod modes;
pub mod operator;
pub mod pace;
pub mod place;
pub mod polygons;
pub mod problem;
pub mod process;
pub mod records;
pub mod reference;
pub mod replay;
pub mod run;
pub mod simd;
pub mod simulate;
pub mod tasks;
pub mod twin;
pub mod verify;

pub use metasense_numerics::brain::milestones;
pub use metasense_numerics::nested::{RECORDS, RUNGS, evaluated_fraction, evaluation_step_near};
pub use metasense_numerics::student::{chance_above, student, student_above};
pub use metasense_numerics::trial::FAILED;
