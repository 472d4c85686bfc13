"""Bodies of one's own: what `serve_body` answers is what the function computes, and a foreign copy of our body is our body."""

import json
import subprocess
import sys
from pathlib import Path

import metasense
import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"

# two decaying levels (T, 2, 1) by the same sum of forces, with its gradient
LEVELS = """
import metasense
import numpy as np

def parts(alpha, forces, times):
    lag = times[:, None] - times[None, :]
    kernels = [np.where(lag >= 0, np.exp(-a * np.maximum(lag, 0)), 0) for a in alpha]
    return lag, kernels, forces.sum(axis=0)[1:]

def simulate(alpha, forces, times):
    print("a line that is no answer")
    _, kernels, push = parts(alpha, forces, times)
    return np.stack([kernel @ push for kernel in kernels], axis=1)[:, :, None]

def vjp(alpha, forces, times, cotangent):
    lag, kernels, push = parts(alpha, forces, times)
    return np.array([cotangent[:, j, 0] @ (-lag * kernel) @ push for j, kernel in enumerate(kernels)])

metasense.serve_body(
    simulate, [3.0, 20.0], name="levels", panels=["a", "b"], sensors=["x", "y"], channels=["level"], vjp=vjp,
    lower=1.0, upper=[10.0, 40.0], project=lambda alpha: np.round(alpha, 3), draw=lambda alpha: f"<svg><!--{alpha[0]}--></svg>",
)
"""


def of_command(spec: Path, *command: object) -> str:
    """The spec of the small body with an external one in its place."""
    text = spec.read_text()
    body = json.dumps([str(word) for word in (sys.executable, *command)])
    head, rest = text.split("[body]")
    return f'{head}[body]\nkind = "external"\ncommand = {body}\n[time]{rest.split("[time]")[1]}'


def test_a_function_with_its_gradient_is_trained(spec, tmp_path, command):
    (tmp_path / "levels.py").write_text(LEVELS)
    text = of_command(spec, "levels.py").replace("tolerance = 1e-7", "").replace("batch = 4", "batch = 4\nlearning_rate = 0.3")
    (tmp_path / "levels.toml").write_text(text)
    command("lab", "verify", "levels.toml", cwd=tmp_path)
    command("run", "levels.toml", "--workers", "1", cwd=tmp_path)
    database = metasense.Database(tmp_path / "results" / "small.sqlite")
    trials = database.query("SELECT hash, holdout_error_initial AS a, holdout_error_optimised AS b FROM v_trial").to_dict()
    assert len(trials["hash"]) == 2 and all(error > 0 for error in trials["a"])
    command("body", "draw", "levels.toml", "--out", "d.svg", cwd=tmp_path)
    assert (tmp_path / "d.svg").read_text() == "<svg><!--3.0--></svg>"


def test_an_error_of_the_function_is_told(spec, tmp_path):
    (tmp_path / "levels.py").write_text(LEVELS.replace("[:, :, None]", ""))
    (tmp_path / "levels.toml").write_text(of_command(spec, "levels.py").replace("tolerance = 1e-7", ""))
    done = subprocess.run([metasense.program(), "trial", "levels.toml"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode != 0 and "body_invalid" in done.stderr and ", 30, 2, 1)" in done.stderr, done.stderr


def test_our_body_in_jax_is_our_body(spec, tmp_path, command, body):
    pytest.importorskip("jax")
    command_of = of_command(spec, EXAMPLES / "lattice.py", 3, 3, "1e-6").replace("tolerance = 1e-7", "")
    placed = "[sensors]\nplacements = [[{}]]\n[stimuli]"
    foreign = command_of.replace("[stimuli]", placed.format(body.sensors[0] - 3))
    foreign = foreign.replace('kind = "external"', f'kind = "external"\npanel_units = [{body.panels[0] - 6}]')
    own = spec.read_text().replace("density = 1e-8", "density = 1e-6").replace("[stimuli]", placed.format(body.sensors[0])) + "[feasible]\nlimits = false\n"
    rows = []
    for name, text in (("foreign", foreign), ("own", own)):
        (tmp_path / f"{name}.toml").write_text(text.replace("iterations = 8", "iterations = 2"))
        table = command("trial", f"{name}.toml", "--format", "json", cwd=tmp_path)
        rows.append(json.loads(table)[0])
    for key in ("holdout_error_initial", "holdout_error_optimised"):
        theirs, ours = (row[key] for row in rows)
        assert abs(theirs / ours - 1) < 1e-3, (key, rows)
    assert rows[0]["best_step"] == rows[1]["best_step"]


@pytest.mark.parametrize("name", ["plate", "magnets"])
def test_an_example_has_the_gradient_of_its_signals(name, tmp_path, command):
    pytest.importorskip("jax")
    text = (EXAMPLES / f"{name}.toml").read_text().replace(f'"{name}.py"', f'"{EXAMPLES / name}.py"')
    text = text.replace('"python3"', f'"{sys.executable}"')
    (tmp_path / f"{name}.toml").write_text(text)
    table = command("lab", "verify", f"{name}.toml", cwd=tmp_path)
    assert "derivative" in table and "false" not in table, table


def test_a_plate_rings_as_theory_says(tmp_path):
    jax = pytest.importorskip("jax")
    jax.config.update("jax_enable_x64", True)
    from test_examples import load

    plate = load("plate")
    stiffness = plate.LAPLACIAN @ plate.LAPLACIAN * plate.MODULUS * plate.THICKNESS**3 / 12 / (1 - plate.POISSON**2)
    lowest = np.sqrt(np.linalg.eigvalsh(stiffness / (plate.DENSITY * plate.THICKNESS))[0])
    rigidity = plate.MODULUS * plate.THICKNESS**3 / 12 / (1 - plate.POISSON**2)
    theory = 2 * np.pi**2 / plate.SIDE**2 * np.sqrt(rigidity / (plate.DENSITY * plate.THICKNESS))
    assert abs(lowest / theory - 1) < 0.03


def test_the_torque_of_magnets_is_the_gradient_of_their_energy():
    jax = pytest.importorskip("jax")
    jax.config.update("jax_enable_x64", True)
    from test_examples import load

    magnets = load("magnets")
    field, directions = np.array([0.3, -0.2]), np.linspace(0.0, 20.0, magnets.UNITS)

    def energy(direction):
        c, s = jax.numpy.cos(direction), jax.numpy.sin(direction)
        pairs = c @ (magnets.XX @ c + magnets.XY @ s) + s @ (magnets.XY @ c + magnets.YY @ s)
        return -magnets.MOMENT * (pairs / 2 + field[0] * c.sum() + field[1] * s.sum())

    torque = magnets.torque(directions, field)
    assert np.allclose(torque, -jax.grad(energy)(directions), rtol=1e-12, atol=0) and np.ptp(torque) > 0
    x, y = (magnets.SPACING * 1e-3 * (axis[7] - axis[0]) for axis in (magnets.x, magnets.y))
    by_a_dipole = 1e3 * 1e-7 * magnets.MOMENT * (3 * x * x / (x * x + y * y) - 1) / np.hypot(x, y) ** 3  # mT, on x
    assert magnets.XX[7, 0] == pytest.approx(by_a_dipole, rel=1e-12)
