"""Trains a body together with a network of your own, written in JAX: `python cotrain.py SPEC [STEPS]`.

The network is a causal filter: it estimates the force at an instant from the last 15 instants. Adam reduces the loss of body and
network, each with its own rate. After each step, the design is projected onto the nearest design that can be cast.
"""

import sys

import jax
import jax.numpy as jnp
import metasense
from metasense.jax import signals

jax.config.update("jax_enable_x64", True)
PAST = 15


def network(weights, x):
    past = [jnp.pad(x, ((0, 0), (lag, 0), (0, 0)))[:, : x.shape[1]] for lag in range(PAST)]
    hidden = jnp.tanh(jnp.concatenate(past, axis=-1) @ weights["w1"] + weights["b1"])
    return hidden @ weights["w2"] + weights["b2"]


def fresh(key, inputs, outputs, width=32):
    one, two = jax.random.split(key)
    w1 = jax.random.normal(one, (PAST * inputs, width)) / jnp.sqrt(PAST * inputs)
    w2 = jax.random.normal(two, (width, outputs)) / jnp.sqrt(width)
    return {"w1": w1, "b1": jnp.zeros(width), "w2": w2, "b2": jnp.zeros(outputs)}


def adam(rate, gradient, state, step):
    first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, state[0], gradient)
    second = jax.tree.map(lambda v, g: 0.99 * v + 0.01 * g * g, state[1], gradient)
    fast = 1 - 0.9**step, 1 - 0.99**step
    move = jax.tree.map(lambda m, v: -rate * m / fast[0] / (jnp.sqrt(v / fast[1]) + 1e-12), first, second)
    return move, (first, second)


def main(spec, steps=60):
    body = metasense.Body.from_spec(spec, threads=2)
    test = body.stimuli("test")
    body = body.tuned(body.alpha, test)
    scale = signals(body, body.alpha, body.stimuli("train")).std(axis=(0, 1))

    def loss(alpha, weights, forces):
        said = network(weights, signals(body, alpha, forces) / scale)
        true = forces[:, :, 1:].swapaxes(1, 2)
        return jnp.mean((said - true) ** 2) / jnp.mean(true**2)

    gradient = jax.jit(jax.value_and_grad(loss, (0, 1)))
    alpha, weights = body.alpha, fresh(jax.random.key(1), 3 * len(body.sensors), len(body.panels))
    state = [(jax.tree.map(jnp.zeros_like, x),) * 2 for x in (alpha, weights)]
    for step in range(1, steps + 1):
        value, (g_body, g_weights) = gradient(alpha, weights, body.stimuli("fresh", 32 * step, 32))
        move, state[0] = adam(0.1, g_body, state[0], step)
        alpha = body.project(alpha + move, alpha)
        move, state[1] = adam(1e-2, g_weights, state[1], step)
        weights = jax.tree.map(jnp.add, weights, move)
        if step % 10 == 0 or step == steps:
            print(f"step {step}: loss {value:.3f}, of the test set {loss(alpha, weights, test):.3f}")
    return alpha, weights


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
