//! A trial in the forms of other programs: arrays (npz), tables (csv, parquet), designs (svg, dxf), the mould (stl).

pub mod dxf;
pub mod mould;
pub mod npz;
pub mod outline;
pub mod series;

pub use mould::Mould;
pub use outline::Outline;
