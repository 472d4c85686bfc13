"""A body's signals as a function of JAX: jit, grad and vmap work; forward derivatives (jvp, jacfwd) do not.

Single precision unless `jax_enable_x64` is set: the body itself always computes in its own precision.
"""

import itertools
import os
import threading
from collections import OrderedDict
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from metasense._metasense import Body, Simulation

# On one core JAX may wait for ever: the thread that is to hand a callback its arguments waits for the callback (jax-ml/jax#25861).
if len(os.sched_getaffinity(0)) == 1:
    jax.config.update("jax_cpu_enable_async_dispatch", False)  # type: ignore[no-untyped-call, unused-ignore]

# Simulations that were run forward and may be asked for their gradient, by the number that stands for them in a trace.
_KEPT: OrderedDict[int, Simulation] = OrderedDict()
_MOST = 2
_NUMBERS = itertools.count(1)
_LOCK = threading.Lock()


def signals(body: Body, alpha: Any, forces: Any) -> jax.Array:
    """Signals of the sensors of `body`, (N, T, 3M) (mm/s², rad/s), with the design `alpha` under `forces` (N, K, T + 1) (N).

    Differentiable in both; the gradient in `forces` is computed only where it is asked for. A sample that does not reach its
    end raises SimulationError from the computation.
    """
    found: jax.Array = _signals(body, jnp.asarray(alpha), jnp.asarray(forces))
    return found


def _like(shape: tuple[int, ...], dtype: Any) -> Any:
    return jax.ShapeDtypeStruct(shape, dtype)  # type: ignore[no-untyped-call, unused-ignore]


def _shape(body: Body, forces: Any) -> Any:
    return _like((forces.shape[0], body.instants, 3 * len(body.sensors)), jnp.result_type(float))


def _simulated(body: Body, alpha: Any, forces: Any, tape: bool) -> Simulation:
    simulation = body.simulate(np.asarray(alpha), np.asarray(forces), tape=tape)
    simulation.check()
    return simulation


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def _signals(body: Body, alpha: jax.Array, forces: jax.Array) -> jax.Array:
    out = _shape(body, forces)

    def call(alpha: Any, forces: Any) -> Any:
        return _simulated(body, alpha, forces, False).signals.astype(out.dtype, copy=False)

    found: jax.Array = jax.pure_callback(call, out, alpha, forces, vmap_method="sequential")
    return found


def _forward(body: Body, alpha: Any, forces: Any) -> Any:
    asked = forces.perturbed
    alpha, forces = alpha.value, forces.value
    out = _shape(body, forces)

    def call(alpha: Any, forces: Any) -> Any:
        simulation = _simulated(body, alpha, forces, True)
        with _LOCK:
            number = next(_NUMBERS) % 2**31
            _KEPT[number] = simulation
            while len(_KEPT) > _MOST:
                _KEPT.popitem(last=False)
        return simulation.signals.astype(out.dtype, copy=False), np.int32(number)

    number = _like((), jnp.int32)
    values, number = jax.pure_callback(call, (out, number), alpha, forces, vmap_method="sequential")
    return values, (alpha, forces, number, number if asked else None)


def _backward(body: Body, kept: Any, cotangent: Any) -> Any:
    alpha, forces, number, asked = kept
    if isinstance(cotangent, jax.custom_derivatives.SymbolicZero):
        return jnp.zeros_like(alpha), jnp.zeros_like(forces)

    def call(alpha: Any, forces: Any, number: Any, cotangent: Any) -> Any:
        with _LOCK:
            simulation = _KEPT.get(int(number))
        if simulation is None:  # others came in between
            simulation = _simulated(body, alpha, forces, True)
        if asked is None:
            return simulation.vjp(np.asarray(cotangent)).astype(alpha.dtype, copy=False), ()
        in_alpha, in_forces = simulation.vjp_forces(np.asarray(cotangent))
        return in_alpha.astype(alpha.dtype, copy=False), in_forces.astype(forces.dtype, copy=False)

    out = _like(alpha.shape, alpha.dtype), () if asked is None else _like(forces.shape, forces.dtype)
    found = jax.pure_callback(call, out, alpha, forces, number, cotangent, vmap_method="sequential")
    return found[0], jnp.zeros_like(forces) if asked is None else found[1]


_signals.defvjp(_forward, _backward, symbolic_zeros=True)
