//! Renders numbers, cells, tables and their file formats, plots, bodies, waves and pages.

pub mod body;
pub mod cell;
mod fit;
pub mod grid;
mod number;
mod page;
mod parquet;
mod picture;
mod plot;
mod style;
mod table;
pub mod wave;
mod write;

pub use fit::screen;
pub use number::{digits, duration, number};
pub use page::{
    Answer, Encoded, Figure, MOST_ROWS, answers, contents, document, download, omitted_rows_note, page, prose,
};
pub use picture::{Legend, Picture, file, legend, lines};
pub use plot::{Axis, Plot, Scale};
pub use style::{SERIES, level, page_style};
pub use table::{Table, readable, short_hash};
pub use write::{Format, PictureData, RowWriter, print_rows, standard_output};
