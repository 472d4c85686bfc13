"""Commands as functions: what each prints as rows comes as a `Table`. They raise as `run` does."""

import json
import math
import warnings
from collections.abc import Mapping, Sequence
from os import PathLike, fspath
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from metasense import _metasense
from metasense._results import ERRORS, Bar, Database, changes, conducted, flags, is_watched, program

Source = Database | str | PathLike[str]
File = str | PathLike[str]


def _words(source: Source, hash: str | None, overrides: Mapping[str, object]) -> list[str]:
    path = source.path if isinstance(source, Database) else source
    return [fspath(path), *([] if hash is None else [hash]), *changes(overrides)]


def _said(words: Sequence[str], bar: Bar | None = None, lines: bool = False, level: int = 3) -> tuple[int, str, str]:
    """Exit code, standard output and messages of a command; raises at codes other than 0 and 1.

    At code 0 its warnings and notes are warnings of the caller that is `level` calls up.
    """
    code, out, said = conducted([fspath(program()), *words], lines=lines, bar=bar, apart=True)
    if code not in (0, 1):
        raise ERRORS.get(code, RuntimeError)(said)
    for line in said.splitlines() if code == 0 else []:
        if line.startswith(("warning:", "note:")):
            warnings.warn(line, RuntimeWarning, stacklevel=level)
    return code, out, said


def _table(text: str) -> _metasense.Table:
    rows = json.loads(text)
    columns = list(rows[0]) if rows else []
    cells = [[{"infinite": x > 0} if isinstance(x, float) and math.isinf(x) else x for x in row.values()] for row in rows]
    return _metasense.unpickle_table(columns, json.dumps(cells))


def _rows(words: Sequence[str], bar: Bar | None = None, lines: bool = False) -> _metasense.Table:
    """The rows that a command prints. A check that failed (exit code 1) is a warning if there are rows, else a RuntimeError."""
    code, out, said = _said([*words, "--format=json"], bar, lines, level=4)
    if not out.strip():
        raise RuntimeError(said)
    if code == 1:
        warnings.warn(said, RuntimeWarning, stacklevel=3)
    return _table(out)


def expand(spec: File, **overrides: object) -> _metasense.Table:
    """The trials of a spec, one row each: hash, panels, sensors, seed, numbers of parameters, estimated cost (s). Starts nothing.

    `overrides` as in `run`. Raises ValueError if the spec is wrong.
    """
    return _rows(["expand", *_words(spec, None, overrides)])


def trial(source: Source, hash: str | None = None, *, threads: int = 1, **overrides: object) -> dict[str, Any]:
    """Trains one trial here, without a database, and returns its errors (%), best_step and seconds; bit-identical to a run.

    `source` is a spec file, with `overrides` as in `run` and by default its first trial, or a database. Raises ValueError if the
    spec is wrong, RuntimeError if the training fails.
    """
    [row] = _rows(["trial", *_words(source, hash, overrides), *flags({"threads": threads})])
    return row


def design(
    spec: File,
    *,
    db: File | None = None,
    workers: int | None = None,
    threads: int | None = None,
    progress: bool = True,
    **overrides: object,
) -> _metasense.Table:
    """Searches a sweep for the cheapest design that meets its [goal]: the candidates, one row each, with cost and error (%).

    After an interruption, the same call resumes. Warns if no design meets the goal. `overrides` and errors as in `run`.
    """
    words = changes(overrides)
    where = Path(db if db is not None else _metasense.default_database(spec, words))
    bar = Bar(where) if progress and is_watched() else None
    command = ["design", fspath(spec), *words, *flags({"db": db, "workers": workers, "threads": threads})]
    return _rows(command, bar, lines=progress and bar is None)


def evaluate(
    source: Source,
    records: Mapping[str, File],
    hash: str | None = None,
    *,
    designs: Mapping[str, File] | None = None,
    twins: Mapping[str, File] | None = None,
    brain: str | None = None,
    folds: int | None = None,
    out_dir: File | None = None,
    **overrides: object,
) -> _metasense.Table:
    """Errors (%) of decoders on measured records (TOML, as `metasense.records` writes them) of bodies, by cross-validation.

    `records`, `designs` and `twins` are files by the name of a body, such as {"initial": "records.toml"}. One row per body.
    """
    of_bodies = [("--records", records), ("--design", designs or {}), ("--twin", twins or {})]
    named = [word for option, files in of_bodies for body, file in files.items() for word in (option, f"{body}={fspath(file)}")]
    options = flags({"brain": brain, "folds": folds, "out_dir": out_dir})
    return _rows(["lab", "evaluate", *_words(source, hash, overrides), *named, *options])


def identify(
    source: Source,
    records: File,
    hash: str | None = None,
    *,
    design: File | None = None,
    fit: Sequence[str] | None = None,
    threads: int = 1,
    out_dir: File | None = None,
    **overrides: object,
) -> _metasense.Table:
    """Material fitted to measured records (TOML): parameter, unit, start, fitted, lower, upper (95 %), outcome; one row each.

    `fit` names parameters: stretch, shear, bend, damping, density, contact. Warns if the fit does not converge or the records do not
    determine a parameter; `outcome` says which.
    """
    options = flags({"records": records, "design": design, "fit": fit, "threads": threads, "out_dir": out_dir})
    return _rows(["lab", "identify", *_words(source, hash, overrides), *options])


def casts(
    source: Source,
    hash: str | None = None,
    *,
    design: File | None = None,
    casts: int | None = None,
    variation: File | Mapping[str, object] | None = None,
    rows: bool = False,
    **overrides: object,
) -> _metasense.Table:
    """Errors (%) of decoders on virtual casts of a body: medians and percentiles, or with `rows` one row per cast and decoder.

    `variation` replaces the trial's: standard deviations as the table of a spec, or a file with that table. `overrides` and errors as
    in `run`.
    """
    with TemporaryDirectory() as folder:
        if isinstance(variation, Mapping):
            file = Path(folder, "variation.toml")
            file.write_text("\n".join(changes({"variation": variation})))
            variation = file
        options = flags({"design": design, "casts": casts, "variation": variation, "rows": rows})
        return _rows(["body", "casts", *_words(source, hash, overrides), *options])


def report(db: Source, hash: str | None = None, *, out: File | None = None, out_dir: File | None = None) -> Path:
    """Writes the answers and figures of a database into one HTML file, by default beside the database. Returns its path."""
    path = db.path if isinstance(db, Database) else Path(db)
    to = Path(out) if out is not None else path.with_suffix(".html")
    _said(["report", *_words(db, hash, {}), *flags({"out": to, "out_dir": out_dir})])
    return to


def export(source: Source, hash: str | None = None, *, format: str, out: File, **options: object) -> Path:
    """Writes a trial (or a view, in place of the hash) for other programs, and returns the path of what it wrote.

    `format`: npz, csv, parquet, npy, svg, dxf, stl, c, onnx or device. `options` are those of `metasense export`, such as
    design="initial" or mould="height=12" (mm).
    """
    _said(["export", *_words(source, hash, {}), *flags({"format": format, "out": out, **options})])
    return Path(out)
