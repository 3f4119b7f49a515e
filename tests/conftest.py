"""Tests run in float64, as the command line does, and leave the user's compilation cache alone."""

import os
from pathlib import Path

os.environ.setdefault("JAX_ENABLE_COMPILATION_CACHE", "false")

import jax
import pytest

jax.config.update("jax_enable_x64", True)

MAPS = Path("/proc/self/maps")
MANY = 25_000
"""Memory maps of a process. Linux allows 65 530 and each compiled program takes some: without any left the compiler ends the
process."""


@pytest.fixture(autouse=True, scope="module")
def _programs_are_given_back():
    """Forget the programs of earlier files before there are too many for one process."""
    yield
    if MAPS.exists() and MAPS.read_bytes().count(b"\n") > MANY:
        jax.clear_caches()
