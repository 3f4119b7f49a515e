"""How the command line sets up JAX: double precision, compiled programs kept between runs, XLA's faster code.

The libraries leave all of this to their user; a command is a program of its own.
"""

import contextlib
import hashlib
import os
import platform
import sys
from pathlib import Path

XLA_FLAGS = (
    "--xla_cpu_prefer_vector_width=512",
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=100000000",
)
"""On a processor: the widest vectors it has, and the march through the tooth periods as one compiled loop instead of
kernels that are dispatched one by one. Between 1.1 and 2 times faster (`make bench`)."""

CACHED_FROM = 0.2
"""Seconds of compilation from which a program is kept."""


def prepare() -> None:
    """Set up JAX for a command. What the user's environment says already stays as it is."""
    if "jax" not in sys.modules:
        given = os.environ.get("XLA_FLAGS", "")
        new = [flag for flag in XLA_FLAGS if flag.split("=")[0] not in given]
        os.environ["XLA_FLAGS"] = " ".join([*given.split(), *new])
        # XLA reports every program it loads from the cache as made for another machine, because of preferences of its own
        # compiler that it takes for features of the processor. What does go wrong still arrives as an exception.
        os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

    import jax

    jax.config.update("jax_enable_x64", True)
    if jax.config.values["jax_compilation_cache_dir"] is None and "JAX_ENABLE_COMPILATION_CACHE" not in os.environ:
        with contextlib.suppress(OSError):  # nowhere to write: compile every time
            folder = _cache_folder()
            folder.mkdir(parents=True, exist_ok=True)
            jax.config.update("jax_compilation_cache_dir", str(folder))
            jax.config.update("jax_persistent_cache_min_compile_time_secs", CACHED_FROM)


def _cache_folder() -> Path:
    """Of the user, and of this kind of processor: compiled code does not run on every one."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "millax" / f"{platform.machine()}-{hashlib.sha256(_processor().encode()).hexdigest()[:12]}"


def _processor() -> str:
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith(("flags", "Features")):
                return line
    return platform.processor()
