"""What a sweep keeps of every simulation."""

import hashlib
import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ._case import Case
from ._simulate import Simulation, simulate
from ._summary import DEFINITIONS
from ._types import AXES, Scalar


@dataclass(frozen=True)
class Reduction:
    """From a simulation to what is kept of it, with what is needed to label the result.

    - `function`: of a `Simulation`, or of a `Simulation` and its `Case` where it takes two arguments; in JAX, since it is
      compiled with the simulation. It returns an array, or a pytree of arrays: each becomes a variable of the result.
    - `unit`, `definition`: for the attributes of the result.
    - `dims`: names of the dimensions of the array. "axis" stands for x, y, z. None: named after the variable.
    """

    function: Callable[..., Any]
    unit: str = ""
    definition: str = ""
    dims: tuple[str, ...] | None = None

    def __call__(self, sim: Simulation, case: Case) -> dict[str, Array]:
        """Arrays by the suffix that their pytree gives them; "" for a single one."""
        two = len([p for p in inspect.signature(self.function).parameters.values() if _required(p)]) > 1
        result = self.function(sim, case) if two else self.function(sim)
        leaves, _ = jax.tree_util.tree_flatten_with_path(result)
        return {_suffix(path): jnp.asarray(leaf) for path, leaf in leaves}


def _required(parameter: inspect.Parameter) -> bool:
    return parameter.default is parameter.empty and parameter.kind in (
        parameter.POSITIONAL_ONLY,
        parameter.POSITIONAL_OR_KEYWORD,
    )


def _suffix(path: tuple) -> str:
    return "".join(f".{key}" for key in (re.sub(r"\W+", "", str(part)) for part in path))


def window(sim: Simulation, case: Case) -> Bool[Array, " periods"]:
    """Which tooth periods are in the whole revolutions in the last half of the trace; in those of all of it where there is
    none."""
    teeth = case.tool.teeth
    end = jnp.sum(_simulated(sim, case))
    half = end // 2 // teeth
    revolutions = jnp.where(half > 0, half, end // teeth)
    period = jnp.arange(case.settings.periods)
    return (period >= end - revolutions * teeth) & (period < end)


def _simulated(sim: Simulation, case: Case) -> Bool[Array, " periods"]:
    """The tooth periods up to the end of the trace: its time is NaN behind it."""
    return ~jnp.isnan(sim.time.reshape(case.settings.periods, -1)[:, 0])


# One column of a trace after the other, and sums over periods as products of a vector and a matrix: as XLA lays traces out,
# that is several times as fast as a sum over time.


def _mean(column: Float[Array, " steps"], inside: Bool[Array, " periods"]) -> Scalar:
    """NaN where nothing is inside."""
    by_period = jnp.where(inside[:, None], column.reshape(len(inside), -1), 0.0)
    return jnp.sum(inside.astype(column.dtype) @ by_period) / (jnp.sum(inside) * by_period.shape[1])


def _std(column: Float[Array, " steps"], inside: Bool[Array, " periods"]) -> Scalar:
    return jnp.sqrt(_mean((column - _mean(column, inside)) ** 2, inside))


def _peak(column: Float[Array, " steps"], inside: Bool[Array, " periods"]) -> Scalar:
    peak = jnp.max(jnp.where(inside[:, None], jnp.abs(column).reshape(len(inside), -1), 0.0))
    return jnp.where(jnp.any(inside), peak, jnp.nan)


def _of_force(statistic, periods):
    return lambda sim, case: jnp.stack([statistic(sim.force[:, i], periods(sim, case)) for i in range(len(AXES))])


def _of_displacement(statistic, periods):
    """Zero along an axis in which the tool does not move."""

    def of(sim, case):
        still = jnp.zeros(sim.time.size)
        columns = [sim.displacement[:, sim.axes.index(axis)] if axis in sim.axes else still for axis in AXES]
        return jnp.stack([statistic(column, periods(sim, case)) for column in columns])

    return of


_WINDOW = "the whole revolutions in the last half of the trace"

REDUCTIONS: dict[str, Reduction] = {
    "mean_force": Reduction(_of_force(_mean, window), *DEFINITIONS["mean_force"], ("axis",)),
    "peak_force": Reduction(_of_force(_peak, window), *DEFINITIONS["peak_force"], ("axis",)),
    "mean_displacement": Reduction(_of_displacement(_mean, window), "m", f"mean over {_WINDOW}", ("axis",)),
    "std_displacement": Reduction(
        _of_displacement(_std, window),
        "m",
        f"standard deviation over {_WINDOW}: the vibration without the static displacement",
        ("axis",),
    ),
    "peak_displacement": Reduction(
        _of_displacement(_peak, _simulated),
        "m",
        "largest displacement, without sign, over the whole trace, the entry into the workpiece included",
        ("axis",),
    ),
}
"""What a sweep keeps unless it is told otherwise, with unit and definition."""

Reduce = Sequence[str] | Mapping[str, Reduction | Callable[..., Any]] | None
"""Names out of `REDUCTIONS`, or functions by the name of the variable; None: all of `REDUCTIONS`."""

OWN = ("status", "residual", "simulated_time")
"""Variables that every sweep has."""


def chosen(reduce: Reduce) -> dict[str, Reduction]:
    """The reductions that `reduce` stands for. Raises `ValueError`."""
    if reduce is None:
        return dict(REDUCTIONS)
    words = f"it takes names out of {', '.join(REDUCTIONS)}, or a dictionary of functions of a Simulation"
    if isinstance(reduce, str) or not isinstance(reduce, Sequence | Mapping):
        raise ValueError(f"reduce: {reduce!r} given; {words}")
    if not isinstance(reduce, Mapping):
        for name in reduce:
            if name not in REDUCTIONS:
                raise ValueError(f"reduce: {name!r} given; {words}")
        return {name: REDUCTIONS[name] for name in reduce}
    found = {}
    for name, function in reduce.items():
        if not isinstance(name, str) or not name or "/" in name or name in OWN:
            raise ValueError(
                f"reduce: {name!r} given as a name; it must be a text without / and not one of {', '.join(OWN)}"
            )
        if not callable(function):
            raise ValueError(f"reduce: {function!r} given for {name}; {words}")
        found[name] = function if isinstance(function, Reduction) else Reduction(function)
    return found


def abstract(case: Case) -> Simulation:
    """The simulation of `case` as shapes and types: nothing is computed."""
    leaves, structure = jax.tree.flatten(case)
    key = (structure, tuple((jnp.shape(leaf), jnp.result_type(leaf)) for leaf in leaves))
    if key not in _ABSTRACT:
        _ABSTRACT[key] = eqx.filter_eval_shape(lambda case: simulate(case, throw=False), case)
    return _ABSTRACT[key]


_ABSTRACT: dict[tuple, Simulation] = {}
"""By what the shapes depend on: tracing a simulation takes milliseconds, as long as a small sweep does."""


def shapes(sim: Simulation, case: Case, reductions: Mapping[str, Reduction]) -> dict[str, tuple[int, ...]]:
    """Shape of every variable made of an abstract simulation. Raises `ValueError` naming a reduction that fails."""
    found = {}
    for name, reduction in reductions.items():
        try:
            parts, _ = _traced(reduction, sim, case)
        except Exception as error:
            raise ValueError(
                f"reduce: {name} cannot be computed from a Simulation by JAX: {type(error).__name__}: {error}"
            ) from error
        if not parts:
            raise ValueError(f"reduce: {name} returns nothing; it must return an array")
        for suffix, part in parts.items():
            if jnp.issubdtype(part.dtype, jnp.complexfloating):
                raise ValueError(f"reduce: {name} is complex; give its real and imaginary part, or its modulus and phase")
            if reduction.dims is not None and len(reduction.dims) != len(part.shape):
                raise ValueError(f"reduce: {name} has shape {part.shape}, but the dimensions {reduction.dims}")
            found[name + suffix] = part.shape
    return found


def fingerprints(sim: Simulation, case: Case, reductions: Mapping[str, Reduction]) -> dict[str, str]:
    """What each reduction computes of an abstract simulation, as a short hash of its program: another function under the
    same name has another one."""
    return {name: _traced(reduction, sim, case)[1] for name, reduction in reductions.items()}


_Traced = tuple[dict[str, jax.ShapeDtypeStruct], str]

_TRACED: dict[tuple, _Traced] = {}
"""Of the reductions that come with millax. Those of the user are traced anew: what they do may have changed."""


def _traced(reduction: Reduction, sim: Simulation, case: Case) -> _Traced:
    """What a reduction makes of an abstract simulation, by suffix, and the hash of its program."""
    arrays, static = eqx.partition((sim, case), lambda x: isinstance(x, jax.ShapeDtypeStruct) or eqx.is_array(x))
    leaves, structure = jax.tree.flatten(arrays)
    key = (reduction, structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves))
    if key in _TRACED:
        return _TRACED[key]

    def run(arrays):
        return reduction(*eqx.combine(arrays, static))

    program, parts = jax.make_jaxpr(run, return_shape=True)(arrays)
    # Addresses of functions differ from run to run.
    found = hashlib.sha256(re.sub(r"0x[0-9a-f]+", "", str(program.jaxpr)).encode())
    for constant in program.consts:
        found.update(jnp.asarray(constant).tobytes())
    found.update(f"{reduction.unit}|{reduction.definition}|{reduction.dims}".encode())
    traced = parts, found.hexdigest()[:12]
    if reduction in REDUCTIONS.values():
        _TRACED[key] = traced
    return traced
