"""A virtual laboratory: files of a hammer's recorder and of two IMUs, for bodies that the model does not contain.

This script integrates the bodies with its own code: ligaments relax (Maxwell), casts deviate, bending stiffens at a stop, chips have
cables, and damping is in the ligaments. Instruments have noise, offsets, resolution, ranges, their own clocks and a finite bandwidth.
"""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from metasense import Body
from metasense.records import convert
from numpy.typing import NDArray

SPEC = """name = "laboratory"
[body]
columns = 4
rows = 4
spacing = 50.0
ligament_length = 7.5
material = { rubber = "Dragon Skin 10", thickness = 10.0, ligament_width = 6.0 }
[time]
duration = 0.5
samples = 100
[stimuli]
kind = "irregular"
samples = 160
test = 40
holdout = 60
amplitude = [1.0, 3.5]
width = [0.006, 0.015]
onset = [0.03, 0.07]
double = 0.0
force_samples = 1000
[feasible]
min_edge = 10.0
clearance = 3.3
ligament_clearance = 1.7
[sensors]
chip = "WT9011DCL"
[brain]
kind = "linear"
[optimise]
iterations = 30
learning_rate = 1.0
[sweep]
panels = [2]
sensors = [2]
seeds = [1]
"""
G = 9806.65
HAMMER, IMU = 2048.0, 200.0
_LENGTH = 0.75  # of a simulated blow (s)
_EVERY = 1.2  # between blows (s)
_FIRST = 0.6
_Array = NDArray[np.float64]


@dataclass
class Set:
    """One session: what the body, the instruments and the person did. Fields are what a mistake changes."""

    seed: int
    blows: int = 4
    """Per panel."""
    dampers: float = 0.0
    """Factor ζ of dampers at the units, as in the model, in place of ligaments that relax; 0: they relax."""
    units: list[int] = field(default_factory=list)
    """Units on which the chips really are; empty: those of the spec."""
    struck: dict[tuple[int, int], int] = field(default_factory=dict)
    """Panel that was really struck, by file and blow."""
    double: list[tuple[int, int]] = field(default_factory=list)
    range_acceleration: float = 16.0  # g
    range_force: float = 50.0  # N
    mount: dict[int, tuple[tuple[float, ...], ...]] = field(default_factory=dict)
    """Rows of a chip's axes in those of the body, (x, y, turn)."""
    dead: dict[int, str] = field(default_factory=dict)
    """Columns that are "stuck" or "noise"."""
    gravity: tuple[float, float] = (0.0, 0.0)
    """In the plane of the sheet (g)."""
    late: float = 0.0
    """Time of the hammer's clock at which the IMU's is 0, other than it should be (s)."""
    drift: float = 0.0
    rate_error: float = 2e-5
    """Standard deviation of the IMU's rate, relative to the hammer's; 0: one clock."""
    lost: float = 0.0
    """Part of the IMU's lines that are missing."""
    pauses: float = 0.0
    """Standard deviation by which each blow's IMU file begins off (s)."""
    force_factor: float = 1.0
    order: list[int] = field(default_factory=lambda: [0, 1, 2, 3, 4, 5])
    """Of the IMU's columns."""
    options: dict[str, Any] = field(default_factory=dict)
    """Of `metasense.records.convert`."""
    keys: dict[str, str] = field(default_factory=lambda: {"recorded": "remove_offset = true"})
    """Lines that the person adds to the TOML."""


def motion(body: Body, sets: list[Set], alpha: _Array | None = None) -> list[list[list[tuple[_Array, _Array]]]]:
    """(force, signals of the chips) of every blow of every file of every set, on a clock of HAMMER entries per second."""
    plans, casts = [], []
    for one in sets:
        rng = np.random.default_rng([one.seed, 1])
        cast = _cast(body, one, rng)
        for panel in range(2):
            for blow in range(one.blows):
                plans.append((one, panel, blow, _force(rng, (panel, blow) in one.double)))
                casts.append(cast)
    force = np.stack([plan[3] for plan in plans])
    struck = [body.panels[one.struck.get((panel, blow), panel)] for one, panel, blow, _ in plans]
    chips = [one.units or body.sensors for one, *_ in plans]
    signals = _integrate(body, alpha, casts, force, struck, chips)
    found = iter(zip(force, signals))
    return [[[next(found) for _ in range(one.blows)] for _ in range(2)] for one in sets]


def _force(rng: np.random.Generator, double: bool) -> _Array:
    """A blow of a soft tip at 0.02 s, of several humps as hands make them."""
    time = np.arange(round(_LENGTH * HAMMER) + 1) / (HAMMER)
    width = rng.uniform(0.006, 0.012)

    def pulse(start: float) -> _Array:
        z = np.clip((time - start) / width, 0.0, 1.0) ** rng.uniform(0.8, 1.0)
        return np.sin(np.pi * z) ** rng.uniform(1.5, 2.0) * (1.0 + 0.1 * np.sin(2.0 * np.pi * z * rng.uniform(2.0, 4.0)))

    force = rng.uniform(1.2, 3.2) * pulse(0.02)
    return force + rng.uniform(0.4, 0.7) * force.max() * pulse(0.02 + width + rng.uniform(0.02, 0.05)) if double else force


def _cast(body: Body, one: Set, rng: np.random.Generator) -> dict[str, _Array]:
    """Material and masses of a cast: what scatters, and what the model leaves out."""
    common = np.exp(rng.normal(0.0, [0.08, 0.08, 0.08]))
    own = np.exp(rng.normal(0.0, 0.03, (len(body.ligaments), 3)))
    cast = {
        "stiffness": np.asarray(body.stiffness) * common * own,
        "density": np.asarray(body.density * np.exp(rng.normal(0.05, 0.03))),
        "share": np.asarray(rng.uniform(0.1, 0.25)),
        "time": np.asarray(rng.uniform(0.004, 0.02)),
        "viscosity": np.asarray(rng.uniform(2e-4, 6e-4)),
        "cable": np.asarray(rng.uniform(5e-7, 2e-6)),
        "tether": np.asarray(rng.uniform(0.0, 4e-3)),
        "shifts": rng.normal(0.0, 0.15, (len(body.ligaments), 2, 2)),
        "chip": np.asarray([9e-6, 9e-6 * (23.5**2 + 32.5**2) / 12.0]),
        "dampers": np.asarray(one.dampers),
    }
    return cast | {key: np.zeros(()) for key in ("share", "viscosity") if one.dampers}


def _integrate(body: Body, alpha: _Array | None, casts: list[dict[str, _Array]], force: _Array, struck: list[int], chips: list[list[int]]) -> _Array:
    """Velocity Verlet of units and relaxing ligaments; (blows, entries, chips · 3) of a_x, a_y (mm/s²), ω (rad/s)."""
    corners = np.asarray(body.vertices(alpha))
    count, units = len(casts), len(corners)
    x, y = corners[..., 0], corners[..., 1]
    ahead = np.roll(corners, -1, axis=1)
    cross = x * ahead[..., 1] - ahead[..., 0] * y
    area = cross.sum(1) / 2.0
    centre = ((corners + ahead) * cross[..., None]).sum(1) / (6.0 * area[:, None])
    polar = (cross * (corners**2 + corners * ahead + ahead**2).sum(2)).sum(1) / 12.0 - area * (centre**2).sum(1)
    a, node_a, b, node_b = np.array(body.ligaments).T
    together = {key: np.stack([cast[key] for cast in casts]) for key in casts[0]}
    mass = together["density"][:, None] * area
    moment = together["density"][:, None] * polar
    for blow, chip in enumerate(chips):
        mass[blow, chip] += together["chip"][blow, 0] + together["cable"][blow]
        moment[blow, chip] += together["chip"][blow, 1]
    arm_a = corners[a, node_a] - centre[a] + together["shifts"][:, :, 0]
    arm_b = corners[b, node_b] - centre[b] + together["shifts"][:, :, 1]
    soft = together["stiffness"].mean(1)
    mean = together["density"] * area.mean(), together["density"] * polar.mean()
    dampers = np.sqrt(np.stack([mean[0] * soft[:, 1], mean[0] * soft[:, 1], mean[1] * soft[:, 2]], axis=1))
    dampers *= 2.0 * together["dampers"][:, None]
    gap = centre[b] - centre[a]
    rest = gap + arm_b - arm_a
    length = np.hypot(rest[..., 0], rest[..., 1])
    angle = np.arctan2(rest[..., 1], rest[..., 0])
    inverse = 1.0 / np.stack([mass, mass, moment], axis=2)
    inverse[:, body.clamped] = 0.0
    stiffness, share = together["stiffness"], together["share"][:, None, None]
    fade = np.exp(-1.0 / (HAMMER) / together["time"])[:, None, None]
    every = np.arange(count)
    to_a, to_b = (np.zeros((units, len(a))) for _ in range(2))
    to_a[a, np.arange(len(a))] = to_b[b, np.arange(len(a))] = 1.0
    tether = np.zeros((count, units, 1))
    for blow, chip in enumerate(chips):
        tether[blow, chip] = together["tether"][blow]

    def turned(arm: _Array, theta: _Array) -> _Array:
        c, s = np.cos(theta), np.sin(theta)
        return np.stack([c * arm[..., 0] - s * arm[..., 1], s * arm[..., 0] + c * arm[..., 1]], axis=2)

    place, speed = np.zeros((count, units, 3)), np.zeros((count, units, 3))
    branch, before = np.zeros(stiffness.shape), np.zeros(stiffness.shape)
    step = 1.0 / (HAMMER)
    out = []
    acceleration = np.zeros_like(place)
    for n in range(force.shape[1]):
        speed += 0.5 * step * acceleration
        place += step * speed * (n > 0)
        of_a, of_b = turned(arm_a, place[:, a, 2]), turned(arm_b, place[:, b, 2])
        vector = gap + place[:, b, :2] + of_b - place[:, a, :2] - of_a
        now = np.hypot(vector[..., 0], vector[..., 1])
        along = vector / now[..., None]
        across = np.stack([-along[..., 1], along[..., 0]], axis=2)
        middle = 0.5 * (place[:, a, 2] + place[:, b, 2])
        shear = np.arctan2(vector[..., 1], vector[..., 0]) - angle - middle
        shear = (shear + np.pi) % (2.0 * np.pi) - np.pi
        bend = place[:, b, 2] - place[:, a, 2]
        strain = np.stack([now - length, length * shear, bend], axis=2)
        rate = (strain - before) / step
        branch = fade * branch + 0.5 * (1.0 + fade) * (strain - before)
        before = strain
        pull = stiffness * (strain + share * branch + together["viscosity"][:, None, None] * rate)
        pull[..., 2] += 40.0 * np.sign(bend) * np.maximum(np.abs(bend) - 0.5, 0.0)
        on_b = -(pull[..., 0, None] * along + (pull[..., 1] * length / now)[..., None] * across)
        swing = 0.5 * pull[..., 1] * length
        turn_a = -(of_a[..., 0] * on_b[..., 1] - of_a[..., 1] * on_b[..., 0]) + swing + pull[..., 2]
        turn_b = of_b[..., 0] * on_b[..., 1] - of_b[..., 1] * on_b[..., 0] + swing - pull[..., 2]
        loads = np.concatenate(
            [
                np.einsum("ul,blc->buc", to_b, on_b) - np.einsum("ul,blc->buc", to_a, on_b),
                (turn_a @ to_a.T + turn_b @ to_b.T)[..., None],
            ],
            axis=2,
        )
        loads[every, struck, 1] -= force[:, n]
        loads[..., :2] -= tether * place[..., :2]
        loads -= dampers[:, None] * speed
        acceleration = loads * inverse
        speed += 0.5 * step * acceleration * (n > 0)
        of_chips = [np.stack([acceleration[every, c, 0], acceleration[every, c, 1], speed[every, c, 2]], axis=1) for c in np.array(chips).T]
        out.append(np.concatenate(of_chips, axis=1))
    return np.stack(out, axis=1)


def write(one: Set, blows: list[list[tuple[_Array, _Array]]], folder: Path) -> Path:
    """Writes the files of a session into `folder`, converts them as a person would, and returns the TOML for `lab check`."""
    rng = np.random.default_rng([one.seed, 2])
    names, begins = [], rng.uniform(2.0, 8.0)
    for panel in range(2):
        time = np.arange(round((_FIRST + _EVERY * one.blows) * HAMMER)) / HAMMER
        force = 0.004 * rng.normal(size=len(time)) + rng.normal(0.0, 0.01)
        ticks = np.arange(round(time[-1] * IMU)) / IMU + rng.uniform(0.0, 1.0 / IMU)
        # the IMU's own time of each reading, and where the body's motion then is
        signals = np.zeros((len(ticks), 6))
        for blow, (of_force, of_signals) in enumerate(blows[panel]):
            first = round((_FIRST + _EVERY * blow) * HAMMER)
            force[first : first + len(of_force)] += of_force
            filtered = np.stack([np.convolve(c, np.ones(5) / 5.0)[: len(c)] for c in of_signals.T], axis=1)
            place = ticks - first / HAMMER - rng.normal(0.0, one.pauses)
            inside = (place > 0.0) & (place < _LENGTH)
            signals[inside] += np.stack([np.interp(place[inside], np.arange(len(c)) / HAMMER, c) for c in filtered.T], axis=1)
        force = np.clip(force, -one.range_force, one.range_force)
        with (folder / f"blows_p{panel + 1}.csv").open("w") as file:
            file.write("Hammer,HX-5,sensitivity 22.5 mV/N\nSample rate,2048 Hz\nOperator,M\n\nTime (s),Hammer\n")
            file.writelines(f"{t:.6f},{f:.4f}\n" for t, f in zip(time, force * one.force_factor))
        for chip, rows in one.mount.items():
            signals[:, 3 * chip : 3 * chip + 3] = signals[:, 3 * chip : 3 * chip + 3] @ np.array(rows).T
        for chip in range(2):
            acceleration = signals[:, 3 * chip : 3 * chip + 2] / G + np.array(one.gravity) + rng.normal(0.0, 0.015, 2)
            turning = np.degrees(signals[:, 3 * chip + 2]) + rng.normal(0.0, 0.5)
            acceleration += 0.004 * rng.normal(size=acceleration.shape)
            turning = np.clip(turning + 0.1 * rng.normal(size=len(turning)), -2000.0, 2000.0)
            acceleration = np.clip(acceleration, -one.range_acceleration, one.range_acceleration)
            signals[:, 3 * chip : 3 * chip + 2] = np.round(acceleration * 2048.0) / 2048.0
            signals[:, 3 * chip + 2] = np.round(turning * 16.4) / 16.4
        for column, how in one.dead.items():
            signals[:, column] = 0.25 if how == "stuck" else np.round(0.5 * rng.normal(size=len(ticks)) * 2048.0) / 2048.0
        own = (ticks - one.late) * (1.0 + one.drift + rng.normal(0.0, one.rate_error)) + begins + rng.normal(0.0, 2e-4)
        kept = np.flatnonzero(rng.uniform(size=len(ticks)) >= one.lost)
        with (folder / f"imu_p{panel + 1}.csv").open("w") as file:
            file.write("# two WT9011DCL on one logger\nt,Acc1X,Acc1Y,Gyr1Z,Acc2X,Acc2Y,Gyr2Z\n")
            file.writelines(f"{own[n]:.5f}," + ",".join(f"{signals[n, c]:.5f}" for c in one.order) + "\n" for n in kept)
        names.append(panel + 1)
    options: dict[str, Any] = {
        "time": "Time", "force": "Hammer", "force_unit": "N", "signal_time": "t", "signal_start": -begins,
        "signals": ["Acc1X", "Acc1Y", "Gyr1Z", "Acc2X", "Acc2Y", "Gyr2Z"], "acceleration_unit": "g", "angular_velocity_unit": "deg/s",
        "trigger": 0.2, "length": 0.6, "before": 0.05, "panel_pattern": r"_p(\d)", "first_panel": 1,
    } | one.options
    files = [[folder / f"{kind}_p{n}.csv" for n in names] for kind in ("blows", "imu")]
    toml, _ = convert(files[0], folder / "records.npz", signal_files=files[1], **options)
    text = toml.read_text()
    for table, line in one.keys.items():
        text = text.replace(f"[{table}]", f"[{table}]\n{line}", 1)
    toml.write_text(text)
    return toml


_SWAPPED = ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
_QUARTER = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
_FLIPPED = ((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0))
# What goes wrong, and the check and the words that name it
MISTAKES: dict[str, tuple[dict[str, Any], str, str]] = {
    "acceleration taken for mm/s²": ({"options": {"acceleration_unit": "mm/s2"}}, "unit", 'signals.acceleration_unit = "g"'),
    "acceleration taken for m/s²": ({"options": {"acceleration_unit": "m/s2"}}, "unit", 'signals.acceleration_unit = "g"'),
    "rotation rate taken for rad/s": ({"options": {"angular_velocity_unit": "rad/s"}}, "unit", 'angular_velocity_unit = "deg/s"'),
    "force in mN taken for N": ({"force_factor": 1e3, "options": {"trigger": 200.0}}, "unit", 'recorded.force_unit = "mN"'),
    "force with the wrong sign": ({"force_factor": -1.0}, "force", "recorded.scale = -1"),
    "x and y of chip 1 exchanged": ({"order": [1, 0, 2, 3, 4, 5]}, "axis", "a_x of sensor 0 fits a_y"),
    "chip 2 turned by 90°": ({"mount": {1: _QUARTER}}, "axis", "a_x of sensor 1 fits minus a_y"),
    "chip 1 upside down": ({"mount": {0: _FLIPPED}}, "axis", "ω of sensor 0 fits minus"),
    "chips exchanged": ({"order": [3, 4, 5, 0, 1, 2]}, "sensor", "the signals of sensor 0 fit sensor 1"),
    "chip on another unit": ({"units": [10, 5]}, "sensor", "unit 10"),
    "gravity left in": ({"gravity": (0.0, -1.0), "keys": {}}, "offset", "contains gravity"),
    "clock 0.35 s late": ({"late": -0.35, "options": {"length": 0.9}, "keys": {"recorded": "remove_offset = true"}}, "clock", "0.35"),
    "clock 60 ms early": ({"late": 0.06}, "clock", "signals"),
    "clock drifts by 2 %": ({"drift": 0.02}, "clock", "signals"),
    "each blow's clock off": ({"pauses": 0.025}, "clock", "signals.start"),
    "panel of one record": ({"struck": {(0, 2): 1}}, "panel", "record 2"),
    "panels exchanged": ({"struck": {(p, b): 1 - p for p in range(2) for b in range(4)}}, "panel", "the records of panel 0 fit panel 1"),
    "gyroscope 2 unplugged": ({"dead": {5: "stuck"}}, "channel", "ω of sensor 1"),
    "broken wire of a_y 1": ({"dead": {1: "noise"}}, "channel", "a_y of sensor 0"),
    "range of 2 g": ({"range_acceleration": 2.0}, "range", "a_"),
    "hammer's range of 1.5 N": ({"range_force": 1.5}, "range", "force 0"),
    "double blow": ({"double": [(1, 1)]}, "blow", "record 5"),
    "lost lines": ({"lost": 0.01}, "file", "entries are missing"),
}


def main(folder: str | Path, seed: int = 1, blows: int = 4, design: str | Path | None = None, dampers: float = 0.0, rate_error: float = 2e-5) -> Path:
    """Writes the spec and a session without mistakes into a folder. Returns the TOML of the records."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    spec = folder / "laboratory.toml"
    if not spec.exists():
        spec.write_text(SPEC)
    one = Set(seed, blows=blows, dampers=dampers, rate_error=rate_error)
    return write(one, motion(Body.from_spec(spec), [one], None if design is None else np.load(design))[0], folder)


if __name__ == "__main__":
    print(main(sys.argv[1], *map(int, sys.argv[2:4]), *sys.argv[4:5], *map(float, sys.argv[5:7])))
