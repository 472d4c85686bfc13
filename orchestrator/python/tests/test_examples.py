"""The examples run, and find what they look for."""

import importlib.util
from pathlib import Path

import metasense
import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


def load(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def losses(text):
    return [float(line.split()[3].rstrip(",")) for line in text.splitlines()]


def test_cotrain(body, spec, capsys):
    pytest.importorskip("jax")
    lines = (EXAMPLES / "cotrain.py").read_text().splitlines()
    assert len(lines) <= 70 and len([line for line in lines if line.strip()]) <= 60
    alpha, _ = load("cotrain").main(spec, 40)
    assert body.feasible(alpha) and not np.array_equal(alpha, body.alpha)
    first, *_, last = losses(capsys.readouterr().out)
    assert last < 0.9 * first, (first, last)


def test_place(body, spec):
    found = load("place").main(spec, 3)
    units, errors = zip(*found)
    assert len(set(units)) == 3 and not set(units) & set(body.clamped)
    assert errors[2] < errors[0]


def test_blocks(spec, tmp_path, rng):
    # a row of three triangles as DifFlexMM lays them out, the second upside down and turned
    triangle = np.array([[-6.0, -3.5], [6.0, -3.5], [0.0, 7.0]])
    turn = np.array([[np.cos(0.5), np.sin(0.5)], [-np.sin(0.5), np.cos(0.5)]])
    centroids = np.array([[0.0, 0.0], [14.0, 0.0], [28.0, 0.0]])
    nodes = np.stack([triangle, -triangle[[2, 0, 1]] @ turn.T, triangle])
    bonds = np.array([[1, 3], [4, 8]])
    lines = spec.read_text().replace("[stimuli]", "[sensors]\nplacements = [[2]]\n[stimuli]")
    body, arrays = load("blocks").main(centroids, nodes, bonds, lines, tmp_path)
    assert (body.units, body.clamped, body.panels) == (3, [0], [1])
    for own, theirs in zip(arrays, (centroids, nodes, bonds), strict=True):
        assert np.allclose(own, theirs, atol=1e-9)
    moved = body.alpha + 0.1 * rng.standard_normal(body.alpha.size)
    assert body.feasible(moved)
    at, arms, _ = load("blocks").arrays(body, moved)
    assert np.allclose(at[:, None] + arms, body.vertices(moved))
    forces = body.stimuli("test")
    assert np.isfinite(body.simulate(moved, forces).signals).all()


def test_elbow(spec, tmp_path):
    pytest.importorskip("matplotlib")
    sweep = tmp_path / "sweep.toml"
    sweep.write_text(spec.read_text().replace("sensors = [1]", "sensors = [1, 2, 3]").replace("rows = 3", "rows = 4").replace("columns = 3", "columns = 4"))
    database = metasense.run(sweep, db=tmp_path / "s.sqlite", workers=2, progress=False)
    answer = load("elbow").main(database.path, tmp_path / "elbow.png")
    assert (tmp_path / "elbow.png").read_bytes().startswith(b"\x89PNG")
    assert "verdict" in answer.columns


@pytest.mark.parametrize("kind", ["quads", "kagome"])
def test_focusing(kind, monkeypatch):
    jax = pytest.importorskip("jax")
    monkeypatch.syspath_prepend(EXAMPLES)
    focusing = load("focusing")
    sizes = {"quads": (5, 6), "kagome": (4, 6)}[kind]
    shape, held, driven, targets, _, *others = getattr(focusing, kind)(sizes, (0, 0))
    # 1 mm: so small a body is pushed into chaos by more
    body, objective, limits = focusing.setup(shape, held, driven, targets, 1.0, *others, tolerance=0.1)
    assert limits(body.alpha)[0].max() <= 0
    found = jax.jit(jax.value_and_grad(objective))
    value, gradient = found(body.alpha)
    slope = np.linalg.norm(gradient)
    sides = [found(body.alpha + by * gradient / slope)[0] for by in (1e-2, -1e-2)]
    assert np.isclose((sides[0] - sides[1]) / 2e-2, slope, rtol=1e-2) and value > 0
    values, end = focusing.ascend(found, limits, body.alpha, 4)
    assert np.isclose(found(end)[0], max(values)) and max(values) > 1.5 * value, values
    assert limits(end)[0].max() <= 1e-6
    aside = np.random.default_rng(1).standard_normal(body.alpha.size)
    (low, slopes), (high, _) = (limits(body.alpha + by * aside) for by in (-1e-6, 1e-6))
    assert np.allclose((high - low) / 2e-6, slopes @ aside, atol=1e-5)


def test_mma():
    sparse = pytest.importorskip("scipy.sparse")
    # neighbours' sum is at most 2, and each is best at 2
    slopes = sparse.diags_array([1.0, 1.0], offsets=[0, 1], shape=(9, 10)).tocsr()
    values, x = load("mma").ascend(lambda x: (-((x - 2) ** 2).sum(), 4 - 2 * x), lambda x: (slopes @ x - 2, slopes), np.zeros(10), 40)
    assert np.allclose(x, 1, atol=1e-3) and values[0] == -40


def test_reprogram():
    pytest.importorskip("jax")
    reprogram = load("reprogram")
    alpha, parts = reprogram.main(12)
    assert reprogram.body(0.0).feasible(alpha)
    apart = [cast - pressed for cast, pressed in parts]
    assert abs(apart[0]) < 0.1 and apart[-1] > apart[0] + 0.1, apart
