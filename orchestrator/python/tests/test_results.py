"""Runs and their results: the command's, as arrays and data frames."""

import json
import os
import signal
import threading
import time

import metasense
import numpy as np
import pytest


@pytest.fixture(scope="module")
def database(spec, tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "s.sqlite"
    return metasense.run(spec, db=path, workers=2, progress=False)


def test_a_run_leaves_a_database(database, body):
    trials = database.trials().to_dict()
    assert set(trials["state"]) == {"done"} and body.hash in trials["hash"] and len(trials["hash"]) == 2
    assert len(database.steps(body.hash)) == 8
    with pytest.raises(ValueError, match="no such column"):
        database.query("SELECT absent FROM v_trial")
    with pytest.raises(ValueError, match="not authorized"):
        database.query("DELETE FROM trial")
    with pytest.raises(ValueError, match="ffff"):
        database.steps("ffff")


def test_designs_and_trials_come_as_arrays(database, body):
    assert np.array_equal(database.design(body.hash, "initial"), body.alpha)
    optimised = database.design(body.hash)
    assert body.feasible(optimised) and not np.array_equal(optimised, body.alpha)
    trial = database.trial(body.hash)
    assert trial["signals_optimised"].shape == (16, 30, 3) and trial["predictions_optimised"].shape == (16, 30, 1)
    assert np.array_equal(trial["alpha_optimised"], optimised)
    assert json.loads(str(trial["scene"]))["point"]["seed"] == 3
    assert trial["w1_optimised"].ndim == 3
    with pytest.raises(ValueError, match='body = "final"'):
        database.design(body.hash, "final")


SQL = "SELECT seed, holdout_error_optimised AS error, hash, reason, CASE seed WHEN 3 THEN 'a' END AS some FROM v_trial ORDER BY 1"


def test_data_frames_read_a_table_as_it_is(database):
    table = database.query(SQL)
    rows = table.to_dict()
    assert table.columns == list(rows) and len(table) == 2 and rows["some"] == ["a", None]
    pyarrow = pytest.importorskip("pyarrow")
    for _ in range(2):  # a table can be read again
        arrow = pyarrow.table(table)
        arrow.validate(full=True)
        assert arrow.to_pydict() == rows
        assert [str(t) for t in arrow.schema.types] == ["int64", "double", "large_string", "null", "large_string"]
    stream = table.__arrow_c_stream__()
    assert len(pyarrow.table(database.query("SELECT 1 AS a WHERE 0"))) == 0
    del stream  # never read


def test_polars_and_pandas(database):
    table = database.query(SQL)
    polars = pytest.importorskip("polars")
    assert polars.DataFrame(table).to_dict(as_series=False) == table.to_dict()
    pandas = pytest.importorskip("pandas")
    for frame in [table.to_pandas(), pandas.DataFrame(table), pandas.DataFrame(table.to_dict())]:
        assert list(frame.columns) == table.columns and frame["error"].tolist() == table["error"]
        assert frame["seed"].dtype == "int64" and frame["reason"].isna().all()
    none = database.query("SELECT 1 AS a, 'x' AS b WHERE 0")
    assert list(none.to_pandas().columns) == ["a", "b"] and len(none.to_pandas()) == 0
    if hasattr(pandas.DataFrame, "from_arrow"):
        assert pandas.DataFrame.from_arrow(table)["error"].tolist() == table["error"]


def test_rows_and_columns_of_a_table(database):
    table = database.query(SQL)
    rows = list(table)
    assert len(rows) == len(table) and all(list(row) == table.columns for row in rows)
    assert [row["hash"] for row in rows] == table["hash"] == table.to_dict()["hash"]
    with pytest.raises(KeyError, match="absent"):
        table["absent"]


def test_a_long_table_arrives_whole(database):
    pyarrow = pytest.importorskip("pyarrow")
    sql = "WITH RECURSIVE n(i) AS (SELECT 0 UNION ALL SELECT i + 1 FROM n WHERE i < 999) SELECT i, {} AS x FROM n"
    found = pyarrow.table(database.query(sql.format("CASE WHEN i % 3 THEN i * 0.5 END"))).to_pydict()
    assert found["i"] == list(range(1000))
    assert found["x"] == [i * 0.5 if i % 3 else None for i in range(1000)]
    found = pyarrow.table(database.query(sql.format("CASE WHEN i % 7 THEN 'ä' || i END"))).to_pydict()
    assert found["x"] == [f"ä{i}" if i % 7 else None for i in range(1000)]


def test_questions_are_answered_as_by_the_command(database, command, tmp_path):
    found = json.loads(command("analyse", database.path, "--question", "paired", "--format", "json", cwd=tmp_path))
    table = database.analyse("paired").to_dict()
    assert found and [dict(zip(table, row)) for row in zip(*table.values())] == found
    with pytest.raises(ValueError, match='question = "eibow": must be one of .*elbow'):
        database.analyse("eibow")


def test_a_query_can_be_interrupted(database):
    timer = threading.Timer(0.5, os.kill, [os.getpid(), signal.SIGINT])
    timer.start()
    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        database.query("WITH RECURSIVE n(i) AS (SELECT 0 UNION ALL SELECT i + 1 FROM n) SELECT count(*) FROM n")
    assert time.monotonic() - begun < 20
    assert len(database.trials()) == 2


def test_watch_sees_every_step_and_the_end(database):
    with pytest.raises(ValueError, match="every = -1: must be"):
        metasense.watch(database, every=-1)
    events = list(metasense.watch(database, every=0.1))
    assert sum(event.step is not None for event in events) == 16
    assert [event.state for event in events if event.step is None] == ["done", "done"]


def test_a_run_that_cannot_be_says_why(spec, tmp_path):
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(spec.read_text().replace("density = 1e-8", "density = -1.0"))
    with pytest.raises(ValueError, match="body.density = -1"):
        metasense.run(wrong, db=tmp_path / "x.sqlite", progress=False)
    with pytest.raises(ValueError, match="missing.sqlite"):
        metasense.Database(tmp_path / "missing.sqlite")
    (tmp_path / "not.sqlite").write_text("not a database, but long enough to be taken for one")
    with pytest.raises((ValueError, OSError), match="not.sqlite"):
        metasense.Database(tmp_path / "not.sqlite")


def test_tables_draw_themselves(database):
    html = database.query("SELECT '<b>' AS a")._repr_html_()
    assert "&lt;b&gt;" in html and "<b>" not in html
