//! Numbers as a CSV has them.

use metasense_schemas::spec::Decimal;

use super::Form;

/// What stands for a number that is missing.
pub(super) const MISSING: [&str; 8] = ["", "-", "--", "---", "na", "n/a", "null", "none"];

/// Whether a field may be a number, a date or a time, in whatever form: it names no column for certain.
pub(super) fn may_be_number(field: &str) -> bool {
    let written = |c: char| c.is_ascii_digit() || "+-.,:/' eE_%".contains(c);
    field.contains(|c: char| c.is_ascii_digit()) && field.chars().all(written) || field.parse::<f64>().is_ok()
}

/// A number and the mark that it was written with, if any.
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

/// The decimal marks that a table has.
#[derive(Debug, Default)]
pub(super) struct Marks {
    /// For each mark a number that has it, with its line.
    seen: [Option<(usize, String)>; 2],
    /// Whether one of them cannot be a whole number with a mark between thousands.
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

    /// Refuses two marks in one table, and one that may stand between thousands.
    pub fn check(&self, separator: u8, form: &Form) -> Result<(), String> {
        if form.decimal.is_some() {
            return Ok(());
        }
        if let [Some((line, number)), Some((other, comma))] = &self.seen {
            let settle = form.settle("decimal");
            return Err(format!(
                "line {line}: {number:?} has a decimal point, line {other}: {comma:?} a comma: {settle}"
            ));
        }
        // beside commas that separate fields a point has always been a decimal mark
        let known = separator == b',' && self.seen[1].is_none();
        let doubtful =
            self.seen.iter().zip(self.certain).find_map(|(seen, certain)| seen.as_ref().filter(|_| !certain));
        if let Some((line, number)) = doubtful.filter(|_| !known) {
            return Err(format!(
                "line {line}: {number:?} may have a decimal mark or a mark between thousands, as all its like: {}",
                form.settle("decimal = \".\" or \",\"")
            ));
        }
        Ok(())
    }
}

/// Whether a number with one mark reads as a whole number with a mark between thousands, too.
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
