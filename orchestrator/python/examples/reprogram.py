"""One body for two tasks, selected by compression: `python reprogram.py [STEPS]`, with JAX.

A blow on the left moves the upper right of the body as cast, and the lower right after its ends are moved together by 4 %. One design is
trained for both (after arXiv:2403.08078). metasense computes motions and gradients; the objective is written in JAX.
"""

import sys

import jax
import jax.numpy as jnp
import metasense
import numpy as np
from metasense.jax import signals

jax.config.update("jax_enable_x64", True)
COLUMNS, ROWS, DURATION, INSTANTS, PRESS = 8, 7, 0.2, 400, 0.04
UPPER, LOWER = ([row * COLUMNS + 5, row * COLUMNS + 6] for row in (ROWS - 3, 2))


def body(press):
    return metasense.body(
        body={
            "columns": COLUMNS,
            "rows": ROWS,
            "spacing": 15.0,
            "ligament_length": 2.25,
            "density": 1e-8,
            "stiffness": {"stretch": 3.0, "shear": 0.5, "bend": 1.0},
            "clamp": "ends",
            "compression": [0.0, press],
            "panels": [{"unit": ROWS // 2 * COLUMNS, "direction": [1, 0]}],
        },
        time={"duration": DURATION, "samples": INSTANTS},
        stimuli={"kind": "bell"},
        sensors={"placements": [UPPER + LOWER], "frame": "world"},
        sweep={"panels": [1], "sensors": [4], "seeds": [1]},
    )


def main(steps=100, rate=0.2):
    time = np.linspace(0, DURATION, INSTANTS + 1)
    blow = 0.3 * np.where(time < 0.04, np.sin(np.pi * time / 0.04) ** 2, 0)[None, None]
    bodies = [body(0.0), body(PRESS)]
    alpha = bodies[0].alpha
    bodies = [each.tuned(alpha, blow) for each in bodies]

    def upper(each, alpha):
        """The upper units' part of all four units' kinetic energy, summed over time."""
        accelerations = signals(each, alpha, blow)[0].reshape(INSTANTS, 4, 3)[:, :, :2]
        energy = (jnp.cumsum(accelerations, axis=0) ** 2).sum(axis=(0, 2))
        return energy[:2].sum() / energy.sum()

    def loss(alpha):
        cast, pressed = (upper(each, alpha) for each in bodies)
        return -jnp.log(cast) - jnp.log(1 - pressed), (cast, pressed)

    gradient = jax.jit(jax.grad(loss, has_aux=True))
    first, second, parts = np.zeros_like(alpha), np.zeros_like(alpha), []
    for step in range(1, steps + 1):
        slope, found = map(np.asarray, gradient(alpha))
        parts.append(found)
        if step % 10 == 1 or step == steps:
            print(f"step {step}: {found[0]:.3f} of the energy above as cast, {found[1]:.3f} pressed", flush=True)
        first, second = 0.9 * first + 0.1 * slope, 0.99 * second + 0.01 * slope**2
        move = first / (1 - 0.9**step) / (np.sqrt(second / (1 - 0.99**step)) + 1e-12)
        alpha = bodies[0].project(alpha - rate * move, alpha)
    return alpha, parts


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
