"""Values of Python and numpy in specs and arguments: understood, or refused by key and value."""

import pathlib

import metasense
import numpy as np
import pytest

BODY = {
    "columns": 4, "rows": 4, "spacing": 15.0, "ligament_length": 2.25, "density": 1e-8,
    "stiffness": {"stretch": 3.0, "shear": 0.5, "bend": 1.0},
}  # fmt: skip


def made(**changes):
    tables = {"stimuli": {"kind": "bell"}, "sweep": {"panels": [1], "sensors": [1]}, **changes}
    return metasense.body(body={**BODY, **tables.pop("body", {})}, **tables)


def test_scalars_and_arrays_of_numpy_are_numbers():
    plain = made(stimuli={"kind": "bell", "onset": [0.25, 0.5]})
    for tables in [
        {"body": {"columns": np.int64(4), "rows": np.array(4), "spacing": np.float32(15.0)}},
        {"body": {"stiffness": {"stretch": np.float64(3.0), "shear": np.float16(0.5), "bend": np.uint8(1)}}},
        {"sweep": {"panels": np.array([1]), "sensors": (np.int32(1),)}},
        {"sweep": {"panels": range(1, 2), "sensors": [1]}, "body": {"material": None}},
    ]:
        assert made(**{"stimuli": {"kind": "bell", "onset": np.array([0.25, 0.5])}, **tables}).hash == plain.hash
    assert made(stimuli={"kind": np.str_("bell"), "onset": (0.25, np.float32(0.5))}).hash == plain.hash


def test_paths_are_texts(tmp_path):
    np.save(tmp_path / "f.npy", made().stimuli("train", 0, 8))
    stimuli = {"kind": "recorded", "samples": 4, "test": 2, "holdout": 2}
    files = {"files": [tmp_path / "f.npy"], "rate": np.int64(100), "augment": {"shift": (0, 0)}}
    assert made(stimuli={**stimuli, "recorded": files}).stimuli("train").shape[0] == 2
    with pytest.raises((ValueError, OSError), match="none.npy") as refused:
        made(stimuli={**stimuli, "recorded": {"files": (tmp_path / "none.npy",)}})
    assert "PosixPath" not in str(refused.value)


@pytest.mark.parametrize(
    ("tables", "error", "says"),
    [
        ({"body": {"spacing": float("nan")}}, ValueError, ["body.spacing", "nan"]),
        ({"body": {"density": np.float32("inf")}}, ValueError, ["body.density", "inf"]),
        ({"body": {"stiffness": {"bend": -np.inf}}}, ValueError, ["body.stiffness.bend", "-inf"]),
        ({"stimuli": {"kind": "bell", "onset": np.array([0.1, np.nan])}}, ValueError, ["stimuli.onset[1]", "nan"]),
        ({"body": {"columns": 2**70}}, ValueError, ["body.columns"]),
        ({"body": {"columns": 4.5}}, ValueError, ["body.columns", "4.5"]),
        ({"body": {"columns": True}}, ValueError, ["body.columns", "true"]),
        ({"body": {"columns": np.bool_(True)}}, ValueError, ["body.columns", "true"]),
        ({"body": {"columns": "4"}}, ValueError, ["body.columns", "4"]),
        ({"body": {"columns": 1 + 0j}}, TypeError, ["body.columns", "complex"]),
        ({"body": {"columns": np.complex128(1)}}, TypeError, ["body.columns", "complex"]),
        ({"body": {"columns": b"4"}}, TypeError, ["body.columns", "bytes"]),
        ({"body": {"columns": object()}}, TypeError, ["body.columns", "object"]),
        ({"body": {1: 2}}, TypeError, ["body", "1"]),
        ({"body": {"unknown": 1}}, ValueError, ["unknown"]),
        ({"sweep": {"panels": {1}, "sensors": [1]}}, TypeError, ["sweep.panels", "set"]),
        ({"sweep": {"panels": [1, None], "sensors": [1]}}, TypeError, ["sweep.panels[1]", "None"]),
        ({"sweep": {"panels": np.datetime64("2020-01-01"), "sensors": [1]}}, TypeError, ["sweep.panels", "date"]),
        ({"stimuli": {"kind": "\ud800"}}, ValueError, ["stimuli.kind"]),
    ],
)
def test_what_a_spec_cannot_hold_is_refused_by_key_and_value(tables, error, says):
    with pytest.raises(error) as refused:
        made(**tables)
    assert all(word in str(refused.value) for word in says), refused.value


@pytest.mark.parametrize("wrong", [0, -1, 1025, 100_000, 10**9, 2**64, 10**30, True, False, 1.0, 2.5, np.float64(2), "2", [2], np.bool_(True)])
def test_threads_are_limited_as_on_the_command_line(spec, body, wrong):
    for ask in [
        lambda: metasense.Body.from_spec(spec, threads=wrong),
        lambda: metasense.body(body=BODY, threads=wrong),
        lambda: metasense.run(spec, threads=wrong if wrong != "2" else "two", progress=False),
        lambda: metasense.run(spec, workers=wrong if wrong != "2" else "two", progress=False),
    ]:
        with pytest.raises((ValueError, TypeError)) as refused:
            ask()
        assert "threads" in str(refused.value) or "workers" in str(refused.value)


def test_whole_numbers_of_numpy_are_whole_numbers(spec, body):
    assert metasense.Body.from_spec(spec, threads=np.int64(2)).threads == 2
    assert metasense.Body.from_spec(spec, threads=np.array(1)).threads == 1
    forces = body.stimuli("train", np.int32(1), np.uint8(2))
    assert np.array_equal(forces, body.stimuli("train", 1, 2))
    own = body.simulate(body.alpha, forces, sensors=[4, 5]).signals
    for units in [(4, 5), np.array([4, 5]), np.array([4, 5], np.uint8), [np.int64(4), 5]]:
        assert np.array_equal(body.simulate(body.alpha, forces, sensors=units).signals, own)
    brain = metasense.LinearBrain(np.array([3, 2]), np.float32(0.25), seed=np.int64(4)).fit(own, forces)
    assert brain.ridge == 0.25


@pytest.mark.parametrize("wrong", [-1, 1.5, True, "1", None, 2**70])
def test_what_is_no_whole_number_is_refused_by_name(body, wrong):
    forces = body.stimuli("test")
    for name, ask in [
        ("first", lambda: body.stimuli("train", wrong, 1)),
        ("seed", lambda: metasense.LinearBrain(seed=wrong)),
        ("sensors", lambda: body.simulate(body.alpha, forces, sensors=[wrong])),
        ("memory", lambda: metasense.LinearBrain((wrong, wrong))),
    ]:
        with pytest.raises((ValueError, TypeError), match=name):
            ask()
    with pytest.raises(MemoryError, match="count"):
        body.stimuli("fresh", 0, 10**17)


def test_a_path_may_be_any_path(spec):
    assert metasense.Body.from_spec(str(spec)).hash == metasense.Body.from_spec(pathlib.Path(spec)).hash
