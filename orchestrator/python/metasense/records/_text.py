"""Tables of text, as instruments and spreadsheets write them: preamble, delimiter, decimal mark and encoding are found or given."""

import csv
import re
from dataclasses import dataclass
from pathlib import Path

from metasense.records._clock import is_stamp
from metasense.records._recording import Column, Recording, RecordsError, grouped_form, number_form, split_unit

_DELIMITERS = {"\t": "tab", ";": ";", ",": ",", "|": "|", " ": "space"}
_LEAST = 3
# Lines that tell the delimiter and the decimal mark
_SAMPLE = 5000


@dataclass(frozen=True)
class Form:
    """How a table is written; None: as found."""

    delimiter: str | None = None
    decimal: str | None = None
    encoding: str | None = None
    skip: int | None = None
    comment: str | None = None
    table: int | None = None


@dataclass
class _Table:
    delimiter: str
    decimal: str
    rows: list[tuple[int, list[str]]]
    others: list[int]
    """First lines of the file's tables."""

    @property
    def width(self) -> int:
        return len(self.rows[0][1])

    @property
    def is_paired(self) -> bool:
        """Whether each number takes two fields, since commas separate fields and are decimal marks, without quotes."""
        return self.delimiter == self.decimal and not any(self.decimal in cell for _, row in self.rows for cell in row)

    def drop_last_if_empty(self) -> None:
        """Takes off what a delimiter at the end of all rows makes."""
        if self.width > 1 and not any(row[-1] for _, row in self.rows):
            self.rows = [(n, row[:-1]) for n, row in self.rows]

    def rank(self) -> tuple[float, int, float]:
        """Of rows, part of fields that are numbers, and whether there are several columns."""
        sample = self.rows[:200]
        read = sum(_is_value(cell, self.decimal) for _, row in sample for cell in row)
        filled = sum(cell != "" for _, row in sample for cell in row)
        return round(read / max(filled, 1), 6), len(self.rows), read / len(sample)


def decoded(file: Path, data: bytes, encoding: str | None) -> str:
    """The text of a file: UTF-8 or UTF-16, or the encoding that is given."""
    if encoding is None:
        if data.startswith((b"\xff\xfe", b"\xfe\xff")):
            encoding = "utf-16"
        elif data[:4096].count(0) * 3 > len(data[:4096]):
            encoding = "utf-16-be" if data[0] == 0 else "utf-16-le"
        elif b"\0" in data:
            raise RecordsError(f"{file}: is neither text nor MATLAB, HDF5, TDMS, UFF or NPZ: export it as CSV or as one of these")
        else:
            encoding = "utf-8-sig"
    try:
        return data.decode(encoding).removeprefix("\ufeff")
    except LookupError:
        raise RecordsError(f"{file}: encoding = {encoding!r} is not known; such as utf-8, utf-16, cp1252, gb18030") from None
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        what = f"{file}: line {line}: byte 0x{data[error.start]:02x} is not {encoding.removesuffix('-sig').upper()}"
        raise RecordsError(f"{what}: pass encoding (--encoding cp1252 for Western, gb18030 for Chinese text)") from None


def read_text(file: Path, data: bytes, form: Form) -> Recording:
    """The table of a text file."""
    for name, value in [("delimiter", form.delimiter), ("decimal", form.decimal)]:
        allowed = list(_DELIMITERS) if name == "delimiter" else [".", ","]
        if value is not None and value not in allowed:
            raise RecordsError(f"{name} = {value!r}: must be one of {allowed}")
    lines = decoded(file, data, form.encoding).replace("\u2212", "-").splitlines()
    hint = re.match(r"sep=(.)$", lines[0].strip()) if lines else None
    delimiter = form.delimiter or (hint[1] if hint and hint[1] in _DELIMITERS else None)
    comments = (form.comment,) if form.comment else ("#", "%", "//")
    numbered = [(n + 1, line) for n, line in enumerate(lines) if n >= (form.skip or 0) and line.strip()]
    numbered = numbered[1:] if hint and not form.skip else numbered
    bodies = [(n, line) for n, line in numbered if not line.lstrip().startswith(comments)]
    if not bodies:
        what = "contains no lines but comments" if numbered else "contains no lines after skip" if form.skip else "is empty"
        raise RecordsError(f"{file}: {what}: pass a file with a table, or other values of skip and comment")
    found = []
    sample = bodies[:_SAMPLE]
    for of in [delimiter] if delimiter else [d for d in _DELIMITERS if any(d in line for _, line in sample[:500])] or ["\t"]:
        for decimal in [form.decimal] if form.decimal else [".", ","]:
            if (of != decimal or form.decimal or '"' in bodies[-1][1]) and (table := _table(sample, of, decimal, None)):
                found.append(table)
    longest = max((len(table.rows) for table in found), default=0)
    found = [table for table in found if 2 * len(table.rows) >= longest]
    several = [table for table in found if table.width > 1] or found
    chosen = max(several, key=_Table.rank, default=None)
    best = chosen and _table(bodies, chosen.delimiter, chosen.decimal, form.table)
    if chosen is None or best is None:
        raise RecordsError(
            f"{file}: contains no table of at least {_LEAST} lines with the same number of fields: pass delimiter, decimal, skip or comment"
        )
    _check(file, best, chosen, several, numbered, form)
    above = _above(numbered, best)
    if not above or len(_fields(above[0], best.delimiter)) != best.width:
        best.drop_last_if_empty()
    names, units = _names(numbered, best, comments)
    if best.is_paired:
        if not names or 2 * len(names) != best.width:
            raise RecordsError(
                f"{file}: decimal commas between commas are read only if each number has one: export it with semicolons"
            )
        best.rows = [(n, [f"{a},{b}" for a, b in zip(row[::2], row[1::2], strict=True)]) for n, row in best.rows]
    elif not names and _pairs(numbered, best):
        what = f"{file}: line {best.rows[0][0]}: has twice as many fields as the line of names: decimal commas between commas?"
        raise RecordsError(f'{what} Pass delimiter="," and decimal="," to read them so, or skip to drop the names')
    first = best.rows[0][1]
    if not names and form.skip is None and first in ([str(i) for i in range(best.width)], [str(i + 1) for i in range(best.width)]):
        raise RecordsError(f"{file}: line {best.rows[0][0]}: {first} may be names or values: pass skip, 0 if they are values")
    names = names or [str(i) for i in range(best.width)]
    units = units or [split_unit(name)[1] for name in names]
    cells = zip(*(row for _, row in best.rows), strict=True)
    columns = [Column(name, values, unit) for name, unit, values in zip(names, units, cells, strict=True)]
    return Recording(file, columns, [n for n, _ in best.rows], best.decimal, form.decimal is not None)


def _check(file: Path, best: _Table, chosen: _Table, several: list[_Table], numbered: list[tuple[int, str]], form: Form) -> None:
    """Refuses a second table, and a second way to divide the lines that is as good."""
    if form.table is None and len(best.others) > 1:
        at = ", ".join(map(str, best.others))
        raise RecordsError(
            f"{file}: contains {len(best.others)} tables, from lines {at}: pass table (--table 1 … {len(best.others)})"
        )
    for other in several:
        as_good = other.rank()[0] >= chosen.rank()[0] and len(other.rows) == len(chosen.rows)
        rows, own = ([[cell for cell in row if cell] for _, row in table.rows[:50]] for table in (other, chosen))
        if as_good and other.delimiter != chosen.delimiter and rows != own:
            choices = " or ".join(sorted({_DELIMITERS[t.delimiter] for t in (chosen, other)}))
            raise RecordsError(f"{file}: line {best.rows[0][0]}: can be divided in several ways: pass delimiter ({choices})")
    if best.width == 2 and best.delimiter == "," and form.delimiter is None and form.decimal is None:
        above = [line for n, line in numbered if n < best.rows[0][0]]
        if (not above or "," not in above[-1]) and all(cell.lstrip("+-").isdigit() for _, row in best.rows for cell in row):
            raise RecordsError(
                f'{file}: line {best.rows[0][0]}: may be one number with a decimal comma or two: pass decimal="," or delimiter=","'
            )


def _fields(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    cells = next(csv.reader([line], delimiter=delimiter)) if '"' in line else line.split(delimiter)
    return [cell.strip() for cell in cells]


def _is_value(cell: str, decimal: str) -> bool:
    return bool(number_form(decimal).match(cell) or grouped_form(decimal).match(cell)) or is_stamp(cell)


def _table(lines: list[tuple[int, str]], delimiter: str, decimal: str, wanted: int | None) -> _Table | None:
    """The longest run of lines with the same number of fields, of which some are numbers; or the run of this number."""
    is_number = number_form(decimal).match
    runs: list[list[tuple[int, list[str]]]] = []
    width = -1
    for n, line in lines:
        row = _fields(line, delimiter)
        if not any(is_number(cell) or is_stamp(cell) for cell in row):
            width = -1
            continue
        if len(row) != width:
            runs.append([])
            width = len(row)
        runs[-1].append((n, row))
    if not any(len(run) >= _LEAST for run in runs):
        return None
    longest = max(runs, key=len)

    def kinds(run: list[tuple[int, list[str]]]) -> list[bool]:
        return [_is_value(cell, decimal) for cell in run[0][1]]

    alike = [run for run in runs if kinds(run) == kinds(longest)]
    if wanted is not None:
        if not 1 <= wanted <= len(alike):
            return None
        longest = alike[wanted - 1]
    return _Table(delimiter, decimal, longest, [run[0][0] for run in alike])


def _above(numbered: list[tuple[int, str]], table: _Table) -> list[str]:
    """Lines before the table, the nearest first."""
    return [line for n, line in reversed(numbered) if n < table.rows[0][0]]


def _names(numbered: list[tuple[int, str]], table: _Table, comments: tuple[str, ...]) -> tuple[list[str], list[str]]:
    """Names and units of the columns, from one line above the first row or two adjacent ones; empty where there are none."""
    rows = []
    width = table.width // 2 if table.is_paired else table.width
    above = [(n, line) for n, line in reversed(numbered) if n < table.rows[0][0]][:2]
    for _, line in above[: 1 if len(above) > 1 and above[0][0] - above[1][0] > 1 else 2]:
        for comment in comments:
            line = line.lstrip().removeprefix(comment)
        row = _fields(line, table.delimiter)
        form = number_form(table.decimal)
        if len(row) == width + 1 and row[-1] in ("", "Comment"):  # LabVIEW names comments that rows leave out
            row.pop()
        if len(row) != width or any(form.match(cell) for cell in row) or not any(row):
            break
        rows.append(row)
    if not rows:
        return [], []
    if len(rows) == 1:
        return rows[0], []
    bare = [cell.strip("()[] ") for cell in rows[0]]
    if all(len(cell) <= 8 for cell in bare) and len(set(rows[1])) == len(rows[1]):
        return rows[1], bare
    return rows[0], []


def _pairs(numbered: list[tuple[int, str]], table: _Table) -> bool:
    """Whether the line above has half as many fields, separated by commas as the rows are."""
    above = _above(numbered, table)
    return table.delimiter == "," and bool(above) and "," in above[0] and 2 * len(_fields(above[0], ",")) == table.width
