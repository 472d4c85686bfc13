"""Derivatives against each other and against differences."""

import numpy as np
import pytest


def test_vjp_is_the_transpose_of_jvp(body, rng):
    simulation = body.simulate(body.alpha, body.stimuli("train"))
    tangent = rng.standard_normal(body.alpha.shape)
    along = {"stiffness": rng.standard_normal(3), "damping_ratio": 0.3, "density": 1e-9}
    forces = rng.standard_normal(body.stimuli("train").shape)
    cotangent = rng.standard_normal(simulation.signals.shape)
    design, material = simulation.vjp_material(cotangent)
    left = np.vdot(cotangent, simulation.jvp(tangent, **along))
    right = design @ tangent + sum(np.vdot(material[key], along[key]) for key in along)
    assert abs(left / right - 1) < 1e-9, (left, right)
    assert np.array_equal(design, simulation.vjp(cotangent))
    same, pushed = simulation.vjp_forces(cotangent)
    left = np.vdot(cotangent, simulation.jvp(0 * tangent, forces=forces))
    assert abs(left / np.vdot(pushed, forces) - 1) < 1e-9 and np.allclose(same, design, rtol=1e-9)
    assert abs(np.vdot(cotangent, simulation.jvp(tangent)) / (design @ tangent) - 1) < 1e-9


@pytest.mark.parametrize("key", ["alpha", "stiffness", "damping_ratio", "density"])
def test_vjp_agrees_with_differences(body, rng, key):
    """Central differences, ε² apart from the slope."""
    forces = body.stimuli("train")
    own = {"alpha": body.alpha, "stiffness": body.stiffness, "damping_ratio": body.damping_ratio, "density": body.density}
    cotangent = rng.standard_normal((len(forces), body.instants, 3))
    tangent = np.asarray(own[key]) * rng.standard_normal(np.shape(own[key]))

    def value(step):
        given = {**own, key: own[key] + step * tangent}
        return np.vdot(cotangent, body.simulate(given.pop("alpha"), forces, tape=False, **given).signals)

    design, material = body.simulate(body.alpha, forces).vjp_material(cotangent)
    slope = np.vdot({"alpha": design, **material}[key], tangent)
    errors = [abs((value(s) - value(-s)) / (2 * s) / slope - 1) for s in [1e-4, 1e-5]]
    assert min(errors) < 1e-4 and slope != 0, errors


def test_without_a_tape_there_is_no_gradient(body):
    simulation = body.simulate(body.alpha, body.stimuli("test"), tape=False)
    for ask in [simulation.vjp, simulation.vjp_forces, simulation.jvp]:
        with pytest.raises(ValueError, match="tape = False"):
            ask(simulation.signals)
