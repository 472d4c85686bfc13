//! Numbers in a CSV.

use metasense_schemas::spec::Decimal;

use super::Form;

/// Fields that stand for a missing number.
pub(super) const MISSING: [&str; 8] = ["", "-", "--", "---", "na", "n/a", "null", "none"];

/// Whether a field may be a number, a date or a time, and so is no certain column name.
pub(super) fn may_be_number(field: &str) -> bool {
    let written = |c: char| c.is_ascii_digit() || "+-.,:/' eE_%".contains(c);
    field.contains(|c: char| c.is_ascii_digit()) && field.chars().all(written) || field.parse::<f64>().is_ok()
}

/// A number, and its decimal mark, if any.
pub(super) fn number(field: &str, decimal: Option<Decimal>) -> Option<(f64, Option<Decimal>)> {
    let mark = field.bytes().find_map(|byte| match byte {
        b'.' => Some(Decimal::Point),
        b',' => Some(Decimal::Comma),
        _ => None,
    });
    let value = match mark {
        Some(mark) if decimal.is_some_and(|decimal| decimal != mark) => return None,
        Some(Decimal::Comma) => field.replacen(',', ".", 1).parse(),
        _ => field.parse(),
    };
    Some((value.ok()?, mark))
}

/// Decimal marks found in a table.
#[derive(Debug, Default)]
pub(super) struct Marks {
    /// Per mark, the first number that contains it and its line.
    seen: [Option<(usize, String)>; 2],
    /// Per mark, whether some number rules out a thousands separator.
    certain: [bool; 2],
}

impl Marks {
    pub fn see(&mut self, mark: Option<Decimal>, field: &str, line: usize) {
        let Some(mark) = mark.map(|mark| mark as usize) else { return };
        if self.seen[mark].is_none() {
            self.seen[mark] = Some((line, field.to_owned()));
        }
        self.certain[mark] = self.certain[mark] || !may_be_thousands(field);
    }

    /// Rejects a table with both marks, or with a mark that may separate thousands.
    pub fn check(&self, separator: u8, form: &Form) -> Result<(), String> {
        if form.decimal.is_some() {
            return Ok(());
        }
        if let [Some((line, number)), Some((other, comma))] = &self.seen {
            let settle = form.settle("decimal");
            return Err(format!(
                "line {line}: {number:?} has a decimal point, but {comma:?} in line {other} has a comma: {settle}"
            ));
        }
        // Where commas separate the fields, a point is a decimal mark.
        let known = separator == b',' && self.seen[1].is_none();
        let doubtful =
            self.seen.iter().zip(self.certain).find_map(|(seen, certain)| seen.as_ref().filter(|_| !certain));
        if let Some((line, number)) = doubtful.filter(|_| !known) {
            return Err(format!(
                "line {line}: {number:?} is ambiguous: the mark may be a decimal mark or separate thousands: {}",
                form.settle("decimal = \".\" or \",\"")
            ));
        }
        Ok(())
    }
}

/// Whether the mark in a number may separate thousands.
fn may_be_thousands(field: &str) -> bool {
    let field = field.trim_start_matches(['+', '-']);
    let digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    field.split_once(['.', ',']).is_some_and(|(whole, part)| {
        (1..=3).contains(&whole.len())
            && !whole.starts_with('0')
            && part.len() == 3
            && digits(whole)
            && digits(part)
    })
}
