"""From the tables [sensor] and [clock] of a case file to what measured a trace."""

from collections.abc import Mapping
from typing import Any

from ._clock import Clock
from ._sensor import LowPass, Resonances, Sensor


def sensor_of(sensor: Mapping[str, Any], resonances: Mapping[str, Any], low_pass: Mapping[str, Any]) -> Sensor | None:
    """From the tables [sensor], [sensor.resonances] and [sensor.low_pass]; None where the file has none of them."""
    if not (sensor or resonances or low_pass):
        return None
    return Sensor(
        **sensor,
        resonances=_resonances(**resonances) if resonances else None,
        low_pass=LowPass(**low_pass) if low_pass else None,
    )


def _resonances(frequency, damping_ratio, axes=None, residue=None) -> Resonances:
    if len(frequency) != len(damping_ratio):
        raise ValueError(
            f"sensor.resonances: {len(frequency)} frequencies and {len(damping_ratio)} damping ratios given; give one of "
            "each per resonance"
        )
    if residue is not None:
        return Resonances(frequency, damping_ratio, residue)
    assert axes is not None  # one of the two is given
    if len(axes) != len(frequency):
        raise ValueError(f"sensor.resonances.axes: {len(axes)} given for {len(frequency)} resonances; give one for each")
    return Resonances.per_axis(frequency, damping_ratio, axes)


def clock_of(clock: Mapping[str, Any]) -> Clock | None:
    """From the table [clock]; None where the file has none."""
    return Clock(**clock) if clock else None
