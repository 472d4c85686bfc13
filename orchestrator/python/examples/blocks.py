"""Converts a geometry of DifFlexMM into a body, and back: `python blocks.py SPEC` for a small Kagome lattice, if DifFlexMM is installed.

DifFlexMM (github.com/bertoldi-collab/DifFlexMM) describes a body by the centroids of its blocks, the vectors from there to their nodes,
and the nodes that bonds join, numbered over all blocks. `body.file` reads these arrays; `arrays` returns those of a trained design.
"""

import sys
from pathlib import Path

import metasense
import numpy as np

HELD = "clamp = [0]\npanel_units = [1]\n"


def arrays(body, alpha):
    """block_centroids, centroid_node_vectors and bond_connectivity of a design."""
    corners = body.vertices(alpha)
    a, b = corners, np.roll(corners, -1, axis=1)
    cross = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    centroids = ((a + b) * cross[..., None]).sum(axis=1) / (3 * cross.sum(axis=1))[:, None]
    each = corners.shape[1]
    bonds = np.array([[i * each + p, j * each + q] for i, p, j, q in body.ligaments])
    return centroids, corners - centroids[:, None], bonds


def main(centroids, nodes, bonds, spec, folder):
    np.savez(Path(folder) / "blocks.npz", block_centroids=centroids, centroid_node_vectors=nodes, bond_connectivity=bonds)
    lattice = ("columns", "rows", "spacing", "ligament_length", "initial_angle")
    kept = [line for line in spec.splitlines() if not line.startswith(lattice)]
    own = Path(folder) / "blocks.toml"
    own.write_text("\n".join(kept).replace("[body]", f'[body]\nfile = "blocks.npz"\n{HELD}'))
    body = metasense.Body.from_spec(own, threads=2)
    return body, arrays(body, body.alpha)


if __name__ == "__main__":
    from difflexmm.geometry import KagomeGeometry

    lattice = KagomeGeometry(4, 3, bond_length=0.1)
    lattice.compute_geometry()
    theirs = [25 * np.asarray(lattice.block_centroids()), 25 * np.asarray(lattice.centroid_node_vectors())]
    body, _ = main(*theirs, np.asarray(lattice.bond_connectivity()), Path(sys.argv[1]).read_text(), ".")
    print(f"{body.units} blocks, {body.alpha.size} design parameters, {len(body.violations(body.alpha))} limits broken")
