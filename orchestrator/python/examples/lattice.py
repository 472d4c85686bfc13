"""The body model of metasense in JAX, as an external body: rotated squares joined by ligaments.

    [body]
    kind = "external"
    command = ["python3", "lattice.py", "6", "6", "1e-8"]   # columns, rows, density (Mg/mm²)

Equations of MODEL.md without contact, integrated by a Runge-Kutta method with equal steps. Units: mm, N, s, Mg. The bottom row is held,
forces push the units of the top row down, and every free unit can carry a sensor.
"""

import math
import os
import sys

# one core per worker process
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
import jax
import jax.numpy as jnp
import numpy as np

WORDS = sys.argv[1:4] if len(sys.argv) > 3 else ["3", "3", "1e-6"]
COLUMNS, ROWS, DENSITY = int(WORDS[0]), int(WORDS[1]), float(WORDS[2])
SPACING, LENGTH, ANGLE = 15.0, 2.25, math.radians(25.0)
STRETCH, SHEAR, BEND, RATIO = 3.0, 0.5, 1.0, 0.02
HALF, UNITS = (SPACING - LENGTH) / 2.0, COLUMNS * ROWS
HORIZONTAL = (COLUMNS + 1) * ROWS * 2
SQUARE = 2.0 * HALF**2  # area of a square that is not rotated
FASTEST = 2 * math.sqrt(2 * STRETCH / (DENSITY * SQUARE))  # about the highest frequency (rad/s)
STEPS = math.ceil(0.01 * FASTEST / 0.14)  # per instant of the signals, of at most 0.01 s
DAMPING = RATIO * np.array(
    [2 * math.sqrt(DENSITY * SQUARE * SHEAR)] * 2 + [2 * math.sqrt(DENSITY * SQUARE**2 / 6 * BEND)]
)
# unit and node of both ends, and direction (0 along x, 1 along y)
LIGAMENTS = np.array(
    [(j * COLUMNS + i, 0, j * COLUMNS + i + 1, 2, 0) for j in range(ROWS) for i in range(COLUMNS - 1)]
    + [(j * COLUMNS + i, 1, (j + 1) * COLUMNS + i, 3, 1) for j in range(ROWS - 1) for i in range(COLUMNS)]
).T


def initial():
    """α of rotated squares."""
    h, v = np.zeros((COLUMNS + 1, ROWS, 2)), np.zeros((COLUMNS, ROWS + 1, 2))
    i, j = np.indices(h.shape[:2])
    h[..., 1] = -HALF * np.tan((-1.0) ** (i + j) * ANGLE)
    i, j = np.indices(v.shape[:2])
    v[..., 0] = HALF * np.tan((-1.0) ** (i + j) * ANGLE)
    return np.concatenate([h.ravel(), v.ravel()])


def geometry(alpha):
    """Nodes from the centroid (units, 4, 2), mass and moment of inertia (units)."""
    h = alpha[:HORIZONTAL].reshape(COLUMNS + 1, ROWS, 2)
    v = alpha[HORIZONTAL:].reshape(COLUMNS, ROWS + 1, 2)
    shifts = jnp.stack([h[1:], v[:, 1:], h[:-1], v[:, :-1]], axis=2)
    nodes = shifts.transpose(1, 0, 2, 3).reshape(UNITS, 4, 2) + HALF * jnp.array([[1.0, 0], [0, 1], [-1, 0], [0, -1]])
    onward = jnp.roll(nodes, -1, axis=1)
    cross = nodes[..., 0] * onward[..., 1] - nodes[..., 1] * onward[..., 0]
    area = cross.sum(1) / 2
    nodes = nodes - (((nodes + onward) * cross[..., None]).sum(1) / (6 * area[:, None]))[:, None]
    onward = jnp.roll(nodes, -1, axis=1)
    cross = nodes[..., 0] * onward[..., 1] - nodes[..., 1] * onward[..., 0]
    squares = (nodes * nodes).sum(-1) + (nodes * onward).sum(-1) + (onward * onward).sum(-1)
    return nodes, DENSITY * area, DENSITY * (cross * squares).sum(1) / 12


def energy(nodes, x):
    """Of the ligaments; x (3, units): displacements (mm) and rotation (rad)."""
    u, v, turn = x
    c, s = jnp.cos(turn) - 1, jnp.sin(turn)
    px = u[:, None] + c[:, None] * nodes[..., 0] - s[:, None] * nodes[..., 1]
    py = v[:, None] + s[:, None] * nodes[..., 0] + c[:, None] * nodes[..., 1]
    a, p, b, q, upward = LIGAMENTS
    ex, ey = 1.0 - upward, 1.0 * upward
    dx, dy = px[b, q] - px[a, p] + LENGTH * ex, py[b, q] - py[a, p] + LENGTH * ey
    stretch = jnp.sqrt(dx * dx + dy * dy) - LENGTH
    shear = LENGTH * (jnp.arctan2(ex * dy - ey * dx, ex * dx + ey * dy) - (turn[a] + turn[b]) / 2)
    return 0.5 * jnp.sum(STRETCH * stretch**2 + SHEAR * shear**2 + BEND * (turn[b] - turn[a]) ** 2)


def simulate(alpha, forces, times):
    """Accelerations and angular velocity (T, free units, 3) under forces (COLUMNS, T + 1) on the top row."""
    nodes, mass, moment = geometry(alpha)
    inertia = jnp.stack([mass, mass, moment])[:, COLUMNS:]
    step = times[0] / STEPS

    def slope(state, push):
        whole = jnp.concatenate([jnp.zeros((3, COLUMNS)), state[0]], axis=1)
        acts = -jax.grad(energy, argnums=1)(nodes, whole)[:, COLUMNS:] - DAMPING[:, None] * state[1]
        return jnp.stack([state[1], acts.at[1, -COLUMNS:].add(-push) / inertia])

    def instant(state, ends):
        def advance(state, n):
            def stage(so_far, row):
                (last, total), (part, weight) = so_far, row
                k = slope(state + part * step * last, ends[0] + (n + part) / STEPS * (ends[1] - ends[0]))
                return (k, total + weight * step * k), None

            parts = (jnp.array([0.0, 0.5, 0.5, 1.0]), jnp.array([1.0, 2.0, 2.0, 1.0]) / 6)
            return jax.lax.scan(stage, (jnp.zeros_like(state), state), parts)[0][1], None

        state, _ = jax.lax.scan(advance, state, jnp.arange(STEPS))
        a = slope(state, ends[1])[1]
        return state, jnp.stack([a[0], a[1], state[1, 2]], axis=-1)

    rest = jnp.zeros((2, 3, UNITS - COLUMNS))
    # of an instant only the state is kept for the gradient
    return jax.lax.scan(jax.checkpoint(instant), rest, (forces.T[:-1], forces.T[1:]))[1]


if __name__ == "__main__":
    import metasense

    metasense.serve_body(
        simulate,
        initial(),
        name="lattice",
        panels=[f"unit {unit}" for unit in range(UNITS - COLUMNS, UNITS)],
        sensors=[f"unit {unit}" for unit in range(COLUMNS, UNITS)],
        channels=["ax", "ay", "omega"],
    )
