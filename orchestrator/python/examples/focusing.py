"""Maximises the kinetic energy of a few units over the shapes of all units: `python focusing.py kagome|quads [EVALUATIONS]`, with JAX.

DifFlexMM's problems kagome_focusing and quads_focusing (github.com/bertoldi-collab/DifFlexMM, PLA with shims): the corners are held, and
two units of the left edge move half a cell to the right and back. The mean kinetic energy of the target is maximised over the positions
of all nodes, by moving asymptotes (mma.py) with limits on angles and edges. Objective and limits are written in JAX; metasense computes
the motion and its gradient.
"""

import sys

import jax
import jax.numpy as jnp
import metasense
import numpy as np
from metasense.jax import signals
from mma import ascend
from scipy.sparse import coo_array, vstack

jax.config.update("jax_enable_x64", True)
BOND, DENSITY, STIFFNESS, FREQUENCY, INSTANTS = 2.25, 6.18e-9, {"stretch": 120.0, "shear": 1.19, "bend": 1.5}, 30.0, 199


def block(sizes, at):
    """Cells 2 × 2 that are `at` from the middle."""
    return [tuple((n - 2) // 2 + a + d for n, a, d in zip(sizes, at, (k // 2, k % 2))) for k in range(4)]


def quads(sizes=(24, 16), target=(4, 5)):
    columns, rows = sizes
    unit = lambda i, j: j * columns + i
    inward = lambda n, size: min(n, size - 1 - n)
    held = [unit(i, j) for j in range(rows) for i in range(columns) if inward(i, columns) + inward(j, rows) < 2]
    body = {"columns": columns, "rows": rows, "spacing": 15.0, "ligament_length": BOND, "initial_angle": -25.0}
    driven = [unit(0, rows // 2 - 1), unit(0, rows // 2)]
    return body, held, driven, [unit(*at) for at in block(sizes, target)], 7.5, 2, 30.0, 5


def kagome(sizes=(20, 12), target=(3, 2)):
    columns, rows = sizes
    along, up = 20 * np.array([[1.0, 0.0], [0.5, 0.75**0.5]])
    gap = 0.5 * BOND * np.array([[0.75**0.5, 0.5], [-(0.75**0.5), 0.5], [0.0, -1.0]])
    below = np.array([along, along + up, up]) / 2 - gap[[2, 0, 1]]
    above = np.array([along + up, 2 * along + up, along + 2 * up]) / 2 + gap
    cells = [(i, j) for j in range(rows) for i in range(columns)]
    units = [(corners + i * along + j * up).tolist() for i, j in cells for corners in (below, above)]
    low = lambda i, j: 2 * (j % rows * columns + i % columns)
    high = lambda i, j: low(i, j) + 1
    ligaments = [[low(i, j), 1, high(i, j), 0] for i, j in cells]
    ligaments += [[low(i, j + 1), 0, high(i, j), 2] for i, j in cells if j + 1 < rows]
    ligaments += [[low(i + 1, j), 2, high(i, j), 1] for i, j in cells if i + 1 < columns]
    held = [low(*at) for at in [(0, 0), (1, 0), (0, 1), (-2, 0), (-1, 0), (0, -1), (0, -2)]]
    held += [high(*at) for at in [(-1, 0), (-1, 1), (-2, -1), (-1, -1), (-1, -2), (0, -1), (1, -1)]]
    targets = [of(*at) for at in block(sizes, target) for of in (low, high)]
    return {"file": {"units": units, "ligaments": ligaments}}, held, [low(0, rows // 2 - 1), low(0, rows // 2)], targets, 10.0, 3, 10.0, 17


def setup(shape, held, driven, targets, amplitude, periods, block_angle, fine, tolerance=0.3):
    """A body, its objective (mJ) and its limits, which are at most 0, as functions of α; `fine` instants from one of theirs to the next."""
    duration, steps = periods / FREQUENCY, fine * INSTANTS
    body = metasense.body(
        body=shape
        | {
            "density": DENSITY,
            "stiffness": STIFFNESS,
            "damping_ratio": 0.0186,
            "contact": {"stiffness": 1.5, "min_angle": -15.0, "cutoff_angle": -10.0},
            "clamp": held,
            # of 1 Mg: the force is the acceleration
            "panels": [{"unit": unit, "direction": [1, 0], "base": 1.0} for unit in driven],
        },
        time={"duration": duration, "samples": steps},
        # accelerations ring, which moves nobody: the energy is some 1e-4 off. Fewer readings keep it, but not its gradient
        solver={"method": "leapfrog", "tolerance": tolerance},
        stimuli={"kind": "bell"},
        sensors={"placements": [targets], "frame": "world"},
        sweep={"panels": [2], "sensors": [len(targets)], "seeds": [1]},
    )
    # there and back by A (1 − cos ωt)/2, begun after a tenth of a period; its second differences, by which equal steps meet it
    phase = (np.arange(-1, steps + 2) * (periods / steps) - 0.1).clip(0, 1)
    push = 0.5 * amplitude * np.diff(1 - np.cos(2 * np.pi * phase), 2) * (steps / duration) ** 2
    forces = np.tile(push, (1, 2, 1))
    body = body.tuned(body.alpha, forces)

    # every node is a corner and the shift of its group
    corners = body.vertices(np.zeros(body.alpha.size))
    group = (body.vertices(np.arange(body.alpha.size)) - corners).round().astype(int)
    nodes = lambda alpha: corners + jnp.asarray(alpha)[group]

    def inertia(nodes):
        nodes = nodes - nodes.mean(axis=1, keepdims=True)
        after = jnp.roll(nodes, -1, axis=1)
        cross = nodes[..., 0] * after[..., 1] - nodes[..., 1] * after[..., 0]
        area = cross.sum(axis=1) / 2
        centroid = ((nodes + after) * cross[..., None]).sum(axis=1) / (6 * area[:, None])
        polar = (cross * (nodes**2 + nodes * after + after**2).sum(axis=2)).sum(axis=1) / 12
        return DENSITY * area, DENSITY * (polar - area * (centroid**2).sum(axis=1))

    def objective(alpha):
        a, b, turning = jnp.moveaxis(signals(body, alpha, forces)[0].reshape(steps, len(targets), 3), 2, 0)
        rates = jnp.stack([a, b])
        before = jnp.concatenate([jnp.zeros_like(rates[:, :1]), rates[:, :-1]], axis=1)
        moving = jnp.cumsum(before + rates, axis=1) * (0.5 * duration / steps)
        mass, moment = inertia(nodes(alpha)[jnp.array(targets)])
        energy = mass * (moving**2).sum(axis=0) + moment * turning**2
        return 0.5 * energy[fine - 1 :: fine].sum() / (INSTANTS + 1)

    turn = lambda u, v: jnp.arctan2(u[0] * v[1] - u[1] * v[0], u @ v) % (2 * jnp.pi)

    def angles(corners):
        """Of the voids and units at both ends of a ligament, from the corners before, at and after each."""
        (back, other_back), (ahead, other) = (corners[:, k] - corners[:, 1] for k in (0, 2))
        voids = jnp.array([turn(other_back, ahead), turn(back, other)])
        inner = jnp.array([turn(ahead, back), turn(other, other_back)])
        # a void of more than 270° would count as units that overlap
        return jnp.concatenate([-voids, voids - 1.45 * jnp.pi, np.radians(block_angle) - inner])

    edges = lambda corners: 3.0 - jnp.linalg.norm(jnp.roll(corners, -1, axis=0) - corners, axis=1)
    ends = np.array(body.ligaments).reshape(-1, 2, 2)
    around = ends[:, :, :1], (ends[:, :, 1:] + np.arange(-1, 2)) % group.shape[1]
    kinds = [(angles, around), (edges, np.arange(len(group)))]

    @jax.jit
    def found(alpha):
        return [[jax.vmap(f)(nodes(alpha)[at]) for f in (of, jax.jacfwd(of))] for of, at in kinds]

    def limits(alpha):
        values, slopes = zip(*found(alpha))
        parts = []
        for value, slope, (_, at) in zip(values, slopes, kinds):
            rows = np.arange(value.size).reshape(*value.shape, *[1] * (slope.ndim - 2))
            entries = np.broadcast_arrays(rows, np.expand_dims(group[at], 1))
            parts.append(coo_array((slope.ravel(), tuple(e.ravel() for e in entries)), (value.size, alpha.size)))
        return np.concatenate([value.ravel() for value in values]), vstack(parts).tocsr()

    return body, objective, limits


def main(kind, evaluations=30):
    body, objective, limits = setup(*{"quads": quads, "kagome": kagome}[kind]())
    return ascend(jax.jit(jax.value_and_grad(objective)), limits, body.alpha, evaluations)


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
