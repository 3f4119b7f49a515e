"""What cuts that are yet to be made would tell: the derivatives of what they would be recorded with, all in one program."""

import dataclasses
import math
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from millax import STATUS, Case, simulate, spectral_radius
from millax._gain import RERUNS
from millax._members import SPINDLE_SPEED, Members, member
from millax._plan import Group, plan
from millax._steady import seen
from millax._sweep import available_memory

from ._compare import Comparison, compare
from ._evaluate import triangle
from ._parameters import FreeParameters
from ._traces import Trace

UNFIT = -1
"""The status of a candidate that is not simulated; its reason says why."""

BATCH = 8
"""Candidates computed at once, each as often as there are coordinates. Always so many, that one program serves any grid."""

TRACES = 30
"""Arrays as long as a trace that a simulation and the comparison with one need, about."""

LONG = 10**9
"""Tooth periods, more than any recording has: how many are needed is not known before it is checked."""


@dataclasses.dataclass(frozen=True)
class Told:
    """What each candidate tells.

    - `triangles`: factors of the Jacobian of each channel by the coordinates asked for; NaN where the status is not 0.
    - `status`: 0, a key of `millax.STATUS`, or `UNFIT`.
    - `reason`: in words, "" where the status is 0.
    """

    triangles: Float[np.ndarray, "members channels k k"]
    status: Int[np.ndarray, " members"]
    reason: tuple[str, ...]


def told(
    case: Case,
    members: Members,
    numbers: FreeParameters,
    place: int,
    which: tuple[int, ...],
    recording: Trace,
    progress: Callable[[int, int], None] | None,
) -> Told:
    """Simulate `members` of `case`, which is the one at `place` of the free `numbers`, at y = 0, and how what they would be
    recorded with changes with the coordinates `which`.

    A candidate is unfit where it cannot be simulated or recorded, and where it chatters: there derivatives grow with the
    vibration and promise what no cut would keep. All others share one program: the longest simulation, the most blocks and
    sweeps that any of them needs; and more sweeps, twice at most, where these do not converge.
    """
    guess = numbers.insert(case, jnp.zeros(len(numbers)), place)
    every = [member(guess, members.names, jnp.asarray(row)) for row in members.table]
    found = [_ready(one, recording) for one in every]
    settings, refused = _settings(guess, members, np.array([not isinstance(one, str) for one in found]))
    reason = [one if isinstance(one, str) else no for one, no in zip(found, refused, strict=True)]
    channels, k = len(recording.channels), len(which)
    triangles, status = np.full((len(members), channels, k, k), np.nan), np.full(len(members), UNFIT)
    fit = np.flatnonzero([not text for text in reason])
    ready = [one for one, text in zip(found, reason, strict=True) if not text and isinstance(one, Comparison)]
    if ready:
        kernels = _alike([one.kernel for one in ready])
        reach = 0 if kernels is None else kernels.shape[-1] // 2
        settled = settings._replace(periods=max(_periods(every[i], recording, reach) for i in fit)).settle(case)

        def run(settled: Case, part: np.ndarray) -> tuple[Array, Array]:
            table, kernel = jnp.asarray(members.table[fit[part]]), None if kernels is None else jnp.asarray(kernels[part])
            return _derivatives(settled, members.names, table, kernel, numbers, place, which, ready[0])

        batch = _batch(settled.settings.steps, k + 1)
        triangles[fit], status[fit] = _in_batches(run, settled, triangles[fit], batch, progress)
    for i in fit:
        reason[i] = "" if status[i] == 0 else STATUS[int(status[i])]
    return Told(triangles, status, tuple(reason))


def _ready(case: Case, recording: Trace) -> Comparison | str:
    """A candidate ready to be compared with its recording; or why not, in words."""
    try:
        # The speed is one number of many here: no sample is taken as it is.
        comparison = compare(recording, case.with_settings(periods=LONG), (SPINDLE_SPEED,))
        if seen(case) and float(case.cut.feed_rate) > 0:
            radius = float(spectral_radius(case))
            if not radius < 1:
                return f"it chatters: a small vibration grows {radius:.4g} times from one period of the cut to the next"
    except ValueError as error:
        return str(error).removeprefix(f"{recording.name}: ")
    return comparison


def _settings(case: Case, members: Members, use: np.ndarray) -> tuple[Group, list[str]]:
    """Blocks and sweeps that serve all members in `use`, and why one cannot be simulated, "" for those that can."""

    def planned(which: np.ndarray) -> Group | str:
        part = dataclasses.replace(members, table=members.table[which])
        try:
            groups = plan(case, part).groups
        except ValueError as error:
            return str(error).removeprefix(f"the member with {members.words(int(which[0]))}: ")
        return Group(*(max(column) for column in zip(*groups, strict=True)))

    reason = [""] * len(members)
    none = Group(case.settings.periods, case.settings.blocks, case.settings.sweeps)
    which = np.flatnonzero(use)
    together = planned(which) if len(which) else none
    if isinstance(together, str):
        for i in which:
            one = planned(np.array([i]))
            reason[i] = one if isinstance(one, str) else ""
        which = np.array([i for i in which if not reason[i]], dtype=int)
        together = planned(which) if len(which) else none
    assert not isinstance(together, str)
    return together, reason


def _alike(kernels: Sequence[np.ndarray | Array | None]) -> np.ndarray | None:
    """Kernels filled up with zeros to one shape; None where there are none, as in a case without instrument."""
    given = [np.asarray(kernel) for kernel in kernels if kernel is not None]
    if not given:
        return None
    powers, taps = np.max([kernel.shape for kernel in given], axis=0)

    def filled(kernel: np.ndarray) -> np.ndarray:
        side = (taps - kernel.shape[1]) // 2
        return np.pad(kernel, ((0, powers - kernel.shape[0]), (side, side)))

    return np.stack([filled(kernel) for kernel in given])


def _periods(case: Case, recording: Trace, reach: int) -> int:
    """Tooth periods that cover a recording."""
    end = recording.time[-1] if case.clock is None else float(case.clock(recording.time)[-1])
    step = float(case.cut.tooth_period(case.tool)) / case.settings.steps_per_tooth
    return math.ceil((end / step + 1 + reach) / case.settings.steps_per_tooth)


def _batch(steps: int, together: int) -> int:
    """Candidates computed at once, so many simulations each: the usual number, or fewer where memory is short."""
    memory, each = available_memory() / 2, 8.0 * TRACES * steps * together
    if each > memory:
        raise ValueError(
            f"duration: the {together} simulations of one cut, {steps} time steps each, do not fit into the memory that is "
            "free; record a shorter part"
        )
    return min(BATCH, int(memory / each))


def _in_batches(run, case: Case, found: np.ndarray, batch: int, progress) -> tuple[np.ndarray, np.ndarray]:
    """Triangles, in place of `found`, and status of all members, a batch at a time."""
    status = np.full(len(found), 1)
    for rerun in range(RERUNS + 1):
        again = np.flatnonzero(status == 1)
        for start in range(0, len(again), batch):
            # Filled up with its last member, so that one shape is compiled.
            part = again[np.minimum(np.arange(start, start + batch), len(again) - 1)]
            triangles, code = run(case.with_settings(sweeps=case.settings.sweeps * 2**rerun), part)
            finite = np.isfinite(triangles).all(axis=(1, 2, 3))
            found[part], status[part] = triangles, np.where(~finite & (np.asarray(code) <= 1), 3, code)
            if progress is not None:
                progress(min(start + batch, len(again)), len(again))
    found[status != 0] = np.nan
    return found, status


@eqx.filter_jit
def _derivatives(
    case: Case,
    names: tuple[str, ...],
    table: Float[Array, "batch names"],
    kernels: Float[Array, "batch coefficients taps"] | None,
    numbers: FreeParameters,
    place: int,
    which: tuple[int, ...],
    comparison: Comparison,
) -> tuple[Float[Array, "batch channels k k"], Int[Array, " batch"]]:
    """Triangular factors of the Jacobians of a batch of members, and their status."""

    def one(values, kernel):
        def model(y):
            changed = numbers.insert(member(case, names, values), y, place)
            sim = simulate(changed, throw=False)
            return dataclasses.replace(comparison, kernel=kernel).predict(sim, changed), sim.status

        def push(direction):
            _, change, status = jax.jvp(model, (jnp.zeros(len(numbers)),), (direction,), has_aux=True)
            return change, status

        changes, status = jax.vmap(push, out_axes=(0, None))(jnp.eye(len(numbers))[jnp.array(which)])
        return triangle(changes), status

    return jax.vmap(one)(table, kernels)
