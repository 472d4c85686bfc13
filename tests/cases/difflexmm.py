#!/usr/bin/env python3
"""Makes the cases *_difflexmm_*: bodies, energies and motion as DifFlexMM computes them (github.com/bertoldi-collab/DifFlexMM).

    pip install jax scipy numpy && git clone https://github.com/bertoldi-collab/DifFlexMM
    python tests/cases/difflexmm.py DifFlexMM tests/cases

Geometries, kinematics, strain and contact energies, inertia and the right-hand side are DifFlexMM's own functions. Ours are: the random
shifts of nodes (the ends of a ligament alike), the forces, which are linear between instants, and SciPy's DOP853 in the place of odeint,
whose accuracy can be asked for. A driven unit is one of DifFlexMM's constrained ones: its place, ∬ f/M, is integrated beside the others'.
"""
import json, pathlib, sys, types
import numpy as np
import jax, jax.numpy as jnp
from scipy.integrate import solve_ivp

jax.config.update("jax_enable_x64", True)
# DifFlexMM takes two functions of jax_md, which needs much else: a sum over bonds, and minus a gradient.
smap, quantity, package = (types.ModuleType(f"jax_md{part}") for part in (".smap", ".quantity", ""))
smap.bond = lambda energy, metric, static_bonds, static_bond_types=None: (
    lambda nodes, **params: energy(metric(nodes[static_bonds[:, 0]], nodes[static_bonds[:, 1]]), **params).sum())
quantity.force = lambda energy: lambda x, *rest: -jax.grad(energy)(x, *rest)
package.smap, package.quantity = smap, quantity
sys.modules |= {"jax_md": package, "jax_md.smap": smap, "jax_md.quantity": quantity}
sys.path.insert(0, sys.argv[1])
from difflexmm import dynamics, energy, geometry, utils  # noqa: E402

OUT = pathlib.Path(sys.argv[2])
DENSITY, STRETCH, SHEAR, BEND, ZETA = 1e-8, 3.0, 0.5, 1.0, 0.02


class Body:
    """A body of DifFlexMM's, its nodes in groups that shift together."""

    def __init__(self, lattice, shifts, scale, cutoff):
        self.contact = {"k_contact": 1.0, "psi_min": 0.0, "psi_cut": cutoff}
        lattice.compute_geometry()
        self.lattice = lattice
        self.bonds = np.asarray(lattice.bond_connectivity())
        self.reference = scale * np.asarray(lattice.reference_bond_vectors())
        # a block's own node vectors start at its centroid: the corners, with ligaments of their lengths between them
        self.nodes = scale * np.asarray(lattice.get_reference_geometry(*shifts))
        count, each, _ = self.nodes.shape
        self.shape = (count, each)
        flat = self.nodes.reshape(-1, 2)
        assert np.allclose(flat[self.bonds[:, 1]] - flat[self.bonds[:, 0]], self.reference, atol=1e-12)
        root = np.arange(count * each)
        for a, b in self.bonds:
            root[root == max(root[a], root[b])] = min(root[a], root[b])
        self.group = np.unique(root, return_inverse=True)[1]

    def vertices(self, alpha):
        return jnp.asarray(self.nodes) + alpha.reshape(-1, 2)[self.group].reshape(*self.shape, 2)

    def params(self, alpha):
        vertices = self.vertices(alpha)
        centroids = jax.vmap(geometry.polygon_centroid)(vertices)
        arms = vertices - centroids[:, None]
        bonds = utils.LigamentParams(STRETCH, SHEAR, BEND, jnp.asarray(self.reference))
        contact = utils.ContactParams(self.contact["psi_min"], self.contact["psi_cut"], self.contact["k_contact"])
        mechanical = utils.MechanicalParams(bond_params=bonds, density=DENSITY, contact_params=contact)
        return utils.ControlParams(utils.GeometricalParams(centroids, arms), mechanical)

    def energies(self):
        elastic = energy.build_strain_energy(self.bonds, energy.ligament_energy)
        touch = energy.build_contact_energy(self.bonds)
        return elastic, touch

    def damping(self):
        """Of the mean unit that is not shifted."""
        _, area, polar = geometry.polygons_geometric_properties(jnp.asarray(self.nodes))
        mass, moment = DENSITY * area.mean(), DENSITY * polar.mean()
        shift = 2 * ZETA * np.sqrt(mass * SHEAR)
        return np.array([shift, shift, 2 * ZETA * np.sqrt(moment * BEND)])

    def scene(self, **other):
        each = self.shape[1]
        ligaments = [[int(a // each), int(a % each), int(b // each), int(b % each)] for a, b in self.bonds]
        return {
            "polygons": {"units": self.nodes.tolist(), "ligaments": ligaments},
            "density": DENSITY, "k_stretch": STRETCH, "k_shear": SHEAR, "k_rot": BEND, "zeta": ZETA, "linearised": False,
            "contact": False, **self.contact, "frame": "world", "duration": 0.2, "T": 40, "initial_angle": 0.0, "panels": [], "sensors": [],
            "clamped": [], "force_direction": [0.0, -1.0], **other,
        }


def save(name, about, arrays):
    folder = OUT / name
    folder.mkdir(parents=True, exist_ok=True)
    for key, value in arrays.items():
        np.save(folder / f"{key}.npy", np.asarray(value, dtype=float))
    about["arrays"] = {key: list(np.shape(value)) for key, value in arrays.items()}
    (folder / "case.json").write_text(json.dumps(about, indent=1) + "\n")


def cases(name, body, alpha, rng, clamped, panels, sensors):
    params = body.params(alpha)
    centroids, arms = params.geometrical_params
    vertices = body.vertices(alpha)
    _, area, polar = geometry.polygons_geometric_properties(vertices)
    voids = energy.void_angles(vertices, jnp.asarray(body.bonds)).reshape(2, -1).T
    ligaments = [dict(zip(("a", "node_a", "b", "node_b"), ends)) for ends in body.scene()["polygons"]["ligaments"]]
    save(f"geometry_difflexmm_{name}", {"kind": "geometry", "scene": body.scene(), "ligaments": ligaments}, {
        "alpha": alpha, "alpha_initial": np.zeros_like(alpha), "vertices": vertices, "centroids": centroids, "r": arms, "area": area,
        "mass": DENSITY * area, "moment": DENSITY * polar, "void_angles": voids})

    elastic, touch = map(jax.jit, body.energies())
    both = lambda x, alpha: elastic(x, body.params(alpha)) + touch(x, body.params(alpha))
    states = np.array([0.3, 0.3, 0.05]) * rng.standard_normal((4, body.shape[0], 3)) * np.array([0.3, 1, 2, 4])[:, None, None]

    def turned(x):
        spin = jax.vmap(geometry.rotation_matrix)(x[:, 2])
        moved = jnp.einsum("uij,upj->upi", spin, arms) + centroids[:, None] + x[:, None, :2]
        return energy.void_angles(moved, jnp.asarray(body.bonds)).reshape(2, -1).T

    of = {"energy_elastic": elastic, "energy_contact": touch}
    arrays = {key: np.array([f(x, params) for x in states]) for key, f in of.items()}
    arrays |= {"alpha": alpha, "displacement": states, "energy": arrays["energy_elastic"] + arrays["energy_contact"],
               "dU_dx": np.array([jax.grad(both)(x, alpha) for x in states]),
               "dU_dalpha": np.array([jax.grad(both, argnums=1)(x, alpha) for x in states]),
               "void_angles": np.array([turned(x) for x in states])}
    save(f"energy_difflexmm_{name}", {"kind": "energy", "scene": body.scene(contact=True)}, arrays)
    motion(name, body, alpha, rng, body.scene(clamped=clamped, panels=panels, sensors=sensors))


def motion(name, body, alpha, rng, scene):
    params, (bonds, touch) = body.params(alpha), body.energies()
    elastic = (lambda x, p: bonds(x, p) + touch(x, p)) if scene["contact"] else bonds
    driven = [scene["panels"][k] for k in scene.get("driven", [])]
    parts = [(unit, 3 * [True]) for unit in scene["clamped"]] + [tuple(guided) for guided in scene.get("guided", [])]
    pressed = scene.get("pressed", np.zeros((len(parts), 2)))
    given = [(3 * unit + d, [*way, 0.0][d]) for (unit, own), way in zip(parts, pressed) for d in range(3) if own[d]]
    held = jnp.array([divmod(place, 3) for place, _ in given] + [[unit, d] for unit in driven for d in range(3)])
    ways = jnp.array([way for _, way in given])
    units, (steps, duration) = body.shape[0], (scene["T"], scene["duration"])
    free, _, _ = geometry.DOFsInfo(units, held)
    fixed = energy.constrain_energy(elastic, dynamics.build_constrained_kinematics(
        types.SimpleNamespace(n_blocks=units), held, lambda pressed, along: jnp.concatenate([
            pressed * ways, jnp.outer(along, jnp.array([*scene["force_direction"], 0.0])).ravel()])))
    rhs = dynamics.build_RHS(lambda x, t, p: fixed(x, t, p), lambda state, t, load, damping: load["f"] - damping * state[1])
    every = np.asarray(geometry.compute_inertia(params.geometrical_params.centroid_node_vectors, DENSITY))
    damping = np.tile(body.damping(), units)[np.asarray(free)]
    inertia = every.reshape(-1)[np.asarray(free)]
    own, drag = every[driven, 0], body.damping()[0]
    params = params._replace(mechanical_params=params.mechanical_params._replace(damping=jnp.asarray(damping)))
    slot = {int(d): i for i, d in enumerate(np.asarray(free))}
    struck = [(k, slot[3 * unit + 1]) for k, unit in enumerate(scene["panels"]) if unit not in driven]
    at_places = lambda along: params._replace(constraint_params={"along": along})
    energy_of = jax.jit(lambda x, along, pressed=1.0: fixed(x, pressed, at_places(along)))
    needs = jax.jit(jax.grad(energy_of, argnums=1))
    right = jax.jit(lambda y, f, along: rhs(y, 1.0, at_places(along)._replace(loading_params={"f": f}), inertia))
    slopes = jax.jit(jax.grad(energy_of)), jax.jit(jax.hessian(energy_of))
    rest, still = np.zeros(len(free)), np.zeros(len(driven))
    for part in np.linspace(0.0, 1.0, 11)[1:] if "pressed" in scene else []:  # held units go a tenth of their way, the others follow
        for _ in range(8):
            rest = rest - np.linalg.solve(slopes[1](rest, still, part), slopes[0](rest, still, part))
        assert np.abs(slopes[0](rest, still, part)).max() < 1e-12 and np.linalg.eigvalsh(slopes[1](rest, still, part)).min() > 0

    def load(forces):
        vector = np.zeros(len(free))
        for k, at in struck:
            vector[at] -= forces[k]
        return vector

    panels, samples, times = len(scene["panels"]), 2, np.linspace(0.0, duration, steps + 1)
    onset, width = rng.uniform(0.0, 0.05, (samples, panels)), rng.uniform(0.05, 0.1, (samples, panels))
    bell = lambda t, o, w: np.where((t > o) & (t < o + w), np.sin(np.pi * np.clip((t - o) / w, 0, 1)) ** 2, 0.0)
    forces = np.array([[rng.uniform(0.1, 0.3) * bell(times, o, w) for o, w in zip(*each)] for each in zip(onset, width)])
    read, ends, kept = [], [], {key: [] for key in ("kinetic_energy", "elastic_energy", "dissipated_work", "external_work")}
    n, d, apart = len(free), len(driven), 0.0
    for sample in forces:
        def slope(y, t, forces=sample):
            now = [np.interp(t, times, row) for row in forces]
            f, given = load(now), np.array([now[k] / scene["driven_mass"] for k in scene.get("driven", [])])
            x, v, along, speed = np.split(y[:-2], [n, 2 * n, 2 * n + d])
            _, a = np.asarray(right(np.array([x, v]), f, along))
            lost = drag * speed @ speed
            done = speed @ (own * given + np.asarray(needs(x, along))) + lost
            return np.concatenate([v, a, speed, given, [damping @ (v * v) + lost, f @ v + done]]), a

        def solve(rtol):
            y, all_of = np.concatenate([rest, np.zeros(n + 2 * d + 2)]), []
            for from_, to in zip(times, times[1:]):
                y = solve_ivp(lambda t, y: slope(y, t)[0], (from_, to), y, method="DOP853", rtol=rtol, atol=rtol * 1e-3).y[:, -1]
                all_of.append(y)
            return np.array(all_of)

        fine, coarse = solve(1e-11), solve(1e-9)
        apart = max(apart, np.linalg.norm(fine - coarse) / np.linalg.norm(fine))
        at = []
        for t, y in zip(times[1:], fine):
            a = slope(y, t)[1]
            here = lambda part, place: part[slot[place]] if place in slot else 0.0
            at.append([here(*each) for u in scene["sensors"] for each in ((a, 3 * u), (a, 3 * u + 1), (y[n:], 3 * u + 2))])
            kept["kinetic_energy"].append(0.5 * inertia @ y[n:2 * n] ** 2 + 0.5 * own @ y[2 * n + d:-2] ** 2)
            kept["elastic_energy"].append(float(energy_of(y[:n], y[2 * n:2 * n + d])))
            kept["dissipated_work"].append(y[-2])
            kept["external_work"].append(y[-1])
        read.append(at)
        ends.append(fine[-1])

    def whole(part, given):
        state = np.array([np.bincount(np.asarray(free), end[part], 3 * units).reshape(units, 3) for end in ends])
        for i, end in enumerate(ends):
            state[i][driven] = np.outer(end[given], [*scene["force_direction"], 0.0])
        return state

    moved = np.bincount([place for place, _ in given], ways, 3 * units).reshape(units, 3)
    start = {"start": moved + np.bincount(np.asarray(free), rest, 3 * units).reshape(units, 3)} if "pressed" in scene else {}
    about = {"kind": "trajectory", "scene": scene, "N": samples,
             "self_consistency": {"methods": "DOP853 rtol 1e-11 (kept) against 1e-9", "sensors_relative_l2": apart,
                                  "final_state_relative_l2": apart}}
    save(f"trajectory_difflexmm_{name}", about, {
        "alpha": alpha, "forces": forces, "sensors": np.array(read), **start,
        "final_displacement": whole(slice(0, n), slice(2 * n, 2 * n + d)) + moved,
        "final_velocity": whole(slice(n, 2 * n), slice(2 * n + d, 2 * n + 2 * d)), **{key: np.array(value).reshape(samples, steps) for key, value in kept.items()}})
    print(name, "trajectories apart by", apart)


if __name__ == "__main__":
    rng = np.random.default_rng(40)
    turn = np.deg2rad(20.0)
    kagome = geometry.KagomeGeometry(3, 2, bond_length=0.1)
    shifts = [np.zeros((4, 2, 2)), np.zeros((3, 3, 2)), np.zeros((3, 2, 2))]
    body = Body(kagome, shifts, 25.0, 2.3)
    alpha = 0.6 * rng.standard_normal(2 * (body.group.max() + 1))
    cases("kagome", body, jnp.asarray(alpha), rng, [0, 2, 4], [7, 11], [5, 9])
    # so heavy that it goes some 1 mm
    driven = body.scene(clamped=[0, 2, 4], panels=[7, 11], sensors=[5, 9], driven=[0], driven_mass=1e-3)
    motion("kagome_driven", body, jnp.asarray(alpha), np.random.default_rng(42), driven)
    motion("kagome_contact", body, jnp.asarray(alpha), np.random.default_rng(44), body.scene(
        clamped=[0, 2, 4], panels=[7, 11], sensors=[5, 9], contact=True))
    # the uppermost units come down in slots
    motion("kagome_pressed", body, jnp.asarray(alpha), np.random.default_rng(45), body.scene(
        clamped=[0, 2, 4], guided=[[unit, [False, True, False]] for unit in (7, 9, 11)], panels=[8, 3], sensors=[5, 9],
        pressed=3 * [[0.0, 0.0]] + 3 * [[0.0, -1.5]]))
    quads = geometry.QuadGeometry(4, 3, spacing=1.0, bond_length=0.15)
    tan = 0.5 * 0.85 * np.tan(turn)
    sign = lambda i, j: (-1.0) ** (i + j)
    horizontal = np.array([[[0.0, -tan * sign(i, j)] for j in range(3)] for i in range(5)])
    vertical = np.array([[[tan * sign(i, j), 0.0] for j in range(4)] for i in range(4)])
    body = Body(quads, [horizontal, vertical], 15.0, 0.6)
    alpha = 0.6 * rng.standard_normal(2 * (body.group.max() + 1))
    cases("quads", body, jnp.asarray(alpha), rng, [0, 1, 2, 3], [9, 10], [5, 6])
    motion("quads_contact", body, jnp.asarray(alpha), np.random.default_rng(46), body.scene(
        clamped=[0, 1, 2, 3], panels=[9, 10], sensors=[5, 6], contact=True))
    # bottom and top come together by a twelfth of the way between them, as in DifFlexMM's quads_kinetic_energy_static_tuning
    quads = geometry.QuadGeometry(4, 5, spacing=1.0, bond_length=0.15)
    horizontal = np.array([[[0.0, -tan * sign(i, j)] for j in range(5)] for i in range(5)])
    vertical = np.array([[[tan * sign(i, j), 0.0] for j in range(4)] for i in range(6)])
    body = Body(quads, [horizontal, vertical], 15.0, 0.6)
    alpha = 0.6 * rng.standard_normal(2 * (body.group.max() + 1))
    held = [*range(4), *range(16, 20)]
    motion("quads_pressed", body, jnp.asarray(alpha), rng, body.scene(
        clamped=held, pressed=4 * [[0.0, 2.5]] + 4 * [[0.0, -2.5]], panels=[13, 8], sensors=[6, 9]))
    # sides come together on rollers, and slide along them but for one corner; a unit inside does not turn
    sides = [unit for row in range(5) for unit in (4 * row, 4 * row + 3) if unit > 0]
    guided = [[unit, [True, False, False]] for unit in sides] + [[10, [False, False, True]]]
    ways = [[1.2 if unit % 4 == 0 else -1.2, 0.0] for unit in [0, *sides]] + [[0.0, 0.0]]
    motion("quads_guided", body, jnp.asarray(alpha), np.random.default_rng(43), body.scene(
        clamped=[0], guided=guided, pressed=ways, panels=[17, 18], sensors=[6, 10]))
