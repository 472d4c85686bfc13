"""`lab check` names what went wrong in a virtual laboratory, and nothing where nothing did."""

import json
import os
import subprocess
from pathlib import Path

import metasense
import pytest
from test_examples import load

# No threshold was chosen on these seeds. METASENSE_SETS=20: as many good sets, and all mistakes in place of every third
SETS = os.environ.get("METASENSE_SETS")
GOOD = range(9000, 9000 + int(SETS or 2))
BAD = 10000
laboratory = load("laboratory")
MISTAKES = dict(list(laboratory.MISTAKES.items())[:: 1 if SETS else 3])


def look(toml: Path) -> tuple[int, list[dict]]:
    call = [metasense.program(), "lab", "check", toml.parents[1] / "spec.toml", "--records", toml, "--format", "json"]
    done = subprocess.run(call, capture_output=True, text=True)
    assert done.returncode in (0, 1), done.stderr
    return done.returncode, json.loads(done.stdout)


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    """The TOML of each set, by name of its mistake, or by its seed."""
    folder = tmp_path_factory.mktemp("laboratory")
    (folder / "spec.toml").write_text(laboratory.SPEC)
    mistakes = {name: laboratory.Set(BAD + i, **how[0]) for i, (name, how) in enumerate(MISTAKES.items())}
    named = {**{seed: laboratory.Set(seed) for seed in GOOD}, **mistakes}
    blows = laboratory.motion(metasense.Body.from_spec(folder / "spec.toml"), list(named.values()))
    found = {}
    for (name, one), of in zip(named.items(), blows, strict=True):
        (folder / str(one.seed)).mkdir()
        found[name] = laboratory.write(one, of, folder / str(one.seed))
    return found


def test_good_sets_raise_no_alarm(sets):
    alarms = {seed: [row for row in look(sets[seed])[1] if row["outcome"] != "ok"] for seed in GOOD}
    assert not any(alarms.values()), alarms


def test_mistakes_are_named(sets):
    missed = {}
    for name, (_, check, words) in MISTAKES.items():
        code, rows = look(sets[name])
        wrong = [row for row in rows if row["outcome"] != "ok"]
        named = [row for row in wrong if row["check"] == check and words in f"{row['place']} {row['found']} {row['remedy']}"]
        if not named or code != (1 if any(row["outcome"] == "fault" for row in wrong) else 0):
            missed[name] = wrong
    assert len(missed) <= 0.1 * len(MISTAKES), missed
