"""A vibrating plate whose thickness is trained: an external body, by finite differences in JAX.

    metasense run orchestrator/python/examples/plate.toml

Kirchhoff's plate, simply supported at its edges, on a grid of N × N points (mm, N, s, Mg):

    ρ h w'' + c ρ h₀ w' + Δ(D Δ w) = f        D = E h³ / 12 (1 − ν²)

The design is the thickness at each point; its mean, and so the mass, is constant. Every point can carry an accelerometer.
"""

import os

# one core per worker process
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
import jax
import jax.numpy as jnp
import numpy as np

N, SIDE = 7, 150.0  # points per side, side (mm)
MODULUS, POISSON, DENSITY = 0.26, 0.5, 1.07e-9  # Dragon Skin 10 (MPa, 1, Mg/mm³)
THICKNESS, DECAY = 4.0, 10.0  # of the initial plate (mm), rate of its vibrations' power (1/s)
STEPS = 6  # per instant of the signals
PANELS = {"left": (1, 5), "right": (5, 4), "low": (4, 1), "high": (2, 3)}  # where forces act (column, row)
SPACING = SIDE / (N + 1)
SECOND = (np.eye(N, k=1) + np.eye(N, k=-1) - 2.0 * np.eye(N)) / SPACING**2
LAPLACIAN = np.kron(SECOND, np.eye(N)) + np.kron(np.eye(N), SECOND)  # of a w that is 0 at the edges
PUSHED = np.array([N * y + x for x, y in PANELS.values()])


def simulate(alpha, forces, times):
    """Accelerations (T, N·N, 1) under forces (P, T + 1), by Verlet's method with STEPS equal steps per instant."""
    rigidity, mass = MODULUS * alpha**3 / (12.0 * (1.0 - POISSON**2)), DENSITY * alpha
    stiffness = LAPLACIAN @ (rigidity[:, None] * LAPLACIAN) / mass[:, None]
    acceleration = 1.0 / (SPACING**2 * mass[PUSHED])  # of a point under 1 N
    damping, step = DECAY * THICKNESS / alpha, times[0] / STEPS

    def advance(state, push):
        w, v = state
        a = (-stiffness @ w - damping * v).at[PUSHED].add(acceleration * push)
        v = v + step * a
        return (w + step * v, v), a

    def instant(state, ends):
        before, after = ends
        ways = jnp.arange(1, STEPS + 1)[:, None] / STEPS
        state, a = jax.lax.scan(advance, state, before + ways * (after - before))
        return state, a[-1]

    rest = (jnp.zeros(N * N), jnp.zeros(N * N))
    # of an instant only the state is kept for the gradient
    _, signals = jax.lax.scan(jax.checkpoint(instant), rest, (forces.T[:-1], forces.T[1:]))
    return signals[:, :, None]


def draw(alpha):
    """The thickness as an SVG of grey squares, dark where it is thick."""
    h = np.asarray(alpha).reshape(N, N)
    shade = np.clip(255 - 110 * h / THICKNESS, 0, 255).astype(int)
    squares = (
        f'<rect x="{x}" y="{N - 1 - y}" width="1" height="1" fill="rgb({s},{s},{s})"><title>{h[y, x]:.2f} mm</title></rect>'
        for (y, x), s in np.ndenumerate(shade)
    )
    return f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {N} {N}" width="360">{"".join(squares)}</svg>'


if __name__ == "__main__":
    import metasense

    metasense.serve_body(
        simulate,
        np.full(N * N, THICKNESS),
        name="plate",
        panels=list(PANELS),
        sensors=[f"{x},{y}" for y in range(N) for x in range(N)],
        channels=["acceleration"],
        lower=0.5 * THICKNESS,
        upper=2.0 * THICKNESS,
        constraints=[(dict.fromkeys(range(N * N), 1.0 / (N * N)), THICKNESS, THICKNESS)],
        draw=draw,
        batch=20,
    )
