"""Files that are no text: MATLAB, HDF5, TDMS, UFF 58 and NPZ, by the libraries of the extra `records`."""

import importlib
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metasense.records._recording import Column, Recording, RecordsError
from metasense.records._text import Form, read_text

# -1 in columns 5 and 6, and the number of the first data set, such as 58b, 151 or 164
_UFF = re.compile(rb"\s*    -1[ ]*\r?\n[ ]*\d{2,5}b?[ \r\n]")
_PACKAGES = {"scipy.io": "scipy", "h5py": "h5py", "pyuff": "pyuff", "nptdms": "npTDMS"}


def need(module: str, file: Path) -> Any:
    """A module of the extra `records`. ImportError that names the extra where it is missing."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        what = f"{file}: needs {_PACKAGES[module]}, which is not installed ({error})"
        raise ImportError(f"{what}: run `pip install {_PACKAGES[module]}` or install metasense[records]") from error


def read_file(file: Path, form: Form) -> list[Recording]:
    """The recordings of a file of any kind that is known, told by its first bytes."""
    try:
        data = file.read_bytes()
    except OSError as error:
        raise RecordsError(f"{file}: cannot be read: {error.strerror}") from None
    if data.startswith(b"\x1f\x8b"):
        raise RecordsError(f"{file}: is compressed: run gunzip first")
    if data.startswith(b"MATLAB 7.3") or data.startswith(b"\x89HDF\r\n\x1a\n"):
        return _hdf5(file, is_matlab=data.startswith(b"MATLAB"))
    if data.startswith(b"MATLAB 5.0"):
        return _matlab(file)
    if data.startswith(b"TDSm"):
        return _tdms(file)
    if _UFF.match(data):
        return _uff(file)
    if data.startswith((b"\x93NUMPY", b"PK\x03\x04")):
        return _numpy(file)
    return [read_text(file, data, form)]


def grouped(file: Path, columns: dict[tuple[str, str], Column]) -> list[Recording]:
    """One recording per group if all groups have the same columns; else one of all, named GROUP/COLUMN."""
    if not columns:
        raise RecordsError(f"{file}: contains no arrays of numbers: export its signals as arrays, or as CSV")
    groups: dict[str, list[Column]] = {}
    for (group, _), column in columns.items():
        groups.setdefault(group, []).append(column)
    names = [sorted(column.name for column in of) for of in groups.values()]
    if all(of == names[0] for of in names):
        return [Recording(file, of) for of in groups.values()]
    whole = [Column(f"{group}/{c.name}" if group else c.name, c.values, c.unit, c.clock) for (group, _), c in columns.items()]
    return [Recording(file, whole)]


def _arrays(name: str, value: Any, unit: str = "") -> list[Column]:
    """The columns of an array: itself, or its signals along the shorter side; none of what holds no numbers."""
    value = np.asarray(value)
    if value.dtype.names:
        return [c for field in value.dtype.names for c in _arrays(f"{name}.{field}".lstrip("."), value[field])]
    if value.dtype.kind not in "fiubM" or value.size < 2 or value.ndim > 2:
        return []
    if 1 in value.shape or value.ndim == 1:
        return [Column(name, value.ravel(), unit)]
    if value.shape[0] < value.shape[1]:
        value = value.T
    return [Column(f"{name}[{i}]", np.ascontiguousarray(value[:, i]), unit) for i in range(value.shape[1])]


def _matlab(file: Path) -> list[Recording]:
    columns: dict[tuple[str, str], Column] = {}

    def add(group: str, name: str, value: Any) -> None:
        if isinstance(value, np.ndarray) and value.dtype == object:
            for i, part in enumerate(value.ravel()):
                add(f"{group}/{name}({i + 1})".lstrip("/") if value.size > 1 else group, name if value.size == 1 else "", part)
        elif hasattr(value, "_fieldnames"):
            of = "/".join(part for part in (group, name) if part)
            for field in value._fieldnames:
                add(of, field, getattr(value, field))
        else:
            columns.update({(group, column.name): column for column in _arrays(name, value)})

    io = need("scipy.io", file)
    try:
        variables = io.loadmat(file, squeeze_me=True, struct_as_record=False)
    except Exception as error:
        raise RecordsError(f"{file}: is not a sound MATLAB file ({error}): save it again with -v7 or -v7.3") from error
    for name, value in variables.items():
        if not name.startswith("__"):
            add("", name, value)
    return grouped(file, columns)


def _hdf5(file: Path, *, is_matlab: bool) -> list[Recording]:
    h5py = need("h5py", file)
    columns: dict[tuple[str, str], Column] = {}

    def add(path: str, node: Any) -> None:
        if not isinstance(node, h5py.Dataset) or path.startswith("#"):
            return
        unit = node.attrs.get("units", node.attrs.get("unit", ""))
        unit = unit.decode() if isinstance(unit, bytes) else str(unit)
        group, _, name = path.rpartition("/")
        if node.dtype.kind in "fiubV":
            value = np.asarray(node[()])
            for column in _arrays(name, value.T if is_matlab else value, unit):
                columns[group, column.name] = column

    try:
        with h5py.File(file, "r") as opened:
            opened.visititems(add)
    except OSError as error:
        raise RecordsError(f"{file}: is not a sound HDF5 file ({error}): write it again") from error
    return grouped(file, columns)


def _tdms(file: Path) -> list[Recording]:
    columns: dict[tuple[str, str], Column] = {}
    begin = None
    try:
        opened = need("nptdms", file).TdmsFile.read(file)
        for group in opened.groups():
            for channel in group.channels():
                values, properties = channel[:], channel.properties
                clock: NDArray[Any] | None = None
                if properties.get("wf_increment"):
                    clock = np.arange(len(values)) * float(properties["wf_increment"]) + float(
                        properties.get("wf_start_offset", 0.0)
                    )
                    start = properties.get("wf_start_time")
                    if start is not None:
                        begin = start if begin is None else begin
                        clock = clock + float((start - begin) / np.timedelta64(1, "ns")) * 1e-9
                unit = str(properties.get("unit_string", ""))
                if np.asarray(values).dtype.kind in "fiubM" and len(values) > 1:
                    columns[group.name, channel.name] = Column(channel.name, np.asarray(values), unit, clock)
    except (ValueError, EOFError, KeyError) as error:
        raise RecordsError(f"{file}: is not a sound TDMS file ({error}): export it again") from error
    return grouped(file, columns)


def _uff(file: Path) -> list[Recording]:
    try:
        opened = need("pyuff", file).UFF(str(file))
        kinds = [str(kind).removesuffix(".0") for kind in opened.get_set_types()]
        sets = [opened.read_sets(n) for n, kind in enumerate(kinds) if kind in ("58", "58b")]
    except (ValueError, IndexError, KeyError, UnicodeDecodeError) as error:
        raise RecordsError(f"{file}: is not a sound UFF file ({error}): export data set 58 again") from error
    columns: dict[tuple[str, str], Column] = {}
    counts: dict[str, int] = {}
    for data in sets:
        if data.get("func_type") not in (0, 1) or np.iscomplexobj(data["data"]):
            continue
        axis = f"{int(data.get('rsp_node', 0))}{_DIRECTIONS.get(int(data.get('rsp_dir', 0)), '')}"
        name = str(data.get("id1", "")).strip()
        name = axis if name in ("", "NONE") else name
        counts[name] = counts.get(name, 0) + 1
        unit = str(data.get("ordinate_axis_units_lab", "")).strip()
        clock = np.asarray(data["x"], dtype=np.float64)
        column = Column(name, np.asarray(data["data"], dtype=np.float64), "" if unit == "NONE" else unit, clock)
        columns[f"#{counts[name]}", name] = column
    if not columns:
        raise RecordsError(f"{file}: contains no data set 58 of a time response: export histories, not spectra")
    return grouped(file, columns)


_AXES = ("X", "Y", "Z", "RX", "RY", "RZ")
_DIRECTIONS = {by * n: sign + axis for n, axis in enumerate(_AXES, 1) for by, sign in ((1, "+"), (-1, "-"))}


def _numpy(file: Path) -> list[Recording]:
    try:
        opened = np.load(file, allow_pickle=False)
    except (ValueError, zipfile.BadZipFile) as error:
        raise RecordsError(f"{file}: is not NPY or NPZ ({error}): export a spreadsheet as CSV") from error
    if isinstance(opened, np.ndarray):
        return grouped(file, {("", c.name): c for c in _arrays("array", opened)})
    try:
        return grouped(file, {("", c.name): c for name in opened.files for c in _arrays(name, opened[name])})
    except ValueError as error:
        raise RecordsError(f"{file}: is not an archive of arrays ({error}): export a spreadsheet as CSV") from error
