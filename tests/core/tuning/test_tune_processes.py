"""Searches in processes that are killed, or that run on a cluster: each trial counts once."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from long_search import LIMIT_S, POINTS, front_of, lines_of, trials_of
from tactune.core.contact.kernels.threads import available_threads
from tactune.core.tuning.measure import local_workers


def test_killed_and_begun_again_with_two_processes_it_gives_the_front_of_one(long_search, tune):
    process = long_search.start("--jobs", "2")
    process.kill()
    process.communicate(timeout=LIMIT_S)
    assert 5 <= long_search.measured() < POINTS
    out = tune(*long_search.words, "--study", long_search.file, "--jobs", 2).out
    long_search.check(out)  # a killed process may leave a trial half written, or measured twice
    wait_for_the_end_of(process.pid)
    assert front_of(out) == front_of(tune(*long_search.words, "--study", "one.log").out)


def test_a_worker_imports_nothing_from_the_working_folder(tmp_path, monkeypatch):
    for name in ("multiprocessing", "joblib", "numpy"):
        (tmp_path / f"{name}.py").write_text("import pathlib; pathlib.Path('harm').touch()")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    with local_workers(2) as workers:
        assert workers.submit(os.path.basename, "a/b").result(LIMIT_S) == "b"
    assert not (tmp_path / "harm").exists()
    assert "PYTHONSAFEPATH" not in os.environ, "programs that are started later import as ever"


def test_ctrl_c_in_a_terminal_keeps_what_is_done_and_the_same_command_goes_on(long_search, tune):
    process = long_search.start("--jobs", "2")
    os.killpg(process.pid, signal.SIGINT)  # a terminal sends it to all processes
    _, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert (
        f"{long_search.measured()} of {POINTS} trials are kept in {long_search.file}; the same command continues" in err
    )
    long_search.check(tune(*long_search.words, "--study", long_search.file).out)
    assert long_search.measured() == POINTS


def test_a_line_that_a_crash_cut_off_is_dropped(tune, recording, tmp_path):
    journal = tmp_path / "cut.log"
    words = ("-s", recording, "--set", "tolerance.t=0.004,0.009,0.014,0.02", "--study", journal, "--json")
    first = trials_of(tune(*words).out)
    with journal.open("a") as file:
        file.write('{"op_code":4,"worker')
    assert len(first) == 4 and trials_of(tune(*words).out) == first
    assert all(json.loads(line) for line in journal.read_text().splitlines())


def test_a_trial_that_was_measured_but_not_ended_when_its_search_was_killed_counts(long_search, tune):
    words = (*long_search.words, "--study", long_search.file)
    out = tune(*words).out
    lines = long_search.file.read_text().splitlines(keepends=True)
    ends = {json.loads(line)["trial_id"]: line for line in lines if '"op_code":6' in line and '"state":1' in line}
    lost = {ends[number] for number in [line for line in lines_of(out) if "front" in line][-1]["front"]}
    long_search.file.write_text("".join(line for line in lines if line not in lost))
    assert front_of(tune(*words).out) == front_of(out)
    assert long_search.file.read_text().count('"op_code":4') == POINTS, "a point was measured again"


@pytest.mark.skipif(available_threads() < 2, reason="one process measures all")
@pytest.mark.parametrize(("sent", "status"), [(signal.SIGTERM, 130), (signal.SIGKILL, -9)])
def test_a_table_that_is_ended_leaves_no_process(sent, status, tmp_path):
    words = (sys.executable, "-m", "tactune.app", "lab", "table", "--objects", "cup")
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
    with subprocess.Popen(words, stderr=subprocess.DEVNULL, env=environment, start_new_session=True) as process:
        while len(living(process.pid)) < 4 and process.poll() is None:  # itself, two workers, the tracker of memory
            time.sleep(0.1)
        process.send_signal(sent)
        assert process.wait(LIMIT_S) == status
    wait_for_the_end_of(process.pid)


def wait_for_the_end_of(session):
    for _ in range(10 * LIMIT_S):
        if not living(session):
            return
        time.sleep(0.1)
    raise AssertionError(f"processes are left: {living(session)}")


def living(session):
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[3]) == session and fields[0] != "Z":
            found.append(folder.name)
    return found


def test_a_dask_cluster_gives_the_front_of_this_computer(tune, recording):
    words = ("-s", recording, "--set", "tolerance.t=0.004,0.009,0.014,0.02", "--objective", "iou", "--json")
    here = front_of(tune(*words, "--study", "here.log").out)
    from distributed import LocalCluster

    with LocalCluster(n_workers=1, threads_per_worker=1, host="127.0.0.1", dashboard_address=None) as cluster:
        done = tune(*words, "--study", "there.log", "--scheduler", cluster.scheduler_address)
    assert done.status == 0, done.err
    assert front_of(done.out) == here
