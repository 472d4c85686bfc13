"""Runs by the installed command, and their databases."""

import io
import os
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from os import PathLike, fspath
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metasense import _metasense


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
    """An outer step that was recorded (errors in %), or a trial whose state is another now."""

    hash: str
    state: str
    step: int | None
    error_test: float | None


def program() -> Path:
    """The `metasense` command that was installed with this module. FileNotFoundError where there is none."""
    from importlib.metadata import files

    for file in files("metasense") or []:
        if file.name == "metasense" and file.parent.name == "bin":
            return Path(str(file.locate()))
    raise FileNotFoundError("the metasense command, which `pip install` puts beside Python")


def run(
    spec: str | PathLike[str],
    *,
    db: str | PathLike[str] | None = None,
    workers: int | None = None,
    threads: int | None = None,
    progress: bool = True,
) -> Database:
    """Runs the trials of a spec file, or goes on where an earlier run has stopped; `progress` prints its output.

    Trials that fail are in the database with their reason. Raises ValueError if the spec or the arguments are wrong, OSError if
    the disk fails. KeyboardInterrupt, or any other exception that is raised meanwhile, stops the run in order; a second one stops it
    at once. If this process is killed, its run stops in order, too.
    """
    command: list[str] = [fspath(program()), "run", fspath(spec), "--parent", str(os.getpid())]
    for name, value in [("--db", db), ("--workers", workers), ("--threads", threads)]:
        if value is not None:
            command += [name, fspath(value) if isinstance(value, PathLike) else str(value)]
    said: list[str] = []
    # Ctrl-C interrupts the main thread: there a run in a session of its own gets it once, from here; elsewhere it comes from the terminal
    alone = threading.current_thread() is threading.main_thread()
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        errors="replace",
        start_new_session=alone,
        env={**os.environ, "COLUMNS": str(shutil.get_terminal_size().columns)},
    ) as process:
        assert process.stdout is not None
        try:
            for line in process.stdout:
                said.append(line.rstrip("\n"))
                if progress:
                    print(line, end="", flush=True)
        except BaseException:
            _stop(process)
            raise
    text = "\n".join(said[-20:])
    if process.returncode in (0, 1):
        return Database(db if db is not None else _metasense.default_database(spec))
    raise {2: ValueError, 3: OSError, 4: KeyboardInterrupt}.get(process.returncode, RuntimeError)(text)


def _stop(process: subprocess.Popen[str]) -> None:
    """Stops a run in order, and at once if there is another interruption; waits for its end."""
    while process.poll() is None:
        process.send_signal(signal.SIGINT)
        try:
            process.communicate()
        except KeyboardInterrupt:
            continue


_STEPS = "SELECT hash, step, error_test FROM v_step WHERE recorded_at >= '{since}' ORDER BY recorded_at, hash, step"


def watch(db: Database | str | PathLike[str], *, every: float = 1.0) -> Iterator[Event]:
    """Steps and changes of state as a run records them, polled every `every` seconds, until no run is writing."""
    database = db if isinstance(db, Database) else Database(db)
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
