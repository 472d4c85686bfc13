"""A recording: the columns of a file as they stand in it, and how one is chosen and read."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_UNIT = re.compile(r"^(.*?)\s*[(\[（]\s*([^()\[\]（）]+?)\s*[)\]）]\s*$")
_MISSING = {"", "nan", "null", "none", "na", "n/a", "-", "#n/a"}


class RecordsError(ValueError):
    """A file that cannot be converted. The message names file, place and value, and the option that would read it."""


def number_form(decimal: str) -> re.Pattern[str]:
    """The form of a number with this decimal mark."""
    mark = re.escape(decimal)
    return re.compile(rf"[+-]?(\d+{mark}?\d*|{mark}\d+)([eE][+-]?\d+)?$")


def grouped_form(decimal: str) -> re.Pattern[str]:
    """The form of a number with the other mark between groups of three digits, and this decimal mark after them."""
    other = "," if decimal == "." else r"\."
    return re.compile(rf"[+-]?\d{{1,3}}({other}\d{{3}})+{re.escape(decimal)}\d*$")


def split_unit(name: str) -> tuple[str, str]:
    """Name and unit of `Force (N)` or `Force [N]`; the unit is empty where none is stated."""
    parts = _UNIT.match(name)
    return (parts[1], parts[2]) if parts and parts[1] else (name, "")


@dataclass(frozen=True)
class Column:
    """A column of a recording: texts of a table, or numbers."""

    name: str
    values: Sequence[str] | NDArray[Any]
    unit: str = ""
    clock: NDArray[Any] | None = None
    """Clock of its own (s), if the file has one per column."""


@dataclass
class Recording:
    """Columns of one file, or of one group of a file."""

    file: Path
    columns: list[Column]
    lines: list[int] = field(default_factory=list)
    """The line of each row of a text file."""
    decimal: str = "."
    is_decimal_given: bool = True

    @property
    def names(self) -> list[str]:
        """Names of the columns."""
        return [column.name for column in self.columns]

    def fail(self, what: str) -> RecordsError:
        """An error that names the file."""
        return RecordsError(f"{self.file}: {what}")

    def column(self, key: str | int) -> Column:
        """The column of a number from 0, or of a name: exact, or without its unit and in any case. RecordsError if there is not one."""
        if isinstance(key, int):
            if not 0 <= key < len(self.columns):
                raise self.fail(f"column {key}: must be between 0 and {len(self.columns) - 1}")
            return self.columns[key]

        def bare(name: str) -> str:
            return split_unit(name)[0].strip().casefold()

        equal = [column for column in self.columns if column.name == key]
        near = [column for column in self.columns if key.strip().casefold() in (bare(column.name), column.name.strip().casefold())]
        found = equal or near
        if len(found) > 1:
            raise self.fail(f"has {len(found)} columns {key!r}: choose one by its number, from 0")
        if not found:
            shown = ", ".join(f"{i} {name!r}" for i, name in enumerate(self.names[:40]))
            raise self.fail(f"has no column {key!r}; choose by number or name from: {shown}")
        return found[0]

    def place(self, row: int) -> str:
        """Where a row stands."""
        return f"line {self.lines[row]}" if self.lines else f"entry {row}"

    def is_empty(self, column: Column) -> NDArray[np.bool_]:
        """The rows in which a column has no value."""
        if isinstance(column.values, np.ndarray):
            floats = column.values.dtype.kind == "f"
            return (
                np.isnan(column.values)
                if floats
                else np.isnat(column.values)
                if column.values.dtype.kind in "mM"
                else np.zeros(len(column.values), bool)
            )
        return np.array([cell.casefold() in _MISSING for cell in column.values], dtype=bool)

    def rows(self, columns: Iterable[Column], empty: str) -> NDArray[np.intp]:
        """The rows in which all of these columns have values. RecordsError at the first empty cell, unless `empty` is "skip"."""
        columns = list(columns)
        lengths = {len(column.values) for column in columns}
        if len(lengths) > 1:
            raise self.fail(f"columns {[c.name for c in columns]} have {sorted(lengths)} entries: they need clocks of their own")
        missing = np.zeros(lengths.pop(), dtype=bool)
        for column in columns:
            gaps = self.is_empty(column)
            if gaps.any() and empty != "skip":
                row = int(np.flatnonzero(gaps)[0])
                what = f"{self.place(row)}: {column.name!r} is empty ({int(gaps.sum())} of {len(gaps)} rows)"
                raise self.fail(f'{what}: pass empty="skip" (--empty skip) to leave such rows out')
            missing |= gaps
        found = np.flatnonzero(~missing)
        if len(found) < 2:
            names = [column.name for column in columns]
            raise self.fail(f"columns {names} have values together in {len(found)} of {len(missing)} rows: must be 2 or more")
        return found

    def numbers(self, column: Column, rows: NDArray[np.intp]) -> NDArray[np.float64]:
        """Values of a column in these rows."""
        if isinstance(column.values, np.ndarray):
            if column.values.dtype.kind not in "fiub":
                raise self.fail(f"{column.name!r} contains {column.values.dtype}, not numbers: choose another column")
            values = column.values[rows]
            read = values.astype(np.float64)
            if values.dtype.kind in "iu" and (read.astype(values.dtype) != values).any():
                raise self.fail(f"{column.name!r} contains integers beyond 2^53, which no float holds exactly")
        else:
            form, other = number_form(self.decimal), "," if self.decimal == "." else "."
            grouped = grouped_form(self.decimal)
            cells = [column.values[row] for row in rows]
            for i, cell in enumerate(cells):
                if form.match(cell):
                    continue
                if not grouped.match(cell):
                    what = f"{self.place(int(rows[i]))}: {column.name!r} = {cell!r} is not a number"
                    remedy = (
                        f'pass decimal="{other}"'
                        if number_form(other).match(cell)
                        else "choose another column, or pass skip or table"
                    )
                    raise self.fail(f"{what}: {remedy}")
                cells[i] = cell.replace(other, "")
            thousands = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}$")
            marked = [cell for cell in cells if "," in cell]
            if marked and not self.is_decimal_given and all(thousands.match(cell) for cell in marked):
                raise self.fail(f'{column.name!r} = {marked[0]!r} may have a decimal comma or thousands: pass decimal="," or "."')
            read = np.array([float(cell.replace(self.decimal, ".")) for cell in cells], dtype=np.float64)
        if not np.isfinite(read).all():
            row = int(np.flatnonzero(~np.isfinite(read))[0])
            raise self.fail(f"{self.place(int(rows[row]))}: {column.name!r} = {read[row]}: must be a finite number")
        return read
