"""Other search methods on the synthetic spaces of orchestrator/analysis/src/goal/tests.rs: the comparison in
docs/explanation/statistics.md.

    SPACES=50 SPACES_FILE=spaces.json cargo test -p metasense-analysis --lib goal::
    pip install optuna numpy scipy && python orchestrator/bench/searches.py spaces.json

Each search proceeds by increasing M, for equal M by increasing multiply-adds, and minimises the error among the candidates there. A
result that meets the requirement is screened on 4 fresh seeds and confirmed on 8 others, as in metasense. The search ends with the first
confirmed design.
"""
import json
import math
import sys

import numpy as np
import optuna
from scipy import stats

optuna.logging.set_verbosity(optuna.logging.ERROR)
CONFIDENCE, FRESH, WORTH = 0.9, 4, 0.12
TRIES = 3  # results that are judged among candidates of equal cost


class World:
    """A space, and what has been paid for what was asked of it (whole trials)."""

    def __init__(self, space):
        self.space, self.trials, self.paid = space, space["trials"], 0.0
        self.reached, self.judged, self.turns = {}, {}, 0

    def level(self, i, level):
        known = self.reached.get(i, 0)
        self.paid += sum(self.space["prices"][known : level + 1])
        self.reached[i] = max(known, level + 1)
        return self.trials[i]["levels"][level]

    def fresh(self, i, seeds):
        known = self.judged.get(i, 0)
        self.paid += self.space["price_fresh"] * max(0, seeds - known)
        self.judged[i] = max(known, seeds)
        return self.trials[i]["fresh"][:seeds]

    def stands(self, i, limit):
        risk, n = (1 - CONFIDENCE) / 2 ** (self.turns + 1), 2 * FRESH
        margin = stats.t.isf(risk, n - 1) * math.sqrt(1 + 1 / n)
        logs = np.log(self.fresh(i, FRESH))
        between = math.sqrt((3 * 0.1**2 + (FRESH - 1) * logs.var(ddof=1)) / (2 + FRESH))  # beside what is thought in advance
        away = (math.log(limit) - margin * between - logs.mean()) / (between * math.sqrt(1 / FRESH + 1 / n))
        if stats.t.cdf(away, 2 + FRESH) < WORTH:
            return False
        self.turns += 1
        logs = np.log(self.fresh(i, 3 * FRESH)[FRESH:])
        return logs.mean() + margin * max(logs.std(ddof=1), 0.02) <= math.log(limit)

    def classes(self):
        keys = [tuple(trial["cost"][:2]) for trial in self.trials]
        return [[i for i, key in enumerate(keys) if key == of] for of in sorted(set(keys))]


def halving(world, limit, eta):
    for some in world.classes():
        for level in (0, 1):
            some = sorted(some, key=lambda i: world.level(i, level))[: max(1, round(len(some) / eta))]
        for i in sorted(some, key=lambda i: world.level(i, 2))[:TRIES]:
            if world.level(i, 2) <= limit and world.stands(i, limit):
                return i
    return None


def tpe(world, limit, budget):
    """TPE with Hyperband; what was paid for once is not paid for again."""
    for some in world.classes():
        sampler = optuna.samplers.TPESampler(seed=world.space["number"], multivariate=True)
        pruner = optuna.pruners.HyperbandPruner(min_resource=1, max_resource=3, reduction_factor=3)
        study, judged = optuna.create_study(sampler=sampler, pruner=pruner), []
        values = [sorted({world.trials[i]["place"][d] for i in some}) for d in (1, 3)]

        def objective(trial):
            size = values[0][trial.suggest_int("size", 0, len(values[0]) - 1)]
            rate = trial.suggest_categorical("rate", values[1])
            like = [i for i in some if world.trials[i]["place"][1::2] == [size, rate]]
            i = like[trial.suggest_categorical("placement", list(range(len(like))))]
            for level in (0, 1, 2):
                error = math.log(world.level(i, level))
                trial.report(error, level + 1)
                if level < 2 and trial.should_prune():
                    raise optuna.TrialPruned
            trial.set_user_attr("candidate", i)
            return error

        for _ in range(budget):
            study.optimize(objective, n_trials=1)
            i = study.trials[-1].user_attrs.get("candidate")
            if i is None or i in judged or len(judged) == TRIES or world.level(i, 2) > limit:
                continue
            judged.append(i)
            if world.stands(i, limit):
                return i
    return None


def report(name, spaces, search):
    for limit in (12.0, 8.0, 5.0):
        met = found = missed = dearer = 0
        more = paid = 0.0
        for space in spaces:
            trials = space["trials"]
            chosen, took = search(space, limit)
            surely = [t for t in trials if t["truth"] + 1.2816 * space["seed"] <= math.log(limit)]
            cheapest = min((t["cost"] for t in surely), default=None)
            paid += took / len(trials) / len(spaces)
            if chosen is None:
                missed += cheapest is not None
                continue
            away = (math.log(limit) - trials[chosen]["truth"]) / space["seed"]
            found, met = found + 1, met + (stats.norm.cdf(away) >= CONFIDENCE)
            if cheapest:
                more += trials[chosen]["cost"][0] - cheapest[0]
                dearer += trials[chosen]["cost"] > cheapest
        print(
            f"{name:24} ≤ {limit:2.0f} %: met by {met} of {found}, {missed} missed, {more / found:.2f} sensors more, "
            f"{100 * dearer / found:.0f} % dearer than the cheapest, {100 * paid:.1f} % of the grid"
        )


def bought(search):
    def of(space, limit):
        world = World(space)
        return search(world, limit), world.paid

    return of


def ours(space, limit):
    found = next(found for found in space["found"] if found["error"] == limit)
    return found["chosen"], found["took"]


if __name__ == "__main__":
    with open(sys.argv[1]) as file:
        spaces = json.load(file)
    report("metasense", spaces, ours)
    for eta in (3, 2):
        report(f"halving, eta = {eta}", spaces, bought(lambda world, limit: halving(world, limit, eta)))
    for budget in (8, 16):
        report(f"TPE + Hyperband, {budget}", spaces, bought(lambda world, limit: tpe(world, limit, budget)))
