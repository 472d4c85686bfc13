"""Figures with matplotlib (extra `plot`). Each function draws on `axes`, or on a new figure, and returns the axes."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metasense._errors import targets
from metasense._metasense import Body
from metasense._results import Database

try:
    import matplotlib.pyplot as plt
    from matplotlib.axes import Axes
except ImportError as error:
    raise ImportError("metasense.plot needs matplotlib: run `pip install matplotlib` or install metasense[plot]") from error

INITIAL, TRAINED, ACCENT = "0.55", "tab:blue", "tab:orange"


def _axes(axes: Axes | None) -> Axes:
    return plt.figure(figsize=(5.0, 3.5), layout="constrained").gca() if axes is None else axes


def body(body: Body, alpha: ArrayLike | None = None, *, axes: Axes | None = None) -> Axes:
    """The units of a body in mm, with a scale of the axes: panels orange, sensors blue with their numbers, clamped units dark."""
    axes = _axes(axes)
    colours = {**dict.fromkeys(body.clamped, "0.3"), **dict.fromkeys(body.panels, ACCENT), **dict.fromkeys(body.sensors, TRAINED)}
    for unit, corners in enumerate(body.polygons(alpha)):
        points = np.array(corners)
        axes.fill(points[:, 0], points[:, 1], facecolor=colours.get(unit, "0.85"), edgecolor="0.4", linewidth=0.8)
        if unit in body.panels or unit in body.sensors:
            axes.annotate(str(unit), tuple(points.mean(axis=0)), ha="center", va="center", fontsize=7)
    axes.set(aspect="equal", xlabel="x (mm)", ylabel="y (mm)")
    return axes


def signals(body: Body, signals: ArrayLike, sample: int = 0, *, axes: Axes | None = None) -> Axes:
    """The signals (N, T, 3M) of a sample over time (s), each relative to its largest value, which the legend states."""
    axes, values = _axes(axes), np.asarray(signals, dtype=np.float64)
    if values.ndim != 3 or values.shape[1] != body.instants:
        raise ValueError(f"signals have shape {values.shape}: must be (N, T = {body.instants}, 3M)")
    time = np.arange(1, body.instants + 1) * body.duration / body.instants
    for channel in range(values.shape[2]):
        history = values[sample, :, channel]
        peak = float(np.abs(history).max())
        kind, unit = [("a_x", "mm/s²"), ("a_y", "mm/s²"), ("ω", "rad/s")][channel % 3]
        axes.plot(time, history / (peak or 1.0), linewidth=1.0, label=f"sensor {channel // 3} {kind}, at most {peak:.3g} {unit}")
    axes.set(xlabel="time (s)", ylabel="signal / its largest value")
    axes.legend(frameon=False, fontsize=7)
    return axes


def forces(
    body: Body, forces: ArrayLike, predictions: ArrayLike | None = None, sample: int = 0, *, axes: Axes | None = None
) -> Axes:
    """The forces (N, K, T + 1) of a sample (N) over time (s), and as dashes the predictions (N, T, K)."""
    axes, true = _axes(axes), targets(forces)
    time = np.arange(1, true.shape[1] + 1) * body.duration / true.shape[1]
    predicted = None if predictions is None else np.asarray(predictions, dtype=np.float64)
    if predicted is not None and predicted.shape != true.shape:
        raise ValueError(f"predictions have shape {predicted.shape}: must be (N, T, K) = {true.shape}")
    for panel in range(true.shape[2]):
        [line] = axes.plot(time, true[sample, :, panel], label=f"force on panel {panel}")
        if predicted is not None:
            axes.plot(time, predicted[sample, :, panel], "--", color=line.get_color(), label="predicted")
    axes.set(xlabel="time (s)", ylabel="force (N)")
    axes.legend(frameon=False, fontsize=7)
    return axes


def _finished(db: Database) -> dict[str, Any]:
    sql = "SELECT sensors, panels, brain, holdout_error_initial AS initial, holdout_error_optimised AS trained FROM v_trial"
    rows = db.query(f"{sql} WHERE holdout_error_initial > 0 AND holdout_error_optimised > 0 ORDER BY sensors").to_dict()
    if not rows["sensors"]:
        raise ValueError(f"{db.path} has no finished trial with a held-out error: run it first")
    return {name: np.array(values) for name, values in rows.items()}


def elbow(db: Database, *, axes: Axes | None = None) -> Axes:
    """Held-out error (%) against the number of sensors: trials as dots, geometric means as lines, per decoder and body."""
    axes, rows = _axes(axes), _finished(db)
    for brain, style in zip(np.unique(rows["brain"]), ["-", "--", ":", "-."] * 9, strict=False):
        of = rows["brain"] == brain
        counts = np.unique(rows["sensors"][of])
        for which, colour in [("initial", INITIAL), ("trained", TRAINED)]:
            errors = rows[which].astype(float)
            axes.plot(rows["sensors"][of], errors[of], "o", color=colour, alpha=0.4, markersize=4)
            means = [np.exp(np.log(errors[of & (rows["sensors"] == count)]).mean()) for count in counts]
            axes.plot(counts, means, style, color=colour, label=f"{which} body, {brain}")
    axes.set(xlabel="sensors M", ylabel="held-out error (%)", yscale="log", xticks=np.unique(rows["sensors"]))
    axes.legend(frameon=False, fontsize=7)
    return axes


def gains(db: Database, *, axes: Axes | None = None) -> Axes:
    """Held-out error (%) of each trained body against that of its initial body; below the line, training helps."""
    axes, rows = _axes(axes), _finished(db)
    for count in np.unique(rows["sensors"]):
        of = rows["sensors"] == count
        axes.plot(rows["initial"][of], rows["trained"][of], "o", markersize=4, label=f"M = {count}")
    both = np.concatenate([rows["initial"], rows["trained"]]).astype(float)
    ends = [both.min() / 1.3, both.max() * 1.3]
    axes.plot(ends, ends, color=INITIAL, linewidth=0.8)
    axes.set(xlabel="initial body: held-out error (%)", ylabel="trained body (%)", xscale="log", yscale="log", xlim=ends, ylim=ends)
    axes.legend(frameon=False, fontsize=7)
    return axes
