"""What is done stays done: parts on disk, going on after every kind of end, and refusing to mix sweeps."""

import errno
import json
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from cases import slot

import millax as mx
from millax import _sweep, _sweepfile

CASE = slot(duration=0.006, axes=())
GRID = {"cut.depth": "0.2:4:12 mm", "force.kr": "0.2, 0.3"}
KEEP = ["mean_force", "peak_force"]


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch):
    """Six chunks of four members."""
    monkeypatch.setattr(_sweep, "BATCH", 4)


@pytest.fixture(scope="module")
def expected():
    return mx.sweep(CASE, grid=GRID, reduce=KEEP)


def run(out, case=CASE, grid=GRID, reduce=KEEP, **more):
    return mx.sweep(case, grid=grid, reduce=reduce, out=out, **more)


def same(result, expected):
    for name in expected.data_vars:
        np.testing.assert_allclose(result[name], expected[name], rtol=1e-12, atol=1e-15)
        assert result[name].dims == expected[name].dims
        assert result[name].attrs == expected[name].attrs


class Stop:
    """Ends a sweep after so many chunks, and counts the members that were computed."""

    def __init__(self, after=None, error=KeyboardInterrupt):
        self.chunks, self.after, self.error, self.first = 0, after, error, None

    def __call__(self, progress):
        self.first = progress.done if self.first is None else self.first
        self.last = progress
        if self.after is not None and self.chunks == self.after:
            raise self.error
        self.chunks += 1


def interrupted(out, after=3) -> Path:
    with pytest.raises(KeyboardInterrupt, match=f"{4 * after} of 24 members are done and kept in .*run the same again"):
        run(out, progress=Stop(after))
    return Path(f"{out}.parts")


def test_the_file_holds_what_is_returned(tmp_path, expected):
    out = tmp_path / "deep" / "sweep.nc"
    result = run(out)
    same(result, expected)
    with xarray.open_dataset(out, engine="h5netcdf") as file:
        same(file, expected)
        assert file["cut.depth"].attrs["units"] == "mm"
        assert json.loads(file.attrs["millax_sweep"])["force.k0"] == 5e9
    assert [path.name for path in out.parent.iterdir()] == ["sweep.nc"]


def test_a_finished_sweep_is_read_and_not_computed_again(tmp_path, expected, monkeypatch):
    run(tmp_path / "sweep.nc")
    monkeypatch.setattr(_sweep, "Computation", None)
    same(run(tmp_path / "sweep.nc"), expected)


def test_an_interrupted_sweep_goes_on_where_it_was(tmp_path, expected):
    parts = interrupted(tmp_path / "sweep.nc")
    assert len(list(parts.glob("*.nc"))) == 3
    assert not (tmp_path / "sweep.nc").exists()
    counter = Stop()
    same(run(tmp_path / "sweep.nc", progress=counter), expected)
    assert counter.first == 12
    assert counter.last.done == counter.last.total == 24
    assert [path.name for path in tmp_path.iterdir()] == ["sweep.nc"]


KILLED = """
import os, signal, sys
import jax
jax.config.update("jax_enable_x64", True)
import millax as mx
from millax import _sweep
from test_sweep_file import CASE, GRID, KEEP
_sweep.BATCH = 4
def progress(p):
    if p.done >= 8:
        os.kill(os.getpid(), signal.SIGKILL)
mx.sweep(CASE, grid=GRID, reduce=KEEP, out=sys.argv[1], progress=progress)
"""


def test_a_killed_process_loses_nothing_that_was_done(tmp_path, expected):
    out = tmp_path / "sweep.nc"
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parent)}
    ended = subprocess.run([sys.executable, "-c", KILLED, str(out)], env=environment, cwd=Path(__file__).parents[1])
    assert ended.returncode == -signal.SIGKILL
    (tmp_path / "sweep.nc.parts" / "half.nc.tmp").write_bytes(b"what a kill in the middle of writing leaves")
    counter = Stop()
    same(run(out, progress=counter), expected)
    assert counter.first == 8


@pytest.mark.parametrize("damage", [lambda data: data[:-100], lambda data: data[:900] + b"?" + data[901:], lambda data: b""])
def test_a_damaged_part_is_computed_again(tmp_path, expected, damage):
    parts = interrupted(tmp_path / "sweep.nc")
    one = sorted(parts.glob("*.nc"))[1]
    one.write_bytes(damage(one.read_bytes()))
    counter = Stop()
    with pytest.warns(UserWarning, match="damaged"):
        same(run(tmp_path / "sweep.nc", progress=counter), expected)
    assert counter.first == 8


CHANGES = {
    "another number of the case": (
        {"case": eqx.tree_at(lambda c: c.force.k0, CASE, jnp.asarray(6e9))},
        "force.k0: 5000000000.0 → 6000000000.0",
    ),
    "another value": ({"grid": GRID | {"force.kr": "0.2, 0.4"}}, "vary.force.kr: 2 values from 0.2 to 0.3 "),
    "another range": ({"grid": GRID | {"cut.depth": "0.2:5:12 mm"}}, "→ 12 values from 0.2 to 5 mm"),
    "another name": ({"grid": {"cut.depth": GRID["cut.depth"]}}, "vary.force.kr: 2 values from 0.2 to 0.3 "),
    "one more reduction": ({"reduce": [*KEEP, "peak_displacement"]}, "reduce.peak_displacement: none → "),
    "other settings": ({"case": slot(duration=0.006, axes=(), passes=2)}, "settings.passes: 3 → 2"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_changed_sweep_does_not_go_on_with_the_parts_of_another(tmp_path, change):
    parts = interrupted(tmp_path / "sweep.nc", after=1)
    kept = {path: path.read_bytes() for path in parts.iterdir()}
    arguments, words = CHANGES[change]
    with pytest.raises(ValueError, match=r"a part of another sweep") as error:
        run(tmp_path / "sweep.nc", **arguments)
    assert words in str(error.value)
    assert "start anew" in str(error.value)
    assert len([line for line in str(error.value).splitlines() if line.startswith("  ")]) == 1  # that, and nothing else
    assert {path: path.read_bytes() for path in parts.iterdir()} == kept


def test_a_function_that_changed_under_the_same_name_is_noticed(tmp_path):
    out = tmp_path / "sweep.nc"
    run(out, reduce={"largest": lambda sim: jnp.max(sim.force)})
    run(out, reduce={"largest": lambda s: jnp.max(s.force)})  # the same computation, however it is written
    with pytest.raises(ValueError, match=r"results of another sweep:\n  reduce.largest: the function has changed"):
        run(out, reduce={"largest": lambda sim: 2 * jnp.max(sim.force)})
    scale = jnp.asarray(3.0)
    with pytest.raises(ValueError, match="the function has changed"):
        run(out, reduce={"largest": lambda sim: scale * jnp.max(sim.force)})


def test_overwriting(tmp_path, expected):
    out = tmp_path / "sweep.nc"
    run(out, grid={"cut.depth": "1, 2 mm"})
    with pytest.raises(ValueError, match="results of another sweep"):
        run(out)
    same(run(out, overwrite=True), expected)
    out.write_text("mine")
    with pytest.raises(ValueError, match="is not the result of a sweep"):
        run(out)
    assert out.read_text() == "mine"
    with pytest.raises(ValueError, match="this is a directory"):
        run(tmp_path)


def test_a_full_disk(tmp_path, expected, monkeypatch):
    sync = os.fsync
    calls = []

    def full(descriptor):
        calls.append(descriptor)
        if len(calls) > 3:  # the manifest and two parts
            raise OSError(errno.ENOSPC, "No space left on device")
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=r"8 of 24 members are done and kept in .*make room and run the same again") as error:
        run(tmp_path / "sweep.nc")
    assert error.value.errno == errno.ENOSPC
    monkeypatch.setattr(os, "fsync", sync)
    assert len(list((tmp_path / "sweep.nc.parts").glob("*.nc"))) == 2
    assert not list(tmp_path.rglob("*.tmp"))
    same(run(tmp_path / "sweep.nc"), expected)


def test_a_limit_of_the_operating_system_while_writing(tmp_path, expected):
    """The real thing: from the second chunk on no file may grow beyond a kilobyte."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)

    def tighten(progress):
        if progress.done == 4:
            resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))

    try:
        with pytest.raises(OSError, match="4 of 24 members are done and kept"):
            run(tmp_path / "sweep.nc", progress=tighten)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list(tmp_path.rglob("*.tmp"))
    same(run(tmp_path / "sweep.nc"), expected)


def test_too_little_room_is_said_before_anything_is_computed(tmp_path, monkeypatch):
    monkeypatch.setattr(_sweepfile.shutil, "disk_usage", lambda path: Disk(free=1000))
    monkeypatch.setattr(_sweep, "Computation", None)
    with pytest.raises(OSError, match=r"the disk has 1 kB free, and the sweep needs about 3\.\d+ kB"):
        run(tmp_path / "sweep.nc")


class Disk:
    def __init__(self, free):
        self.free = free


def test_a_sweep_larger_than_memory_is_computed_and_read_in_chunks(tmp_path, monkeypatch):
    keep = {"force": lambda sim: sim.force, "mean_force": mx.REDUCTIONS["mean_force"]}
    grid = {"cut.depth": "0.2:4:60 mm"}
    whole = mx.sweep(CASE, grid=grid, reduce=keep)
    monkeypatch.setattr(_sweep, "available_memory", lambda: 400e3)
    with pytest.raises(ValueError, match=r'result of this sweep, 23\d kB, does not fit .*400 kB.* Give out="sweep.nc"'):
        mx.sweep(CASE, grid=grid, reduce=keep)
    with pytest.warns(UserWarning, match=r"23\d kB, is larger than .*written in chunks"):
        result = mx.sweep(CASE, grid=grid, reduce=keep, out=tmp_path / "sweep.nc")
    with result:
        assert not result["force"].variable._in_memory
        same(result, whole)


def test_one_simulation_larger_than_memory(monkeypatch):
    monkeypatch.setattr(_sweep, "available_memory", lambda: 10e3)
    with pytest.raises(ValueError, match=r"needs .* kB of memory, and 10 kB are free. Simulate a shorter cut"):
        mx.sweep(CASE, grid=GRID)
