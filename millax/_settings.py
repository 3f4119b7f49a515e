"""Numerical settings: how the model is computed, never what it is."""

import dataclasses
import math
import warnings

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ._check import not_negative, positive
from ._cut import Cut
from ._forces import ForceLaw
from ._gain import COMPILED, DISPATCHED, SPARE, TOLERANCE, gain_kernel, sweeps_needed
from ._runtime import loops_are_compiled
from ._structure import Structure, free_rates
from ._tool import EndMill
from ._types import Scalar, as_number
from .robot import Arm, at_tool

MOST_STEPS = 10**8
"""Longest trace: some 10 GB."""

STEPS, STEPS_WITH_RUNOUT = 40, 64
"""Time steps per tooth period with which the force is within 0.1 % of exact tooth paths (`make validate`)."""

STEPS_PER_MODE = 8
"""Fewest time steps per period of the fastest mode."""

MANY = 3
"""Passes remembered of a tool with equal teeth: enough for strong chatter."""

STEPS_PER_SLICE = 2
"""Most time steps by which a tooth may lag behind from one slice to the next."""


class Settings(eqx.Module):
    """How long and how finely to simulate.

    **Arguments** (all static but `width`):

    - `periods`: tooth periods simulated, >= 1. The trace has periods * steps_per_tooth samples.
    - `steps_per_tooth`: time steps per tooth period, >= 10. The scheme is second order; at 40 the force error of equal teeth
      is below 0.2 % in every step (`make validate`).
    - `passes`: earlier tooth passes remembered, >= 1. One is enough while no tooth loses contact, a turn of them where the
      teeth are not equal.
    - `blocks`: parts into which a tooth period is cut, a divisor of steps_per_tooth. Each is computed at once; none may be
      longer than the shortest pitch.
    - `sweeps`: most fixed-point sweeps per block, >= 1; a block takes as many as `tolerance` asks for, its derivatives take
      them all. `Settings.suited` chooses `blocks` and `sweeps`.
    - `slices`: axial slices into which a helical tool is cut, >= 1. In each it is straight-fluted.
    - `width`: half-width of the smoothed gates [m], >= 0; small against h_s and the feed per tooth. The bias of the mean
      force at the default is below 0.3 % (`make validate`); 0 is the hard model.
    - `tolerance`: error of the force that the sweeps may leave in a block, over the largest force so far [-], > 0. It is
      estimated from what they change; the largest estimate is the residual of every result. In float32 not below 4e-6.
    """

    periods: int = eqx.field(static=True)
    steps_per_tooth: int = eqx.field(static=True, default=STEPS)
    passes: int = eqx.field(static=True, default=3)
    blocks: int = eqx.field(static=True, default=1)
    sweeps: int = eqx.field(static=True, default=4)
    slices: int = eqx.field(static=True, default=1)
    width: Scalar = eqx.field(converter=as_number, default=1e-6)
    tolerance: Scalar = eqx.field(converter=as_number, default=TOLERANCE)

    def __check_init__(self):
        for name in ("periods", "steps_per_tooth", "passes", "blocks", "sweeps", "slices"):
            value, least = getattr(self, name), 10 if name == "steps_per_tooth" else 1
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise ValueError(f"simulation.{name}: {value!r} given; it must be a whole number of at least {least}")
        if self.steps_per_tooth % self.blocks:
            raise ValueError(
                f"simulation.blocks: {self.blocks} given; it must divide steps_per_tooth ({self.steps_per_tooth})"
            )
        not_negative("simulation.width", self.width, "m")
        positive("simulation.tolerance", self.tolerance, "")

    @property
    def steps(self) -> int:
        """Number of samples of every trace."""
        return self.periods * self.steps_per_tooth

    @staticmethod
    def suited(
        tool: EndMill,
        force: ForceLaw,
        structure: Structure | Arm,
        cut: Cut,
        duration,
        steps_per_tooth: int | None = None,
        passes: int | None = None,
        width=1e-6,
        blocks: int | None = None,
        sweeps: int | None = None,
        tolerance=TOLERANCE,
        slices: int | None = None,
    ) -> "Settings":
        """Settings for a simulation of at least `duration` [s], in whole tooth periods.

        `blocks` and `sweeps` are chosen from the gain of the iteration force -> displacement -> force unless given, `slices`
        from the helix and the depth. `steps_per_tooth` is 40, but 64 where the radii of the teeth differ: of the passes that
        vie for a tooth each step takes one. `passes` is 3, but at least a turn where the teeth are not equal. It needs
        concrete numbers: call it outside `jit`. Raises `ValueError` where the steps cannot resolve the fastest mode of the
        structure, or the slices not the helix. Warns of a runout beyond the feed per tooth.
        """
        positive("simulation.duration", duration, "s")
        if steps_per_tooth is None:
            steps_per_tooth = STEPS if tool.equal_radii else STEPS_WITH_RUNOUT
        period = float(cut.tooth_period(tool))
        periods = math.ceil(float(duration) / period * (1 - 1e-12))
        if periods * steps_per_tooth > MOST_STEPS:
            raise ValueError(
                f"simulation.duration: {float(duration):g} s given; its {periods * steps_per_tooth:.2g} time steps are more "
                f"than the {MOST_STEPS:.0e} that one trace can hold. Simulate a shorter cut"
            )
        settings = Settings(
            periods=periods,
            steps_per_tooth=steps_per_tooth,
            passes=(MANY if tool.equal_teeth else max(MANY, tool.teeth)) if passes is None else passes,
            slices=_slices(tool, cut, steps_per_tooth, slices),
            width=width,
            tolerance=tolerance,
        )
        _warn_of_runout(tool, cut)
        structure = at_tool(structure)
        matrices = structure.mass_matrix, structure.damping_matrix, structure.stiffness_matrix
        require_resolved(float(fastest_rate(*matrices)), period, steps_per_tooth)
        if blocks is None or sweeps is None:
            blocks, sweeps = _cheapest(tool, force, structure, cut, settings, blocks, sweeps)
        return dataclasses.replace(settings, blocks=blocks, sweeps=sweeps)


def fastest_rate(mass, damping, stiffness) -> np.ndarray:
    """Largest modulus of the eigenvalues of M q'' + C q' + K q = 0 [1/s], 0 for a rigid tool. Leading axes are a batch."""
    if np.shape(mass)[-1] == 0:
        return np.zeros(np.shape(mass)[:-2])
    return np.abs(np.linalg.eigvals(free_rates(mass, damping, stiffness))).max(axis=-1)


def require_resolved(fastest: float, period: float, steps_per_tooth: int) -> None:
    """Raises `ValueError` where the steps of a tooth period [s] cannot resolve a mode of this rate [1/s]."""
    needed = math.ceil(STEPS_PER_MODE * fastest * period / (2 * math.pi))
    if steps_per_tooth < needed:
        raise ValueError(
            f"simulation.steps_per_tooth: {steps_per_tooth} given; the fastest mode of the structure "
            f"({fastest / (2 * math.pi):.4g} Hz) needs at least {needed} ({STEPS_PER_MODE} steps per period of that mode)"
        )


def steps_of_lag(tool: EndMill, cut: Cut, steps_per_tooth: int) -> Scalar:
    """By how many time steps a tooth lags behind its tip at the depth of cut."""
    return tool.lag(cut.depth) * (tool.teeth * steps_per_tooth / (2 * math.pi))


def _slices(tool: EndMill, cut: Cut, steps_per_tooth: int, slices: int | None) -> int:
    """Slices that resolve the helix: with L steps of lag over the whole depth, sqrt(L/0.04) leave less than 0.1 % of the
    force (`make validate`), and no slice may lag by more than a step. Raises `ValueError` where those given are too few."""
    lag = float(steps_of_lag(tool, cut, steps_per_tooth))
    if slices is None:
        return max(1, math.ceil(math.sqrt(lag / 0.04)), math.ceil(lag))
    if lag > STEPS_PER_SLICE * slices:
        raise ValueError(
            f"simulation.slices: {slices} given; over the depth the helix wraps by {lag:.3g} time steps, and a slice may "
            f"lag by {STEPS_PER_SLICE} at most. Give {math.ceil(lag / STEPS_PER_SLICE)} or more, or fewer steps per tooth"
        )
    return slices


def _warn_of_runout(tool: EndMill, cut: Cut) -> None:
    deviation = tool.deviation(jnp.zeros(1))
    if deviation is None:
        return
    spread, feed = float(np.ptp(np.asarray(deviation))), float(cut.feed_per_tooth(tool))
    if spread > feed:
        warnings.warn(
            f"tool: its teeth differ in radius by {1e6 * spread:.3g} µm, more than the feed per tooth, {1e6 * feed:.3g} µm: "
            "some teeth may never cut, and the others take their share",
            stacklevel=3,
        )


def _cheapest(tool, force, structure, cut, settings, blocks, sweeps) -> tuple[int, int]:
    """Blocks per tooth period and sweeps per block that converge at the least cost."""
    options = block_options(settings.steps_per_tooth, float(tool.shortest))
    if blocks is not None and blocks < options[0]:
        raise ValueError(
            f"simulation.blocks: {blocks} given; the shortest pitch of tool.pitch is {float(tool.shortest):.3g} of the mean "
            f"one, and a block must not be longer. Give {options[0]} or more"
        )
    options = np.array([blocks] if blocks else options)
    if structure.coordinates == 0:
        return int(options[0]), sweeps or 1
    kernel = np.asarray(gain_kernel(tool, force, structure, cut, settings.width, settings.steps_per_tooth))
    needed = sweeps_needed(kernel[None], options, float(settings.tolerance))[0]
    cost = COMPILED if loops_are_compiled() else DISPATCHED
    best = int(np.argmin(cost(settings.steps_per_tooth, options, needed)))
    return int(options[best]), sweeps or int(needed[best]) + SPARE


def block_options(steps_per_tooth: int, shortest: float = 1.0) -> list[int]:
    """Numbers of blocks into which a tooth period may be cut: none is longer than the shortest pitch, in parts of the mean
    one. Raises `ValueError` where there is none."""
    options = [parts for parts in range(1, 17) if steps_per_tooth % parts == 0 and parts * shortest > 1 - 1e-9]
    if not options:
        raise ValueError(
            f"tool.pitch: the shortest pitch is {shortest:.3g} of the mean one; tooth periods are cut into at most 16 "
            f"blocks, which must divide simulation.steps_per_tooth ({steps_per_tooth}), and none be longer than a pitch. "
            "Give another number of steps, such as 48, or a longer pitch"
        )
    return options
