"""Tests run in float64, as the command line does, and leave the user's compilation cache alone."""

import gc
import os
import shutil
import tempfile
from pathlib import Path

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # why is said in `identification._runtime`

import jax
import pytest

jax.config.update("jax_enable_x64", True)

QUICK = "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false"
"""Nearly all of a test is making a program that then runs for milliseconds: left unoptimised it takes 40 % of that. What
users have, optimised programs, is compared with it in `test_cli_simulate`, and is all that `make validate` has, which sets
XLA_FLAGS. A process that is given a flag that XLA does not know ends at once: versions to come do without."""

if jax.__version_info__ < (0, 11):
    os.environ.setdefault("XLA_FLAGS", QUICK)

gc.set_threshold(100_000, 20)  # traced programs are many small objects that live long: looking through them again is 5 %

CACHE, FROM = "JAX_COMPILATION_CACHE_DIR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"

MAPS = Path("/proc/self/maps")
MANY = 25_000
"""Memory maps of a process. Linux allows 65 530 and each compiled program takes some: without any left the compiler ends the
process."""


def pytest_configure():
    """One cache of compiled programs for all processes of a run, and no longer than it: half the time is compiling, and many
    tests compile what others did."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        os.environ |= {CACHE: tempfile.mkdtemp(prefix="millax-tests-"), FROM: "0.2"}
    jax.config.update("jax_compilation_cache_dir", os.environ[CACHE])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", float(os.environ[FROM]))


def pytest_unconfigure():
    if "PYTEST_XDIST_WORKER" not in os.environ:
        shutil.rmtree(os.environ[CACHE], ignore_errors=True)


@pytest.fixture(autouse=True, scope="module")
def _programs_are_given_back():
    """Forget the programs of earlier files before there are too many for one process."""
    yield
    if MAPS.exists() and MAPS.read_bytes().count(b"\n") > MANY:
        jax.clear_caches()
