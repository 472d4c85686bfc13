"""Holdout error against the number of sensors, the paper's Fig. 4B: `python elbow.py DATABASE FIGURE`."""

import sys

import matplotlib
import metasense
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt


def main(database, figure):
    db = metasense.Database(database)
    rows = db.query(
        "SELECT sensors, brain, holdout_error_initial AS initial, holdout_error_optimised AS optimised FROM v_trial "
        "WHERE state = 'done' ORDER BY sensors"
    ).to_dict()
    sensors, brains = np.array(rows["sensors"]), np.array(rows["brain"])
    axes = plt.figure(figsize=(5, 3.5), layout="constrained").gca()
    for brain, style in zip(np.unique(brains), ["-", "--", ":"]):
        for body, colour in [("initial", "tab:gray"), ("optimised", "tab:blue")]:
            errors = np.where(brains == brain, np.array(rows[body], dtype=float), np.nan)
            axes.plot(sensors, errors, "o", color=colour, alpha=0.4, markersize=4)
            counts = np.unique(sensors[brains == brain])
            means = [np.exp(np.nanmean(np.log(errors[sensors == count]))) for count in counts]
            axes.plot(counts, means, style, color=colour, label=f"{body} body, {brain}")
    axes.set(xlabel="sensors M", ylabel="holdout error (%)", yscale="log", xticks=np.unique(sensors))
    axes.legend(frameon=False)
    axes.figure.savefig(figure, dpi=150)
    return db.analyse("elbow")


if __name__ == "__main__":
    print(main(*sys.argv[1:]).to_dict())
