"""A body's signals as a function of PyTorch, and a function of PyTorch as a body; on the CPU in double precision."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch.autograd.function import once_differentiable

import metasense
from metasense._metasense import Body


def serve_body(simulate: Callable[..., torch.Tensor], alpha0: Any, **rest: Any) -> None:
    """As `metasense.serve_body`, for a PyTorch (≥ 2.0) function of one sample; `torch.func` vectorises and differentiates it."""
    torch.set_num_threads(1)  # of each worker's process

    def signals(alpha: torch.Tensor, forces: torch.Tensor, times: torch.Tensor, *more: float) -> torch.Tensor:
        return torch.func.vmap(lambda sample: simulate(alpha, sample, times, *more))(forces)

    def apply(alpha: Any, forces: Any, times: Any, *more: float) -> Any:
        with torch.no_grad():
            return signals(*map(torch.from_numpy, (alpha, forces, times)), *more).numpy()

    def vjp(alpha: Any, forces: Any, times: Any, *more: Any) -> Any:
        a, f, t, cotangent = map(torch.from_numpy, (alpha, forces, times, more[-1]))
        return torch.func.vjp(lambda a: signals(a, f, t, *more[:-1]), a)[1](cotangent)[0].numpy()

    metasense.serve_body(apply, alpha0, vjp=vjp, batched=True, **rest)


def signals(body: Body, alpha: torch.Tensor, forces: torch.Tensor) -> torch.Tensor:
    """Signals of the sensors of `body`, (N, T, 3M) (mm/s², rad/s), with the design `alpha` under `forces` (N, K, T + 1) (N).

    Differentiable once, in either; the gradient in `forces` is computed only where it is asked for. Raises SimulationError if a
    sample does not reach its end.
    """
    found: torch.Tensor = _Signals.apply(alpha, forces, body)
    return found


class _Signals(torch.autograd.Function):  # type: ignore[misc, unused-ignore]
    @staticmethod
    def forward(ctx: Any, alpha: torch.Tensor, forces: torch.Tensor, body: Body) -> torch.Tensor:
        tape = any(ctx.needs_input_grad)
        simulation = body.simulate(alpha.detach().numpy(), forces.detach().numpy(), tape=tape)
        simulation.check()
        ctx.simulation = simulation
        ctx.dtypes = alpha.dtype, forces.dtype
        return torch.from_numpy(np.array(simulation.signals))

    @staticmethod
    @once_differentiable  # type: ignore[untyped-decorator, unused-ignore]
    def backward(ctx: Any, cotangent: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor | None, None]:
        pull = ctx.simulation.vjp_forces if ctx.needs_input_grad[1] else lambda c: (ctx.simulation.vjp(c), None)
        found = pull(cotangent.contiguous().numpy())
        alpha, forces = (g if g is None else torch.from_numpy(g).to(d) for g, d in zip(found, ctx.dtypes))
        return alpha, forces, None
