//! One renderer for everything that is looked at: numbers, tables and their writers. It knows nobody else here.

mod number;
mod parquet;
mod table;
mod write;

pub use number::{digits, number};
pub use table::Table;
pub(crate) use table::row;
pub use write::{Format, RowWriter, print_rows, standard_output};
