"""External bodies: answers the calls of `body.kind = "external"` with a JAX or NumPy function."""

import json
import mmap
import os
import queue
import sys
import threading
import traceback
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def serve_body(
    simulate: Callable[..., Any],
    alpha0: ArrayLike,
    *,
    name: str,
    panels: Sequence[str],
    sensors: Sequence[str],
    channels: Sequence[str],
    vjp: Callable[..., ArrayLike] | None = None,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    constraints: Sequence[tuple[dict[int, float], float | None, float | None]] = (),
    project: Callable[[Array], ArrayLike] | None = None,
    draw: Callable[[Array], str] | None = None,
    duration: float | None = None,
    samples: int | None = None,
    tolerance: bool = False,
    version: str = "",
    batch: int = 16,
    batched: bool = False,
) -> None:
    """Answers the calls of the worker that started this program until the worker ends.

    `simulate(alpha, forces, times)` returns the signals (T, S, C) of one sample. `forces` has shape (P, R + 1) for all panels,
    at equal intervals from 0 to `times[-1]`; `times` has shape (T,). With `tolerance=True`, `tolerance` is the fourth argument.
    Without `vjp`, JAX must be able to trace `simulate`; `batch` samples are computed at once. With `vjp(alpha, forces, times,
    cotangent)`, which returns the gradient in `alpha` of the sum of cotangent × signals, `simulate` can be any function. With
    `batched=True`, both take up to `batch` samples: forces (N, P, R + 1), signals and cotangent (N, T, S, C).
    `lower` and `upper` bound alpha; a constraint is `({number: coefficient}, least, most)`.
    """
    alpha = np.array(alpha0, dtype=np.float64)
    lists = {"lower": lower, "upper": upper}
    description = {
        "name": name, "version": version, "alpha": alpha.tolist(), "panels": list(panels), "sensors": list(sensors),
        "channels": list(channels), "duration": duration, "samples": samples, "tolerance": tolerance,
        "project": project is not None, "draw": draw is not None,
        "constraints": [{"terms": list(terms.items()), "least": least, "most": most} for terms, least, most in constraints],
        **{key: np.broadcast_to(values, alpha.shape).tolist() for key, values in lists.items() if values is not None},
    }  # fmt: skip
    asked = _requests()
    places = (len(panels), len(sensors), len(channels))
    plain = vjp and _Plain(simulate, vjp, batch if batched else None)
    body = (plain or _Traced(simulate, batch), places, tolerance)
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # the function's prints go to standard error
    while (line := asked.get()) is not None:
        request = json.loads(line)
        try:
            answer = description if request["call"] == "describe" else _answer(request, *body, project, draw)
        except Exception as error:
            traceback.print_exc()
            sys.stderr.flush()
            answer = {"error": f"{request['call']}: {type(error).__name__}: {error}"}
        print(json.dumps(answer), file=answers, flush=True)


def _requests() -> "queue.SimpleQueue[str | None]":
    """Returns a queue of lines of standard input. When the worker closes it, this program ends at once."""
    asked: queue.SimpleQueue[str | None] = queue.SimpleQueue()

    def read() -> None:
        for line in sys.stdin:
            asked.put(line)
        os._exit(0)

    threading.Thread(target=read, daemon=True).start()
    return asked


class _Memory:
    """The arrays of a call, in memory shared with the worker."""

    kept: "mmap.mmap | None" = None

    @classmethod
    def array(cls, request: dict[str, Any], name: str) -> Array:
        if cls.kept is None or len(cls.kept) != request["bytes"]:
            file = os.open(request["memory"], os.O_RDWR)
            cls.kept = mmap.mmap(file, request["bytes"])
            os.close(file)
        offset, *shape = request[name]
        return np.ndarray(shape, dtype="<f8", buffer=cls.kept, offset=8 * offset)


def _answer(
    request: dict[str, Any],
    body: "_Traced | _Plain",
    places: tuple[int, int, int],
    tolerance: bool,
    project: Callable[[Array], ArrayLike] | None,
    draw: Callable[[Array], str] | None,
) -> dict[str, Any]:
    call, alpha = request["call"], _Memory.array(request, "alpha").copy()
    if call == "draw" and draw is not None:
        return {"svg": draw(alpha)}
    if call == "project" and project is not None:
        return _put(request, "projected", project(alpha))
    if call not in ("apply", "vjp"):
        raise ValueError("this body does not answer it")
    panels, sensors, channels = places
    own = _Memory.array(request, "forces")
    forces = np.zeros((len(own), panels, own.shape[2]))
    forces[:, request["panels"]] = own
    shape = request["signals" if call == "apply" else "cotangent"][1:]
    times = np.linspace(0.0, request["duration"], shape[1] + 1)[1:]
    rest = (request["tolerance"],) if tolerance else ()
    if call == "apply":
        signals = body.apply(alpha, forces, times, rest)
        wanted = (len(forces), len(times), sensors, channels)
        if signals.shape != wanted:
            raise ValueError(f"signals have shape {signals.shape}: must be (N, T, S, C) = {wanted}")
        return _put(request, "signals", signals[:, :, request["sensors"]])
    cotangent = np.zeros((*shape[:2], sensors, channels))
    cotangent[:, :, request["sensors"]] = _Memory.array(request, "cotangent")
    return _put(request, "gradient", body.vjp(alpha, forces, times, rest, cotangent))


def _put(request: dict[str, Any], name: str, values: ArrayLike) -> dict[str, Any]:
    found = np.asarray(values, dtype=np.float64)
    if list(found.shape) == request[name][1:]:
        _Memory.array(request, name)[...] = found
    return {"shape": list(found.shape)}


class _Plain:
    """A function with its own gradient, called per sample or per batch."""

    def __init__(self, simulate: Callable[..., Any], vjp: Callable[..., ArrayLike], batch: int | None) -> None:
        self._simulate, self._vjp, self._batch = simulate, vjp, batch

    def _parts(self, values: Array) -> "list[Array] | Array":
        batch = self._batch
        return values if batch is None else [values[i : i + batch] for i in range(0, len(values), batch)]

    def apply(self, alpha: Array, forces: Array, times: Array, rest: tuple[float, ...]) -> Array:
        found = [np.asarray(self._simulate(alpha, part, times, *rest)) for part in self._parts(forces)]
        return np.stack(found) if self._batch is None else np.concatenate(found)

    def vjp(self, alpha: Array, forces: Array, times: Array, rest: tuple[float, ...], cotangent: Array) -> Array:
        gradient = np.zeros_like(alpha)
        for part, own in zip(self._parts(forces), self._parts(cotangent), strict=True):
            gradient += np.asarray(self._vjp(alpha, part, times, *rest, own))
        return gradient


class _Traced:
    """A JAX function, compiled once per clock. The last batch is padded with copies of its last sample."""

    def __init__(self, simulate: Callable[..., Any], batch: int) -> None:
        import jax

        jax.config.update("jax_enable_x64", True)  # type: ignore[no-untyped-call, unused-ignore]
        self._batch = batch

        def signals(alpha: Any, forces: Any, times: Any, rest: Any) -> Any:
            return jax.vmap(lambda sample: simulate(alpha, sample, times, *rest))(forces)

        def pullback(alpha: Any, forces: Any, times: Any, rest: Any, cotangent: Any) -> Any:
            return jax.vjp(lambda alpha: signals(alpha, forces, times, rest), alpha)[1](cotangent)[0]

        self._signals, self._pullback = jax.jit(signals), jax.jit(pullback)

    def _filled(self, values: Array, by: float) -> list[Array]:
        parts = [values[first : first + self._batch] for first in range(0, len(values), self._batch)]
        if missing := self._batch - len(parts[-1]):
            parts[-1] = np.concatenate([parts[-1], by * np.repeat(values[-1:], missing, axis=0)])
        return parts

    def apply(self, alpha: Array, forces: Array, times: Array, rest: tuple[float, ...]) -> Array:
        found = [np.asarray(self._signals(alpha, part, times, rest)) for part in self._filled(forces, 1.0)]
        return (np.concatenate(found) if len(found) > 1 else found[0])[: len(forces)]

    def vjp(self, alpha: Array, forces: Array, times: Array, rest: tuple[float, ...], cotangent: Array) -> Array:
        gradient = np.zeros_like(alpha)
        for part, own in zip(self._filled(forces, 1.0), self._filled(cotangent, 0.0), strict=True):
            gradient += np.asarray(self._pullback(alpha, part, times, rest, own))
        return gradient
