//! A grid of cells, coloured from pale to strong.

use maud::{Markup, html};

use super::picture::Picture;
use super::plot::label;
use super::style::level;

/// A cell.
#[derive(Debug, Clone, Default)]
pub struct Cell {
    /// Text; an empty cell is not drawn.
    pub text: String,
    /// Colour strength, 0 to 1.
    pub part: f64,
    /// Tooltip.
    pub title: String,
    /// Link address.
    pub to: Option<String>,
}

/// Width and height of a cell (px); room for row and column names.
const CELL: [f64; 2] = [56.0, 26.0];
const ROOM: [f64; 2] = [64.0, 40.0];
/// Least width (px): pages scale pictures to equal widths, and few columns would have large letters.
const WIDTH_MIN: f64 = 400.0;

/// A grid with row names on the left and column names at the bottom.
pub fn grid(title: &str, across: (&str, &[String]), down: (&str, &[String]), cells: &[Vec<Cell>]) -> Picture {
    let (columns, rows) = (across.1, down.1);
    let letters = rows.iter().map(|name| name.chars().count()).max().unwrap_or(0);
    let room = ROOM[0].max(26.0 + 6.2 * letters as f64);
    let at = |i: usize, j: usize| [room + i as f64 * CELL[0], j as f64 * CELL[1]];
    let cell = |i: usize, j: usize, cell: &Cell| -> Markup {
        let [x, y] = at(i, j);
        // `level` takes the square root
        let inside = html! {
            rect class=(format!("cell {}", level(cell.part * cell.part))) x=(x) y=(y) width=(CELL[0]) height=(CELL[1]) {
                title { (cell.title) }
            }
            // readable on pale and on strong cells
            (label(if cell.part > 0.65 { "inside strong" } else { "inside" }, [x + 0.5 * CELL[0], y + 17.0], "middle", &cell.text))
        };
        match &cell.to {
            Some(to) => html! { a href=(to) aria-label=(cell.title) { (inside) } },
            None => inside,
        }
    };
    let [right, floor] = at(columns.len(), rows.len());
    // leaves room for the axis name even with few rows
    let middle = 0.5 * floor.max(7.0 * down.0.chars().count() as f64);
    let marks = html! {
        @for (j, row) in cells.iter().enumerate() {
            (label("tick", [room - 5.0, at(0, j)[1] + 17.0], "end", &rows[j]))
            @for (i, one) in row.iter().enumerate().filter(|(_, one)| !one.text.is_empty()) { (cell(i, j, one)) }
        }
        @for (i, name) in columns.iter().enumerate() {
            (label("tick", [at(i, 0)[0] + 0.5 * CELL[0], floor + 14.0], "middle", name))
        }
        (label("label", [0.5 * (room + right), floor + 32.0], "middle", across.0))
        g transform=(format!("rotate(-90 11 {middle:.1})")) { (label("label", [11.0, middle], "middle", down.0)) }
    };
    Picture {
        title: title.into(),
        class: "grid-of-cells",
        view: [0.0, 0.0, (right + 4.0).max(WIDTH_MIN), (2.0 * middle).max(floor + ROOM[1])],
        marks,
    }
}
