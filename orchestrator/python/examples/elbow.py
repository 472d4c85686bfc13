"""Held-out error against the number of sensors, the paper's Fig. 4B: `python elbow.py DATABASE FIGURE`."""

import sys

import matplotlib
import metasense

matplotlib.use("Agg")
from metasense import plot


def main(database, figure):
    db = metasense.Database(database)
    plot.elbow(db).figure.savefig(figure, dpi=150)
    return db.analyse("elbow")


if __name__ == "__main__":
    print(main(*sys.argv[1:]).to_dict())
