"""Measurements that need a process of their own: peak memory, start-up and compile times.

`python -m benchmarks.speed.child NAME [NUMBER ...]` prints one JSON object.
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

BEGIN = time.perf_counter()
import millax  # noqa: E402  how long this takes is one of the measurements
from millax._runtime import XLA_FLAGS  # noqa: E402

IMPORTED = time.perf_counter() - BEGIN
PLAIN = "--plain"
ROOT = Path(__file__).resolve().parents[2]


def ask(name: str, *numbers: float, plain: bool = False) -> dict[str, float]:
    """Run measurement `name` in a fresh process; `plain`: without the XLA flags of `millax.set_up`."""
    command = [sys.executable, "-m", "benchmarks.speed.child", name, *map(str, numbers)]
    environment = dict(os.environ)
    if plain:
        command.append(PLAIN)
        given = environment.get("XLA_FLAGS", "").split()
        environment["XLA_FLAGS"] = " ".join(flag for flag in given if flag not in XLA_FLAGS)
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command[1:])} failed:\n{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


def start() -> dict[str, float]:
    """Seconds for the case, the first simulation, and the second."""
    import jax

    import millax as mx
    from benchmarks.slot import slot

    begin = time.perf_counter()
    case = slot(duration=1.0)
    ready = time.perf_counter()
    jax.block_until_ready(mx.simulate(case))
    first = time.perf_counter()
    jax.block_until_ready(mx.simulate(case))
    second = time.perf_counter()
    return {"import": IMPORTED, "case": ready - begin, "first": first - ready, "second": second - first}


def memory(mode: str, duration: float) -> dict[str, float]:
    """Peak memory of a process [bytes] that takes one derivative of a simulation of `duration` [s], the size of the result
    [bytes], and how long it takes once compiled [s]."""
    import jax
    import jax.numpy as jnp

    from benchmarks.slot import slot
    from benchmarks.speed.derivatives import GRADIENT, JACOBIAN, programs, row_by_row

    case = slot(duration=duration)
    functions = programs(case)
    function = {"reverse": functions[GRADIENT], "forward": functions[JACOBIAN], "rows": row_by_row(case)}[mode]
    result = jax.block_until_ready(function(jnp.ones(6)))
    peak, size = _peak(), sum(leaf.nbytes for leaf in jax.tree.leaves(result))
    del result
    begin = time.perf_counter()
    jax.block_until_ready(function(jnp.ones(6)))
    return {"peak": peak, "result": size, "seconds": time.perf_counter() - begin, "steps": case.settings.steps}


def on_all_cores(subject: str, *numbers: float) -> dict[str, float]:
    """What `measure` of a subject finds in a process in which every core is a device."""
    import importlib

    import millax as mx

    mx.use_all_cores()
    return importlib.import_module(f"benchmarks.speed.{subject}").measure(*numbers)


def _peak() -> int:
    """Largest resident memory of this process so far [bytes]."""
    status = Path("/proc/self/status")
    if status.exists():  # what getrusage says on Linux includes the process that started this one
        return 1024 * next(int(line.split()[1]) for line in status.read_text().splitlines() if line.startswith("VmHWM"))
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


if __name__ == "__main__":
    name, *rest = (argument for argument in sys.argv[1:] if argument != PLAIN)
    numbers = [float(number) for number in rest]
    if PLAIN in sys.argv:
        import jax

        jax.config.update("jax_enable_x64", True)
    else:
        millax.set_up()
    if name == "start":
        print(json.dumps(start()))
    elif name in ("forward", "rows", "reverse"):
        print(json.dumps(memory(name, *numbers)))
    else:
        print(json.dumps(on_all_cores(name, *numbers)))
