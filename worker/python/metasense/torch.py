"""A body's signals as a function of PyTorch, on the CPU in double precision."""

from typing import Any

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from metasense._metasense import Body


def signals(body: Body, alpha: torch.Tensor, forces: torch.Tensor) -> torch.Tensor:
    """What the sensors of `body` feel, (N, T, 3M) (mm/s², rad/s), with the design `alpha` under `forces` (N, K, T + 1) (N).

    Differentiable once and in `alpha`; TypeError where `forces` ask for a gradient. Raises SimulationError if a sample
    does not reach its end.
    """
    if forces.requires_grad:
        raise TypeError("metasense.torch.signals cannot be differentiated in `forces`, only in `alpha`")
    found: torch.Tensor = _Signals.apply(alpha, forces, body)
    return found


class _Signals(torch.autograd.Function):  # type: ignore[misc, unused-ignore]
    @staticmethod
    def forward(ctx: Any, alpha: torch.Tensor, forces: torch.Tensor, body: Body) -> torch.Tensor:
        tape = ctx.needs_input_grad[0]
        simulation = body.simulate(alpha.detach().numpy(), forces.detach().numpy(), tape=tape)
        simulation.check()
        ctx.simulation = simulation
        ctx.dtype = alpha.dtype
        return torch.from_numpy(np.array(simulation.signals))

    @staticmethod
    @once_differentiable  # type: ignore[untyped-decorator, unused-ignore]
    def backward(ctx: Any, cotangent: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        gradient = ctx.simulation.vjp(cotangent.contiguous().numpy())
        return torch.from_numpy(gradient).to(ctx.dtype), None, None
