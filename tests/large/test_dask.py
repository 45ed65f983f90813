"""Dask clusters that do not answer, or end."""

import os
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from threading import Thread

import numpy as np
import pytest

from anisomap.errors import InputError
from anisomap.large import map_reduce as mapping
from anisomap.large.map_reduce import WorkerPool, map_reduce
from anisomap.numerics.similarity.correlation import Moments
from dying import Killing

distributed = pytest.importorskip("distributed", reason="needs the extra 'cluster'")

CHUNKS = np.random.default_rng(0).random((20, 30, 4))
LONGEST_S = 300.0
"""Time after which a cluster counts as hung; far more than a busy machine needs."""


@pytest.fixture(autouse=True)
def limits(monkeypatch):
    """Let only the limit that a test is about end its wait."""
    for name in ("ANSWER_S", "WORKERS_S"):
        monkeypatch.setattr(mapping, name, LONGEST_S)
    return lambda name, seconds: monkeypatch.setattr(mapping, name, seconds)


def mapped(address: str, mapper=Moments.of) -> Moments:
    return map_reduce(lambda: iter(CHUNKS), mapper, pool=WorkerPool(scheduler=address))


@pytest.mark.parametrize(
    "address", ["foo", "tcp://", "tcp://host", "tcp://host:", "foo://host:1", "inproc://x:1", "://"]
)
def test_addresses_that_no_scheduler_has(address: str) -> None:
    with pytest.raises(InputError, match="must be as in tcp://host:8786, got"):
        mapped(address)


def test_encryption_needs_certificates() -> None:
    with pytest.raises(InputError, match="needs certificates"):
        mapped("tls://127.0.0.1:8786")


def test_a_port_that_never_answers(limits) -> None:
    limits("ANSWER_S", 0.3)
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(InputError, match=f"no Dask scheduler at {address}"):
            mapped(address)


def test_a_port_that_nobody_listens_at_is_refused_at_once() -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        with pytest.raises(InputError, match=r"no Dask scheduler at .* refused"):
            mapped(f"tcp://127.0.0.1:{unused.getsockname()[1]}")


def test_a_server_that_is_no_scheduler() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            with suppress(OSError):  # until the server is shut down
                while True:
                    with server.accept()[0] as caller, suppress(OSError):
                        caller.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")
                        caller.recv(1)

        answering = Thread(target=answer)
        answering.start()
        with pytest.raises(InputError, match="another server answers"):
            mapped(f"tcp://127.0.0.1:{server.getsockname()[1]}")
        server.shutdown(socket.SHUT_RDWR)
        answering.join()


@pytest.mark.filterwarnings("ignore")
def test_a_cluster_without_workers(limits) -> None:
    limits("WORKERS_S", 0.3)
    with (
        distributed.LocalCluster(
            n_workers=0, processes=False, protocol="tcp", dashboard_address=None
        ) as cluster,
        pytest.raises(InputError, match="has had no worker for"),
    ):
        mapped(cluster.scheduler_address)


@pytest.fixture
def cluster(tmp_path: Path):
    """Start a scheduler and a worker as processes; return its address and the two."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    paths = os.pathsep.join(map(str, [Path(__file__).parents[1] / "helpers", *sys.path]))
    options = {"cwd": tmp_path, "env": os.environ | {"PYTHONPATH": paths}, "stderr": -3}
    started = []
    for arguments in (
        f"distributed.cli.dask_scheduler --host 127.0.0.1 --port {port} --no-dashboard",
        f"distributed.cli.dask_worker {address} --nthreads 1 --no-nanny --no-dashboard",
    ):
        started.append(subprocess.Popen([sys.executable, "-m", *arguments.split()], **options))
        while not answers(port):
            assert started[0].poll() is None, "the scheduler ended"
            time.sleep(0.1)
    yield address, *started
    for process in started:
        process.kill()
        process.wait()


def answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("killed", "message"), [(1, "is lost"), (2, "has had no worker for")])
def test_a_cluster_that_is_killed_midway(
    cluster, tmp_path: Path, limits, killed: int, message: str
) -> None:
    mapped(cluster[0])  # waits for the worker
    limits("WORKERS_S", 2.0)
    with pytest.raises(InputError, match=message):
        mapped(cluster[0], Killing(tmp_path / "started", cluster[killed].pid))
