"""Commands as functions: the same rows as on the command line, overrides, errors, and what is drawn."""

import io
import json
import sys
import threading

import metasense
import numpy as np
import pytest


@pytest.fixture(scope="module")
def database(spec, tmp_path_factory):
    return metasense.run(spec, db=tmp_path_factory.mktemp("run") / "s.sqlite", workers=2, progress=False)


def test_overrides_select_and_change_trials(spec, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    database = metasense.run(spec, name="other", seeds=[np.int64(3)], optimise={"iterations": 2}, workers=1, progress=False)
    assert database.path.name == "other.sqlite"
    trials = database.trials()
    assert (trials["seed"], trials["steps"], trials["state"]) == ([3], [2], ["done"])
    assert metasense.expand(spec, seeds=[7, 8, 9])["seed"] == [7, 8, 9]
    noisy = metasense.expand(
        spec, **{"sweep.seeds": [1]}, sensors={"noise": 0.5}, body={"stiffness": {"stretch": 2.0, "shear": 0.5, "bend": 1}}
    )
    assert len(noisy) == 1 and noisy["hash"] != metasense.expand(spec, seeds=[1])["hash"]
    with pytest.raises(ValueError, match="optimise.iterations"):
        metasense.run(spec, optimise={"iterations": -1}, progress=False)
    with pytest.raises(ValueError, match="seedz"):
        metasense.expand(spec, seedz=[1])
    with pytest.raises(ValueError, match=r"sensors\.noise = nan: must be a finite number"):
        metasense.expand(spec, sensors={"noise": float("nan")})


@pytest.mark.parametrize("name", ['quo"te', "back\\slash", "line\nend", "ä 力"])
def test_texts_arrive_as_they_are(spec, name):
    with pytest.raises(ValueError) as refused:
        metasense.expand(spec, optimise={"brain": name})
    assert "optimise.brain" in str(refused.value)
    if name.isprintable() and "\\" not in name and '"' not in name:
        assert name in str(refused.value)


def test_a_table_has_the_rows_that_the_command_prints(spec, command, tmp_path):
    table = metasense.expand(spec)
    printed = json.loads(command("expand", spec, "--format", "json", cwd=tmp_path))
    assert table.columns == list(printed[0]) and len(table) == 2
    for row, own in zip(table, printed, strict=True):
        assert row | {"cost_seconds": None} == own | {"cost_seconds": None}  # measured anew by each call
    pandas, polars = pytest.importorskip("pandas"), pytest.importorskip("polars")
    assert pandas.DataFrame(table)["hash"].tolist() == table["hash"]
    assert table.to_polars().equals(polars.DataFrame(table.to_dict()))


def test_a_trial_is_that_of_a_run(spec, database):
    row = database.query("SELECT hash, holdout_error_optimised AS e, best_step AS step FROM v_trial WHERE seed = 5").to_dict()
    found = metasense.trial(spec, row["hash"][0])
    assert (found["holdout_error_optimised"], found["best_step"]) == (row["e"][0], row["step"][0])
    assert metasense.trial(database, row["hash"][0][:8])["holdout_error_optimised"] == row["e"][0]
    assert metasense.trial(spec, optimise={"iterations": 1})["best_step"] <= 1
    with pytest.raises(ValueError, match="threads"):
        metasense.trial(spec, threads=100_000)
    with pytest.raises(ValueError, match="ffff"):
        metasense.trial(spec, "ffff")


def test_a_design_is_searched(spec, tmp_path):
    goal = tmp_path / "goal.toml"
    text = spec.read_text().replace('brain = "linear"', "").replace("iterations = 10\n", 'kind = "linear"\n')
    goal.write_text(text.replace("[brain]", "[goal]\nerror = 99.0\n[brain]"))
    table = metasense.design(goal, db=tmp_path / "g.sqlite", workers=2, progress=False)
    assert len(table) >= 1 and "meets" in table.columns
    with pytest.raises(ValueError, match="goal"):
        metasense.design(spec, db=tmp_path / "h.sqlite", progress=False)


def test_records_are_evaluated_and_fitted(body, spec, tmp_path):
    from metasense import records

    forces = body.stimuli("train")
    signals = body.simulate(body.alpha, forces).signals
    signals = signals * (1 + 1e-3 * np.random.default_rng(2).normal(size=signals.shape))
    time = np.arange(body.instants + 1) * body.duration / body.instants
    rest = np.zeros((len(forces), 1, 3))
    toml = records.save(
        tmp_path / "r.npz",
        [records.Record(time, f[0], s) for f, s in zip(forces, np.concatenate([rest, signals], axis=1), strict=True)],
    )
    found = metasense.identify(spec, toml, fit=["stretch", "bend"], body={"stiffness": {"stretch": 3.3, "shear": 0.5, "bend": 0.9}})
    assert found["parameter"] == ["stretch", "bend"]
    assert np.allclose(found["fitted"], [3.0, 1.0], rtol=0.01) and found["start"] == [3.3, 0.9]
    rows = list(metasense.evaluate(spec, {"initial": toml}, brain="linear", folds=3))
    assert {row["body"] for row in rows} == {"initial"}, rows
    with pytest.raises(ValueError, match=r"absent\.toml"):
        metasense.identify(spec, tmp_path / "absent.toml")


def test_casts_report_and_export(spec, database, tmp_path):
    for source in (spec, database):  # of a database the spec cannot be changed, but what casts scatter can
        hash = database.trials()["hash"][0]
        table = metasense.casts(source, hash, casts=2, rows=True, variation={"stretch": 0.05, "nodes": 0.1})
        assert len(set(table["casting"])) == 2
    page = metasense.report(database, out=tmp_path / "r.html")
    assert page.read_text().lstrip().lower().startswith("<!doctype html")
    hash = database.trials()["hash"][0]
    file = metasense.export(database, hash, format="npy", out=tmp_path / "a.npy", design="initial")
    assert np.array_equal(np.load(file).ravel(), database.design(hash, "initial"))
    with pytest.raises(ValueError, match="format"):
        metasense.export(database, hash, format="docx", out=tmp_path / "a.docx")


def test_errors_are_those_of_trials(database):
    [hash, *_] = database.trials()["hash"]
    trial = database.trial(hash)
    held = trial["split"] == 2
    errors = metasense.error(trial["forces"][held], trial["predictions_optimised"][held])
    same = metasense.error(metasense.targets(trial["forces"])[held], trial["predictions_optimised"][held])
    assert np.array_equal(errors, same)
    network = database.query(f"SELECT error_holdout AS e FROM v_network WHERE hash = '{hash}' AND body = 'optimised'")["e"]
    assert np.min(np.abs(np.array(network) - np.nanmean(errors))) < 1e-3 * np.nanmean(errors)
    assert metasense.targets(trial["forces"]).shape == trial["predictions_optimised"].shape
    silent = metasense.error(np.zeros((1, 1, 4)), np.ones((1, 3, 1)))
    assert np.isnan(silent).all()
    with pytest.raises(ValueError, match=r"forces have shape \(2, 1, 4\), predictions \(2, 4, 1\)"):
        metasense.error(np.zeros((2, 1, 4)), np.zeros((2, 4, 1)))
    with pytest.raises(ValueError, match=r"\(N, K, T \+ 1\)"):
        metasense.targets(np.zeros((3, 4)))


def test_a_bar_follows_a_run(spec, tmp_path, monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    said = Terminal()
    monkeypatch.setattr(sys, "stderr", said)
    metasense.run(spec, db=tmp_path / "s.sqlite", workers=1)
    last = said.getvalue().split("\r")[-1]
    assert last.startswith("2/2 trials |####################| 100 % of the steps") and "least error" in last
    assert said.getvalue().endswith("\n") and not [t for t in threading.enumerate() if "follow" in t.name]


def test_without_a_terminal_lines_are_printed(spec, tmp_path, capsys):
    metasense.run(spec, db=tmp_path / "s.sqlite", workers=1, seeds=[3])
    assert "done: K=1 M=1" in capsys.readouterr().out


def test_warnings_and_notes_of_a_command_that_succeeds_are_warnings(monkeypatch, tmp_path):
    said = "reading\nwarning: chaotic\nnote: two voids"
    monkeypatch.setattr(metasense._commands, "conducted", lambda *_, **__: (0, '[{"hash": "a"}]', said))
    for call in [lambda: metasense.expand("a.toml"), lambda: metasense.export("a.sqlite", format="npz", out=tmp_path / "a")]:
        with pytest.warns(RuntimeWarning) as seen:
            call()
        assert [str(w.message) for w in seen] == ["warning: chaotic", "note: two voids"]
        assert {w.filename for w in seen} == {__file__}


def test_the_version_is_that_of_the_command(command, tmp_path):
    assert command("--version", cwd=tmp_path).split()[1] == metasense.__version__


def test_figures_show_what_they_are_given(body, database, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    plt = pytest.importorskip("matplotlib.pyplot")
    from metasense import plot

    axes = plot.body(body)
    assert len(axes.patches) == body.units and {text.get_text() for text in axes.texts} == {
        str(u) for u in [*body.panels, *body.sensors]
    }
    corners = np.concatenate([patch.get_xy()[:-1] for patch in axes.patches])
    assert np.allclose(corners, np.concatenate([np.array(unit) for unit in body.polygons()]))
    forces = body.stimuli("test")
    signals = body.simulate(body.alpha, forces).signals
    axes = plot.signals(body, signals, 1)
    assert len(axes.lines) == 3 and np.allclose(axes.lines[2].get_ydata() * np.abs(signals[1, :, 2]).max(), signals[1, :, 2])
    axes = plot.forces(body, forces, metasense.targets(forces), 2)
    assert np.array_equal(axes.lines[0].get_ydata(), forces[2, 0, 1:]) and np.array_equal(
        axes.lines[1].get_ydata(), forces[2, 0, 1:]
    )
    with pytest.raises(ValueError, match="predictions have shape"):
        plot.forces(body, forces, forces)
    trials = database.trials()
    figure, (left, right) = plt.subplots(1, 2)
    assert plot.elbow(database, axes=left) is left
    assert sorted(left.lines[0].get_ydata()) == sorted(trials["holdout_error_initial"])
    [dots, _] = plot.gains(database, axes=right).lines
    assert sorted(dots.get_ydata()) == sorted(trials["holdout_error_optimised"])
    figure.savefig(io.BytesIO())
    plt.close("all")
