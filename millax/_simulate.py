"""Stub to be replaced by the engine."""

import equinox as eqx
from jaxtyping import Array, Float, Int

from ._case import Case


class SimulationError(RuntimeError):
    """A simulation that must not be used; the message says why and what to try."""


class Simulation(eqx.Module):
    """Traces of one simulated cut. Sample j is at the middle of time step j."""

    time: Float[Array, " steps"]
    force: Float[Array, "steps 3"]
    displacement: Float[Array, "steps axes"]
    chip_thickness: Float[Array, "steps teeth"]
    residual: Float[Array, ""]
    status: Int[Array, ""]
    axes: tuple[str, ...] = eqx.field(static=True)


def simulate(case: Case, *, throw: bool = True) -> Simulation:
    raise NotImplementedError
