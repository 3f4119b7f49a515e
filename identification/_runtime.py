"""How a command sets up JAX: as `millax.set_up` does, and with compiled programs kept between runs."""

import contextlib
import hashlib
import os
import platform
from pathlib import Path

CACHED_FROM = 0.2
"""Seconds of compilation from which a program is kept."""


def prepare() -> None:
    """Set up JAX for a command. What the user's environment says already stays as it is."""
    # Before JAX is imported: XLA reports every program that it loads from the cache as made for another machine, because of
    # preferences of its own compiler that it takes for features of the processor. What does go wrong still arrives as an
    # exception.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

    import jax

    import millax

    millax.set_up()
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
