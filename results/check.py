#!/usr/bin/env python3
"""Recomputes tables of README.md and results/README.md from the rows of trials in committed/, by nothing of metasense.

`python3 results/check.py` prints a line a table and exits with 1 if a number differs. Only tables whose every cell follows from rows
of trials, samples or casts are here: a table that was printed by `metasense analyse` is an answer, not a row.
"""

import csv
import math
import re
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
T975 = {3: 3.182, 4: 2.776}  # Student's t, 97.5 %, by degrees of freedom, as tables print it


def rows(file, **wanted):
    with open(HERE / "committed" / file, newline="") as text:
        return [row for row in csv.DictReader(text) if all(row[k.replace("__", ".")] == v for k, v in wanted.items())]


def numbers(of, name):
    return [float(row[name]) for row in of]


def geometric(values):
    return math.exp(sum(map(math.log, values)) / len(values))


def median(values):
    values, half = sorted(values), len(values) // 2
    return values[half] if len(values) % 2 else (values[half - 1] + values[half]) / 2


def short(x):
    """Two significant digits, three after a leading 1."""
    def digits(count):
        return f"{x:.{max(count - 1 - math.floor(math.log10(abs(x))), 0)}f}"
    two = digits(2)
    return digits(3) if two.lstrip("0.-").startswith("1") else two


def mean_and_half(values):
    """The mean and half of its 95 % interval, by Student's t."""
    mean, free = sum(values) / len(values), len(values) - 1
    return mean, T975[free] * math.sqrt(sum((x - mean) ** 2 for x in values) / free / len(values))


def with_interval(ratios):
    """The geometric mean of ratios with the 95 % interval of their logarithms."""
    mean, half = mean_and_half([math.log(x) for x in ratios])
    return "{} ({} … {})".format(*(short(math.exp(x)) for x in (mean, mean - half, mean + half)))


def change(of):
    """Initial → optimised body, geometric means of the trials' holdout errors."""
    ends = (short(geometric(numbers(of, f"holdout_error_{body}"))) for body in ("initial", "optimised"))
    return " → ".join(ends) + " %"


def table(name, file="results/README.md"):
    """Cells of a generated table, without its head."""
    text = (HERE.parent / file).read_text()
    body = re.search(rf"<!-- generated: {name} -->\n(.*?)<!-- end -->", text, re.S).group(1)
    lines = [line for line in body.splitlines() if line.startswith("|") and not line.startswith("|---")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines][1:]


BRAINS = {
    "the paper's network": ("", "13122"),
    "long network": ("", "11138"),
    "linear brain": ("linear", "968"),
    "stacked network": ("stacked", "14474"),
    "stacked long network": ("stacked", "12538"),
}


def quickstart():
    for line in table("quickstart", "README.md"):
        brain = "linear" if line[1] == "linear brain" else "cnn"
        [row] = rows("quickstart.csv", sensors=line[0], brain=brain)
        names = ["holdout_error_initial", "holdout_error_optimised"]
        yield line[2:], [short(float(row[name])) + " %" for name in names + ["linear_" + name for name in names]]


def who_senses():
    readers = ["nominal", "casts", "records", "records", "network", "network_casts", "inverse", "twin", "twin"]
    for reader, line in zip(readers, table("who senses")):
        records = (re.search(r"\d+ records", line[0]) or ["0"])[0].split()[0]
        brain = "cnn" if "network" in reader else "inverse"
        own = brain == "cnn" or reader in ("inverse", "twin")
        found = []
        for body, objective in [("initial", "nominal"), ("optimised", "nominal"), ("optimised", "mean")]:
            trials = rows("who-senses/trials.csv", brain=brain, objective=objective)
            name = ("" if own else "linear_") + f"holdout_error_{body}"
            cast = rows("who-senses/casts.csv", brain=brain, objective=objective, body=body, reader=reader, records=records)
            errors = numbers(cast, "error")
            found.append("" if records != "0" else short(geometric(numbers(trials, name))) + " %")
            found.append(f"{short(median(errors))} [{short(max(errors))}] %")
        yield line[2:], found


def sensors():
    for line in table("sensors"):
        file = "claims/four-forces-trials.csv" if "K = 4" in line[0] else "claims/eight-forces-trials.csv"
        brain = "linear" if "linear" in line[0] else ""
        yield line[1:], [change(rows(file, sensors=m, brain__kind=brain)) for m in "123456"]


def claims():
    """Those of the sweeps over sensors: better with every number, and two trained against six untrained."""
    for line in table("claims"):
        if "with every number" not in line[0] and "with two sensors" not in line[0]:
            continue
        file = "claims/four-forces-trials.csv" if line[0].startswith("K = 4") else "claims/eight-forces-trials.csv"
        def of(m, brain):
            return sorted(rows(file, sensors=m, brain__kind=brain), key=lambda row: int(row["placement"]))
        for cell, brain in [(line[2], ""), (line[4], "linear")]:
            before, after = ("6", "2") if "with two sensors" in line[0] else ("1", "1")
            initial = numbers(of(before, brain), "holdout_error_initial")
            optimised = numbers(of(after, brain), "holdout_error_optimised")
            found = with_interval([a / b for a, b in zip(initial, optimised)])
            yield [cell.split(",")[0].split(":")[0]], [found]


def brains():
    for line in table("brains"):
        kind = {"smooth pulses": "bell", "hammer blows": "irregular"}[line[0]]
        noise = {"none": "", "1 %": "0.01", "3 %": "0.03", "10 %": "0.1"}[line[1]]
        found = []
        for brain, weights in [BRAINS[name] for name in ("the paper's network", "long network", "linear brain")]:
            of = rows("brains-two-core/trials.csv", stimuli__kind=kind, sensors__noise=noise, brain__kind=brain, brain_parameters=weights)
            found.append(change(of))
        yield line[2:5], found


def linear_bodies():
    for line in table("linear bodies"):
        brain, weights = BRAINS[line[0]]
        def cell(kind):
            return change(rows("fig2-linear/trials.csv", brain__kind=brain, brain_parameters=weights, stimuli__kind=kind))
        yield line[1:], [cell("bell"), cell("irregular")]


def placed():
    for line in table("placed"):
        kind = "linear" if line[0].startswith("linear") else ""
        search = "greedy" if "placed" in line[1] else ""
        if line[1].startswith("gain"):
            continue
        body = "initial" if line[1].startswith("initial") else "optimised"
        def cell(m):
            of = rows("placed-two-core/trials.csv", sensors=m, brain__kind=kind, sensors__search=search, stimuli__kind="bell")
            return short(geometric(numbers(of, f"holdout_error_{body}"))) + " %"
        yield line[2:], [cell(m) for m in "123456"]


def transfer_networks():
    def errors(body, under):
        return numbers(rows("transfer/networks.csv", trained_under=body, read_under=under), "error")
    for body, line in zip(["initial", "bell", "irregular", "mix"], table("transfer networks"), strict=True):
        found = [short(geometric(errors(body, under))) + " %" for under in ("bell", "irregular")]
        for under in ("bell", "irregular"):
            ends = zip(errors("initial", under), errors(body, under), errors(under, under), strict=True)
            kept = [math.log(a / b) / math.log(a / c) for a, b, c in ends]
            mean, half = mean_and_half(kept)
            own = body in ("initial", under)
            found.append("" if own else "{} ({} … {})".format(*map(short, (mean, mean - half, mean + half))))
        yield line[1:], found


def why():
    bodies = {"initial": (None, "initial"), "trained with a linear brain": ("linear", "optimised"),
              "trained with the paper's network": ("cnn", "optimised")}
    for words, *cells in table("why"):
        trained, body = bodies[words]
        mine = [row for row in rows("why/rows.csv", body=body) if trained in (None, row["trained_with"])]
        mean = lambda column, of=mine: short(geometric(numbers(of, column)))
        by = [trained] if trained else ["linear", "cnn"]
        errors = [mean("error", [row for row in mine if row["trained_with"] == brain]) for brain in by]
        memory = short(geometric([1e3 * x for x in numbers(mine, "memory")]))
        told = [mean(column) for column in ("forces_told", "condition", "bits")]
        yield cells, [", ".join(errors) + " %", mean("wiener_error") + " %", *told, memory + " ms"]


def real_scale():
    scenes = [("reference", "bell"), ("real, chip", "bell"), ("reference", "irregular"), ("real, chip", "irregular"), ("real", "irregular")]
    for (body, stimuli), line in zip(scenes, table("real scale"), strict=True):
        def cell(panels, sensors):
            of = rows("real-scale/trials.csv", body=body, stimuli=stimuli, panels=panels, sensors=sensors)
            return " → ".join(", ".join(map(short, numbers(of, end))) for end in ("initial", "optimised")) + " %"
        yield line[1:], [cell(k, m) for k in "24" for m in "12"]


def filtered():
    for line in table("filtered"):
        bandwidth = {"none": "", "50 Hz": "50.0", "20 Hz": "20.0"}[line[0]]
        found = []
        for noise in "01":
            of = rows("filtered/trials.csv", bandwidth=bandwidth, noise=noise)
            initial, optimised = numbers(of, "initial"), numbers(of, "optimised")
            gains = [a / b for a, b in zip(initial, optimised)]
            found.append(f"{short(geometric(initial))} → {short(geometric(optimised))} %")
            found.append(f"{short(geometric(gains))} ({short(min(gains))} … {short(max(gains))})")
        yield line[1:], found


def relaxing():
    for line in table("relaxing"):
        def cell(reader, records):
            of = rows("robust-two-core/relaxing.csv", body=line[0], reader=reader, records=records)
            return "{} [{}] %".format(*(short(geometric(numbers(of, name))) for name in ("median", "percentile_90")))
        yield line[1:], [cell(*by) for by in [("nominal", "0"), ("casts", "0"), ("records", "10"), ("records", "100")]]


CHECKS = [quickstart, who_senses, sensors, claims, brains, linear_bodies, placed, transfer_networks, why, real_scale, filtered, relaxing]

if __name__ == "__main__":
    wrong = 0
    for check in CHECKS:
        pairs = list(check())
        cells = [(said, found) for line in pairs for said, found in zip(*line, strict=True)]
        differ = [pair for pair in cells if pair[0] != pair[1]]
        print(f"{check.__name__.replace('_', ' ')}: {len(cells)} cells, {len(differ)} differ")
        for said, found in differ:
            print(f"  {said!r} is said, {found!r} is found")
        wrong += len(differ) + (not cells)
    sys.exit(1 if wrong else 0)
