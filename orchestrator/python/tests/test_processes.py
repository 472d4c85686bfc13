"""Bodies and decoders in other processes and threads: forked, started anew, copied, pickled; the same bits everywhere."""

import concurrent.futures as futures
import copy
import multiprocessing as mp
import os
import pickle
import subprocess
import sys
import time

import metasense
import numpy as np
import pytest

# No answer takes so long; a fork without threads would wait for ever.
DEADLINE = 60.0
METHODS = ["fork", "spawn", "forkserver"]
held: dict[str, object] = {}


def work(body, alpha, forces):
    """What uses the body's threads: signals, a derivative, a projection."""
    simulation = body.simulate(alpha, forces)
    return simulation.signals, simulation.vjp(simulation.signals), body.project(alpha + 0.3)


def by_argument(job):
    return work(*job)


def by_inheritance(forces):
    return work(held["body"], held["body"].alpha, forces)


def derivative_of_parent(_):
    simulation = held["simulation"]
    return simulation.vjp(simulation.signals), simulation.jvp(np.ones_like(held["body"].alpha))


def by_decoders(signals):
    return held["inverse"].fit(signals)[0], held["linear"].predict(signals)


def failing(body):
    body.simulate(body.alpha, 1e300 * body.stimuli("test")).check()


def same(found, expected):
    return all(np.array_equal(a, b) for a, b in zip(found, expected, strict=True))


@pytest.fixture(scope="module")
def forces(body):
    return body.stimuli("test")


@pytest.fixture(scope="module")
def expected(body, forces):
    return work(body, body.alpha, forces)


@pytest.mark.parametrize("method", METHODS)
def test_pools_of_processes(body, forces, expected, method):
    jobs = [(body, body.alpha, forces), (body.tuned(body.alpha, forces), body.alpha, forces)]
    with mp.get_context(method).Pool(2) as pool:
        for job, found in zip(jobs, pool.map_async(by_argument, jobs).get(DEADLINE), strict=True):
            assert same(found, work(*job))
        with pytest.raises(metasense.SimulationError, match="samples") as raised:
            pool.apply_async(failing, (body,)).get(DEADLINE)
        assert len(raised.value.outcomes) == 3
    with futures.ProcessPoolExecutor(1, mp_context=mp.get_context(method)) as executor:
        assert same(executor.submit(by_argument, jobs[0]).result(DEADLINE), expected)


@pytest.mark.parametrize("used", [False, True])
@pytest.mark.parametrize("threads", [1, 2])
def test_a_body_of_before_the_fork(spec, forces, expected, threads, used):
    held["body"] = body = metasense.Body.from_spec(spec, threads=threads)
    held["simulation"] = body.simulate(body.alpha, forces[:1]) if used else None
    with mp.get_context("fork").Pool(2) as pool:
        for found in pool.map_async(by_inheritance, [forces] * 3).get(DEADLINE):
            assert same(found, expected)
        if used:
            assert same(pool.map_async(derivative_of_parent, [0]).get(DEADLINE)[0], derivative_of_parent(0))
    assert same(work(body, body.alpha, forces), expected)


def test_a_fork_while_another_thread_computes(body, forces, expected):
    """The child has neither the thread nor what it held."""
    held["body"] = body
    with futures.ThreadPoolExecutor(2) as executor:
        done = [False]

        def busy():
            while not done[0]:
                body.project(body.alpha + 0.3)
                body.simulate(body.alpha, forces)

        running = [executor.submit(busy) for _ in range(2)]
        try:
            with mp.get_context("fork").Pool(2) as pool:
                for found in pool.map_async(by_inheritance, [forces] * 4).get(DEADLINE):
                    assert same(found, expected)
        finally:
            done[0] = True
        for each in running:
            each.result(DEADLINE)


def test_decoders_of_before_the_fork(body):
    train = body.stimuli("train")
    signals = np.array(body.simulate(body.alpha, train).signals)
    held["inverse"], held["linear"] = metasense.Inverse(body), metasense.LinearBrain((5, 5)).fit(signals, train)
    expected = by_decoders(signals[:2])
    with mp.get_context("fork").Pool(1) as pool:
        assert same(pool.map_async(by_decoders, [signals[:2]]).get(DEADLINE)[0], expected)
    held["inverse"] = copy.deepcopy(held["inverse"])
    for duplicate in [copy.copy, copy.deepcopy, lambda brain: pickle.loads(pickle.dumps(brain))]:
        held["linear"] = linear = duplicate(held["linear"])
        assert np.array_equal(linear.predict(signals[:2]), expected[1])
    assert same(by_decoders(signals[:2]), expected)
    assert np.array_equal(linear.vjp(train[:, :, 1:].swapaxes(1, 2)), duplicate(linear).vjp(train[:, :, 1:].swapaxes(1, 2)))
    fresh = duplicate(metasense.LinearBrain((1, 2), 0.5, seed=7)).fit(signals, train)
    assert fresh.ridge == 0.5 and np.array_equal(
        fresh.predict(signals), metasense.LinearBrain((1, 2), 0.5, seed=7).fit(signals, train).predict(signals)
    )


def test_threads_share_a_body(body, forces, expected):
    with futures.ThreadPoolExecutor(3) as executor:
        for found in executor.map(by_argument, [(body, body.alpha, forces)] * 6, timeout=DEADLINE):
            assert same(found, expected)


@pytest.mark.parametrize("backend", ["loky", "multiprocessing", "threading"])
def test_joblib(body, forces, expected, backend):
    joblib = pytest.importorskip("joblib")
    held["body"] = body
    ask = joblib.Parallel(2, backend=backend, timeout=DEADLINE)
    for found in ask(joblib.delayed(by_argument)((body, body.alpha, forces)) for _ in range(3)):
        assert same(found, expected)


def test_copies_have_the_same_bits(spec, body, forces, expected, tmp_path):
    """A search places the sensors of the second body: a copy does not search again."""
    searched = tmp_path / "searched.toml"
    searched.write_text(spec.read_text() + '[sensors]\nsearch = "greedy"\n')
    for own in [body, body.tuned(body.alpha, forces), metasense.Body.from_spec(searched)]:
        for protocol in [2, pickle.HIGHEST_PROTOCOL]:
            other = pickle.loads(pickle.dumps(own, protocol))
            assert (other.hash, other.threads, other.sensors) == (own.hash, own.threads, own.sensors)
            assert same(work(other, other.alpha, forces), work(own, own.alpha, forces))
        assert own.hash == copy.copy(own).hash == copy.deepcopy({"own": own})["own"].hash
    with pytest.raises(TypeError, match="signals"):
        pickle.dumps(body.simulate(body.alpha, forces))


def test_tables_and_databases_are_pickled(spec, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    database = metasense.run(spec, db="s.sqlite", workers=2, progress=False)
    table = database.query("SELECT hash, 1e300 / 3 AS x, NULL AS none, 'ä\"' AS t, 9007199254740993 AS n FROM v_trial")
    other = pickle.loads(pickle.dumps((database, table)))
    assert other[1].to_dict() == table.to_dict() and other[1].columns == table.columns
    monkeypatch.chdir("/")
    assert len(pickle.loads(pickle.dumps(other[0])).trials()) == 2
    assert copy.deepcopy(table).to_dict() == table.to_dict()


RUN = "import metasense, sys; metasense.run(sys.argv[1], db=sys.argv[2], workers=2)"


def processes(word):
    """The living processes whose command line holds a word."""
    found = []
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{pid}/cmdline", "rb") as line, open(f"/proc/{pid}/stat") as stat:
                if word.encode() in line.read() and stat.read().rsplit(")", 1)[1].split()[0] != "Z":
                    found.append(int(pid))
        except OSError:
            pass  # it has ended
    return found


def until(holds):
    end = time.monotonic() + DEADLINE
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.02)


def children(pid):
    with open(f"/proc/{pid}/task/{pid}/children") as file:
        return [int(child) for child in file.read().split()]


@pytest.mark.parametrize("ending", ["KILL", "TERM", "INT"])
def test_a_run_ends_with_its_python(spec, tmp_path, ending):
    """Run and workers end in order, and leave what they have done."""
    import signal

    long = tmp_path / "long.toml"
    long.write_text(spec.read_text().replace("iterations = 8", "iterations = 100000"))
    db = tmp_path / "s.sqlite"
    python = subprocess.Popen([sys.executable, "-c", RUN, long, db], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    steps = "SELECT count(*) AS n FROM v_step"
    until(lambda: db.exists() and len(processes(str(db))) == 2)
    run = next(pid for pid in processes(str(db)) if pid != python.pid)

    def recorded():
        try:
            return metasense.Database(db).query(steps).to_dict()["n"][0] > 2
        except (OSError, ValueError):
            return False  # it is just being made

    until(recorded)
    workers = children(run)
    assert len(workers) == 2
    python.send_signal(getattr(signal, f"SIG{ending}"))
    python.wait(DEADLINE)
    until(lambda: not any(os.path.exists(f"/proc/{pid}") for pid in [run, *workers]))
    database = metasense.Database(db)
    assert not database.is_running()
    assert database.query("SELECT outcome FROM v_run").to_dict()["outcome"] == ["interrupted"]


def test_any_exception_stops_a_run(spec, tmp_path, monkeypatch):
    """Here standard output is closed while it prints."""

    class Closed:
        def write(self, text):
            raise BrokenPipeError

        def flush(self):
            pass

    db = tmp_path / "s.sqlite"
    long = tmp_path / "long.toml"
    long.write_text(spec.read_text().replace("iterations = 8", "iterations = 100000"))
    monkeypatch.setattr(sys, "stdout", Closed())
    with pytest.raises(BrokenPipeError):
        metasense.run(long, db=db, workers=1)
    assert processes(str(db)) == []
