"""The linear brain from Python is the one that reads a trial's bodies."""

import metasense
import numpy as np
import pytest


def test_a_trial_s_linear_brain_comes_back(body, spec, command, tmp_path):
    command("run", spec, "--db", "s.sqlite", "--workers", 2, cwd=tmp_path)
    command("export", "s.sqlite", body.hash, "--format", "npz", "--out", "t.npz", cwd=tmp_path)
    with np.load(tmp_path / "t.npz") as file:
        trial = dict(file)
    train = trial["split"] == 0
    for name in ["initial", "optimised"]:
        signals = trial[f"signals_{name}"]
        brain = metasense.LinearBrain(seed=3)
        assert brain.fit(signals[train], trial["forces"][train], signal_scale=trial["signal_scale"]) is brain
        assert np.array_equal(brain.predict(signals), trial[f"linear_predictions_{name}"])
        assert np.array_equal(brain.bias, trial[f"linear_b_{name}"])
    own = metasense.LinearBrain(seed=3).fit(trial["signals_initial"][train], trial["forces"][train])
    assert np.array_equal(own.predict(trial["signals_initial"]), trial["linear_predictions_initial"])


def test_vjp_is_the_transpose_of_predict(body, rng):
    forces = body.stimuli("train")
    signals = body.simulate(body.alpha, forces).signals
    brain = metasense.LinearBrain((5, 2), 1e-3).fit(signals, forces)
    assert brain.ridge == 1e-3 and 0.0 < brain.error < 100.0
    tangent, cotangent = rng.standard_normal(signals.shape), rng.standard_normal((len(forces), 30, 1))
    left = np.vdot(brain.predict(signals + tangent) - brain.predict(signals), cotangent)
    assert np.isclose(left, np.vdot(brain.vjp(cotangent), tangent), rtol=1e-6) and left != 0


def test_what_does_not_fit_is_refused(body):
    forces = body.stimuli("train")
    signals = body.simulate(body.alpha, forces).signals
    brain = metasense.LinearBrain()
    with pytest.raises(ValueError, match="call `fit` first"):
        brain.predict(signals)
    for wrong in [signals[:-1], signals[:, :-1], signals[0], signals * np.nan, np.empty((9, 0, 3))]:
        with pytest.raises(ValueError):
            brain.fit(wrong, forces)
    with pytest.raises(ValueError, match="signal_scale"):
        brain.fit(signals, forces, signal_scale=[1.0, 0.0, 1.0])
    with pytest.raises(ValueError, match="forces: all are zero"):
        brain.fit(signals, np.zeros_like(forces))
    brain.fit(signals, forces)
    with pytest.raises(ValueError, match="signals has shape"):
        brain.predict(signals[..., :2])
    with pytest.raises(ValueError, match="ridge = -1"):
        metasense.LinearBrain(ridge=-1.0)
