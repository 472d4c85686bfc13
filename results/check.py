#!/usr/bin/env python3
"""Recomputes tables of README.md and results/README.md from the rows in committed/, without code of metasense.

`python3 results/check.py` prints one line per table; exit code 1 if a number differs. Tables that `metasense analyse` printed are not
checked: their cells do not follow from rows of trials, samples or casts.
`python3 results/check.py relaxing` checks only that table. `--power` prints the statistical power of sweeps like `elbow-law`.
"""

import csv
import itertools
import math
import random
import re
import statistics
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
# Student's t by degrees of freedom, from 1: quantiles 97.5, 98.75 and 80 %
T975 = [math.nan, 12.706205, 4.302653, 3.182446, 2.776445, 2.570582, 2.446912, 2.364624, 2.306004, 2.262157, 2.228139, 2.200985, 2.178813, 2.160369, 2.144787, 2.131450, 2.119905, 2.109816, 2.100922, 2.093024, 2.085963]
T9875 = [math.nan, 25.451700, 6.205347, 4.176535, 3.495406, 3.163381, 2.968687, 2.841244, 2.751524, 2.685011, 2.633767, 2.593093, 2.560033, 2.532638, 2.509569, 2.489880, 2.472878, 2.458051, 2.445006, 2.433440, 2.423117]
T80 = [math.nan, 1.376382, 1.060660, 0.978472, 0.940965, 0.919544, 0.905703, 0.896030, 0.888890, 0.883404, 0.879058, 0.875530, 0.872609, 0.870152, 0.868055, 0.866245, 0.864667, 0.863279, 0.862049, 0.860951, 0.859964]


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
    """Mean and half-width of its 95 % interval (Student's t)."""
    mean, free = sum(values) / len(values), len(values) - 1
    return mean, T975[free] * math.sqrt(sum((x - mean) ** 2 for x in values) / free / len(values))


def in_words(mean, half, shown):
    return "{} ({} … {})".format(*(short(shown(x)) for x in (mean, mean - half, mean + half)))


def interval(values, shown):
    return in_words(*mean_and_half(values), shown)


def with_interval(ratios):
    """Geometric mean of ratios, with the 95 % interval from their logarithms."""
    return interval([math.log(x) for x in ratios], math.exp)


def change(of):
    """Geometric means of held-out errors, initial → optimised body."""
    ends = (short(geometric(numbers(of, f"holdout_error_{body}"))) for body in ("initial", "optimised"))
    return " → ".join(ends) + " %"


def table(name, file="results/README.md"):
    """Cells of a generated table, without the header."""
    text = (HERE.parent / file).read_text()
    body = re.search(rf"<!-- generated: {name} -->\n(.*?)<!-- end -->", text, re.S).group(1)
    lines = [line for line in body.splitlines() if line.startswith("|") and not line.startswith("|---")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines][1:]


BRAINS = {
    "the paper's network": ("", "13122"),
    "long network": ("", "11138"),
    "linear decoder": ("linear", "968"),
    "stacked network": ("stacked", "14474"),
    "stacked long network": ("stacked", "12538"),
}


def quickstart():
    for line in table("quickstart", "README.md"):
        brain = "linear" if line[1] == "linear decoder" else "cnn"
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


def over_sensors(words, **of):
    """Trials by M with one placement per seed; `words`: number of forces, decoder, noise."""
    forces, brain, noise = words.split(", ")
    linear = brain == "linear decoder"
    if forces == "K = 8":
        return rows("eight-forces-map/trials.csv", brain="linear" if linear else "cnn", **of)
    file = "four-forces-map" if linear else "four-forces-map-network"
    kind = MIDDLE | dict(noise="0.03" if noise == "3 % noise" else "0.0")
    return [row for row in rows(f"{file}/trials.csv", **kind, **of) if row["placement"] not in "45"]


def sensors():
    for line in table("sensors"):
        yield line[1:], [change(of) if (of := over_sensors(line[0], sensors=m)) else "" for m in "12346"]


def judged(of, kinds, statistic):
    """Statistic of weighted rows, half-width of its 95 % interval, and the effect that is detected with a power of 80 %.

    Jackknife over each kind with four or more units and over crossings of kinds (Cameron, Gelbach and Miller)."""
    drawn = [kind for kind in kinds if len({row[kind] for row in of}) >= 4]
    variance, most, squares = 0, 0, 0
    for chosen in (c for n in range(1, len(drawn) + 1) for c in itertools.combinations(drawn, n)):
        unit = lambda row: tuple(row[kind] for kind in chosen)
        left_out = [statistic([unit(row) != gone for row in of]) for gone in sorted({unit(row) for row in of})]
        n, mean = len(left_out), sum(left_out) / len(left_out)
        part = (n - 1) / n * sum((x - mean) ** 2 for x in left_out)
        if len(chosen) == 1:
            most, squares = max(most, part), squares + part * part / (n - 1)
        variance += part if len(chosen) % 2 else -part
    variance = max(variance, most)
    free = max(variance**2 / squares, min(len({row[kind] for row in of}) for kind in drawn) - 1)
    free = min(free, len(T975) - 1)
    at = lambda table: table[math.floor(free)] + (free - math.floor(free)) * (table[math.ceil(free)] - table[math.floor(free)])
    half = at(T975) * math.sqrt(variance)
    return statistic([1] * len(of)), half, half + at(T80) * math.sqrt(variance)


def of_rows(ratio):
    """Weighted mean of the logarithm of a ratio."""
    return lambda of: lambda weights: sum(w * math.log(ratio(row)) for w, row in zip(weights, of)) / sum(weights)


def scattered(height):
    """ln of the ratio of scatters over placements at equal M and seed, initial / trained body."""
    def squares(of, weights, column):
        total = 0
        for cell in sorted({(row["sensors"], row["seed"]) for row in of}):
            here = [height(float(row[column])) for w, row in zip(weights, of) if w and (row["sensors"], row["seed"]) == cell]
            total += spread(here) ** 2 if len(here) > 1 else 0
        return total
    return lambda of: lambda weights: 0.5 * math.log(squares(of, weights, INITIAL) / squares(of, weights, TRAINED))


def claim_ratio(says, brain, of_set="holdout"):
    """Rows, kinds of units and statistic of a claim."""
    initial, trained = f"{of_set}_error_initial", f"{of_set}_error_optimised"
    def brain_of(row):
        return "linear decoder" if row["brain.kind"] == "linear" else "long network" if row["brain.width"] else "the paper's network"
    def two(kind, sort=lambda row: not any(row[k] for k in ("body.design.random", "optimise.gradient", "long_" + INITIAL))):
        return [row for row in rows("claims/trials.csv") if brain_of(row) == brain and row["stimuli.kind"] == kind and sort(row)]
    by_seed = lambda of, column, like: next(float(row[column]) for row in of if row["seed"] == like["seed"])
    one_by = lambda before, after: of_rows(lambda row: float(row[before]) / float(row[after]))
    gains = one_by(initial, trained)
    noise = "3 % noise" if says.startswith("K = 8") else "without noise"
    curve = lambda m: over_sensors(f"{says[:5]}, {brain}, {noise}", sensors=m)
    if says.startswith("a trained body halves"):
        return two("bell"), ["seed"], gains
    if says.startswith("a network on a trained body needs"):
        return two("bell"), ["seed"], of_rows(lambda row: float(row["iterations_to_error"]))
    if says.startswith("after 10 000"):
        return two("bell", lambda row: row["long_" + INITIAL]), ["seed"], one_by("long_" + initial, "long_" + trained)
    if says.startswith("under hand-hammered"):
        return two("irregular"), ["seed"], gains
    if says.startswith("training gains more"):
        bell = two("bell")
        gain_of = lambda row, of: by_seed(of, initial, row) / by_seed(of, trained, row)
        return two("irregular"), ["seed"], of_rows(lambda row: float(row[initial]) / float(row[trained]) / gain_of(row, bell))
    if says.startswith("random bodies"):
        than, regular = initial if says.endswith("initial body") else trained, two("bell")
        random_ones = two("bell", lambda row: row["body.design.random"])
        return random_ones, ["body.design.random", "seed"], of_rows(lambda row: float(row[initial]) / by_seed(regular, than, row))
    if "with every number" in says:
        low = lambda m: (lambda whole, half, _: whole - half)(*judged(curve(m), ["seed"], gains(curve(m))))
        return curve(min("1236" if says.startswith("K = 4") else "12346", key=low)), ["seed"], gains
    if "with two sensors" in says:
        six = curve("6")
        return curve("2"), ["seed"], of_rows(lambda row: by_seed(six, INITIAL, row) / float(row[TRAINED]))
    if "depends less on the placement" in says:
        of = rows(f"four-forces-map{'' if brain == 'linear decoder' else '-network'}/trials.csv", **MIDDLE | dict(noise="0.0"))
        return of, ["placement", "seed"], scattered((lambda error: error) if "in %" in says else math.log)
    if "more design parameters" in says:
        disc = lambda columns, tie="": rows("disc-map/trials.csv", columns=columns, tie=tie)
        many, few = disc("12"), disc("5") if "smaller units, one size of body" in says else disc("12", "[6,6]")
        return few, ["seed"], of_rows(lambda row: float(row[TRAINED]) / by_seed(many, TRAINED, row))
    direct, implicit = (two("bell", lambda row: row["optimise.gradient"] == term) for term in ("direct", "implicit"))
    return direct, ["seed"], of_rows(lambda row: float(row[trained]) / by_seed(implicit, trained, row))


# Claims that were examined twice, because the first test left them open: each test has half of the significance level.
SECOND_LOOKS = ("after 10 000", "a trained body with more design")


def claim_rated(says, brain, cell, of_set="holdout"):
    """Parts of a cell, and their values from the rows. Ratings follow the rule above the table, with Holm's p-values from the evidence."""
    of, kinds, statistic = claim_ratio(says, brain, of_set)
    whole, half, tells = judged(of, kinds, statistic(of))
    numbers = [short(math.exp(x)) for x in (whole, whole - half, whole + half)]
    low, high = math.exp(whole - half), math.exp(whole + half)
    [claim] = [row["claim"] for row in rows("claims/claims.csv") if says.startswith(row["says"])]
    [row] = [row for row in rows("claims/evidence.csv", claim=claim) if row["low"] and row["set"].split()[0] == of_set
             and [short(float(row[key])) for key in ("found", "low", "high")] == numbers]
    stated, chance = float(row["stated"]), float(row["chance"])
    rating = ("holds" if low >= stated and low > 1 else "compatible" if low > 1 and high >= stated else "in part" if low > 1
              else "fails" if high < 1 else "no difference" if 1 / 1.15 < low and high < 1.15 else "open")
    if rating != "no difference" and chance > (0.025 if says.startswith(SECOND_LOOKS) else 0.05):
        rating = "open" if low < 1 < high else "open after correction"
    if rating == "open":
        rating += f" (detectable {short(math.exp(tells))})"
    return [cell.split(",")[0].split(":")[0], cell.rsplit(": ")[-1]], ["{} ({} … {})".format(*numbers), rating]


def claims():
    """Ratios, intervals, ratings and elbows of the claims."""
    for says, _, _, *cells in table("claims"):  # `authors` checks the authors' scenes
        for cell, brain in zip(cells, ("the paper's network", "long network", "linear decoder")):
            if not cell:
                continue
            if "elbow" not in says:
                yield claim_rated(says, brain, cell)
                continue
            noise = "3 % noise" if says.startswith("K = 8") else "without noise"
            shares = ends(over_sensors(f"{says[:5]}, {brain}, {noise}"))[0]["in logarithms" in says]
            found = next((place for place, share in shares.items() if share > 0.5), "?")
            stated = shares[int(re.search(r"M = (\d)", says)[1])]
            rating = "holds" if stated > 0.95 else "fails" if stated < 0.05 else "open"
            yield [cell], [f"{'no elbow' if found is None else f'elbow at M = {found}'}: {rating}"]


def claims_on_the_test_set():
    for says, brain, *cells in table("claims on the test set"):
        for cell, of_set in zip(cells, ("test", "holdout")):
            yield claim_rated(says, brain, cell, of_set)


def brains():
    for line in table("brains"):
        kind = {"smooth pulses": "bell", "hammer blows": "irregular"}[line[0]]
        noise = {"none": "", "1 %": "0.01", "3 %": "0.03", "10 %": "0.1"}[line[1]]
        found = []
        for brain, weights in [BRAINS[name] for name in ("the paper's network", "long network", "linear decoder")]:
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
            def errors(m, search, body):
                of = rows("placed-two-core/trials.csv", sensors=m, brain__kind=kind, sensors__search=search, stimuli__kind="bell")
                return logs(of, f"holdout_error_{body}")
            def gain(m):
                before = errors(m, "" if "by placement" in line[1] else "greedy", "initial")
                after = errors(m, "greedy", "initial" if "by placement" in line[1] else "optimised")
                return interval([a - b for a, b in zip(before, after, strict=True)], math.exp)
            yield line[2:], [gain(m) for m in "123456"]
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
    bodies = {"initial": (None, "initial"), "trained with a linear decoder": ("linear", "optimised"),
              "trained with the paper's network": ("cnn", "optimised")}
    for words, *cells in table("why"):
        trained, body = bodies[words]
        mine = [row for row in rows("why/rows.csv", body=body) if trained in (None, row["trained_with"])]
        mean = lambda column, of=mine: short(geometric(numbers(of, column)))
        by = [trained] if trained else ["linear", "cnn"]
        errors = [mean("error", [row for row in mine if row["trained_with"] == brain]) for brain in by]
        memory = short(geometric([1e3 * x for x in numbers(mine, "memory")]))
        told = [mean(column) for column in ("distinguishable_forces", "condition", "bits")]
        yield cells, [", ".join(errors) + " %", mean("wiener_error") + " %", *told, memory + " ms", mean("modes")]


def residual(columns, curves, weights):
    """Slopes and residual sum of squares of weighted curves on one or two columns, after subtraction of each curve's mean."""
    def less_mean(x):
        return [value - sum(x) / len(x) for value in x]
    columns = [less_mean(column) for column in columns]
    curves = [less_mean(curve) for curve in curves]
    dot = lambda a, b: sum(x * y for x, y in zip(a, b))
    of = [sum(w * dot(column, curve) for w, curve in zip(weights, curves)) for column in columns]
    [aa, ab, bb] = [sum(weights) * dot(a, b) for a, b in [(columns[0], columns[0]), (columns[0], columns[-1]), (columns[-1], columns[-1])]]
    slopes = [of[0] / aa]
    if len(columns) == 2:
        slopes = [(bb * of[0] - ab * of[1]) / (aa * bb - ab * ab), (aa * of[1] - ab * of[0]) / (aa * bb - ab * ab)]
    return slopes, sum(w * dot(curve, curve) for w, curve in zip(weights, curves)) - dot(slopes, of)


FAST = [0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3]
SMOOTH = [0.05 * i for i in range(7, 20)]


def elbow(at, curves, weights, decays=SMOOTH):
    """Bend of the broken line, if it falls before, falls at most half as fast after, and fits better (BIC) than line and decay."""
    n = sum(weights) * len(at)
    information = lambda rest, parameters: n * math.log(rest / n) + parameters * math.log(n)
    sticks = [(m, *residual([[min(x, m) for x in at], [max(x - m, 0) for x in at]], curves, weights)) for m in at[1:-1]]
    place, (before, after), rest = min(sticks, key=lambda stick: stick[2])
    decay = min(residual([[rho**x for x in at]], curves, weights)[1] for rho in decays)
    rival = min(information(decay, 2), information(residual([at], curves, weights)[1], 1))
    return place if information(rest, 3) < rival and before < 0 and after >= 0.5 * before else None


def fall(at, curves, weights, part):
    """Smallest M with this fraction of the fall from 100 % to the smallest mean error."""
    means = [math.exp(sum(w * math.log(e) for w, e in zip(weights, errors)) / sum(weights)) for errors in zip(*curves)]
    return next(m for m, mean in zip(at, means) if mean <= 100 - part * (100 - min(means)))


def ends(of, part=0.9):
    """End of the fall of the error of trained bodies: shares of votes per method, and results with other thresholds.

    Votes are all resamples of one unit fewer than exist. Units are seeds, or placements if there is one seed."""
    at = sorted({int(row["sensors"]) for row in of})
    clusters = sorted({(row["placement"], row["seed"]) for row in of})
    error = {(row["placement"], row["seed"], int(row["sensors"])): float(row["holdout_error_optimised"]) for row in of}
    assert len(error) == len(of) == len(at) * len(clusters), "incomplete grid"
    curves = [[error[*cluster, m] for m in at] for cluster in clusters]
    logs = [[math.log(e) for e in curve] for curve in curves]
    unit = 1 if len({seed for _, seed in clusters}) > 1 else 0
    units = sorted({cluster[unit] for cluster in clusters})
    n, even = len(units), [1] * len(clusters)
    ways = [[way.count(cluster[unit]) * n / (n - 1) for cluster in clusters] for way in itertools.product(units, repeat=n - 1)]
    shares = []
    for reading in (lambda w: elbow(at, curves, w), lambda w: elbow(at, logs, w), lambda w: fall(at, curves, w, part)):
        votes = [reading(way) for way in ways]
        shares.append({place: votes.count(place) / len(ways) for place in [*at, None]})
    any_decay = ", ".join(str(elbow(at, of, even, FAST + SMOOTH) or "none") for of in (curves, logs))
    return shares, [any_decay, ", ".join(str(fall(at, curves, even, part)) for part in (0.8, 0.95))]


def votes_in_words(shares):
    told = sorted(((-share, place is None, place) for place, share in shares.items() if share > 0.004))
    return ", ".join(("none" if none else str(place)) + ("" if -share > 0.996 else f": {-100 * share:.0f} %") for share, none, place in told)


def power(campaigns=60):
    """Share of simulated campaigns (four seeds, means and scatter of `elbow-law`) with 95 % of votes for K / channels, rounded up."""
    draw = random.Random(5)
    mean = lambda x: sum(x) / len(x)
    for forces, channels, _, law, *_ in table("elbow law asked"):
        of = rows("elbow-law/trials.csv", panels=forces, channels=channels)
        seeds = sorted({row["seed"] for row in of})
        logs = [[math.log(float(row["holdout_error_optimised"])) for row in sorted(of, key=lambda row: int(row["sensors"])) if row["seed"] == seed]
                for seed in seeds]
        means = list(map(mean, zip(*logs)))
        levels = [mean(curve) - mean(means) for curve in logs]
        rest = sum((y - m - level) ** 2 for curve, level in zip(logs, levels) for y, m in zip(curve, means)) / (len(logs) - 1) / (len(means) - 1)
        level = sum(x * x for x in levels) / (len(levels) - 1)
        sure = [0, 0, 0]
        for _ in range(campaigns):
            made_up = []
            for seed in range(4):
                own = draw.gauss(0, math.sqrt(level))
                errors = [math.exp(m + own + draw.gauss(0, math.sqrt(rest))) for m in means]
                made_up += [dict(placement="0", seed=str(seed), sensors=str(m), holdout_error_optimised=e) for m, e in enumerate(errors, 1)]
            sure = [n + (shares.get(int(law), 0) >= 0.95) for n, shares in zip(sure, ends(made_up)[0])]
        yield f"K = {forces}, {channels} channels: elbow in %, in logarithms, nine tenths of the fall: " + ", ".join(f"{100 * n / campaigns:.0f} %" for n in sure)


def ranks(values):
    return [sum(v < x for v in values) + (1 + sum(v == x for v in values)) / 2 for x in values]


def why_correlated():
    measures = ("wiener_error", "distinguishable_forces", "condition", "bits", "memory", "modes")
    for (words, *cells), measure in zip(table("why correlated"), measures, strict=True):
        found = []
        for trained in ("linear", "cnn"):
            before, after = (rows("why/rows.csv", body=body, trained_with=trained) for body in ("initial", "optimised"))
            assert [row["hash"] for row in before] == [row["hash"] for row in after]
            fallen, grown = (numbers(before, "error"), numbers(after, "error")), (numbers(after, measure), numbers(before, measure))
            r = statistics.correlation(*(ranks([a / b for a, b in zip(*both)]) for both in (fallen, grown)))
            half = 1.96 * math.sqrt(1.06 / (len({row["seed"] for row in before}) - 3))
            low, high = (math.tanh(math.atanh(r) + sign * half) for sign in (-1, 1))
            found.append(f"{short(r)} ({short(low)} … {short(high)})")
        yield cells, found


def verdict(shares, law, by_elbow):
    """Verdict by the rule in the head of elbow-law.toml."""
    if by_elbow and law == 1:
        return "refuted" if sum(share for m, share in shares.items() if (m or 0) >= 2) >= 0.95 else "no answer"
    share = shares.get(law, 0)
    return "confirmed" if share >= 0.95 else "refuted" if share <= 0.05 else "open"


def errors_by_sensors(of):
    means = [short(geometric(numbers([row for row in of if row["sensors"] == m], "holdout_error_optimised")))
             for m in sorted({row["sensors"] for row in of})]
    return ", ".join(means) + " %"


def elbow_law_asked():
    for forces, channels, *cells in table("elbow law asked"):
        of, law = rows("elbow-law/trials.csv", panels=forces, channels=channels), -(-int(forces) // int(channels))
        readings, beside = ends(of)
        told = [f"{votes_in_words(shares)} ({verdict(shares, law, n < 2)})" for n, shares in enumerate(readings)]
        yield cells, [errors_by_sensors(of), str(law), *told, *beside]


MIDDLE = dict(noise="0.03", damping_ratio="0.02", training_samples="120", width="[0.06,0.25]", columns="8")
SETTINGS = {
    "base scene": {}, "without noise": dict(noise="0.0"), "10 % noise": dict(noise="0.1"),
    "a quarter of the damping": dict(damping_ratio="0.005"), "30 training samples instead of 120": dict(training_samples="30"),
    "pulses of 20 to 80 ms": dict(width="[0.02,0.08]"), "4 columns instead of 8": dict(columns="4"),
    "four times the damping": dict(damping_ratio="0.08"), "370 training samples instead of 120": dict(training_samples="370"),
    "14 columns instead of 8": dict(columns="14"),
}


IN_MAP = {"confirmed": "holds", "refuted": "fails", "open": "open"}


def spread(values):
    mean = sum(values) / len(values)
    return math.sqrt(sum((x - mean) ** 2 for x in values) / (len(values) - 1))


def chance(t, free):
    """Two-sided p-value of t (Abramowitz and Stegun 26.7.3 and 4)."""
    angle, odd = math.atan(abs(t) / math.sqrt(free)), free % 2
    sine, cosine = math.sin(angle), math.cos(angle)
    term, total = (cosine, 0) if odd else (1, 0)
    for n in range(odd, free - 1, 2):
        total, term = total + term, term * cosine * cosine * (n + 1) / (n + 2)
    return 1 - ((angle + sine * total) * 2 / math.pi if odd else sine * total)


def rated(all_values, shown, words):
    """Values by seed with interval and verdict; a star marks significance after Holm's correction."""
    return rated_each([(x, shown, words) for x in all_values])


def rated_each(all_values, none=0.05):
    """The same with conversion and words per entry, at the significance level `none`."""
    chances = [chance(sum(x) / spread(x) / math.sqrt(len(x)), len(x) - 1) for x, _, _ in all_values]
    order, corrected, most = sorted(range(len(chances)), key=chances.__getitem__), {}, 0
    for rank, n in enumerate(order):
        corrected[n] = most = max(most, (len(chances) - rank) * chances[n])
    # for an open verdict the detectable effect; `none` is 5 %, or half of it for the second of two tests
    quantile = lambda x: (T975 if none == 0.05 else T9875)[len(x) - 1] + T80[len(x) - 1]
    would = lambda x, shown: f"open (detectable {short(shown(quantile(x) * spread(x) / math.sqrt(len(x))))})"
    told = [would(x, shown) if chances[n] > none else words[sum(x) < 0] for n, (x, shown, words) in enumerate(all_values)]
    return [f"{interval(x, shown)}: {told[n]}{'*' if corrected[n] <= none else ''}" for n, (x, shown, _) in enumerate(all_values)]


def four_forces_map():
    yield from four_forces("four forces map", "four-forces-map/trials.csv")


def four_forces_map_network():
    yield from four_forces("four forces map network", "four-forces-map-network/trials.csv")


def four_forces(name, file):
    lines, found = table(name), []
    for line in lines:
        of = rows(file, **MIDDLE | SETTINGS[line[0]])
        error = {tuple(row[k] for k in ("seed", "placement", "sensors")): row for row in of}
        def at(seed, placement, sensors, body):
            return float(error[str(seed), str(placement), sensors][f"holdout_error_{body}"])
        def scatter(seed, body, shown):
            return spread([shown(at(seed, p, "2", body)) for p in (seed - 131, 4, 5)])
        ends_of = lambda s, one, two: at(s, s - 131, one, "initial") / at(s, s - 131, two, "optimised")
        spreads = lambda s, shown: scatter(s, "initial", shown) / scatter(s, "optimised", shown)
        seeds = range(131, 135)
        found.append((of, [[ends_of(s, "6", "2") for s in seeds], [spreads(s, lambda e: e) for s in seeds],
                           [spreads(s, math.log) for s in seeds], [ends_of(s, "2", "2") for s in seeds]]))
    told_of = rated([[math.log(x) for x in ratios] for _, four in found for ratios in four], math.exp, ("holds", "fails"))
    for n, (line, (of, four)) in enumerate(zip(lines, found)):
        main = [row for row in of if row["placement"] not in "45"]
        found = (f"{votes_in_words(shares)} ({IN_MAP[verdict(shares, 2, False)]})" for shares in ends(main)[0])
        yield line[1:], [errors_by_sensors(main), *found, *told_of[4 * n : 4 * n + 4]]


INITIAL, TRAINED = "holdout_error_initial", "holdout_error_optimised"


def logs(of, column):
    """Logarithm of the geometric mean of a column, per seed."""
    return [math.log(geometric(numbers([row for row in of if row["seed"] == seed], column))) for seed in sorted({row["seed"] for row in of})]


def slopes_over(sizes, errors):
    """Slope of logarithms on ln(size), per seed."""
    x = [math.log(int(size)) for size in sizes]
    x = [value - sum(x) / len(x) for value in x]
    return [sum(a * e[seed] for a, e in zip(x, errors)) / sum(a * a for a in x) for seed in range(len(errors[0]))]


def less(one, two):
    return [a - b for a, b in zip(one, two, strict=True)]


def gain(of):
    return less(logs(of, INITIAL), logs(of, TRAINED))


def before_and_after(of):
    return " → ".join(short(geometric(numbers(of, column))) for column in (INITIAL, TRAINED)) + " %"


def random_bodies_map():
    of = rows("random-bodies-map/trials.csv")
    spread_of = lambda row: (row["body.design.spread"] or "0.25") if row["body.design.random"] else ""
    kind = lambda angle, spread: [row for row in of if (row["body.initial_angle"], spread_of(row)) == (angle, spread)]
    angles, found = ("10.0", "20.0", "30.0", "40.0"), []
    for angle in angles:
        regular = logs(kind(angle, ""), INITIAL)
        found += [gain(kind(angle, "")), *(less(logs(kind(angle, s), INITIAL), regular) for s in ("0.1", "0.25", "0.5"))]
    told = rated(found, math.exp, ("holds", "fails"))
    for n, line in enumerate(table("random bodies map")):
        yield line[1:], [before_and_after(kind(angles[n], "")), *told[4 * n : 4 * n + 4]]


def blows_map():
    lines = table("blows map")
    blows, of = dict(kind="irregular", roughness="[0.1,0.35]", double="0.25", width="[0.02,0.08]", amplitude="[0.3,1.0]"), {
        "blows": {}, "smooth blows": dict(roughness="[0.0,0.0]"), "no second blow": dict(double="0.0"),
        "as wide as pulses": dict(width="[0.06,0.25]"), "as weak as pulses": dict(amplitude="[0.15,0.5]")}
    of["all four"] = of["smooth blows"] | of["no second blow"] | of["as wide as pulses"] | of["as weak as pulses"]
    of["pulses"], names = of["all four"] | dict(kind="bell", roughness="", double=""), [line[0] for line in lines]
    stimuli = lambda name: {f"stimuli__{key}": value for key, value in (blows | of[name]).items()}
    kind = lambda name, noise: rows("blows-map/trials.csv", **stimuli(name), sensors__noise=noise)
    gains = {(name, noise): gain(kind(name, noise)) for name in names for noise in ("0.03", "")}
    told = rated([less(gains[name, noise], gains["blows", noise]) for name, noise in list(gains)[2:]], math.exp, ("more", "less"))
    for n, (name, line) in enumerate(zip(names, lines, strict=True)):
        cells = []
        for m, noise in enumerate(("0.03", "")):
            cells += [before_and_after(kind(name, noise)), interval(gains[name, noise], math.exp), told[2 * (n - 1) + m] if n else ""]
        yield line[1:], cells


def sizes(name, file):
    units = ("16", "36", "64", "100")
    grows = lambda row: float(row["body.spacing"]) == 15.0
    kind = lambda way, u: [row for row in rows(file, units=u) if u == "36" or grows(row) == (way == "grows")]
    found = [(way, column) for way in ("grows", "finer") for column in (INITIAL, TRAINED)]
    slopes = [slopes_over(units, [logs(kind(way, u), column) for u in units]) for way, column in found]
    told = rated(slopes, lambda value: value, ("fails", "holds"))
    for (way, column), said, line in zip(found, told, table(name), strict=True):
        errors = ", ".join(short(geometric(numbers(kind(way, u), column))) for u in units) + " %"
        gains = [interval(gain(kind(way, u)), math.exp) if column == TRAINED else "" for u in ("16", "100")]
        yield line[1:], [errors, said, *gains]


def eight_forces_map():
    brains, found = {"linear decoder": "linear", "the paper's network": "cnn"}, []
    for brain in brains.values():
        of = lambda m: rows("eight-forces-map/trials.csv", brain=brain, sensors=m)
        found += [less(logs(of(m), INITIAL), logs(of("4"), TRAINED)) for m in "46"]
    told = rated(found, math.exp, ("holds", "fails"))
    for n, line in enumerate(table("eight forces map")):
        of = rows("eight-forces-map/trials.csv", brain=brains[line[0]])
        shares = ends(of)[0][2]
        yield line[1:], [errors_by_sensors(of), f"{votes_in_words(shares)} ({IN_MAP[verdict(shares, 4, False)]})", *told[2 * n : 2 * n + 2]]


def disc_map():
    columns, ties = ("5", "8", "12"), ("[6,6]", "[3,3]")
    kind = lambda columns, tie="": rows("disc-map/trials.csv", columns=columns, tie=tie)
    slopes = [slopes_over(columns, [logs(kind(c), column) for c in columns]) for column in (INITIAL, TRAINED)]
    tied = [less(logs(kind("12", tie), TRAINED), logs(kind("12"), TRAINED)) for tie in ties]
    told = rated_each([*((s, lambda v: v, ("fails", "holds")) for s in slopes), *((t, math.exp, ("holds", "fails")) for t in tied)], 0.025)
    errors = lambda column: ", ".join(short(geometric(numbers(kind(c), column))) for c in columns) + " %"
    lines = table("disc map")
    yield lines[0][1:], [errors(INITIAL), told[0], "", "", ""]
    yield lines[1][1:], [errors(TRAINED), told[1], "", *(interval(gain(kind(c)), math.exp) for c in ("5", "12"))]
    for n, tie in enumerate(ties):
        yield lines[2 + n][1:], [short(geometric(numbers(kind("12", tie), TRAINED))) + " %", "", told[2 + n], "", ""]


def size_map():
    yield from sizes("size map", "size-map/trials.csv")


def size_map_network():
    yield from sizes("size map network", "size-map-network/trials.csv")


def protocol_map():
    settings = [dict(batch="68", schedule="cosine"), dict(batch="68", schedule="constant"), dict(batch="", schedule="constant"),
                dict(batch="68", schedule="cosine", samples="1000"), dict(batch="68", schedule="cosine", brain="linear")]

    def errors(setting, stimuli, body, iterations):
        if setting == 5:
            return rows(f"{stimuli}/networks.csv", body=body, iterations=iterations)
        kind = dict(samples="300", brain="", stimuli={"fig2": "bell", "fig3": "irregular"}[stimuli])
        return rows("protocol-map/networks.csv", body=body, iterations=iterations, **kind | settings[setting])

    def gain_of(setting, stimuli, iterations="1000"):
        return less(*(logs(errors(setting, stimuli, body, iterations), "error_holdout") for body in ("initial", "optimised")))

    def cells(setting, stimuli, iterations, stated):
        ends = [numbers(errors(setting, stimuli, body, iterations), "error_holdout") for body in ("initial", "optimised")]
        if not ends[0]:
            return ["", ""]
        values = gain_of(setting, stimuli, iterations)
        mean, half = mean_and_half(values)
        told = "reached" if math.exp(mean - half) >= stated else "below" if math.exp(mean + half) < stated else "compatible"
        return [" → ".join(map(short, map(geometric, ends))) + " %", f"{interval(values, math.exp)}: {told}"]

    changes = []
    for stimuli in ("fig2", "fig3"):
        for setting in range(6):
            beside = gain_of(0, "fig2") if setting == 0 else gain_of(2 if setting == 5 else 0, stimuli)
            own = gain_of(setting, stimuli)
            changes.append(less(own, beside[: len(own)]))
    said = ["", *rated(changes[1:], math.exp, ("more", "less"))]
    for setting, line in enumerate(table("protocol map")):
        yield line[1:], [*cells(setting, "fig2", "1000", 2), said[setting], *cells(setting, "fig2", "10000", 5.8),
                         *cells(setting, "fig3", "1000", 5.3), said[6 + setting]]


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


def external_bodies():
    for body, *line in table("external bodies"):
        file = "network" if line.pop(1) == "network" else "trials"
        of = rows(f"{body}/{file}.csv", sensors=line[0])
        initial, optimised = numbers(of, "initial"), numbers(of, "optimised")
        gains = [a / b for a, b in zip(initial, optimised)]
        yield line[1:], [f"{short(geometric(initial))} → {short(geometric(optimised))} %", with_interval(gains)]


def designs():
    for limit, seed, *cells in table("designs"):
        of = {"requirement": limit.removesuffix(" %"), "seed": seed}
        [row] = rows("design/searches.csv", **of)
        errors = numbers(rows("design/further.csv", **of), "error")
        found = [f"{row['cpu_seconds']} s ({row['part']} %)"]
        found.append(f"{row['M']}, {row['operations']}, {row['units']}" if row["code"] == "0" else "none")
        found.append(f"{short(float(row['error']))}, {short(float(row['keeps_to']))} %")
        found.append(f"{100 * float(row['cheaper']):.0f} %" if row["code"] == "0" else "")
        met = sum(error <= float(of["requirement"]) for error in errors)
        found.append(f"{short(geometric(errors))}, {short(max(errors))} %; {met} of {len(errors)}" if errors else "")
        yield cells, found


def better(folder, **of):
    """Number of test samples with less error on the trained body."""
    tested = rows(f"{folder}/samples.csv", **of)
    return f"{sum(a > b for a, b in zip(numbers(tested, 'error_initial'), numbers(tested, 'error_optimised')))} of {len(tested)}"


def of_protocol(name, folder, networks):
    times = []  # one row per seed: initial / trained error of each network and set, initial / trained iterations
    *seeds, last = table(name)
    for seed, *cells in seeds:
        found, of_seed = [], []
        for network in networks:
            for error in ("error_test", "error_holdout"):
                [initial], [trained] = (numbers(rows(f"{folder}/networks.csv", seed=seed, network=network, body=body), error)
                                        for body in ("initial", "optimised"))
                of_seed.append(initial / trained)
                found.append(f"{short(initial)} → {short(trained)} %, {short(of_seed[-1])}")
        found.append(better(folder, seed=seed))
        for value in ("loss", "error_holdout"):
            curves = [[(int(row["iteration"]), float(row[value])) for row in rows(f"{folder}/curves.csv", seed=seed, body=body)]
                      for body in ("initial", "optimised")]
            target = max(min(at for _, at in curve) for curve in curves)
            initial, trained = (min(iteration for iteration, at in curve if at <= target) for curve in curves)
            of_seed.append(initial / trained)
            found.append(short(of_seed[-1]))
        times.append(of_seed)
        yield cells, found
    *errors, loss, holdout = (with_interval(ratios) for ratios in zip(*times))
    yield last[1:], [*errors, better(folder), loss, holdout]


def authors():
    trials = rows("authors/trials.csv")
    names = ("scene", "decoder", "steps", "noise", "limits")
    for scene, decoder, steps, noise, limits, *cells in table("authors"):
        noise = "0" if noise == "none" else str(float(noise.split()[0]) / 100)

        def own(scene):
            return [row for row in trials if [row[name] for name in names] == [scene, decoder, steps, noise, limits]]

        # a comparison has one scene per body
        initial, _, trained = scene.partition(" / trained ")
        few, many = own(trained or scene), own(initial.removeprefix("initial "))
        found = [str(len(few))]
        for errors in ("test", "holdout"):
            before, after = numbers(many, f"{errors}_initial"), numbers(few, f"{errors}_trained")
            of = [dict(row, ratio=a / b) for row, a, b in zip(few, before, after, strict=True)]
            ratio, half, _ = judged(of, ("placement", "seed"), of_rows(lambda row: row["ratio"])(of))
            gain = in_words(ratio, half, math.exp)
            found.append(f"{short(geometric(before))} → {short(geometric(after))} %, {gain}")
        yield cells, found


def authors_casts():
    every = rows("authors/casts.csv")
    designs = list(dict.fromkeys(row["design"] for row in every))
    for noise, decoder, *cells in table("authors casts"):
        noise = "0" if noise == "none" else noise
        before, *after = (numbers([row for row in every if [row[k] for k in ("noise", "decoder", "design")] == [noise, decoder, design]], "error") for design in designs)
        gains = [f"{short(geometric(errors))} %, {with_interval([a / b for a, b in zip(before, errors, strict=True)])}" for errors in after]
        yield cells, [f"{short(geometric(before))} %", *gains]


def tasks():
    every = rows("tasks/rows.csv")
    for noise, task, unit, without, *cells in table("tasks"):
        noise = "0" if noise == "none" else str(float(noise.split()[0]) / 100)

        def errors(readout, body):
            own = [row for row in every if [row["noise"], row["task"], row["readout"], row["body"]] == [noise, task, readout, body]]
            return sorted(own, key=lambda row: int(row["seed"]))

        def at_least(row):
            return max(float(row["error"]), float(row["least"]))

        found = [short(statistics.fmean(numbers(errors("direct", "initial"), "trivial")))]
        for readout in ("direct", "decoded"):
            before, after = errors(readout, "initial"), errors(readout, "optimised")
            means = [statistics.fmean(numbers(of, "error")) for of in (before, after)]
            gains = with_interval([at_least(a) / at_least(b) for a, b in zip(before, after, strict=True)])
            found.append(f"{' → '.join(short(mean) if mean else '0' for mean in means)}, {gains}")
        yield [without, *cells], found


def tasks_transfer():
    every = rows("tasks/transfer.csv")

    def logs(training, task):
        own = {}
        for row in every:
            readout = "decoded" if task == "forces" else "direct"
            if [row["trained_for"], row["task"], row["readout"]] == [training, task, readout]:
                own[row["seed"], row["body"]] = max(float(row["error"]), float(row["least"]))
        return [math.log(own[seed, "initial"] / own[seed, "optimised"]) for seed in sorted({seed for seed, _ in own})]

    names = ["forces", "panel", "count", "position", "peak", "impulse", "onset"]
    for training, *cells in table("tasks transfer"):
        if ": " in training:
            training = training.split(":")[0]
            yield cells, [short(sum(logs(training, task)) / sum(logs(task, task))) for task in names]
        else:
            yield cells, [with_interval([math.exp(x) for x in logs(training, task)]) for task in names]


def tasks_decoded():
    for task, unit, *cells in table("tasks decoded"):
        def mean(training, body, column):
            own = rows("tasks/transfer.csv", trained_for=training, task=task, readout="decoded", body=body)
            return short(statistics.fmean(numbers(own, column)))
        initial = [mean("forces", "initial", column) for column in ("trivial", "error")]
        yield cells, initial + [mean(training, "optimised", "error") for training in ("forces", "impulse", "all")]


def position():
    for training, task, window, readout, unit, *cells in table("position"):
        def column(body, name):
            window_ms = window.removesuffix(" ms").removeprefix("record")
            own = rows("position/rows.csv", trained_for=training, task=task, window=window_ms, readout=readout, body=body)
            return numbers(own, name)
        initial, trained = column("initial", "error"), column("optimised", "error")
        trivial = short(statistics.fmean(column("initial", "trivial")))
        spreads = [interval(values, lambda x: x) for values in (initial, trained)]
        least = column("initial", "least")
        gains = [max(a, half) / max(b, half) for a, b, half in zip(initial, trained, least, strict=True)]
        yield cells, [trivial, *spreads, with_interval(gains)]


def ranks(values):
    return [statistics.fmean(i for i, y in enumerate(sorted(values)) if y == x) for x in values]


def capacity():
    trainings = ["forces", "panel", "count", "position", "peak", "impulse", "onset", "all"]
    for measure, *cells in table("capacity"):
        def values(training, body):
            return numbers(rows("tasks/capacity.csv", measure=measure, trained_for=training, body=body), "value")
        def correlation(task):
            errors = [numbers(rows("tasks/transfer.csv", task=task, readout="decoded", body="optimised", trained_for=training), "error") for training in trainings]
            measures = [values(training, "optimised") for training in trainings]
            per_seed = zip(zip(*measures), zip(*errors))
            return interval([statistics.correlation(ranks(a), ranks(b)) for a, b in per_seed], lambda x: x)
        means = [short(statistics.fmean(values(training, "optimised"))) for training in ("forces", "impulse", "onset", "all")]
        yield cells, [short(statistics.fmean(values("forces", "initial"))), *means, correlation("forces"), correlation("position")]


def paper_protocol():
    yield from of_protocol("paper protocol", "fig2", "01")


def paper_protocol_blows():
    yield from of_protocol("paper protocol, blows", "fig3", "0")


def paper_protocol_four_forces():
    def pairs(untrained, trained, error):
        of = {(row["sensors"], row["body"], row["placement"]): float(row[error]) for row in rows("fig4b/networks.csv")}
        placements = [placement for sensors, body, placement in of if (sensors, body) == (trained, "optimised")]
        return [(of[untrained, "initial", placement], of[trained, "optimised", placement]) for placement in placements]

    def times(pairs):
        return with_interval([a / b for a, b in pairs])

    *lines, last = table("paper protocol, four forces")
    sets = ("error_test", "error_holdout")
    for m, *cells in lines:
        both = [pairs(m, m, error) for error in sets]
        ends = (f"{short(geometric(a))} → {short(geometric(b))} %, {times(of)}" for of in both for a, b in [zip(*of)])
        yield cells, [str(len(both[0])), *ends, better("fig4b", sensors=m)]
    few = [pairs("6", "2", error) for error in sets]
    yield last[1:], [str(len(few[0])), *map(times, few), ""]


def race():
    for seed, *cells in table("race"):
        found = []
        for search in ("design", "halving", "optuna"):
            [row] = rows("design/race.csv", seed=seed, search=search)
            design = f"{row['M']}, {row['memory'].strip('[]').replace(',', ' + ')} s, {row['units']}" if row["M"] else "none"
            found.append(f"{row['cpu_seconds']} s: {design}")
        yield cells, found


def warm_starts():
    for sensors, other, *cells in table("warm starts"):
        file = "warm-units.csv" if "tied" in other else "warm-starts.csv"
        kinds = [numbers(rows(file, sensors=sensors, steps=steps, start=start), "optimised")
                 for steps, start in (("30", "cold"), ("30", "warm"), ("60", "cold"))]
        ratios = [with_interval([warm / cold for warm, cold in zip(kinds[1], over, strict=True)]) for over in (kinds[0], kinds[2])]
        yield cells, [*(short(geometric(errors)) + " %" for errors in kinds), *ratios]


def memory():
    for change, scene, *cells in table("memory"):
        old, new = ({row["seed"]: float(row["error"]) for row in rows("memory.csv", scene=scene, rule=rule)} for rule in change.split(" → "))
        both = [seed for seed in new if seed in old]
        means = [short(geometric([errors[seed] for seed in both])) + " %" for errors in (old, new)]
        yield cells, [str(len(both)), *means, with_interval([new[seed] / old[seed] for seed in both])]


LATTICES = {"squares": "square", "squares, chiral": "chiral", "Kagome's triangles": "kagome", "hexagons": "triangular"}


def families():
    for words, *cells in table("families"):
        of = {lattice: rows("families/trials.csv", lattice=lattice, sensors="2") for lattice in ("square", LATTICES[words])}
        mine = of[LATTICES[words]]
        initial, optimised = numbers(mine, "initial"), numbers(mine, "optimised")
        found = [mine[0]["units"], mine[0]["design_parameters"], short(geometric(initial)) + " %", short(geometric(optimised)) + " %"]
        found.append(with_interval([a / b for a, b in zip(initial, optimised, strict=True)]))
        for own, body in ((initial, "initial"), (optimised, "optimised")):
            ratios = [a / b for a, b in zip(own, numbers(of["square"], body), strict=True)]
            found.append("1" if mine is of["square"] else with_interval(ratios))
        yield cells, found


def families_sensors():
    for words, *cells in table("families sensors"):
        found = []
        for sensors in "1234":
            of = rows("families/trials.csv", lattice=LATTICES[words], sensors=sensors)
            initial, optimised = numbers(of, "initial"), numbers(of, "optimised")
            gain = with_interval([a / b for a, b in zip(initial, optimised, strict=True)])
            found.append(f"{short(geometric(initial))} → {short(geometric(optimised))} %; {gain}")
        yield cells, found


def pressed():
    presses = {"as cast": "0.0", "5 % narrower": "0.05", "5 % wider": "-0.05"}
    for words, *cells in table("pressed"):
        press, found = presses[words], []
        own, cast = ([numbers(rows("pressed/trials.csv", press=p), of) for of in ("initial", "optimised")] for p in (press, "0.0"))
        read = {p: numbers(rows("pressed/read.csv", trained=press, read=p), "error") for p in presses.values()}
        found += [short(geometric(errors)) + " %" for errors in own]
        for mine, theirs in zip(own, cast, strict=True):
            found.append("1" if press == "0.0" else with_interval([a / b for a, b in zip(mine, theirs, strict=True)]))
        untouched = {p: numbers(rows("pressed/trials.csv", press=p), "initial") for p in read}
        others, there = ([math.sqrt(a * b) for a, b in zip(*(of[p] for p in read if p != press), strict=True)] for of in (read, untouched))
        found.append(short(geometric(others)) + " %")
        found += [with_interval([a / b for a, b in zip(others, base, strict=True)]) for base in (read[press], there)]
        yield cells, found


def relaxing():
    for line in table("relaxing"):
        def cell(reader, records):
            of = rows("robust-two-core/relaxing.csv", body=line[0], reader=reader, records=records)
            return "{} [{}] %".format(*(short(geometric(numbers(of, name))) for name in ("median", "percentile_90")))
        yield line[1:], [cell(*by) for by in [("nominal", "0"), ("casts", "0"), ("records", "10"), ("records", "100")]]


def bands():
    for line in table("bands"):
        decoder, body = line[0].split(", ")
        readers = ["designed"] + (["nominal", "casts"] if decoder == "linear" else ["network", "network_casts"])
        def cell(reader, name):
            of = [numbers(rows("robust-two-core/bands.csv", decoder=decoder, body=body, reader=reader, kind=kind), name) for kind in ("instant", "sample")]
            return ", ".join(short(sum(x) / len(x)) for x in of)
        yield line[1:], [cell("designed", "width")] + [cell(reader, "coverage") + " %" for reader in readers]


def findings():
    """Numbers in the findings of README, compared with tables that are checked above, or with rows."""
    text = re.search(r"<!-- generated: findings -->\n(.*?)<!-- end -->", (HERE.parent / "README.md").read_text(), re.S)[1]
    senses, casts, memory, places, blows, paper = text.strip().split("\n")
    said = lambda bullet, pattern: list(re.search(pattern, bullet).groups())
    share = r"([\d.]+ %)"
    reads = {line[0]: line[1:] for line in table("who senses")}
    linear, model, twin = (reads[name] for name in ("linear, fitted to the design", "the design's model, inverted", "a twin from 30 records, inverted"))
    on_casts = lambda cell: cell.split(" [")[0] + " %"
    yield (said(senses, rf"body: linear decoder \(([^)]+)\) {share} → {share}; inverted model \(([^)]+)\) {share} → {share}\. On"),
           [linear[0], linear[1], linear[3], model[0], model[1], model[3]])
    yield (said(senses, f"On casts: linear decoder {share} → {share}; .* cast {share} → {share}, and {share} if"),
           [on_casts(cell) for cell in (linear[2], linear[4], twin[2], twin[4], twin[6])])
    two = {line[1]: line[2:] for line in table("casts") if line[0] == "K = 2, M = 1"}
    longer = two["trained over casts, three times the steps"]
    band = r"([\d.]+ \[[\d.]+\] %)"
    yield (said(casts, rf"initial body {band}; .* deviations {band} \(([\d.]+ %) .* casts {band}, .* steps {band}, .* cast {band}"),
           [two["initial body"][2], two["trained as designed"][2], two["trained as designed"][0], two["trained over casts"][2], longer[2], longer[3]])
    alone = dict(zip(("network", "long", "linear"), next(line[2:5] for line in table("brains") if line[:2] == ["smooth pulses", "none"])))
    yield said(memory, r"body: (.*?) with the paper.*; (.*?) with a linear"), [alone["network"], alone["linear"]]
    at = {tuple(line[:2]): line[2:] for line in table("placed")}
    best, random = at["linear decoder", "initial body, placed sensors"], at["linear decoder", "initial body, random sensors"]
    yield said(places, f"sensors have {share}, six random ones {share}; .* have {share}"), [best[3], random[5], at["linear decoder", "trained body, placed sensors"][3]]
    def located(readout):
        [line] = [line for line in table("position") if line[:4] == ["position", "position", "20 ms", readout]]
        return " → ".join(cell.split(" (")[0] for cell in line[6:8])
    yield said(blows, r"error ([\d.]+ → [\d.]+) mm .*, ([\d.]+ → [\d.]+) mm with"), [located("direct"), located("network")]
    rated = {}
    for says, _, _, *cells in table("claims"):  # `authors` checks the authors' scenes
        [claim] = [row["claim"] for row in rows("claims/claims.csv") if says.startswith(row["says"])]
        if not says.startswith("not claimed"):
            rated.setdefault(claim, []).extend(cell.rsplit(": ")[-1] for cell in cells if cell)
    good = [sum(word in ("holds", "compatible", "in part") for word in words) for words in rated.values()]
    whole = sum(words == ["holds"] * len(words) for words in rated.values())
    fails = sum(not some and "fails" in words for some, words in zip(good, rated.values()))
    results = (HERE / "README.md").read_text()
    apart = results.split("claims that have no row above")[1].split("\n\n")[1].split("- *")[1:]
    law = {tuple(line[:2]): line[6].split()[0] for line in table("elbow law asked")}
    yield (said(paper, r"Of (\d+) .* paper, (\d+) hold .* tried, (\d+) with .* (\d+) fails; .* Of (\d+) further claims, (\d+) fail .* need (\d) sensors, (\d) without"),
           [str(n) for n in (len(rated), whole, sum(some > 0 for some in good) - whole, fails, len(apart), sum("fails" in text for text in apart))]
           + [law["6", "3"], law["6", "2"]])


def recordings():
    """Cells of the two tables about the virtual laboratory, which are written by hand."""
    section = (HERE / "README.md").read_text().split("## Check of recordings")[1].split("\n## ")[0]
    said = {line.split(" | ")[0][2:]: [cell.strip() for cell in line.strip("| ").split("|")][1:] for line in section.splitlines() if line.startswith("| ")}
    looked = rows("check.csv")
    alarms = sum(int(row["false_alarms"]) for row in looked if row["mistake"] == "none")
    named = [row["named"] == "yes" for row in looked if row["mistake"] != "none"]
    yield said["20 without mistakes (9000 to 9019)"], ["no false alarm" if alarms == 0 else f"{alarms} false alarms"]
    yield said["23 with one mistake each (10000 to 10022)"], ["all named" if all(named) else f"{sum(named)} named"]
    lines = ["simulated", "dampers: predicted", "dampers: measured", "relaxing: measured", "relaxing, own clocks: measured"]
    kinds = [("relaxing", "simulated"), ("dampers", "predicted"), ("dampers", "measured"), ("relaxing", "measured"), ("own clocks", "measured")]
    for line, (casts, signals) in zip(lines, kinds):
        of = [numbers(rows("check-evaluate.csv", casts=casts, signals=signals, body=body), "error_test") for body in ("initial", "optimised")]
        gain = with_interval([one / two for one, two in zip(*of, strict=True)])
        yield said[line], [" → ".join(short(geometric(errors)) for errors in of) + " %", gain]


CHECKS = [quickstart, findings, authors, authors_casts, tasks, tasks_transfer, tasks_decoded, position, capacity, who_senses, sensors, claims, claims_on_the_test_set, brains, linear_bodies, placed, transfer_networks, why, why_correlated, elbow_law_asked, four_forces_map, four_forces_map_network, eight_forces_map, disc_map, random_bodies_map, blows_map, size_map, size_map_network, protocol_map, real_scale, families, families_sensors, pressed, filtered, external_bodies, designs, paper_protocol, paper_protocol_blows, paper_protocol_four_forces, race, memory, warm_starts, relaxing, bands, recordings]

if __name__ == "__main__":
    if "--power" in sys.argv:
        print(*power(), sep="\n")
        sys.exit()
    wrong = 0
    for check in CHECKS:
        name = check.__name__.replace("_", " ")
        if sys.argv[1:] and name not in sys.argv[1:]:
            continue
        pairs = list(check())
        cells = [(said, found) for line in pairs for said, found in zip(*line, strict=True)]
        differ = [pair for pair in cells if pair[0] != pair[1]]
        print(f"{name}: {len(cells)} cells, {len(differ)} differ")
        for said, found in differ:
            print(f"  is {said!r}, should be {found!r}")
        wrong += len(differ) + (not cells)
    sys.exit(1 if wrong else 0)
