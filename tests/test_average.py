"""The synchronous average: what of a trace repeats with every turn, and how fast the spindle truly turned."""

import numpy as np
import pytest
from cases import slot

from identification import Trace, TraceError, synchronous_average

CASE = slot()  # 10 000 rpm
SPEED, RATE, ERROR = 2 * np.pi * 10000 / 60, 10e3, 3e-4


def recorded(seconds: float, noise: float, seed: int = 0) -> Trace:
    """A trace of known lines by a spindle that turns too fast, with white noise."""
    time = 3.0 + np.arange(round(seconds * RATE)) / RATE
    return Trace(
        time, ("Fx", "Fy"), wave(time - 3.0, 1 + ERROR) + noise * np.random.default_rng(seed).normal(size=(len(time), 2))
    )


def wave(time: np.ndarray, faster: float) -> np.ndarray:
    angle = SPEED * faster * time[:, None]
    return 20.0 + np.hstack([50 * np.cos(angle + 0.3) + 80 * np.cos(4 * angle), 30 * np.sin(12 * angle)])


def test_the_average_is_what_repeats():
    found = synchronous_average(CASE, recorded(0.6, noise=10.0), turns=3)
    assert found.speed_error == pytest.approx(ERROR, abs=2e-6)
    assert found.trace.time[0] == pytest.approx(3.0)
    assert len(found.trace.time) == 180
    # By the clock of a spindle at its speed. 100 turns of noise, and 59 numbers of each channel from them.
    error = found.trace.values - wave(found.trace.time - 3.0, 1.0)
    assert np.sqrt((error**2).mean()) == pytest.approx(10.0 * np.sqrt(59 / 6000), rel=0.2)


def test_what_does_not_repeat_bounds_r2():
    found = synchronous_average(CASE, recorded(0.6, noise=10.0))
    left = 10.0 * np.sqrt(1 - 59 / 6000)
    power = {"Fx": (50**2 + 80**2) / 2, "Fy": 30**2 / 2}
    for channel in ("Fx", "Fy"):
        assert found.rest[channel] == pytest.approx(left, rel=0.03)
        assert found.r2[channel] == pytest.approx(1 - left**2 / (power[channel] + 100), abs=0.01)


def test_a_few_turns_are_no_average():
    with pytest.raises(TraceError, match=r"8\.33 turns of the spindle long; an average needs 10 at least"):
        synchronous_average(CASE, recorded(0.05, noise=0.0))
