"""The body as a function of JAX."""

import numpy as np
import pytest

jax = pytest.importorskip("jax")
jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
from jax.test_util import check_grads  # noqa: E402
from metasense.jax import signals  # noqa: E402


def test_check_grads(body):
    forces = body.stimuli("train")[:3]
    scale = np.abs(body.simulate(body.alpha, forces).signals).max(axis=(0, 1))
    check_grads(lambda alpha: signals(body, alpha, forces) / scale, (body.alpha,), 1, ["rev"], rtol=1e-4)


def test_gradient_is_that_of_vjp_under_jit(body):
    forces = body.stimuli("train")
    loss = jax.jit(jax.value_and_grad(lambda a, f: jnp.sum(signals(body, a, f) ** 2)))
    value, gradient = loss(body.alpha, forces)
    simulation = body.simulate(body.alpha, forces)
    assert np.isclose(value, np.sum(simulation.signals**2), rtol=1e-12)
    assert np.allclose(gradient, simulation.vjp(2 * simulation.signals), rtol=1e-12)


def test_more_gradients_in_flight_than_are_kept(body):
    forces = body.stimuli("test")
    pulls = [jax.vjp(lambda a: signals(body, a, forces), body.alpha * s)[1] for s in [1.0, 0.99, 0.98, 0.97]]
    cotangent = np.ones((3, 30, 3))
    found = [pull(cotangent)[0] for pull in pulls]
    for s, gradient in zip([1.0, 0.99, 0.98, 0.97], found):
        assert np.array_equal(gradient, body.simulate(body.alpha * s, forces).vjp(cotangent))


def test_vmap_over_designs_and_over_forces(body, rng):
    forces = body.stimuli("test")
    alphas = body.alpha + 0.01 * rng.standard_normal((2, body.alpha.size))
    both = jax.vmap(lambda a: signals(body, a, forces))(alphas)
    for alpha, found in zip(alphas, both):
        assert np.array_equal(found, body.simulate(alpha, forces).signals)
    sets = np.stack([forces, 0.5 * forces])
    grads = jax.vmap(jax.grad(lambda a, f: jnp.sum(signals(body, a, f))), in_axes=(None, 0))(body.alpha, sets)
    for one, gradient in zip(sets, grads):
        assert np.array_equal(gradient, body.simulate(body.alpha, one).vjp(np.ones((3, 30, 3))))


def test_check_grads_in_forces(body):
    forces = body.stimuli("train")[:3]
    scale = np.abs(body.simulate(body.alpha, forces).signals).max(axis=(0, 1))
    check_grads(lambda a, f: signals(body, a, f) / scale, (body.alpha, forces), 1, ["rev"], rtol=1e-4)


def test_gradient_in_forces_is_that_of_vjp_forces(body):
    forces = body.stimuli("test")
    pull = body.simulate(body.alpha, forces).vjp_forces(np.ones((3, 30, 3)))
    both = jax.jit(jax.grad(lambda a, f: jnp.sum(signals(body, a, f)), argnums=(0, 1)))(body.alpha, forces)
    assert all(map(np.array_equal, both, pull))
    alone = jax.vmap(jax.grad(lambda f: jnp.sum(signals(body, body.alpha, f))))(forces[None])
    assert np.array_equal(alone[0], pull[1]) and np.any(alone[0])


def test_a_failed_sample_raises(body):
    with pytest.raises(Exception, match="did not reach their end"):
        signals(body, body.alpha, 1e300 * body.stimuli("test")).block_until_ready()


def test_single_precision_without_x64(body):
    jax.config.update("jax_enable_x64", False)
    try:
        forces = body.stimuli("test")
        gradient = jax.grad(lambda a: jnp.sum(signals(body, a, forces)))(jnp.asarray(body.alpha))
        assert gradient.dtype == jnp.float32 and np.isfinite(gradient).all()
    finally:
        jax.config.update("jax_enable_x64", True)
