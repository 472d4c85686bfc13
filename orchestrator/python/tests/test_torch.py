"""The body as a function of PyTorch, and in its workers."""

import subprocess

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


class Signals(torch.utils.data.Dataset):
    """Samples that are simulated when they are asked for."""

    def __init__(self, body):
        self.body, self.forces = body, body.stimuli("train")

    def __len__(self):
        return len(self.forces)

    def __getitem__(self, number):
        return np.array(self.body.simulate(self.body.alpha, self.forces[number : number + 1]).signals[0])


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_workers_of_a_data_loader(body, method):
    """The body has simulated before the workers are forked, or is pickled for them."""
    data = Signals(body)
    expected = np.stack([data[i] for i in range(4)])
    part = torch.utils.data.Subset(data, range(4))
    loader = torch.utils.data.DataLoader(part, 2, num_workers=2, multiprocessing_context=method, timeout=60)
    assert np.array_equal(torch.cat(list(loader)).numpy(), expected)


LEVELS = """
import torch
from metasense.torch import serve_body

def simulate(alpha, forces, times):
    lag = times[:, None] - times[None, :]
    kernels = torch.exp(-alpha[:, None, None] * lag.clamp(min=0.0)) * (lag >= 0)
    return (kernels @ forces.sum(0)[1:]).T[:, :, None]

serve_body(simulate, [3.0, 20.0], name="levels", panels=["a", "b"], sensors=["x", "y"], channels=["level"], batch=2)
"""


def test_a_function_of_torch_is_a_body(spec, tmp_path):
    from test_serve import of_command

    pytest.importorskip("torch.func", reason="PyTorch 2.0")
    (tmp_path / "levels.py").write_text(LEVELS)
    (tmp_path / "levels.toml").write_text(of_command(spec, "levels.py").replace("tolerance = 1e-7", ""))
    # the command in PATH: a Python with torch may have the package in PYTHONPATH alone
    done = subprocess.run(["metasense", "lab", "verify", "levels.toml"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0 and "derivative" in done.stdout and "false" not in done.stdout, done.stdout + done.stderr
