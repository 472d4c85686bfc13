"""Metamaterial bodies as differentiable functions, and results of metasense, in Python.

    import metasense
    body = metasense.Body.from_spec("schemas/sweeps/quickstart.toml")
    forces = body.stimuli("train")                        # (N, K, T + 1) in N
    simulation = body.simulate(body.alpha, forces)        # .signals (N, T, 3M), .vjp, .jvp

Commands are functions: `run`, `expand`, `trial`, `design`, `evaluate`, `identify`, `casts`, `report`, `export`. `metasense.records`
imports files of instruments, and `metasense.plot` draws figures (optional extras). `metasense.jax.signals` and `metasense.torch.signals` are
the simulation as a function that JAX and PyTorch can differentiate.
Lengths are in mm, forces in N, times in s, masses in Mg; MODEL.md has the physics and the order of every array.
"""

from os import PathLike

import numpy as np
from numpy.typing import NDArray

from metasense._commands import casts, design, evaluate, expand, export, identify, report, trial
from metasense._errors import error, targets
from metasense._metasense import Body, Inverse, LinearBrain, Simulation, SimulationError, Table, Twin, __version__
from metasense._results import Database, Event, program, run, watch
from metasense._serve import serve_body
from metasense._values import plain

__all__ = [
    "Body", "Database", "Event", "Inverse", "LinearBrain", "Simulation", "SimulationError", "Table", "Twin", "__version__",
    "body", "casts", "design", "error", "evaluate", "expand", "export", "identify", "program", "report", "run", "serve_body", "stimuli",
    "targets", "trial", "watch",
]  # fmt: skip


def body(*, threads: int = 1, **tables: object) -> Body:
    """Returns the body of the first trial of a spec. Keywords are its tables (dictionaries); keys that are None are omitted.

    Values may be numpy's scalars and arrays, tuples and paths. Raises ValueError for the first unknown key or invalid
    value, TypeError for the first value that a spec cannot contain.
    """
    import json

    return Body._from_json(json.dumps(plain({"name": "python", **tables})), threads)


def stimuli(
    spec: str | PathLike[str], set: str, first: int = 0, count: int | None = None, *, hash: str | None = None
) -> NDArray[np.float64]:
    """Returns force histories (N, K, T + 1) (N) of a trial of a spec file, by default the first, as `Body.stimuli` does."""
    return Body.from_spec(spec, hash).stimuli(set, first, count)
