"""The processes that make maps: what remains of a session when they are killed."""

import multiprocessing
import os
import signal
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from anisomap.live import ExaminationOptions, LiveSession
from anisomap.live.batches import Batch
from live_processes import LONGEST_S, Given, wait_for_maps
from skins import flat_skin

if sys.platform == "win32":
    pytest.skip("signals are those of Unix", allow_module_level=True)

pytestmark = pytest.mark.slow


@pytest.fixture
def others():
    """Processes of earlier tests, such as those of a pool."""
    return multiprocessing.active_children()


def workers_beside(others):
    return [child for child in multiprocessing.active_children() if child not in others]


@pytest.fixture
def session(tmp_path, others):  # lists others before its own start
    source = Given([Batch(flat_skin(n_frames=300).readings.astype(float))])
    options = ExaminationOptions(method="r-anisomap", dimensions=2)
    with LiveSession(source, tmp_path / "r.csv", options) as started:
        wait_for_maps(started, lambda maps: maps.checked)
        yield started


def finish_while(session, action):
    """Finish a session without a limit of time; repeat an action until it is finished."""
    with ThreadPoolExecutor(1) as pool:
        final, begun = pool.submit(session.finish), time.monotonic()
        while not (session.finishing or final.done()):
            time.sleep(0.01)
        while not final.done() and time.monotonic() - begun < LONGEST_S:
            action()
            time.sleep(0.01)
        if not final.done():
            session.maps.close()  # ends the wait
            pytest.fail("the session does not end")
        return final.result()


def test_the_final_map_is_made_though_its_process_is_killed(session, others):
    workers = workers_beside(others)
    for worker in workers:
        os.kill(worker.pid, signal.SIGSTOP)  # the request for the final map stays unanswered
    final = finish_while(session, lambda: [worker.kill() for worker in workers])
    assert final.final
    assert final.n_frames == 300
    assert final.sensor_map is not None


def test_a_session_ends_though_its_processes_die_again_and_again(session, others):
    def kill():
        for worker in workers_beside(others):
            worker.kill()

    assert finish_while(session, kill) is None
    assert finish_while(session, lambda: None) is None  # waits for no process that is gone


def test_a_session_ends_though_its_processes_are_stopped(session, others):
    for worker in workers_beside(others):
        os.kill(worker.pid, signal.SIGSTOP)
    session.maps.close()
    assert workers_beside(others) == []


def test_dimensions_are_chosen_though_the_first_checked_map_is_earlier(tmp_path, others):
    def given():
        (quick,) = (child for child in workers_beside(others) if child.name == "quick maps")
        os.kill(quick.pid, signal.SIGSTOP)
        yield Batch(flat_skin(n_frames=800).readings.astype(float))
        wait_for_maps(session, lambda maps: maps.checked)
        os.kill(quick.pid, signal.SIGCONT)

    options = ExaminationOptions(method="r-anisomap")
    with LiveSession(Given(given()), tmp_path / "r.csv", options) as session:
        wait_for_maps(session, lambda maps: maps.quick and maps.quick.positions.shape[1] == 2)
