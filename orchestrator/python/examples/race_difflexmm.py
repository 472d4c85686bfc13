"""Compares focusing.py with DifFlexMM, alternately and from the same start: `taskset -c 0 python race_difflexmm.py CLONE kagome|quads
[EVALUATIONS]`.

CLONE is a clone of github.com/bertoldi-collab/DifFlexMM. Settings are those of its notebooks *_focusing_3dp_pla_shims; both use the
optimiser and limits of focusing.py. Times are CPU seconds for a value with its gradient, over all threads, without compilation.
"""

import sys
import time
import types

import focusing
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

# of jax_md, which needs much else, DifFlexMM takes a sum over bonds and minus a gradient
SMAP, QUANTITY, JAX_MD = (types.ModuleType(f"jax_md{part}") for part in (".smap", ".quantity", ""))
SMAP.bond = lambda energy, metric, static_bonds, static_bond_types=None: (
    lambda nodes, **params: energy(metric(nodes[static_bonds[:, 0]], nodes[static_bonds[:, 1]]), **params).sum()
)
QUANTITY.force = lambda energy: lambda x, *rest: -jax.grad(energy)(x, *rest)
JAX_MD.smap, JAX_MD.quantity = SMAP, QUANTITY
sys.modules |= {"jax_md": JAX_MD, "jax_md.smap": SMAP, "jax_md.quantity": QUANTITY}

KINDS = {
    # sizes, target, name of a length, that length, periods, mass and moment of the mean unit
    "quads": ((24, 16), (4, 5), "spacing", 15.0, 2, 0.36125, 0.02175026),
    "kagome": ((20, 12), (3, 2), "cell_size", 20.0, 3, 0.070175913225, 0.0009477510275),
}


def theirs(kind):
    """DifFlexMM's problem and its start."""
    sizes, target, length, size, periods, mass, moment = KINDS[kind]
    damping = [2 * (mass * focusing.DENSITY * size**2 * 1.19) ** 0.5] * 2
    damping += [2 * (moment * focusing.DENSITY * size**4 * 1.5) ** 0.5]
    if kind == "quads":
        from difflexmm.geometry import QuadGeometry
        from problems import quads_focusing as problem

        own = {"n1_blocks": sizes[0], "n2_blocks": sizes[1]}
        lattice = QuadGeometry(*sizes, spacing=size, bond_length=focusing.BOND)
        start, units = lattice.get_design_from_rotated_square(angle=np.radians(25)), sizes[0] * sizes[1]
    else:
        from problems import kagome_focusing as problem

        own = {"n1_cells": sizes[0], "n2_cells": sizes[1], "cell_angle": jnp.pi / 3}
        (m, n), units = sizes, 2 * sizes[0] * sizes[1]
        start = tuple(jnp.zeros(shape) for shape in ((m + 1, n, 2), (m, n + 1, 2), (m, n, 2)))
    forward = problem.ForwardProblem(
        **own,
        **{length: size},
        bond_length=focusing.BOND,
        **{f"k_{name}": k for name, k in zip(("stretch", "shear", "rot"), focusing.STIFFNESS.values())},
        density=focusing.DENSITY,
        damping=0.0186 * jnp.array(damping) * jnp.ones((units, 3)),
        use_contact=True,
        k_contact=1.5,
        min_angle=np.radians(-15),
        cutoff_angle=np.radians(-10),
        amplitude=size / 2,
        loading_rate=focusing.FREQUENCY,
        input_delay=0.1 / focusing.FREQUENCY,
        n_excited_blocks=2,
        loaded_side="left",
        input_shift=0,
        simulation_time=periods / focusing.FREQUENCY,
        n_timepoints=focusing.INSTANTS + 1,
        atol=1e-4,
    )
    optimisation = problem.OptimizationProblem(forward_problem=forward, target_size=(2, 2), target_shift=target)
    optimisation.setup_objective()
    return optimisation, start


def in_alpha(optimisation, start, body):
    """Their objective and its gradient in our α."""
    flat, tree = ravel_pytree(start)
    place = lambda x: np.asarray(optimisation.forward_problem.geometry.get_reference_geometry(*tree(x)))
    number = lambda of, step, size: ((of(step * np.arange(size)) - of(np.zeros(size))) / step).round().astype(int)
    each, ours = number(place, 1e-6, flat.size), number(body.vertices, 1.0, body.alpha.size)
    back = np.empty(flat.size, int)
    back[each.ravel()] = ours.ravel()
    apart = place(flat) - body.vertices(body.alpha)
    assert np.ptp(apart, axis=(0, 1)).max() < 1e-9, "another body"
    found = jax.jit(jax.value_and_grad(lambda x: optimisation.objective_fn(tree(x)) / (focusing.INSTANTS + 1)))

    def value_and_gradient(alpha):
        value, gradient = found(alpha[back])
        in_ours = np.zeros(alpha.size)
        in_ours[back] = gradient
        return value, in_ours

    return value_and_gradient


def timed(function, found):
    """The function, which adds to `found` the value and the CPU seconds of each call."""

    def call(alpha):
        begin = time.process_time()
        value, gradient = jax.block_until_ready(function(alpha))
        found.append((float(value), time.process_time() - begin))
        return float(value), np.asarray(gradient)

    return call


def main(kind, evaluations=10):
    body, objective, limits = focusing.setup(*{"quads": focusing.quads, "kagome": focusing.kagome}[kind]())
    both = {"metasense": jax.jit(jax.value_and_grad(objective)), "DifFlexMM": in_alpha(*theirs(kind), body)}
    first = [np.asarray(function(body.alpha)[1]) for function in both.values()]
    print(f"gradients at the start are {np.linalg.norm(first[0] - first[1]) / np.linalg.norm(first[1]):.1e} apart", flush=True)
    ends, found = {}, {name: [] for name in both}
    for name, function in both.items():
        print(f"by {name}:", flush=True)
        _, ends[name] = focusing.ascend(timed(function, found[name]), limits, body.alpha, evaluations)
    for n, ((own, ours), (other, longer)) in enumerate(zip(*found.values()), 1):
        print(f"evaluation {n:3}: {other:.6f} mJ in {longer:.1f} CPU s by DifFlexMM, {own:.6f} in {ours:.3f} by metasense")
    mean = {name: np.mean([seconds for _, seconds in own]) for name, own in found.items()}
    print(f"CPU s a value and gradient: {mean['DifFlexMM']:.1f} and {mean['metasense']:.3f}, {mean['DifFlexMM'] / mean['metasense']:.0f} times")
    for name, end in ends.items():
        best = [f"{float(function(end)[0]):.6f} mJ by {own}" for own, function in both.items()]
        print(f"best of {name}: {best[0]}, {best[1]}", flush=True)
    return found, mean


if __name__ == "__main__":
    sys.path.insert(0, sys.argv[1])
    main(sys.argv[2], *map(int, sys.argv[3:]))
