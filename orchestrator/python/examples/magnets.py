"""Pivoted magnets in an unknown field: the directions of their moments are trained, by a body of one's own in JAX.

    metasense run orchestrator/python/examples/magnets.toml

A grid of units, each with a pivot at its centre and a magnet of equal moment m. Elastic hinges hold each unit at its pivot and
join neighbours. The sensors are gyroscopes; the two unknowns are the components Bx, By of a uniform field (mT). Units: mm, N, s, Mg.

    J θ'' + c θ' + (k₀ + k L) θ = τ(α + θ, B) − τ(α, 0)        τᵢ = mᵢ × (B + Σⱼ field of magnet j at unit i)

L is the Laplacian of the grid. Without a field the units rest at θ = 0: the hinges were relaxed with the magnets in place. The
design α is the direction of each moment (rad), so mass, stiffness and amount of magnet stay.
"""

import os

# one core per worker process
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
import jax
import jax.numpy as jnp
import numpy as np

COLUMNS, ROWS, SPACING = 5, 3, 12.0
UNITS = COLUMNS * ROWS
MOMENT = 0.005  # of a cube of NdFeB with edges of 1.6 mm (A m²)
INERTIA = 1.5e-5  # of a unit of 10 × 10 × 4 mm with its magnet (Mg mm²)
PIVOT, LINK = 0.02, 0.02  # stiffness of hinges (N mm/rad)
DAMPING = 2.0 * 0.05 * np.sqrt(PIVOT * INERTIA)  # 5 % of critical for the lowest mode (N mm s/rad)
STEPS = 3  # per instant of the signals

x, y = (axis.ravel() for axis in np.meshgrid(np.arange(COLUMNS), np.arange(ROWS)))
dx, dy = SPACING * (x[:, None] - x), SPACING * (y[:, None] - y)
r = np.hypot(dx, dy) + np.where(np.eye(UNITS), np.inf, 0.0)  # a magnet does not act on itself
LINKED = 1.0 * (r < 1.1 * SPACING)
STIFFNESS = PIVOT * np.eye(UNITS) + LINK * (np.diag(LINKED.sum(0)) - LINKED)
# field (mT) at unit i per moment along x or y of unit j: μ₀/4π (3 r̂ (m·r̂) − m) / r³
XX, XY, YY = (1e5 * MOMENT * part / r**3 for part in (3 * (dx / r) ** 2 - 1, 3 * dx * dy / r**2, 3 * (dy / r) ** 2 - 1))


def torque(direction, field):
    """Of the magnets (N mm)."""
    c, s = jnp.cos(direction), jnp.sin(direction)
    return MOMENT * (c * (field[1] + XY @ c + YY @ s) - s * (field[0] + XX @ c + XY @ s))


def simulate(alpha, forces, times):
    """Angular velocities (T, UNITS, 1) in a field (2, T + 1), by Verlet's method with STEPS equal steps per instant."""
    step, rest = times[0] / STEPS, torque(alpha, jnp.zeros(2))

    def advance(state, field):
        turn, rate = state
        pull = torque(alpha + turn, field) - rest - STIFFNESS @ turn - DAMPING * rate
        rate = rate + step / INERTIA * pull
        return (turn + step * rate, rate), None

    def instant(state, ends):
        before, after = ends
        ways = jnp.arange(STEPS)[:, None] / STEPS
        state, _ = jax.lax.scan(advance, state, before + ways * (after - before))
        return state, state[1]

    start = (jnp.zeros(UNITS), jnp.zeros(UNITS))
    # of an instant only the state is kept for the gradient
    return jax.lax.scan(jax.checkpoint(instant), start, (forces.T[:-1], forces.T[1:]))[1][:, :, None]


def draw(alpha):
    """The moments as an SVG of arrows."""
    ends = zip(x, ROWS - 1 - y, 0.4 * np.cos(alpha), -0.4 * np.sin(alpha), strict=True)
    arrows = (f'<path d="M{i - c:.3f} {j - s:.3f}L{i + c:.3f} {j + s:.3f}" marker-end="url(#a)"/>' for i, j, c, s in ends)
    head = '<marker id="a" orient="auto" markerWidth="4" markerHeight="4" refX="2" refY="2"><path d="M0 0L4 2L0 4Z"/></marker>'
    style = 'width="360" stroke="black" stroke-width="0.04"'
    box = f'viewBox="-0.6 -0.6 {COLUMNS + 0.2} {ROWS + 0.2}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {box} {style}>{head}{"".join(arrows)}</svg>'


if __name__ == "__main__":
    import metasense

    metasense.serve_body(
        simulate,
        2.4 * np.arange(UNITS) % (2 * np.pi),  # all directions alike
        name="magnets",
        panels=["Bx", "By"],
        sensors=[f"{i},{j}" for i, j in zip(x, y, strict=True)],
        channels=["omega"],
        draw=draw,
        batch=20,
    )
