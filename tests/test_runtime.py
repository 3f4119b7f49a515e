"""How the command line sets up JAX."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SET_HERE = (
    "XLA_FLAGS",
    "TF_CPP_MIN_LOG_LEVEL",
    "JAX_ENABLE_COMPILATION_CACHE",
    "JAX_COMPILATION_CACHE_DIR",
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS",
)

CASE = Path(__file__).parent.parent / "docs" / "cases" / "kr240_2dof.toml"


def run(tmp_path, *arguments, **environment):
    """A command in a process of its own, its cache in `tmp_path`."""
    clean = {key: value for key, value in os.environ.items() if key not in SET_HERE}
    return subprocess.run(
        [sys.executable, *arguments],
        env=clean | {"XDG_CACHE_HOME": str(tmp_path / "cache")} | environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def test_programs_are_kept_between_runs_and_loaded_without_noise(tmp_path):
    command = ("-m", "identification.cli", "simulate", str(CASE), "--out", str(tmp_path / "out"))
    first = run(tmp_path, *command)
    assert first.returncode == 0, first.stderr
    kept = sorted(path.name for path in (tmp_path / "cache" / "millax").rglob("*-cache"))
    assert kept
    second = run(tmp_path, *command)
    assert second.returncode == 0
    assert second.stderr == ""
    # Small programs are kept where they took long to compile, which on a busy machine any may.
    again = sorted(path.name for path in (tmp_path / "cache" / "millax").rglob("*-cache"))
    assert [name for name in again if "simulate" in name] == [name for name in kept if "simulate" in name]


def test_a_cache_that_cannot_be_written_is_done_without(tmp_path):
    (tmp_path / "cache").write_text("not a folder")
    done = run(
        tmp_path, "-c", "from identification._runtime import prepare; prepare(); import jax.numpy as n; n.ones(2) + 1"
    )
    assert done.returncode == 0, done.stderr


SHOW = "from identification._runtime import prepare; prepare(); import os; print(os.environ['XLA_FLAGS'])"


@pytest.mark.parametrize(
    ("given", "width"), [("", "512"), ("--xla_cpu_prefer_vector_width=256", "256")], ids=["nothing", "given"]
)
def test_the_users_flags_have_the_last_word(tmp_path, given, width):
    flags = run(tmp_path, "-c", SHOW, XLA_FLAGS=given).stdout.split()
    assert [flag for flag in flags if "vector_width" in flag] == [f"--xla_cpu_prefer_vector_width={width}"]
    assert any("small_while_loop" in flag for flag in flags)


def test_a_script_sets_up_jax_as_a_command_does(tmp_path):
    show = "import millax, jax, os; millax.set_up(); print(os.environ['XLA_FLAGS'], jax.numpy.ones(1).dtype)"
    done = run(tmp_path, "-W", "error", "-c", show)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[-1] == "float64"
    assert done.stdout.split()[:-1] == run(tmp_path, "-c", SHOW).stdout.split()


def test_setting_up_too_late_is_said(tmp_path):
    show = "import millax, jax; jax.numpy.ones(1); millax.set_up(); millax.set_up(); print(jax.numpy.ones(1).dtype)"
    done = run(tmp_path, "-c", show)
    assert done.stderr.count("comes too late") == 1
    assert done.stdout.split() == ["float64"]


def test_importing_the_packages_sets_nothing(tmp_path):
    show = "import millax, identification, os, jax; print(os.environ.get('XLA_FLAGS'), jax.config.jax_compilation_cache_dir)"
    assert run(tmp_path, "-c", show).stdout.split() == ["None", "None"]
