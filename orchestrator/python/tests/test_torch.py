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


def test_gradcheck_in_forces(body):
    forces = torch.from_numpy(body.stimuli("train")[:2]).requires_grad_()
    scale = torch.from_numpy(np.abs(body.simulate(body.alpha, forces.detach().numpy()).signals).max(axis=(0, 1)))
    alpha = torch.from_numpy(body.alpha)
    assert torch.autograd.gradcheck(lambda f: signals(body, alpha, f) / scale, (forces,), rtol=1e-4, atol=1e-6)


def test_gradients_in_both_are_those_of_vjp_forces(body):
    forces = torch.from_numpy(body.stimuli("test")).requires_grad_()
    alpha = torch.from_numpy(body.alpha).requires_grad_()
    signals(body, alpha, forces).sum().backward()
    pull = body.simulate(body.alpha, body.stimuli("test")).vjp_forces(np.ones((3, 30, 3)))
    assert np.array_equal(alpha.grad.numpy(), pull[0]) and np.array_equal(forces.grad.numpy(), pull[1])
