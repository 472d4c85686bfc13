"""The body as a function of PyTorch."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from metasense.torch import signals  # noqa: E402


def test_gradcheck(body):
    forces = torch.from_numpy(body.stimuli("train")[:2])
    scale = torch.from_numpy(np.abs(body.simulate(body.alpha, forces).signals).max(axis=(0, 1)))
    alpha = torch.from_numpy(body.alpha).requires_grad_()
    assert torch.autograd.gradcheck(lambda a: signals(body, a, forces) / scale, (alpha,), rtol=1e-4, atol=1e-6)


def test_gradient_is_that_of_vjp(body):
    forces = body.stimuli("train")
    alpha = torch.from_numpy(body.alpha).requires_grad_()
    signals(body, alpha, torch.from_numpy(forces)).square().sum().backward()
    simulation = body.simulate(body.alpha, forces)
    assert np.array_equal(alpha.grad.numpy(), simulation.vjp(2 * simulation.signals))


def test_a_gradient_in_forces_is_refused(body):
    forces = torch.from_numpy(body.stimuli("test")).requires_grad_()
    with pytest.raises(TypeError, match="cannot be differentiated in `forces`"):
        signals(body, torch.from_numpy(body.alpha), forces)
