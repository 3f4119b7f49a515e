"""A sweep on a Dask cluster: the numbers of one process, also where a worker is killed half-way."""

import os
import signal

import numpy as np
import pytest
from cases import slot

import millax as mx
from millax import _cluster, _sweep

distributed = pytest.importorskip("distributed")

CASE = slot(duration=4.0)  # long enough for a worker to be at work when it is killed
GRID = {"cut.depth": "0.2:4:8 mm", "force.k0": "4000:6000:4 N/mm^2"}
KEEP = ["mean_force", "std_displacement"]


@pytest.fixture
def client(monkeypatch):
    monkeypatch.setattr(_sweep, "BATCH", 2)  # sixteen chunks of two members
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


def test_a_worker_that_is_killed_half_way_takes_nothing_with_it(client, tmp_path):
    here = mx.sweep(CASE, grid=GRID, reduce=KEEP)
    workers = client.run(os.getpid)
    killed = []

    def progress(p):
        if p.done >= 8 and not killed:
            busy = next((address for address, tasks in client.processing().items() if tasks), None)
            if busy is None:
                return
            os.kill(workers[busy], signal.SIGKILL)
            killed.append(busy)

    there = mx.sweep(CASE, grid=GRID, reduce=KEEP, client=client, out=tmp_path / "sweep.nc", progress=progress)
    assert killed
    assert (there["status"] == 0).all()
    for name in (*KEEP, "residual", "simulated_time"):
        np.testing.assert_allclose(there[name], here[name], rtol=1e-12, atol=1e-15)
    assert there["mean_force"].dtype == np.float64


def test_a_function_that_fails_on_the_workers_is_an_error_and_what_is_done_stays(client, tmp_path, monkeypatch):
    calls = tmp_path / "calls"
    monkeypatch.setattr(_cluster, "RETRIES", 1)

    def fails(work, group, table, periods, calls=str(calls)):
        with open(calls, "a") as file:
            file.write("x")
        raise ArithmeticError("no")

    monkeypatch.setattr(_cluster, "_task", fails)
    with pytest.raises(RuntimeError, match="ArithmeticError: no"):
        mx.sweep(CASE, grid={"cut.depth": [1e-3]}, reduce=KEEP, client=client)
    assert calls.read_text() == "xx"  # once more than once
