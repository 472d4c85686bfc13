"""A body from Python is the trial's: the same signals, stimuli and designs to the bit."""

import json
import os

import metasense
import numpy as np
import pytest


def test_signals_and_gradient_are_those_of_the_command(body, spec, command, tmp_path, rng):
    forces = body.stimuli("train")[:3]
    alpha = body.alpha + 0.01 * rng.standard_normal(body.alpha.shape)
    cotangent = rng.standard_normal((3, body.instants, 3))
    for name, array in [("f", forces), ("a", alpha), ("c", cotangent)]:
        np.save(tmp_path / f"{name}.npy", array)
    arguments = ["body", "simulate", spec, body.hash, "--forces", "f.npy", "--design", "a.npy"]
    command(*arguments, "--cotangent", "c.npy", "--out-dir", "o", cwd=tmp_path)
    simulation = body.simulate(alpha, forces)
    assert np.array_equal(simulation.signals, np.load(tmp_path / "o/signals.npy"))
    assert np.array_equal(simulation.vjp(cotangent), np.load(tmp_path / "o/gradient.npy"))
    assert simulation.ok.all() and set(simulation.outcomes) == {"ok"}
    assert np.abs(simulation.signals).max() > 1.0


def test_stimuli_are_those_of_a_trial(body, spec, command, tmp_path):
    command("run", spec, "--db", "s.sqlite", "--workers", 2, cwd=tmp_path)
    command("export", "s.sqlite", body.hash, "--format", "npz", "--out", "t.npz", cwd=tmp_path)
    with np.load(tmp_path / "t.npz") as trial:
        forces, split = trial["forces"], trial["split"]
        alpha = trial["alpha_initial"]
    for number, name in enumerate(["train", "test", "holdout"]):
        of_trial = forces[split == number]
        assert np.array_equal(body.stimuli(name), of_trial)
        assert np.array_equal(body.stimuli(name, 1, 2), of_trial[1:3])
    assert [np.count_nonzero(split == n) for n in range(3)] == [9, 3, 4]
    assert np.array_equal(body.alpha, alpha)


def test_fresh_samples_are_numbered(body):
    some = body.stimuli("fresh", 5, 4)
    assert np.array_equal(some[1:3], body.stimuli("fresh", 6, 2))
    assert not np.array_equal(some[0], some[1])
    with pytest.raises(ValueError, match="count must be given"):
        body.stimuli("fresh")
    with pytest.raises(ValueError, match="the trial has 9 train samples"):
        body.stimuli("train", 8, 2)
    with pytest.raises(ValueError, match='set = "tests"'):
        body.stimuli("tests")


def test_a_tuned_body_keeps_its_integrator(body, rng):
    forces = body.stimuli("train")
    tuned = body.tuned(body.alpha, forces)
    own, same = body.simulate(body.alpha, forces), tuned.simulate(body.alpha, forces)
    assert np.array_equal(own.signals, same.signals) and own.solver == same.solver
    alpha = body.alpha + 0.05 * rng.standard_normal(body.alpha.shape)
    scale = np.abs(own.signals).max()
    assert np.allclose(tuned.simulate(alpha, forces).signals, body.simulate(alpha, forces).signals, atol=1e-5 * scale)


def test_a_body_draws_itself(body):
    assert body._repr_svg_() == body.draw(body.alpha)
    assert body.draw().startswith("<svg") and body.draw() != body.draw(body.alpha * 0.5)


def test_threads_change_nothing(body, spec):
    one = metasense.Body.from_spec(spec, threads=1)
    forces = body.stimuli("train")
    a, b = one.simulate(one.alpha, forces), body.simulate(body.alpha, forces)
    assert np.array_equal(a.signals, b.signals)
    assert np.array_equal(a.vjp(a.signals), b.vjp(b.signals))
    assert (one.threads, body.threads) == (1, 2)


def test_a_body_says_what_it_is(body):
    assert (body.units, body.panels, body.clamped) == (9, [7], [0, 1, 2])
    assert (body.instants, body.duration, body.sensors) == (30, 0.3, [4])
    assert body.vertices().shape == (9, 4, 2)
    moved = body.alpha
    moved[0] += 0.5
    assert np.isclose(np.abs(body.vertices(moved) - body.vertices()).sum(), 0.5)
    assert body.hash in repr(body)


def test_designs_are_judged_and_repaired(body, rng):
    assert body.feasible(body.alpha) and body.violations(body.alpha) == []
    bad = body.alpha
    bad[4] += 20.0
    assert not body.feasible(bad)
    assert any("unit" in what for what in body.violations(bad))
    near = body.project(bad)
    assert body.feasible(near) and not np.array_equal(near, body.alpha)
    assert np.array_equal(body.project(near), near)
    with pytest.raises(ValueError, match="previous cannot be cast"):
        body.project(100 * rng.standard_normal(bad.size), 100 * rng.standard_normal(bad.size))


def test_material_and_sensors_of_a_call(body, spec):
    forces = body.stimuli("test")
    own = body.simulate(body.alpha, forces)
    same = body.simulate(
        body.alpha, forces, sensors=body.sensors, stiffness=body.stiffness,
        damping_ratio=body.damping_ratio, density=body.density,
    )  # fmt: skip
    assert np.array_equal(own.signals, same.signals)
    for other in [{"stiffness": [3.0, 0.5, 2.0]}, {"damping_ratio": 0.1}, {"density": 2e-8}]:
        assert not np.allclose(own.signals, body.simulate(body.alpha, forces, **other).signals)
    two = body.simulate(body.alpha, forces, sensors=[4, 5])
    assert two.signals.shape == (3, 30, 6)
    assert np.allclose(two.signals[..., :3], own.signals, rtol=1e-4, atol=1e-3 * np.abs(own.signals).max())
    with pytest.raises(ValueError, match="sensors = 0: is clamped"):
        body.simulate(body.alpha, forces, sensors=[0])
    with pytest.raises(ValueError, match="bend = -1: must be a number above 0"):
        body.simulate(body.alpha, forces, stiffness=[3.0, 0.5, -1.0])


CHIPS = ["noise = 0.03\nbias = [50.0, 0.01]\nrange = [2000.0, 3.0]", 'noise = 0.03\ndelay = 0.004\nbandwidth = 60.0\nchannels = ["ax", "omega"]']


@pytest.mark.parametrize("sensors", CHIPS)
def test_noise_is_that_of_a_trial(sensors, spec, command, tmp_path, rng):
    noisy = tmp_path / "noisy.toml"
    noisy.write_text(spec.read_text() + f"[sensors]\n{sensors}\n")
    body = metasense.Body.from_spec(noisy)
    command("run", noisy, "sweep.seeds=[3]", "--db", "n.sqlite", cwd=tmp_path)
    command("export", "n.sqlite", body.hash, "--format", "npz", "--out", "t.npz", cwd=tmp_path)
    with np.load(tmp_path / "t.npz") as trial:
        forces, signals = trial["forces"], trial["signals_initial"]
    simulated = [body.simulate(body.alpha, forces, noise_seed=seed) for seed in (body.seed, 7)]
    assert np.array_equal(simulated[0].signals, signals)
    assert not np.array_equal(simulated[1].signals, signals)
    ideal = body.simulate(body.alpha, forces).signals
    assert ideal.shape == (*signals.shape[:2], 3) and not np.array_equal(ideal, signals)
    # the same derivative forward and backward
    tangent, cotangent = rng.standard_normal(body.alpha.shape), rng.standard_normal(signals.shape)
    along = (cotangent * simulated[0].jvp(tangent)).sum()
    assert np.isclose(along, simulated[0].vjp(cotangent) @ tangent, rtol=1e-6) and along != 0.0


def test_noise_needs_a_chip_and_own_forces(body, spec, tmp_path):
    forces = body.stimuli("test")
    with pytest.raises(ValueError, match="noise_seed = 1: .* set sensors.noise"):
        body.simulate(body.alpha, forces, noise_seed=1)
    slow = tmp_path / "slow.toml"
    slow.write_text(spec.read_text() + "[sensors]\nnoise = [1.0, 0.1]\nbandwidth = 60.0\n")
    slow = metasense.Body.from_spec(slow)
    two = slow.simulate(slow.alpha, forces, sensors=[4, 5], noise_seed=1)
    assert two.signals.shape == (3, 30, 6)
    with pytest.raises(ValueError, match="have no derivatives in the forces"):
        two.vjp_forces(two.signals)


def test_a_body_by_keywords_is_that_of_the_file(body, spec):
    try:
        import tomllib
    except ModuleNotFoundError:  # Python 3.10
        pytest.skip("no tomllib")
    tables = tomllib.loads(spec.read_text())
    tables.pop("name")
    tables["body"]["material"] = None  # not given
    made = metasense.body(**tables)
    assert made.hash == body.hash and np.array_equal(made.alpha, body.alpha)
    tables["body"]["density"] = -1.0
    with pytest.raises(ValueError, match="body.density = -1"):
        metasense.body(**tables)
    json.dumps(tables)  # still plain


def test_specs_and_hashes_that_are_none(spec, tmp_path):
    with pytest.raises(OSError, match="missing.toml"):
        metasense.Body.from_spec(tmp_path / "missing.toml")
    assert metasense.Body.from_spec(os.fsencode(spec)).hash == metasense.Body.from_spec(spec).hash
    for name, text, why in [
        ("s.sqlite", b"SQLite format 3\0", "s.sqlite is a database; SPEC must be the .toml file"),
        ("wide.toml", spec.read_text().encode("utf-16"), "wide.toml is not UTF-8"),
    ]:
        (tmp_path / name).write_bytes(text)
        with pytest.raises(ValueError, match=why):
            metasense.Body.from_spec(tmp_path / name)
    with pytest.raises(ValueError, match="zzzz: no hash begins with this text"):
        metasense.Body.from_spec(spec, "zzzz")
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(spec.read_text().replace("columns = 3", "columns = 1"))
    with pytest.raises(ValueError, match=r"wrong.toml:4.*body.columns = 1: must be at least 2"):
        metasense.Body.from_spec(wrong)


def test_samples_that_fail_are_an_exception_or_a_mask(body):
    forces = body.stimuli("test")
    forces[1] *= 1e300
    simulation = body.simulate(body.alpha, forces)
    assert simulation.ok.tolist() == [True, False, True]
    assert not simulation.signals[1].any() and simulation.signals[0].any()
    with pytest.raises(metasense.SimulationError, match="1 of 3 samples") as raised:
        simulation.check()
    assert raised.value.outcomes == simulation.outcomes
    kept = body.simulate(body.alpha, forces[[0, 2]])
    assert np.allclose(simulation.vjp(np.ones((3, 30, 3))), kept.vjp(np.ones((2, 30, 3))), rtol=1e-3)
