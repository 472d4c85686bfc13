"""Files of instruments as measured records: NPZ and the TOML that `metasense lab identify` and `evaluate` read.

    from metasense import records
    records.convert(["run.csv"], "records.npz", time="t", force="F", signals=["ax", "ay", "wz"], trigger=0.5, length=0.5)

The command does the same: `python -m metasense.records run.csv --out records.npz --time t --force F --signals ax,ay,wz`.
Read are CSV and text of any delimiter, decimal mark and encoding, with preamble; MATLAB v5 and v7.3, HDF5, UFF 58, TDMS (extra
`records`: scipy, h5py, pyuff, npTDMS), NPY and NPZ. What could have two meanings is refused, with the option that settles it.
"""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metasense.records._clock import Clock, read_clock
from metasense.records._formats import read_file
from metasense.records._recording import Column, Recording, RecordsError
from metasense.records._text import Form

__all__ = ["Column", "Record", "Recording", "RecordsError", "blows", "convert", "read", "save"]

Key = str | int
# By name as it stands, else in small letters; mN and kN only as they stand, since MN is not mN
_FORCE = {"n": "N", "newton": "N", "newtons": "N", "mN": "mN", "kN": "kN"}
_ACCELERATION = {"g": "g", "gn": "g"} | {f"{of}/s{two}": f"{of}/s2" for of in ("m", "mm") for two in ("2", "^2", "²")}
_ANGULAR = {"deg/s": "deg/s", "°/s": "deg/s", "º/s": "deg/s", "dps": "deg/s", "rad/s": "rad/s"}


@dataclass
class Record:
    """One record: forces with the signals that sensors gave under them."""

    time: NDArray[np.float64]
    """Clock of the force, (n) (s)."""
    force: NDArray[np.float64]
    """(n), or (K, n) if the file has one force per panel; in the file's unit."""
    signals: NDArray[np.float64] | None = None
    """(m, channels), in the file's units."""
    signal_time: NDArray[np.float64] | None = None
    """Clock of the signals, (m) (s); None: that of the force."""
    panel: int | None = None
    """The panel that is struck, from 0."""
    source: str = ""
    """File and place, for messages."""
    units: dict[str, str] = field(default_factory=dict)
    """Keys of the TOML: `force_unit`, `acceleration_unit`, `angular_velocity_unit`, as far as the file states them."""


def read(
    file: str | PathLike[str],
    *,
    delimiter: str | None = None,
    decimal: str | None = None,
    encoding: str | None = None,
    skip: int | None = None,
    comment: str | None = None,
    table: int | None = None,
) -> list[Recording]:
    """The columns of a file: one `Recording`, or one per group or occurrence of HDF5, TDMS, MATLAB and UFF.

    For text: `delimiter` (`,` `;` tab `|` or a space for any blanks), `decimal` (`.` or `,`), `encoding` (as Python names it), `skip`
    (number of lines to skip), `comment` (first characters of ignored lines) and `table` (number of the table in the file, from 1). Omitted
    options are detected. Raises RecordsError, a ValueError, with file, line and option; ImportError if a package of the extra is missing.
    """
    return read_file(Path(file), Form(delimiter, decimal, encoding, skip, comment, table))


def blows(
    time: NDArray[np.float64],
    force: NDArray[np.float64],
    trigger: float,
    *,
    length: float,
    before: float = 0.01,
    rearm: float | None = None,
) -> list[int]:
    """Entries at which blows begin: where the force deviates from its median by `trigger` (the unit of the force).

    The next blow counts after `length − before` (s), once the force has been below the level for `rearm` (s, default: `before`).
    `force` has shape (n) or (K, n).
    """
    rearm = before if rearm is None else rearm
    for name, value in [("trigger", trigger), ("length", length)]:
        if not value > 0:
            raise RecordsError(f"{name} = {value}: must be above 0")
    if not 0 <= before < length or rearm < 0:
        raise RecordsError(f"before = {before}, rearm = {rearm}: before must be from 0 to length = {length}, rearm 0 or more")
    force = np.atleast_2d(force)
    reached = np.flatnonzero((np.abs(force - np.median(force, axis=1, keepdims=True)) >= trigger).any(axis=0))
    found: list[int] = []
    over, last = -np.inf, -np.inf
    for n in reached:
        if time[n] >= over and time[n] - last > rearm:
            found.append(int(n))
            over = time[n] + length - before
        last = time[n]
    return found


@dataclass(frozen=True)
class _Options:
    force: Sequence[Key]
    signals: Sequence[Key] | None
    time: Key | None
    rate: float | None
    signal_time: Key | None
    signal_rate: float | None
    signal_start: float
    time_unit: str | None
    time_format: str | None
    panel: Key | None
    panel_pattern: str | None
    first_panel: int
    empty: str
    given: frozenset[str]
    """Units that the user states."""


def _clock(
    of: Recording, columns: list[Column], rows: NDArray[np.intp], time: Key | None, rate: float | None, o: _Options
) -> Clock:
    """The clock of these rows: the column `time`, entries per second, or the columns' own."""
    if (time is not None) and (rate is not None):
        raise of.fail("pass either time or rate")
    if time is not None:
        return read_clock(of, of.column(time), rows, o.time_unit, o.time_format)
    if rate is not None:
        if not (np.isfinite(rate) and rate > 0):
            raise of.fail(f"rate = {rate}: must be above 0 (entries per second)")
        return Clock(rows / rate)
    own = [column.clock for column in columns if column.clock is not None]
    if len(own) < len(columns) or any(not np.array_equal(clock, own[0]) for clock in own):
        raise of.fail("has no clock for these columns: pass time (a column) or rate (entries per second)")
    return Clock(own[0][rows])


def _unit(column: Column, known: dict[str, str]) -> str | None:
    """The unit that a column states, if it is one of `known`."""
    unit = column.unit.strip().replace(" ", "")
    return known.get(unit, known.get(unit.casefold()))


def _stated(of: Recording, columns: list[Column], known: dict[str, str], option: str, o: _Options) -> str | None:
    """The unit that columns state; None if they state none or the user does. RecordsError if it is not one of `known`."""
    if option in o.given:
        return None
    for column in columns:
        if column.unit.strip() and _unit(column, known) is None:
            names = ", ".join(dict.fromkeys(known.values()))
            what = f"column {column.name!r} states the unit {column.unit.strip()!r}; known are {names}"
            raise of.fail(f"{what}: convert it, or pass {option} (--{option.replace('_', '-')}) if its values are in one of these")
    units = {_unit(column, known) for column in columns}
    if len(units) > 1:
        raise of.fail(f"columns {[c.name for c in columns]} state different units: pass {option}")
    return units.pop() if units else None


def _once(of: Recording, columns: list[Column]) -> None:
    """Refuses a column that is read twice."""
    for n, column in enumerate(columns):
        if any(column is other for other in columns[:n]):
            raise of.fail(f"{column.name!r} is read twice: choose it once, as force, signal or clock")


def _record(of: Recording, beside: Recording | None, o: _Options) -> tuple[Record, NDArray[np.intp]]:
    """A recording as one record, and the rows of its forces."""
    keys = list(o.force)
    forces = [of.column(key) for key in keys]
    timed = [] if o.time is None else [of.column(o.time)]
    _once(of, [*forces, *timed])
    rows = of.rows([*forces, *timed], o.empty)
    clock = _clock(of, forces, rows, o.time, o.rate, o)
    values = np.array([of.numbers(column, rows) for column in forces])
    units = {"force_unit": _stated(of, forces, _FORCE, "force_unit", o)}
    record = Record(clock.seconds, values[0] if len(keys) == 1 else values, source=str(of.file))
    if o.signals is not None:
        there = beside or of
        chosen = [there.column(key) for key in o.signals]
        for column in chosen:
            if beside is None and any(column is force for force in forces):
                raise of.fail(f"{column.name!r} is chosen as force and as signal: a decoder would take the force from there")
        is_own = beside is not None or o.signal_time is not None or o.signal_rate is not None
        clocks = [c.clock for c in (*chosen, forces[0]) if c.clock is not None]
        is_own = is_own or any(not np.array_equal(own, clocks[-1]) for own in clocks)
        time, rate = (o.signal_time, o.signal_rate) if o.signal_time is not None or o.signal_rate is not None else (o.time, o.rate)
        timed = [] if time is None else [there.column(time)]
        _once(there, [*chosen, *timed])
        of_signals = there.rows([*chosen, *timed], o.empty)
        gaps = np.flatnonzero(np.diff(of_signals) != 1)
        if beside is None and o.signal_rate is not None and len(gaps):
            what = f"{there.place(int(of_signals[gaps[0]]) + 1)}: has no signals, so signal_rate would count other rows than theirs"
            raise there.fail(f"{what}: pass signal_time (a column), or signal_files of their own")
        is_own = is_own or not np.array_equal(of_signals, rows)
        record.signals = np.stack([there.numbers(column, of_signals) for column in chosen], axis=1)
        if is_own:
            own = _clock(there, chosen, of_signals, time, rate, o)
            if own.kind != clock.kind and o.signal_start == 0.0:
                what = f"its clock is of the kind {own.kind!r}, the force's in {of.file} {clock.kind!r}"
                raise there.fail(f"{what}: pass signal_start, the force's time (s) at which this clock is 0")
            record.signal_time = own.seconds + o.signal_start + (own.zero - clock.zero) * 1e-9 * (own.kind == clock.kind)
        elif o.signal_start != 0.0:
            record.signal_time = clock.seconds + o.signal_start
        # by unit, and by place where the unit does not tell
        is_angular = [
            _unit(c, _ANGULAR) is not None or (i % 3 == 2 and _unit(c, _ACCELERATION) is None) for i, c in enumerate(chosen)
        ]
        angular, others = ([c for c, is_of in zip(chosen, is_angular, strict=True) if is_of is kind] for kind in (True, False))
        units["acceleration_unit"] = _stated(there, others, _ACCELERATION, "acceleration_unit", o)
        units["angular_velocity_unit"] = _stated(there, angular, _ANGULAR, "angular_velocity_unit", o)
    record.units = {key: unit for key, unit in units.items() if unit is not None}
    return record, rows


def _panels(of: Recording, rows: NDArray[np.intp], o: _Options) -> NDArray[np.int64] | int | None:
    """The panel of each row, or of the file."""
    if o.panel_pattern is not None:
        found = re.search(o.panel_pattern, of.file.name)
        if found is None or not found.groups() or not found[1].isdigit():
            raise of.fail(f"panel_pattern = {o.panel_pattern!r}: its first group must match a number in the file's name")
        read: NDArray[np.int64] | int = int(found[1]) - o.first_panel
    elif o.panel is not None:
        values = of.numbers(of.column(o.panel), rows)
        if (values != np.round(values)).any():
            raise of.fail(
                f"column {o.panel!r} names the panel, but contains {values[values != np.round(values)][0]}: must be whole numbers"
            )
        read = values.astype(np.int64) - o.first_panel
    else:
        return None
    if np.min(read) < 0:
        raise of.fail(f"panel {int(np.min(read)) + o.first_panel} is below first_panel = {o.first_panel}")
    return read


def _cut(record: Record, starts: list[int], before: float, length: float, panels: Any, notes: list[str]) -> list[Record]:
    """The blows of a long recording. Time 0 is `before` ahead of each; a blow that is not whole in the recording is left out."""
    cut: list[Record] = []
    step = float(np.median(np.diff(record.time)))
    for n in starts:
        zero = record.time[n] - before
        first, last = (int(np.searchsorted(record.time, t)) for t in (zero - 1e-6 * step, zero + length + 1e-6 * step))
        source = f"{record.source}, blow at {record.time[n]:.6g} s"
        whole = zero >= record.time[0] - 1e-6 * step and zero + length <= record.time[-1] + 1.000001 * step
        signals, times = record.signals, record.signal_time
        if signals is not None and times is not None:
            own = float(np.median(np.diff(times)))
            whole = whole and times[0] <= zero + own and times[-1] >= zero + length - own
            # an entry more on each side, between which the ends lie
            inside = (times >= zero - 1.000001 * own) & (times <= zero + length + 1.000001 * own)
            signals, times = signals[inside], times[inside] - zero
        elif signals is not None:
            signals = signals[first:last]
        if not whole:
            notes.append(f"{source}: left out, since the recording does not contain all {length} s of it")
            continue
        of_blow = Record(record.time[first:last] - zero, record.force[..., first:last], signals, times, None, source, record.units)
        of_blow.panel = None if panels is None else int(panels if isinstance(panels, int) else panels[n])
        cut.append(of_blow)
    return cut


def convert(
    files: Sequence[str | PathLike[str]] | str | PathLike[str],
    out: str | PathLike[str],
    *,
    force: Key | Sequence[Key],
    signals: Key | Sequence[Key] | None = None,
    signal_files: Sequence[str | PathLike[str]] | str | PathLike[str] | None = None,
    time: Key | None = None,
    rate: float | None = None,
    signal_time: Key | None = None,
    signal_rate: float | None = None,
    signal_start: float = 0.0,
    time_unit: str | None = None,
    time_format: str | None = None,
    trigger: float | None = None,
    length: float | None = None,
    before: float = 0.01,
    rearm: float | None = None,
    panel: Key | None = None,
    panel_pattern: str | None = None,
    first_panel: int = 0,
    force_unit: str | None = None,
    acceleration_unit: str | None = None,
    angular_velocity_unit: str | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
    encoding: str | None = None,
    skip: int | None = None,
    comment: str | None = None,
    table: int | None = None,
    empty: str = "refuse",
) -> tuple[Path, list[str]]:
    """Converts files into `out` (.npz) and a TOML beside it. Returns the TOML's path and notes for the user.

    Columns are chosen by name, or by number from 0.

    - `force`: the force, or one column per panel; `signals`: a_x, a_y, ω of each sensor in turn.
    - `signal_files`: files of the signals, one per file of forces; default: the same files.
    - `time` or `rate` (1/s): clock of the forces; `signal_time`, `signal_rate`: of the signals, default the same. Clocks are numbers,
      ticks since an epoch or time stamps. Dates place both clocks; otherwise `signal_start` (s) is the forces' time at the signals' 0.
    - `time_unit`: s, ms, us, ns, min, h or d; `time_format`: format of time stamps for `datetime.strptime`.
    - `trigger`, `length`, `before`, `rearm`: cuts several blows from a long recording, see `blows`. Default: a file is one record.
    - `panel`: a column with the panel's number; `panel_pattern`: a regular expression whose first group is its number in the file's
      name; `first_panel`: the number of the first panel (0 or 1).
    - `force_unit` (N, mN, kN), `acceleration_unit` (mm/s2, m/s2, g), `angular_velocity_unit` (rad/s, deg/s): default: as columns
      state. Other stated units are refused.
    - `empty`: "skip" leaves out rows with empty cells, separately for forces and signals.
    - The others: see `read`.

    Raises RecordsError (a ValueError) with file, place and option; ImportError if a package of the extra `records` is missing.
    """
    files = [files] if isinstance(files, (str, PathLike)) else list(files)
    if not files:
        raise RecordsError("files = []: pass at least one file")
    signals = [signals] if isinstance(signals, (str, int)) else signals
    signal_files = [signal_files] if isinstance(signal_files, (str, PathLike)) else signal_files
    if signal_files is not None and signals is None:
        raise RecordsError("signal_files: pass signals (--signals), the columns to take from them")
    if signal_files is not None and len(signal_files) != len(files):
        raise RecordsError(f"signal_files: {len(signal_files)} files, but {len(files)} of forces; must be one for each")
    if empty not in ("refuse", "skip"):
        raise RecordsError(f"empty = {empty!r}: must be refuse or skip")
    if (trigger is None) != (length is None):
        raise RecordsError("trigger and length: pass both to cut blows from a recording, or neither")
    if panel is not None and panel_pattern is not None:
        raise RecordsError("pass either panel or panel_pattern")
    try:
        re.compile(panel_pattern or "")
    except re.error as error:
        raise RecordsError(f"panel_pattern = {panel_pattern!r}: is no regular expression: {error}") from None
    given = {"force_unit": force_unit, "acceleration_unit": acceleration_unit, "angular_velocity_unit": angular_velocity_unit}
    for key, known in [("force_unit", _FORCE), ("acceleration_unit", _ACCELERATION), ("angular_velocity_unit", _ANGULAR)]:
        if given[key] is not None and given[key] not in known.values():
            raise RecordsError(f"{key} = {given[key]!r}: must be one of {', '.join(dict.fromkeys(known.values()))}")
    keys = [force] if isinstance(force, (str, int)) else list(force)
    o = _Options(
        keys, signals, time, rate, signal_time, signal_rate, signal_start, time_unit, time_format, panel, panel_pattern, first_panel,
        empty, frozenset(key for key, unit in given.items() if unit is not None),
    )  # fmt: skip
    form = Form(delimiter, decimal, encoding, skip, comment, table)
    notes: list[str] = []
    found: list[Record] = []
    for i, file in enumerate(files):
        recordings = read_file(Path(file), form)
        besides: list[Recording | None] = [None] * len(recordings)
        if signal_files is not None:
            besides = [*read_file(Path(signal_files[i]), form)]
            if len(besides) != len(recordings):
                raise RecordsError(
                    f"{signal_files[i]}: contains {len(besides)} records, {file} {len(recordings)}: pass files of one each"
                )
        for of, beside in zip(recordings, besides, strict=True):
            record, rows = _record(of, beside, o)
            panels = _panels(of, rows, o)
            if trigger is not None and length is not None:
                starts = blows(record.time, record.force, trigger, length=length, before=before, rearm=rearm)
                if not starts:
                    peak = np.abs(record.force - np.median(record.force)).max()
                    raise of.fail(f"trigger = {trigger}: the force never reaches it; its peak above the median is {peak:.4g}")
                found += _cut(record, starts, before, length, panels, notes)
                continue
            if panels is not None and np.min(panels) != np.max(panels):
                raise of.fail("names several panels: pass trigger and length to cut its blows")
            record.panel = None if panels is None else int(np.min(panels))
            found.append(record)
    for record in found:
        record.units = {**record.units, **{key: unit for key, unit in given.items() if unit is not None}}
    if not found:
        raise RecordsError("no record is whole: " + "; ".join(notes))
    toml = save(out, found)
    return toml, notes + _missing(found, signals is not None) + _offset(found, toml)


def _missing(found: list[Record], with_signals: bool) -> list[str]:
    """What the files do not state."""
    assumed = {"force_unit": "N"} | ({"acceleration_unit": "mm/s2", "angular_velocity_unit": "rad/s"} if with_signals else {})
    return [
        f"{key} is not stated by the files: {unit} is assumed; pass {key}"
        for key, unit in assumed.items()
        if key not in found[0].units
    ]


def _offset(found: list[Record], toml: Path) -> list[str]:
    """The level of the forces where both their first entries and their median tell it, if above 2 % of the peak."""
    levels = []
    for record in found:
        force = np.atleast_2d(record.force)
        median = np.median(force, axis=1)
        level = np.minimum(np.abs(median), np.abs(np.median(force[:, :5], axis=1))).max()
        levels.append([level, np.abs(force - median[:, None]).max()])
    level, peak = np.median(levels, axis=0)
    if peak == 0.0 or level <= 0.02 * peak:
        return []
    of_peak = f"{level:.3g}, {100.0 * level / peak:.0f} % of the peak"
    return [f"the force rests at {of_peak}: set remove_offset = true below [recorded] in {toml.name}"]


def save(out: str | PathLike[str], found: Sequence[Record]) -> Path:
    """Writes records as NPZ and TOML, and returns the TOML's path.

    Records with the same clocks become one file, (N, n) or (N, K, n) of forces and (N, m, channels) of signals; others one file each,
    OUT-000.npz and so on. Raises RecordsError if records have different units or numbers of forces or signals.
    """
    out = Path(out)
    if out.suffix != ".npz":
        raise RecordsError(f"out = {str(out)!r}: must end in .npz")
    first = found[0]
    for record in found:
        if record.units != first.units:
            raise RecordsError(f"{record.source}: units {record.units}, but {first.source} {first.units}: pass the units")
        shapes = [(r.force.shape[:-1], r.signals is None or r.signals.shape[1], r.signal_time is None) for r in (record, first)]
        if shapes[0] != shapes[1]:
            raise RecordsError(
                f"{record.source}: forces, signals or clocks are others than those of {first.source}: convert them apart"
            )
        if (record.panel is None) != (first.panel is None):
            raise RecordsError(f"{record.source}: the panel must be known for all records or none")
    together = [found] if all(_same(record, first) for record in found) else [[record] for record in found]
    names = []
    for i, group in enumerate(together):
        arrays: dict[str, Any] = {"time": group[0].time, "force": np.stack([record.force for record in group])}
        if group[0].signals is not None:
            arrays["signals"] = np.stack([record.signals for record in group if record.signals is not None])
        if group[0].signal_time is not None:
            arrays["signal_time"] = group[0].signal_time
        path = out if len(together) == 1 else out.with_name(f"{out.stem}-{i:03}.npz")
        np.savez_compressed(path, **arrays)
        names.append(path.name)
    of_signals = {"acceleration_unit", "angular_velocity_unit"}
    lines = ["[recorded]", f"files = {json.dumps(names, ensure_ascii=False)}", 'time = "time"', 'force = ["force"]']
    lines += [f"{key} = {json.dumps(unit)}" for key, unit in first.units.items() if key not in of_signals]
    if first.panel is not None:
        lines.append(f"panels = {[record.panel for record in found]}")
    if first.signals is not None:
        lines += ["", "[signals]", 'channels = ["signals"]']
        lines += ['time = "signal_time"'] if first.signal_time is not None else []
        lines += [f"{key} = {json.dumps(unit)}" for key, unit in first.units.items() if key in of_signals]
    toml = out.with_suffix(".toml")
    toml.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return toml


def _same(record: Record, other: Record) -> bool:
    """Whether two records have the same clocks, but for a millionth of a step."""

    def alike(a: NDArray[np.float64] | None, b: NDArray[np.float64] | None) -> bool:
        if a is None or b is None:
            return a is b
        return a.shape == b.shape and bool(np.abs(a - b).max() <= 1e-6 * np.median(np.diff(b)))

    return alike(record.time, other.time) and alike(record.signal_time, other.signal_time)
