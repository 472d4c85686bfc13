//! The worker process: receives jobs, sends records and heartbeats, stops on request.

pub mod arrays;
pub mod clock;
pub mod convert;
pub mod design;
pub mod external;
pub mod files;
pub mod invalid;
pub mod limits;
pub mod memory;
pub mod pace;
pub mod polygons;
pub mod problem;
pub mod process;
pub mod records;
pub mod reference;
pub mod run;
pub mod simd;

pub use metasense_numerics::brain::milestones;
pub use metasense_numerics::nested::{RECORDS, RUNGS, evaluated_fraction, evaluation_step_near};
pub use metasense_numerics::student::{chance_above, student, student_above};
pub use metasense_numerics::trial::FAILED;
