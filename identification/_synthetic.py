"""What an instrument would record of a cut."""

from collections.abc import Mapping, Sequence

import numpy as np

from millax import Case, simulate

from ._compare import compare
from ._traces import Trace


def synthetic_trace(
    case: Case,
    time: np.ndarray,
    channels: Sequence[str],
    noise: Mapping[str, float] | None = None,
    seed: int | None = None,
    name: str = "synthetic",
) -> Trace:
    """A trace of a simulation of `case`, through its sensor and by its clock, as a fit reads it: with the truth known.

    **Arguments:**

    - `time`: time stamps [s], even, shape (samples,).
    - `channels`: of Fx, Fy, Fz, x, y, z.
    - `noise`: standard deviation of white noise per channel [N], [m]; none where it is not named. The trace knows of it.
    - `seed`: of the noise, where there is any.

    Raises `TraceError` for channels that the case does not have and times that its simulation does not cover,
    `SimulationError` where the simulation fails, and `ValueError` for noise without a seed.
    """
    noise = dict(noise or {})
    if noise and seed is None:
        raise ValueError("seed: none given; noise needs one, so that the trace can be made again")
    blank = Trace(np.asarray(time), tuple(channels), np.ones((len(time), len(channels))), name=name)
    clean = np.asarray(compare(blank, case).predict(simulate(case), case)).T
    drawn = np.random.default_rng(seed).normal(size=clean.shape) * [noise.get(channel, 0.0) for channel in channels]
    return Trace(blank.time, blank.channels, clean + drawn, noise, name=name)
