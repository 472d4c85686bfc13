"""Whatever is passed for an array is understood or refused in words; nothing panics."""

import numpy as np
import pytest

REFUSED = (ValueError, TypeError)


def test_any_layout_of_real_numbers_is_understood(body):
    forces = body.stimuli("train")
    own = body.simulate(body.alpha, forces).signals
    readonly = forces.copy()
    readonly.setflags(write=False)
    spread = np.zeros((*forces.shape[:2], 2 * forces.shape[2]))
    spread[..., ::2] = forces
    swapped = forces.astype(">f8")
    for same in [readonly, spread[..., ::2], np.asfortranarray(forces), forces[::-1][::-1], swapped, forces.tolist()]:
        assert np.array_equal(body.simulate(body.alpha, same).signals, own)
    whole = np.rint(forces)
    assert np.array_equal(
        body.simulate(body.alpha, whole.astype(np.int8)).signals, body.simulate(body.alpha, whole).signals
    )


def test_a_design_has_two_shapes(body):
    """α is (n), or (n/2, 2) with x and y of a shift in a row; an array that is turned, or of other axes, is refused."""
    own, forces = body.alpha, body.stimuli("test")
    pairs = own.reshape(-1, 2)
    assert np.array_equal(body.simulate(pairs, forces).signals, body.simulate(own, forces).signals)
    assert np.array_equal(body.project(np.asfortranarray(pairs)), body.project(own))
    for other in [pairs.T, own[None], own[:, None], pairs[None], own.reshape(-1, 4)]:
        for ask in [body.violations, body.feasible, body.project, lambda a: body.simulate(a, forces)]:
            with pytest.raises(ValueError, match="alpha has shape"):
                ask(other)


def bad(good: np.ndarray) -> list[object]:
    nan, inf = good.copy(), good.copy()
    nan.flat[-1], inf.flat[0] = np.nan, -np.inf
    return [
        nan, inf, good[..., :-1], good[None], good.ravel()[:0], good.astype(complex), good.astype(str), good.astype(object),
        np.float64(1.0), None, "text", [], [[1.0], [1.0, 2.0]], {}, object(), np.array(["2020-01-01"], "M8[D]"),
    ]  # fmt: skip


@pytest.mark.parametrize("number", range(16))
def test_what_is_no_such_array_is_refused(body, number):
    forces = body.stimuli("test")
    simulation = body.simulate(body.alpha, forces)
    for ask in [body.violations, body.feasible, body.project, simulation.jvp, lambda a: body.simulate(a, forces)]:
        with pytest.raises(REFUSED):
            ask(bad(body.alpha)[number])
    with pytest.raises(REFUSED):
        body.simulate(body.alpha, bad(forces)[number])
    with pytest.raises(REFUSED):
        simulation.vjp(bad(simulation.signals.copy())[number])


def test_scalars_and_masked_arrays_are_refused_by_name(body):
    forces = body.stimuli("test")
    with pytest.raises(ValueError, match=r"the forces have shape \[\]"):
        body.simulate(body.alpha, np.float64(3))
    with pytest.raises(TypeError, match="forces is a masked array"):
        body.simulate(body.alpha, np.ma.masked_invalid(forces))


def test_random_shapes_and_numbers(body):
    """A thousand arrays of any shape, size, strides and dtype: an answer, or a refusal."""
    rng = np.random.default_rng(1)
    answers = 0
    for _ in range(1000):
        shape = tuple(int(n) for n in rng.choice([0, 1, 2, 3, 24, 30, 31, 61], rng.integers(0, 4)))
        array = rng.standard_normal(shape) * 10.0 ** rng.integers(-320, 300)
        with np.errstate(all="ignore"):
            array = np.asarray(array).astype(rng.choice(["f8", "f4", "f2", "i8", "u1", "?", "c16", "O"]))
        if array.ndim and rng.random() < 0.5:
            array = array[..., :: int(rng.choice([-1, 2]))].T
        for ask in [body.feasible, lambda a: body.simulate(body.alpha, a), lambda a: body.simulate(a, a)]:
            try:
                ask(array)
                answers += 1
            except REFUSED:
                pass
    assert answers > 0


def test_signals_cannot_be_written_to(body):
    signals = body.simulate(body.alpha, body.stimuli("test")).signals
    with pytest.raises(ValueError, match="read-only"):
        signals[0] = 0.0
