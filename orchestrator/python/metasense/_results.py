"""Runs by the installed command, and their databases."""

import io
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from os import PathLike, fspath
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metasense import _metasense
from metasense._values import plain


class Database(_metasense.Database):
    """A database of trials, written by `run`. It can be read while a run writes to it."""

    def __reduce__(self) -> tuple[type["Database"], tuple[str]]:
        return type(self), (os.path.abspath(self.path),)

    def trial(self, hash: str, *, threads: int = 1) -> dict[str, NDArray[Any]]:
        """A finished trial simulated again, by the names of `metasense export --format npz`.

        Of each body, `_initial` and `_optimised`: alpha, vertices (mm), signals (N, T, 3M), predictions (N, T, K) (N), weights;
        forces (N, K, T + 1) (N), split (0 training, 1 test, 2 holdout), scales, and the trial's spec as JSON (scene).
        """
        with np.load(io.BytesIO(self._archive(hash, threads))) as file:
            return dict(file)


class Event(NamedTuple):
    """A recorded outer step (errors in %), or a trial whose state has changed."""

    hash: str
    state: str
    step: int | None
    error_test: float | None


def program() -> Path:
    """Path of the `metasense` command installed with this module. Raises FileNotFoundError if it is missing."""
    from importlib.metadata import files

    for file in files("metasense") or []:
        if file.name == "metasense" and file.parent.name == "bin":
            return Path(str(file.locate()))
    raise FileNotFoundError("the metasense command, which `pip install` puts beside Python")


def changes(given: Mapping[str, object]) -> list[str]:
    """KEY=VALUE of keywords: a dictionary is a table of the spec, `name` its name, anything else a key of [sweep]."""
    words = []
    for key, value in given.items():
        if isinstance(value, Mapping):
            words += [f"{key}.{_key(name)}={_toml(plain(of, f'{key}.{name}'))}" for name, of in value.items() if of is not None]
        elif value is not None:
            path = key if key == "name" or "." in key else f"sweep.{_key(key)}"
            words.append(f"{path}={_toml(plain(value, path))}")
    return words


def flags(given: Mapping[str, object]) -> list[str]:
    """`--name=value` of each that is given; a list is separated by commas, True an option alone."""
    words: list[str] = []
    for name, value in given.items():
        option = "--" + name.replace("_", "-")
        if value is True:
            words.append(option)
        elif isinstance(value, Sequence) and not isinstance(value, str):
            words.append(f"{option}={','.join(map(str, value))}")
        elif value is not None and value is not False:
            words.append(f"{option}={fspath(value) if isinstance(value, PathLike) else str(value)}")
    return words


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else f'"{name}"'


def _toml(value: object) -> str:
    """A value of plain Python as TOML."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(name)} = {_toml(of)}" for name, of in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, str):
        escaped = "".join(c if c >= " " and c not in '"\\\x7f' else f"\\u{ord(c):04x}" for c in value)
        return f'"{escaped}"'
    return str(value).lower() if isinstance(value, bool) else repr(value)


def run(
    spec: str | PathLike[str],
    *,
    db: str | PathLike[str] | None = None,
    workers: int | None = None,
    threads: int | None = None,
    progress: bool = True,
    **overrides: object,
) -> Database:
    """Runs the trials of a spec file, or resumes an earlier run.

    `overrides` replace values of the spec: `seeds=[3]` is `sweep.seeds`, `optimise={"iterations": 20}` a key of another table.
    `progress` shows a bar on a terminal or in a notebook, and prints the lines of the command elsewhere. `threads` (1 to 1024) are
    those of each worker.

    Trials that fail are in the database with their reason. Raises ValueError if the spec or the arguments are wrong, OSError if
    the disk fails, RuntimeError if this machine lacks a resource. KeyboardInterrupt, or any other exception that is raised
    meanwhile, stops the run in order; a second one stops it at once. If this process is killed, its run stops in order, too.
    """
    words = changes(overrides)
    command: list[str] = [fspath(program()), "run", fspath(spec), *words, "--parent", str(os.getpid())]
    for name, value in [("--db", db), ("--workers", workers), ("--threads", threads)]:
        if value is not None:
            command += [name, fspath(value) if isinstance(value, PathLike) else str(value)]
    bar = Bar(Path(db if db is not None else _metasense.default_database(spec, words))) if progress and is_watched() else None
    code, _, said = conducted(command, lines=progress and bar is None, bar=bar)
    if code not in (0, 1):
        raise ERRORS.get(code, RuntimeError)(said)
    return Database(db if db is not None else _metasense.default_database(spec, words))


ERRORS: dict[int, type[BaseException]] = {2: ValueError, 3: OSError, 4: KeyboardInterrupt}


def conducted(command: list[str], *, lines: bool, bar: "Bar | None" = None, apart: bool = False) -> tuple[int, str, str]:
    """Runs a command to its end. Returns its exit code, its standard output, and the last lines that it said.

    `lines` prints what it says. Where standard output is not to be `apart`, it is among these lines.
    """
    said: list[str] = []
    # Ctrl-C interrupts the main thread: there a run in a session of its own gets it once, from here; elsewhere it comes from the terminal
    alone = threading.current_thread() is threading.main_thread()
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE if apart else subprocess.STDOUT,
        encoding="utf-8",
        errors="replace",
        start_new_session=alone,
        env={**os.environ, "COLUMNS": str(shutil.get_terminal_size().columns)},
    ) as process:
        spoken = process.stderr if apart else process.stdout
        assert spoken is not None and process.stdout is not None
        kept: list[str] = []
        reader = threading.Thread(target=lambda out: kept.append(out.read()), args=[process.stdout], daemon=True)
        ended = threading.Event()
        try:
            if apart:
                reader.start()
            if bar is not None:
                follower = threading.Thread(target=bar.follow, args=[ended], daemon=True)
                follower.start()
            for line in spoken:
                said.append(line.rstrip("\n"))
                if lines:
                    print(line, end="", flush=True)
        except BaseException:
            ended.set()
            _stop(process, spoken)
            raise
        ended.set()
        if apart:
            reader.join()
    if bar is not None:
        follower.join()
        bar.close()
    return process.returncode, "".join(kept), "\n".join(said[-20:])


def _stop(process: subprocess.Popen[str], spoken: IO[str]) -> None:
    """Stops a run in order, and at once if there is another interruption; waits for its end."""
    while process.poll() is None:
        process.send_signal(signal.SIGINT)
        try:
            spoken.read()  # a full pipe would stop it from ending
            process.wait()
        except KeyboardInterrupt:
            continue


def is_watched() -> bool:
    """Whether a person sees a bar: on a terminal, or in a notebook."""
    return sys.stderr.isatty() or type(sys.modules.get("ipykernel")).__name__ == "module"


class Bar:
    """The progress of the trials in a database, in one line on standard error."""

    def __init__(self, db: Path) -> None:
        self._db, self._begun = db, time.monotonic()

    def line(self) -> str:
        """Trials and steps that are done, the time, and the least error so far; empty before there is a database."""
        ask = (
            "SELECT count(*) AS trials, sum(state NOT IN ('pending', 'running')) AS ended, sum(steps) AS steps, "
            "sum(CASE WHEN state IN ('pending', 'running') THEN spec->>'$.optimise.iterations' ELSE steps END) AS planned, "
            "min(holdout_error_optimised) AS least FROM v_trial"
        )
        try:
            [row] = Database(self._db).query(ask)
        except (OSError, ValueError):
            return ""
        if not row["trials"]:
            return ""
        part = row["steps"] / row["planned"] if row["planned"] else row["ended"] / row["trials"]
        minutes, seconds = divmod(int(time.monotonic() - self._begun), 60)
        least = "" if row["least"] is None else f", least error {row['least']:.3g} %"
        drawn = "#" * round(20 * part)
        return f"{row['ended']}/{row['trials']} trials |{drawn:20}| {100 * part:3.0f} % of the steps, {minutes}:{seconds:02}{least}"

    def follow(self, ended: threading.Event, every: float = 0.5) -> None:
        """Draws the line until the run has ended, with pauses of at least twenty times what a query takes."""
        while not ended.wait(every):
            begun = time.monotonic()
            line = self.line()
            every = max(every, 20 * (time.monotonic() - begun))
            if line and not ended.is_set():
                self._draw(line, end="")

    def close(self) -> None:
        """Draws the last line."""
        self._draw(self.line(), end="\n")

    @staticmethod
    def _draw(line: str, end: str) -> None:
        print(f"\r{line:<{shutil.get_terminal_size().columns - 1}}", end=end, file=sys.stderr, flush=True)


_STEPS = "SELECT hash, step, error_test FROM v_step WHERE recorded_at >= '{since}' ORDER BY recorded_at, hash, step"


def watch(db: Database | str | PathLike[str], *, every: float = 1.0) -> Iterator[Event]:
    """Steps and changes of state as a run records them, polled every `every` seconds, until no run is writing.

    Raises ValueError if `every` is negative or there is no database.
    """
    if not 0 <= every <= threading.TIMEOUT_MAX:
        raise ValueError(f"every = {every}: must be a number of seconds, at least 0")
    return _events(db if isinstance(db, Database) else Database(db), every)


def _events(database: Database, every: float) -> Iterator[Event]:
    states: dict[str, str] = {}
    seen: set[tuple[str, int]] = set()
    since = ""
    while True:
        working = database.is_running()
        trials = database.query("SELECT hash, state FROM v_trial ORDER BY hash").to_dict()
        now = database.query("SELECT strftime('%Y-%m-%dT%H:%M:%f', 'now', '-5 seconds') AS now").to_dict()["now"][0]
        steps = database.query(_STEPS.format(since=since)).to_dict()
        state_of = dict(zip(trials["hash"], trials["state"], strict=True))
        for hash, step, error in zip(steps["hash"], steps["step"], steps["error_test"], strict=True):
            if (hash, step) not in seen:
                seen.add((hash, step))
                yield Event(hash, "running", step, error)
        for hash, state in state_of.items():
            if states.get(hash) != state:
                states[hash] = state
                yield Event(hash, state, None, None)
        since = now
        if not working:
            return
        time.sleep(every)
