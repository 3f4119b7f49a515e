"""How every member of a sweep is simulated: for how long, in how many blocks, with how many sweeps.

Members of one `Group` share a compiled program. It is long enough for each of them; what a member is simulated for
beyond its own duration is forgotten, so that its result does not depend on which others are in the group.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Float, Int

from ._case import Case
from ._gain import IN_BATCH, SPARE, gain_kernel, sweeps_needed
from ._members import SPINDLE_SPEED, Members, member
from ._settings import MOST_STEPS, block_options, fastest_rate, require_resolved
from .robot._arm import NO_EQUILIBRIUM

LADDER = 1.1
"""Largest ratio of the lengths of simulation that are in one group from the start."""

COMPILING = 3.0
"""Seconds that one more program costs; against it stands what its members save."""

PIECE = 64
"""Members planned at once."""


class Group(NamedTuple):
    """What is static in a program."""

    periods: int
    blocks: int
    sweeps: int

    def settle(self, case: Case) -> Case:
        """`case` with these settings."""
        return case.with_settings(**self._asdict())


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """How the members are simulated.

    - `periods`: tooth periods of every member.
    - `groups`: the members of every group, by their numbers.
    """

    periods: Int[np.ndarray, " members"]
    groups: dict[Group, Int[np.ndarray, " n"]]


def plan(case: Case, members: Members) -> Plan:
    """Plan the simulation of `members`: each for the duration of `case`, in whole tooth periods.

    Raises `ValueError` where the time steps cannot resolve the fastest mode of a member, a trace would be too long, or the
    springs of a robot do not hold its loads.
    """
    tooth_period, shortest, kernel, *matrices = _features(case, members)
    steps = case.settings.steps_per_tooth
    if matrices and not (held := np.isfinite(np.stack(matrices)).all(axis=(0, 2, 3))).all():
        words = members.words(int(np.argmin(held)))
        raise ValueError(f"the member with {words}: {NO_EQUILIBRIUM}")
    fastest = fastest_rate(*matrices) if matrices else np.zeros(len(members))
    hardest = int(np.argmax(fastest * tooth_period))
    try:
        require_resolved(float(fastest[hardest]), float(tooth_period[hardest]), steps)
    except ValueError as error:
        raise ValueError(f"the member with {members.words(hardest)}: {error}") from None
    duration = case.settings.periods * float(case.cut.tooth_period(case.tool))
    periods = np.full(len(members), case.settings.periods)
    if SPINDLE_SPEED in members.names:
        periods = np.ceil(duration / tooth_period * (1 - 1e-12)).astype(int)
    if periods.max() * steps > MOST_STEPS:
        longest = int(np.argmax(periods))
        raise ValueError(
            f"the member with {members.words(longest)}: its {periods[longest] * steps:.2g} time steps are more than the "
            f"{MOST_STEPS:.0e} that one trace can hold. Simulate a shorter cut"
        )
    blocks = np.array(block_options(steps, float(shortest.min())))
    if case.at_tool.coordinates == 0:
        blocks, needed = blocks[:1], np.ones((len(members), 1), int)
    else:
        needed = sweeps_needed(kernel, blocks, float(case.settings.tolerance))
    return Plan(periods, _grouped(periods, blocks, needed, functools.partial(IN_BATCH, steps, blocks)))


def _features(case: Case, members: Members) -> list[np.ndarray]:
    """`_features_of` all members, in pieces of one size: then there is one program."""
    which = np.minimum(np.arange(math.ceil(len(members) / PIECE) * PIECE), len(members) - 1)
    pieces = [_features_of(case, members.names, jnp.asarray(members.table[part])) for part in which.reshape(-1, PIECE)]
    return [np.concatenate(column)[: len(members)] for column in zip(*pieces, strict=True)]


@eqx.filter_jit
def _features_of(case: Case, names: tuple[str, ...], table: Float[jax.Array, "n names"]):
    """Of every member: tooth period [s], shortest pitch, `gain_kernel`, and M, C and K, where the tool is not rigid."""

    def features(values):
        c = member(case, names, values)
        s = c.at_tool
        kernel = gain_kernel(c.tool, c.force, s, c.cut, c.settings.width, c.settings.steps_per_tooth)
        matrices = (s.mass_matrix, s.damping_matrix, s.stiffness_matrix) if s.coordinates else ()
        return c.cut.tooth_period(c.tool), jnp.asarray(c.tool.shortest, float), kernel, *matrices

    return lax.map(features, table, batch_size=32)


class _Part(NamedTuple):
    """Members that may share a program: the longest simulation and the most sweeps among them."""

    which: Int[np.ndarray, " n"]
    periods: int
    needed: Int[np.ndarray, " options"]


def _grouped(
    periods: Int[np.ndarray, " members"],
    blocks: Int[np.ndarray, " options"],
    needed: Int[np.ndarray, "members options"],
    cost: Callable,
) -> dict[Group, Int[np.ndarray, " n"]]:
    """As many programs as pay for their compilation. Every member gets at least the periods and the sweeps it needs."""
    rung = np.ceil(np.log(periods) / math.log(LADDER)).astype(int)
    kinds, kind = np.unique(np.stack([rung, np.argmin(cost(needed), axis=1)], axis=1), axis=0, return_inverse=True)
    parts = dict(enumerate(_part(np.flatnonzero(kind.ravel() == k), periods, needed) for k in range(len(kinds))))
    savings = {(i, j): _saving(parts[i], parts[j], cost) for i in parts for j in range(i)}
    while savings and max(savings.values()) > 0:
        i, j = max(savings, key=savings.__getitem__)
        merged = _merged(parts.pop(i), parts.pop(j))
        savings = {pair: s for pair, s in savings.items() if not {i, j} & set(pair)}
        new = max(i, *parts, 0) + 1
        savings |= {(new, k): _saving(merged, part, cost) for k, part in parts.items()}
        parts[new] = merged
    groups: dict[Group, Int[np.ndarray, " n"]] = {}
    for part in parts.values():
        best = int(np.argmin(cost(part.needed)))
        group = Group(part.periods, int(blocks[best]), int(part.needed[best]) + SPARE)
        groups[group] = np.sort(np.concatenate([groups[group], part.which]) if group in groups else part.which)
    return groups


def _part(which, periods, needed) -> _Part:
    return _Part(which, int(periods[which].max()), needed[which].max(axis=0))


def _merged(a: _Part, b: _Part) -> _Part:
    return _Part(np.concatenate([a.which, b.which]), max(a.periods, b.periods), np.maximum(a.needed, b.needed))


def _saving(a: _Part, b: _Part, cost: Callable) -> float:
    """Seconds saved by one program for both."""

    def seconds(part: _Part) -> float:
        return len(part.which) * part.periods * 1e-9 * float(cost(part.needed).min())

    return COMPILING + seconds(a) + seconds(b) - seconds(_merged(a, b))
