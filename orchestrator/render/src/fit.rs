//! Rows as readable text, never truncated: a grid. For narrower screens: with wrapped names and texts; then with values common to
//! all rows in front; then as a list. Numbers are never broken.

use std::io::{self, IsTerminal};

use unicode_width::UnicodeWidthStr;

use super::table::{Table, rounded};
use crate::cell;

/// Columns of a terminal of unknown size.
const USUAL: usize = 80;
/// Texts in a grid wrap to at least this width. Words up to `WORD` letters stay whole; in lists, words up to a line.
const TEXT: usize = 12;
const WORD: usize = 40;

/// Width of standard output in columns: COLUMNS, or the terminal's width. `None` if it is no terminal.
pub fn screen() -> Option<usize> {
    let asked = std::env::var("COLUMNS").ok().and_then(|columns| columns.trim().parse().ok());
    asked.filter(|columns| *columns > 0).or_else(|| io::stdout().is_terminal().then(terminal_columns))
}

fn terminal_columns() -> usize {
    let mut size = libc::winsize { ws_row: 0, ws_col: 0, ws_xpixel: 0, ws_ypixel: 0 };
    // SAFETY: the call writes a `winsize`, or nothing.
    let known = unsafe { libc::ioctl(libc::STDOUT_FILENO, libc::TIOCGWINSZ, &raw mut size) } == 0;
    if known && size.ws_col > 0 { size.ws_col.into() } else { USUAL }
}

/// A table for a screen of this width; `None`: one line per row.
pub fn text(table: &Table, screen: Option<usize>) -> String {
    let numeric = |i: usize| table.rows.iter().all(|row| row[i].is_null() || cell::number(&row[i]).is_some());
    let of = |i: usize| Column {
        name: clean(&table.columns[i]).replace('\n', " "),
        cells: table.rows.iter().map(|row| clean(&rounded(&row[i]))).collect(),
        numeric: numeric(i),
    };
    let columns: Vec<Column> = (0..table.columns.len()).map(of).collect();
    let whole: Vec<usize> = columns.iter().map(|c| width(&c.name).max(c.width())).collect();
    let Some(screen) = screen.filter(|screen| *screen < BARS.total(&whole)) else {
        return grid(&columns, &whole, &BARS);
    };
    if let Some(widths) = narrowed(&columns, screen) {
        return grid(&columns, &widths, &BLANKS);
    }
    let alike = |c: &Column| table.rows.len() > 1 && c.cells.iter().all(|cell| *cell == c.cells[0]);
    let (shared, own): (Vec<Column>, Vec<Column>) = columns.into_iter().partition(alike);
    let value =
        |c: &Column| if c.cells[0].is_empty() { "–".to_owned() } else { c.cells[0].replace('\n', " ") };
    let shared: Vec<String> = shared.iter().map(|c| format!("{} = {}", c.name, value(c))).collect();
    let mut blocks = match shared.is_empty() {
        true => Vec::new(),
        false => wrapped(&format!("in all rows: {}", shared.join("; ")), screen),
    };
    blocks.push(match narrowed(&own, screen) {
        Some(widths) => grid(&own, &widths, &BLANKS),
        None if blocks.is_empty() => list(&own, table.rows.len(), screen),
        None => format!("\n{}", list(&own, table.rows.len(), screen)),
    });
    blocks.join("\n")
}

/// Text before, between and after the columns of a grid, in rows and in the line below the names.
struct Style {
    cells: [&'static str; 3],
    line: [&'static str; 3],
}

/// Markdown, for pages and programs.
const BARS: Style = Style { cells: ["| ", " | ", " |"], line: ["|-", "-|-", "-|"] };
/// The narrowest style.
const BLANKS: Style = Style { cells: ["", "  ", ""], line: ["", "  ", ""] };

impl Style {
    /// Total width of a grid with columns of these widths.
    fn total(&self, widths: &[usize]) -> usize {
        let [before, between, behind] = self.cells.map(width);
        before + widths.iter().sum::<usize>() + between * widths.len().saturating_sub(1) + behind
    }
}

struct Column {
    name: String,
    cells: Vec<String>,
    numeric: bool,
}

impl Column {
    /// Width of the widest line.
    fn width(&self) -> usize {
        self.cells.iter().flat_map(|cell| cell.lines()).map(width).max().unwrap_or(0)
    }

    /// Least width that breaks no number, short word or part of the name.
    fn least(&self) -> usize {
        let words = || self.cells.iter().flat_map(|cell| cell.split_whitespace()).map(width);
        let cells = match self.numeric {
            true => self.width(),
            false => words().max().unwrap_or(0).min(WORD).max(TEXT.min(self.width())),
        };
        parts(&self.name).map(width).max().unwrap_or(0).max(cells)
    }
}

fn width(text: &str) -> usize {
    text.width()
}

/// The text with control characters escaped.
fn clean(text: &str) -> String {
    let shown = |c: char| match c {
        '\n' => "\n".into(),
        '\t' | '\r' => " ".into(),
        c if c.is_control() => c.escape_default().to_string(),
        c => c.to_string(),
    };
    text.chars().map(shown).collect()
}

/// The parts of a name, each with its separator.
fn parts(name: &str) -> impl Iterator<Item = &str> {
    name.split_inclusive(['_', '.', ' '])
}

/// Parts of a text in lines of at most this width, where they allow.
fn packed<'a>(parts: impl Iterator<Item = &'a str>, most: usize) -> Vec<String> {
    let mut found = vec![String::new()];
    for part in parts {
        let line = found.last_mut().expect("there is one");
        match line.is_empty() || width(line) + width(part) <= most {
            true => line.push_str(part),
            false => found.push(part.to_owned()),
        }
    }
    found
}

/// Wraps a text to this width. Longer words break after commas and similar characters, otherwise between letters.
fn wrapped(text: &str, most: usize) -> Vec<String> {
    let letters = |piece| str::split_inclusive(piece, |_: char| true);
    let mut found = Vec::new();
    for line in text.lines() {
        if width(line) <= most {
            found.push(line.to_owned());
            continue;
        }
        let mut current = String::new();
        for word in line.split_whitespace() {
            let mut begins = !current.is_empty();
            let long = width(word) > most;
            let pieces: Vec<&str> =
                if long { word.split_inclusive([',', ';', '/', '&']).collect() } else { vec![word] };
            for piece in pieces.into_iter().flat_map(|piece| packed(letters(piece), most.max(1))) {
                if !current.is_empty() && width(&current) + usize::from(begins) + width(&piece) > most {
                    found.push(std::mem::take(&mut current));
                } else if begins {
                    current.push(' ');
                }
                current += &piece;
                begins = false;
            }
        }
        found.push(current);
    }
    found
}

/// Column widths with which a grid fits, reducing the widest columns first; `None` if it cannot.
fn narrowed(columns: &[Column], screen: usize) -> Option<Vec<usize>> {
    let min_widths: Vec<usize> = columns.iter().map(Column::least).collect();
    let mut widths: Vec<usize> =
        columns.iter().zip(&min_widths).map(|(c, min_width)| c.width().max(*min_width)).collect();
    while BLANKS.total(&widths) > screen {
        let wide = (0..widths.len()).filter(|&i| widths[i] > min_widths[i]).max_by_key(|&i| widths[i])?;
        widths[wide] -= 1;
    }
    // names get the remaining width
    for (i, column) in columns.iter().enumerate() {
        while widths[i] < width(&column.name) && BLANKS.total(&widths) < screen {
            widths[i] += 1;
        }
    }
    Some(widths)
}

fn grid(columns: &[Column], widths: &[usize], style: &Style) -> String {
    let framed = |cells: Vec<String>, [before, between, behind]: [&str; 3]| {
        format!("{before}{}{behind}", cells.join(between)).trim_end().to_owned()
    };
    let row = |cells: Vec<Vec<String>>| {
        let height = cells.iter().map(Vec::len).max().unwrap_or(0).max(1);
        let line = |n: usize| {
            let cell = |(i, lines): (usize, &Vec<String>)| {
                let text = lines.get(n).map_or("", String::as_str);
                let blanks = " ".repeat(widths[i].saturating_sub(width(text)));
                if columns[i].numeric { blanks + text } else { text.to_owned() + &blanks }
            };
            framed(cells.iter().enumerate().map(cell).collect(), style.cells)
        };
        (0..height).map(line).collect::<Vec<_>>().join("\n")
    };
    let mut said = vec![row(columns.iter().zip(widths).map(|(c, w)| packed(parts(&c.name), *w)).collect())];
    said.push(framed(widths.iter().map(|width| "-".repeat(*width)).collect(), style.line));
    for n in 0..columns.first().map_or(0, |column| column.cells.len()) {
        said.push(row(columns.iter().zip(widths).map(|(c, w)| wrapped(&c.cells[n], *w)).collect()));
    }
    said.join("\n")
}

/// A paragraph per row, with values beside the names, or below if there is no room.
fn list(columns: &[Column], rows: usize, screen: usize) -> String {
    let names = columns.iter().map(|column| width(&column.name)).max().unwrap_or(0);
    let of_row = |n: usize| {
        let of = |column: &Column| {
            let (name, cell) = (&column.name, &column.cells[n]);
            let longest = cell.split_whitespace().map(width).max().unwrap_or(0);
            let room = screen.saturating_sub(names + 2);
            if cell.is_empty() {
                return name.clone();
            }
            if longest <= room {
                let blanks = " ".repeat(names + 2);
                let lines = wrapped(cell, room).join(&format!("\n{blanks}"));
                return format!("{name}{}{lines}", " ".repeat(names + 2 - width(name)));
            }
            format!("{name}\n  {}", wrapped(cell, screen.saturating_sub(2)).join("\n  "))
        };
        columns.iter().map(of).collect::<Vec<_>>().join("\n")
    };
    match rows {
        0 => columns.iter().map(|column| column.name.as_str()).collect::<Vec<_>>().join("\n"),
        _ => (0..rows).map(of_row).collect::<Vec<_>>().join("\n\n"),
    }
}

#[cfg(test)]
mod tests;
