"""The C loops of this directory, compiled when they are asked for and called through ctypes.

Both compute a slot of a fractional law on one core, one time step after the other:

- `same_model`: the equations of millax, step means and smoothed gates included;
- `sampled`: a simpler model, hard gates and the force sampled in the middle of each step, which is less work.
"""

import ctypes
import functools
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

import millax as mx

FLAGS = ("-O3", "-march=native", "-ffast-math")
TOLERANCE = 1e-11
"""Where the loop ends to iterate force and displacement of a step [m]. Forces are then as good as the engine's."""

_FOLDER = tempfile.TemporaryDirectory(prefix="millax-bench-")


class Traces(NamedTuple):
    """What the loops return: force (steps, 2) [N], displacement (steps, 2) [m], chip thickness (steps, teeth) [m]."""

    force: np.ndarray
    displacement: np.ndarray
    thickness: np.ndarray | None = None
    evaluations: float = 1.0
    """Times the force of a step was computed, on average."""


def have_compiler() -> bool:
    return shutil.which("gcc") is not None


def same_model(case: mx.Case, tolerance: float = TOLERANCE) -> Callable[[], Traces]:
    """The model of `case`, ready to run. Any structure that moves in the plane, any stock, a fractional law."""
    s, law, cut = case.settings, _fractional(case), case.cut
    n, borders, states = s.steps_per_tooth, len(case.stock.offsets), 2 * case.at_tool.coordinates
    sizes = {"STEPS_PER_TOOTH": n, "TEETH": case.tool.teeth, "PASSES": s.passes, "BORDERS": borders, "STATES": states}
    function = _library("same_model.c", tuple(sizes.items())).same_model
    function.restype = ctypes.c_double
    numbers = [
        *(2 * np.pi / (case.tool.teeth * n), case.tool.radius, cut.depth, *cut.start, cut.feed_rate),
        *(cut.feed_per_tooth(case.tool), cut.spindle_speed * case.tool.radius),
        *(law.k0, law.hs, law.r, law.kr, s.width, tolerance),
        *(*np.ravel(case.stock.normals), 0.0, *case.stock.offsets, 0.0),
    ]
    dt = time_step(case)
    seen, half, whole = observed(case), discrete(case, dt / 2), discrete(case, dt)
    for matrix in (seen @ half[0], seen @ half[1], *whole):
        numbers.extend(matrix.ravel())
    # The C struct: one long, then doubles without gaps.
    memory = np.array([np.int64(s.steps).view(np.float64), *(float(x) for x in numbers)])
    traces = Traces(np.empty((s.steps, 2)), np.empty((s.steps, 2)), np.empty((s.steps, case.tool.teeth)))

    def run():
        evaluations = function(*(_pointer(a) for a in (memory, *traces[:3])))
        return traces._replace(evaluations=evaluations)

    return run


def sampled(case: mx.Case) -> Callable[[], Traces]:
    """The simpler model of `case`, ready to run. A 2-DOF structure, the border x = 0."""
    s, law, cut, dt = case.settings, _fractional(case), case.cut, time_step(case)
    matrices = [np.ascontiguousarray(m) for m in (*discrete(case, dt / 2), *discrete(case, dt))]
    assert matrices[0].shape == (4, 4)
    function = _library("sampled.c", ()).sampled
    traces = Traces(np.empty((s.steps, 2)), np.empty((s.steps, 2)))
    numbers = (dt, cut.spindle_speed, cut.feed_rate, case.tool.radius, law.k0 * cut.depth, law.hs, law.r, law.kr)
    arguments = [
        *(ctypes.c_int(n) for n in (s.steps_per_tooth, case.tool.teeth, s.passes)),
        ctypes.c_long(s.steps),
        *(ctypes.c_double(float(x)) for x in numbers),
        *(_pointer(a) for a in (*matrices, *traces[:2])),
    ]

    def run(keep=matrices):
        function(*arguments)
        return traces

    return run


def time_step(case: mx.Case) -> float:
    return float(case.cut.tooth_period(case.tool)) / case.settings.steps_per_tooth


def observed(case: mx.Case) -> np.ndarray:
    """(x, y, vx, vy) of the tool from the state (q, q')."""
    shapes = np.asarray(case.at_tool.in_plane_shapes)
    return np.block([[shapes, np.zeros_like(shapes)], [np.zeros_like(shapes), shapes]])


def discrete(case: mx.Case, duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition of the state (q, q') over `duration`, and its response to a constant force in the plane."""
    s = case.at_tool
    n = s.coordinates
    mass, damping, stiffness = (np.asarray(m) for m in (s.mass_matrix, s.damping_matrix, s.stiffness_matrix))
    rates = np.zeros((2 * n + 2, 2 * n + 2))
    rates[:n, n : 2 * n] = np.eye(n)
    rates[n : 2 * n] = np.linalg.solve(mass, np.hstack([-stiffness, -damping, np.asarray(s.in_plane_shapes).T]))
    exponential = expm(rates * duration)
    return exponential[: 2 * n, : 2 * n], exponential[: 2 * n, 2 * n :]


@functools.cache
def _library(name: str, sizes: tuple[tuple[str, int], ...]) -> ctypes.CDLL:
    source = Path(__file__).with_name(name)
    library = Path(_FOLDER.name) / f"{source.stem}-{'-'.join(str(size) for _, size in sizes)}.so"
    defined = [f"-D{key}={size}" for key, size in sizes]
    compiled = library.with_suffix(".o")
    subprocess.run(["gcc", *FLAGS, *defined, "-c", "-fPIC", str(source), "-o", str(compiled)], check=True)
    # Linked without -ffast-math, with which the library would take subnormal numbers from the whole process that loads it.
    subprocess.run(["gcc", "-shared", str(compiled), "-o", str(library), "-lm"], check=True)
    return ctypes.CDLL(str(library))


def _fractional(case: mx.Case) -> mx.FractionalLaw:
    if not isinstance(case.force, mx.FractionalLaw):
        raise TypeError(f"the C loops know the fractional law only, not {type(case.force).__name__}")
    return case.force


def _pointer(array: np.ndarray):
    return array.ctypes.data_as(ctypes.c_void_p)
