"""What tests share: a small body, and the command that was installed with the module."""

import subprocess
from pathlib import Path

import metasense
import numpy as np
import pytest

SPEC = """
name = "small"
[body]
columns = 3
rows = 3
spacing = 15.0
ligament_length = 2.25
density = 1e-8
stiffness = { stretch = 3.0, shear = 0.5, bend = 1.0 }
[time]
duration = 0.3
samples = 30
[solver]
tolerance = 1e-7
[stimuli]
kind = "bell"
samples = 12
test = 3
holdout = 4
onset = [0.0, 0.1]
[brain]
iterations = 10
[optimise]
iterations = 8
brain = "linear"
batch = 4
[sweep]
panels = [1]
sensors = [1]
seeds = [3, 5]
"""


@pytest.fixture(scope="session")
def spec(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("spec") / "small.toml"
    path.write_text(SPEC)
    return path


@pytest.fixture(scope="session")
def body(spec: Path) -> metasense.Body:
    return metasense.Body.from_spec(spec, threads=2)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


@pytest.fixture(scope="session")
def command():
    """Runs the installed `metasense` and gives what it wrote to standard output."""

    def run(*arguments: object, cwd: Path) -> str:
        done = subprocess.run([metasense.program(), *map(str, arguments)], cwd=cwd, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run
