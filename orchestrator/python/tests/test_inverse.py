"""A body read by its own model, and by that of its twin."""

from pathlib import Path

import metasense
import numpy as np
import pytest


@pytest.fixture(scope="module")
def noisy(spec: Path) -> Path:
    path = spec.parent / "noisy.toml"
    path.write_text(spec.read_text().replace("[sweep]", "[sensors]\nnoise = 0.02\n[sweep]"))
    return path


def error(said, forces):
    truth = forces[:, :, 1:].transpose(0, 2, 1)
    return np.sum((said - truth) ** 2) / np.sum(truth**2)


def test_it_reads_as_the_command_does(noisy, command, tmp_path):
    body = metasense.Body.from_spec(noisy, threads=2)
    call = ["lab", "evaluate", noisy, "--brain", "inverse", "--records", "initial=holdout", "--out-dir", "o"]
    command(*call, cwd=tmp_path)
    with np.load(tmp_path / "o/records.npz") as file:
        trial = dict(file)
    inverse = metasense.Inverse(body)
    forces, low, high = inverse.fit(trial["signals_initial"])
    assert np.array_equal(forces, trial["predictions_initial"])
    assert np.array_equal(low, trial["forces_low_initial"]) and np.array_equal(high, trial["forces_high_initial"])
    assert (low < forces).all() and (forces < high).all() and inverse.unexplained == 0
    assert error(forces, body.stimuli("holdout")) < 0.05
    # one sample as among others
    assert np.allclose(inverse.fit(trial["signals_initial"][1:2])[0], forces[1:2], atol=1e-9)
    with pytest.raises(ValueError, match="signals has shape"):
        inverse.fit(trial["signals_initial"][..., :2])
    with pytest.raises(ValueError, match="shape \\[3\\]"):
        metasense.Inverse(body, [1.0, 2.0, 3.0])


def test_a_twin_reads_its_cast(noisy, spec, tmp_path, rng):
    body = metasense.Body.from_spec(noisy, threads=2)
    forces = body.stimuli("train")
    of_cast = body.simulate(body.alpha, forces, stiffness=body.stiffness * [1.05, 0.96, 1.08]).signals
    signals = of_cast + 0.02 * of_cast.std(axis=(0, 1)) * rng.standard_normal(of_cast.shape)
    twin = body.twin(forces, signals)
    assert twin.ending == "converged" and 0.8 < twin.misfit < 1.2
    assert abs(twin.material["bend"] - 1.08) < 0.05 and twin.alpha.shape == body.alpha.shape
    by_design = error(metasense.Inverse(body).fit(signals)[0], forces)
    by_twin = error(metasense.Inverse(body, twin=twin).fit(signals)[0], forces)
    assert by_twin < 0.5 * by_design
    twin.save(tmp_path / "t.toml")
    again = body.read_twin(tmp_path / "t.toml")
    assert again.material == twin.material and again.ending is None
    other = body.alpha + 0.01
    with pytest.raises(ValueError, match="belongs to another body"):
        body.read_twin(tmp_path / "t.toml", other)
    with pytest.raises(OSError, match="none.toml"):
        body.read_twin(tmp_path / "none.toml")
    with pytest.raises(ValueError, match="cannot be passed together with twin"):
        metasense.Inverse(body, other, twin=twin)
    moved = spec.parent / "moved.toml"
    moved.write_text(noisy.read_text().replace("columns = 3", "columns = 4"))
    with pytest.raises(ValueError, match="twin: belongs to another body"):
        metasense.Inverse(metasense.Body.from_spec(moved), twin=twin)
    with pytest.raises(ValueError, match="signals has shape"):
        body.twin(forces, signals[:-1])
