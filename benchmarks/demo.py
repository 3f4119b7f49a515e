"""The demo's slot as figures use it: forces and displacements at every step of a simulation, with noise."""

import numpy as np

import millax as mx
from identification import Trace

from .slot import slot

NOISE = {"Fx": 2.0, "Fy": 2.0, "x": 1e-6, "y": 1e-6}
"""Standard deviation by channel, SI."""


def cut(duration: float) -> mx.Case:
    """The slot with a stiffness and a damping ratio for each axis, so that each can be free."""
    return slot(stiffness=[3e5, 3e5], damping_ratio=[0.05, 0.05], duration=duration)


def recorded(case: mx.Case, seed: int | None, *, known: bool = True) -> Trace:
    """What would be recorded of it; without noise where there is no seed. `known`: whether the trace states its noise."""
    sim = mx.simulate(case)
    values = np.column_stack([sim.force[:, :2], sim.displacement])
    if seed is not None:
        values = values + np.array(list(NOISE.values())) * np.random.default_rng(seed).normal(size=values.shape)
    return Trace(np.asarray(sim.time), tuple(NOISE), values, NOISE if known else {}, name=f"seed {seed}")
