"""Clocks: numbers of seconds, ticks since an epoch, or time stamps, as seconds that are exact to the nanosecond."""

import datetime
import re
from dataclasses import dataclass
from decimal import Decimal

import numpy as np
from numpy.typing import NDArray

from metasense.records._recording import Column, Recording, number_form

UNITS = {"d": "86400", "h": "3600", "min": "60", "s": "1", "ms": "1e-3", "us": "1e-6", "ns": "1e-9"}
_NAMES = {
    name: unit
    for unit, names in {
        "s": "s sec secs second seconds sek sekunde sekunden 秒",
        "ms": "msec msecs millisec millisecond milliseconds millisekunden 毫秒",
        "us": "μs usec usecs μsec microsec microsecond microseconds mikrosekunden 微秒",
        "ns": "nsec nsecs nanosecond nanoseconds nanosekunden 纳秒",
        "min": "min mins minute minutes minuten 分钟",
        "h": "h hr hrs hour hours stunde stunden 小时",
        "d": "d day days tag tage 天",
    }.items()
    for name in names.split()
}
# What parentheses after a name of a clock may hold that is no unit
_WORDS = {"utc", "gmt", "local", "rel", "relative", "abs", "absolute", "elapsed", "unix", "posix", "epoch"}
_STAMP = re.compile(
    r"(?:(\d{1,4})([-/.年])(\d{1,2})[-/.月](\d{1,4})日?[T ]+)?(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,:](\d{1,9}))?)?"
    r"(?: ?([AaPp])\.?[Mm]\.?)?(?: ?(Z|UTC|[+-]\d{2}:?\d{2}))?$"
)
_DAY = 86400 * 10**9
# Seconds since 1970 (or 1904, LabVIEW's) that count as a date
_EPOCH = (1e9, 5e9)


@dataclass(frozen=True)
class Clock:
    """Instants (s), and the date (ns) at which they are 0 if the clock has one. `kind` is "relative", "date" or "time of day"."""

    seconds: NDArray[np.float64]
    kind: str = "relative"
    zero: int = 0


def is_stamp(text: str) -> bool:
    """Whether a text is a time stamp."""
    return _STAMP.match(text) is not None


def read_clock(of: Recording, column: Column, rows: NDArray[np.intp], unit: str | None, form: str | None) -> Clock:
    """A column as clock, in seconds. RecordsError if it does not ascend or has several meanings."""
    clock = _read(of, column, rows, unit, form)
    steps = np.diff(clock.seconds)
    if (steps <= 0).any():
        n = int(np.flatnonzero(steps <= 0)[0]) + 1
        what = f"{of.place(int(rows[n]))}: {column.name!r} = {column.values[int(rows[n])]!r} is not later than the entry before"
        raise of.fail(f"{what}: pass rate (entries per second) in place of time if the entries are evenly spaced")
    return clock


def _read(of: Recording, column: Column, rows: NDArray[np.intp], unit: str | None, form: str | None) -> Clock:
    if unit is not None and unit not in UNITS:
        raise of.fail(f"time_unit = {unit!r}: must be one of {', '.join(UNITS)}")
    values = column.values
    if not isinstance(values, np.ndarray):
        cells = [values[row] for row in rows]
        is_number = number_form(of.decimal).match
        if form is not None or not is_number(cells[0]):
            return _stamps(of, column, cells, rows, form)
        if abs(float(cells[0].replace(of.decimal, "."))) < 1e8:
            return _numbers(of, column, of.numbers(column, rows), None, unit)
        of.numbers(column, rows)
        exact = [Decimal(cell.replace(of.decimal, ".")) for cell in cells]
        return _numbers(of, column, np.array([float(x - exact[0]) for x in exact]), exact[0], unit)
    values = values[rows]
    if values.dtype.kind == "M":
        ticks = values.astype("datetime64[ns]").astype(np.int64)
        return Clock((ticks - ticks[0]) * 1e-9, "date", int(ticks[0]))
    if abs(float(values[0])) < 1e8:
        return _numbers(of, column, of.numbers(column, rows), None, unit)
    return _numbers(of, column, (values - values[0]).astype(np.float64), Decimal(values[0].item()), unit)


def _numbers(of: Recording, column: Column, values: NDArray[np.float64], first: Decimal | None, unit: str | None) -> Clock:
    """A clock of numbers: as it stands, or relative to a large `first`."""
    stated = _NAMES.get(column.unit.strip().casefold(), column.unit.strip())
    if unit is None and stated and stated not in UNITS and stated.casefold() not in _WORDS:
        what = f"column {column.name!r} states the unit {stated!r}; known are {', '.join(UNITS)}"
        raise of.fail(f"{what}: pass time_unit (--time-unit), one of these, or rate (entries per second) in place of time")
    unit = unit or (stated if stated in UNITS else None)
    if first is None:
        factor = float(UNITS[unit or "s"])
        return Clock(values if factor == 1.0 else values * factor)
    step = float(np.median(np.diff(values))) if len(values) > 1 else 0.0
    if unit is None:
        epochs = [u for u in ("s", "ms", "us", "ns") if _EPOCH[0] <= float(first) * float(UNITS[u]) <= _EPOCH[1]]
        if len(epochs) != 1 or step * float(UNITS[epochs[0]]) > 10.0:
            raise of.fail(f"{column.name!r} = {first}: its unit is not known: pass time_unit (--time-unit s, ms, us or ns)")
        unit = epochs[0]
    seconds, zero = values * float(UNITS[unit]), first * Decimal(UNITS[unit])
    if _EPOCH[0] <= zero <= _EPOCH[1]:
        return Clock(seconds, "date", int(zero * 10**9))
    return Clock(seconds + float(zero))


def _stamps(of: Recording, column: Column, cells: list[str], rows: NDArray[np.intp], form: str | None) -> Clock:
    """A clock of time stamps. A date in another order than year, month, day is read only if it does not matter, or by `form`."""

    def wrong(n: int, what: str) -> Exception:
        return of.fail(f"{of.place(int(rows[n]))}: {column.name!r} = {cells[n]!r} {what}")

    if form is not None:
        ticks = []
        for n, cell in enumerate(cells):
            try:
                read = datetime.datetime.strptime(cell, form)
            except ValueError as error:
                raise wrong(n, f"does not have the form time_format = {form!r}: {error}") from None
            since = read.replace(tzinfo=None) - (read.utcoffset() or datetime.timedelta()) - datetime.datetime(1970, 1, 1)
            ticks.append((since.days * 86400 + since.seconds) * 10**9 + since.microseconds * 1000)
        return Clock((np.array(ticks) - ticks[0]) * 1e-9, "date", ticks[0])
    found = [_STAMP.match(cell) for cell in cells]
    dates = {part.group(1, 3, 4) for part in found if part}
    ticks, turns, kind = [], 0, "date"
    for n, part in enumerate(found):
        if part is None:
            raise wrong(n, 'is no time stamp: pass time_format, such as "%d/%m/%Y %H:%M:%S.%f", or rate')
        first, mark, second, third, hour, minute, second_of, fraction, half, zone = part.groups()
        if int(hour) > 23 or int(minute) > 59 or int(second_of or 0) > 59:
            raise wrong(n, "is no time of day, which ends at 23:59:59: pass rate (entries per second) in place of time")
        hours = int(hour) % 12 + (12 if half in ("p", "P") else 0) if half else int(hour)
        tick = (hours * 3600 + int(minute) * 60 + int(second_of or 0)) * 10**9 + int((fraction or "0").ljust(9, "0"))
        if fraction and len(fraction) < 3 and cells[n][part.start(8) - 1] == ":":
            raise wrong(n, 'has a fraction of unclear meaning after ":": pass time_format')
        if first is None:
            kind = "time of day"
            if ticks and tick + turns < ticks[-1] - _DAY // 2:
                turns += _DAY
            ticks.append(tick + turns)
            continue
        if len(first) == 4:
            year, month, day = int(first), int(second), int(third)
        elif mark == ".":
            year, month, day = int(third), int(second), int(first)
        elif len(dates) == 1:
            kind, year, month, day = "time of day", 1970, 1, 1
        else:
            raise wrong(n, 'may be of day and month in either order: pass time_format, such as "%d/%m/%Y %H:%M:%S.%f"')
        try:
            days = (datetime.date(year, month, day) - datetime.date(1970, 1, 1)).days
        except ValueError as error:
            raise wrong(n, f"is no date ({error}): pass time_format") from None
        if zone and zone not in ("Z", "UTC"):
            sign = -1 if zone[0] == "-" else 1
            tick -= sign * (int(zone[1:3]) * 3600 + int(zone[-2:]) * 60) * 10**9
        ticks.append(days * _DAY + tick)
    return Clock((np.array(ticks) - ticks[0]) * 1e-9, kind, ticks[0])
