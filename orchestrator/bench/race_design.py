"""`metasense design` against other search methods, on the bodies of schemas/sweeps/design-two-core.toml: a table of results/README.md.

    pip install . optuna scipy && python orchestrator/bench/race_design.py 25 71 72 73 74 >> rows.csv

The searches of searches.py use the same evaluations (error on the test set at the same outer steps), results (the worst of the casts)
and fresh seeds. Paused trials keep their checkpoints and resume. Each search has its own database, which records the CPU time of its
workers. One worker; pin it to a core.
"""
import csv
import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import metasense
from searches import World, halving, tpe

PROGRAM, SPEC = str(metasense.program()), "schemas/sweeps/design-two-core.toml"
RUNGS = (6, 16)  # outer steps of 50, as `design` has them
FRESH = 300  # seeds from here on


def said(*arguments):
    found = subprocess.run([PROGRAM, *arguments], capture_output=True, text=True)
    assert found.returncode in (0, 1), found.stderr
    return found


def spent(folder):
    """CPU seconds of the workers, by all databases of a folder."""
    sql = "SELECT coalesce(sum(cpu_seconds), 0) AS spent FROM attempt"
    return sum(metasense.Database(file).query(sql).to_dict()["spent"][0] for file in folder.glob("*.sqlite"))


class Real(World):
    """The space of a seed, and a folder in which it is looked at."""

    def __init__(self, seed, folder):
        found = json.loads(said("expand", SPEC, f"sweep.seeds=[{seed}]", "--format", "json").stdout)
        memories = sorted({trial["brain.memory"] for trial in found}, key=self.instants)
        for trial in found:
            nominal = trial["optimise.objective"] is None
            trial["cost"] = [trial["sensors"], memories.index(trial["brain.memory"]), trial["units"]]
            trial["place"] = [trial["sensors"], trial["units"], trial["cost"][1], int(not nominal)]
        super().__init__({"trials": found, "number": seed})
        self.seed, self.folder, self.known = seed, folder, {}
        folder.mkdir(parents=True)

    @staticmethod
    def instants(memory):
        return sum(json.loads(memory))

    def keys(self, i, seeds, iterations, design=None):
        trial = self.trials[i]
        units = [int(unit) for unit in trial["sensor_units"].split()]
        size = f'{{ "body.columns" = {trial["body.columns"]}, "body.rows" = {trial["body.rows"]} }}'
        keys = [
            f"sweep.seeds={seeds}",
            f"sweep.sensors=[{len(units)}]",
            "sweep.placements=1",
            f"sensors.placements=[{units}]",
            f"sweep.points=[{size}]",
            f'sweep."brain.memory"=[{trial["brain.memory"]}]',
            f'sweep."optimise.objective"=["{trial["optimise.objective"] or "nominal"}"]',
            f"optimise.iterations={iterations}",
        ]
        return keys + ([f"body.design={design}"] if design else [])

    def query(self, name, sql):
        rows = metasense.Database(self.folder / name).query(sql).to_dict()
        return [dict(zip(rows, row)) for row in zip(*rows.values())]

    def level(self, i, level):
        if (i, level) not in self.known:
            name = f"{i}.sqlite"
            command = [PROGRAM, "run", SPEC, *self.keys(i, [self.seed], 50), "--workers", "1", "--db", self.folder / name]
            looks = "SELECT step, error_test FROM v_step WHERE error_test IS NOT NULL ORDER BY step"
            with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as run:
                while level < 2 and run.poll() is None:
                    time.sleep(0.1)
                    try:
                        steps = self.query(name, looks)
                    except (OSError, ValueError, RuntimeError):
                        continue  # the database is not there yet
                    if steps and steps[-1]["step"] + 1 >= RUNGS[level]:
                        run.send_signal(signal.SIGINT)
                        break
            steps = [s["error_test"] for s in self.query(name, looks) if s["step"] + 1 <= RUNGS[min(level, 1)]]
            worst = self.worst(name) if level == 2 else []
            self.known[i, level] = (worst[0] if worst else float("inf")) if level == 2 else steps[-1]
        return self.known[i, level]

    def worst(self, name):
        sql = "SELECT seed, max(error) AS error FROM v_cast WHERE body = 'optimised' AND reader = 'casts' GROUP BY seed ORDER BY seed"
        return [row["error"] for row in self.query(name, sql)]

    def fresh(self, i, seeds):
        name, design = f"{i}-fresh.sqlite", self.folder / f"{i}.npy"
        if not design.exists():
            trial = self.query(f"{i}.sqlite", "SELECT hash FROM v_trial")[0]["hash"]
            said("export", str(self.folder / f"{i}.sqlite"), trial, "--format", "npy", "--out", str(design))
        keys = self.keys(i, [FRESH + n for n in range(seeds)], 0, design.resolve())
        said("run", SPEC, *keys, "--workers", "1", "--db", str(self.folder / name))
        return self.worst(name)


def ours(seed, limit, folder):
    folder.mkdir(parents=True)
    keys = [f"sweep.seeds=[{seed}]", f"goal.error={limit:g}", "goal.at_a_time=1", "--workers", "1", "--format", "csv"]
    table = csv.DictReader(said("design", SPEC, *keys, "--db", str(folder / "design.sqlite")).stdout.splitlines())
    chosen = [row for row in table if row["chosen"] == "true"]
    if not chosen:
        return []
    memory = re.search(r"brain.memory = (\[.*?\])", chosen[0]["setting"]).group(1)
    return [chosen[0]["M"], memory, chosen[0]["units"]]


def others(seed, search, folder):
    world = Real(seed, folder)
    i = search(world)
    found = world.trials[i] if i is not None else None
    return [found["sensors"], found["brain.memory"], found["units"]] if found else []


if __name__ == "__main__":
    limit, out = float(sys.argv[1]), csv.writer(sys.stdout)
    for seed in map(int, sys.argv[2:]):
        place = Path(f"race/{limit:g}-{seed}")
        for name, search in [
            ("design", lambda folder: ours(seed, limit, folder)),
            ("halving", lambda folder: others(seed, lambda world: halving(world, limit, 3), folder)),
            ("optuna", lambda folder: others(seed, lambda world: tpe(world, limit, 8), folder)),
        ]:
            found = search(place / name)
            out.writerow([f"{limit:g}", seed, name, f"{spent(place / name):.0f}", *(found or ["", "", ""])])
            sys.stdout.flush()
