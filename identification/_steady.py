"""Steady cutting: through which angles a tooth is engaged then, and how long it lasts."""

import math
from dataclasses import dataclass

import numpy as np

from millax import Case


@dataclass(frozen=True)
class Steady:
    """Where the borders of the stock along the feed alone decide when a tooth cuts.

    **Attributes:**

    - `low`, `high`: sin(phi) where a tooth begins and ends to be engaged, -1 and 1 in a slot. The sines, not the angles, so
      that what vanishes by symmetry is exactly 0.
    - `begin`, `end`: from when to when every border across the feed is out of reach of the engaged teeth [s], infinite
      where there is none.
    """

    low: float
    high: float
    begin: float
    end: float


def steady(case: Case) -> Steady:
    """The steady part of a cut. The tip at the angle phi has y = y_0 - R sin(phi), and is within a border y <= Y for
    sin(phi) >= (y_0 - Y)/R. Raises `ValueError` where there is none."""
    radius, feed = float(case.tool.radius), float(case.cut.feed_rate)
    if feed == 0:
        raise ValueError("cut.feed_rate: 0 m/s given; a tool that is not fed never cuts")
    x, y = np.asarray(case.cut.start, dtype=float)
    (nx, ny), offsets = np.asarray(case.stock.normals, dtype=float).T, np.asarray(case.stock.offsets, dtype=float)
    level = np.abs(nx) < 1e-12
    sines = (y - offsets[level] / ny[level]) / radius
    low, high = max([-1.0, *sines[ny[level] > 0]]), min([1.0, *sines[ny[level] < 0]])
    if not low < high:
        raise ValueError(f"stock: the tool, its centre at y = {y:.4g} m, passes beside it: no tooth is ever engaged")
    nx, ny, offsets = nx[~level], ny[~level], offsets[~level]
    # How far the engaged tips reach beyond the tool centre towards a border: R cos(phi - phi_N), most at phi = phi_N.
    first, last = math.asin(low), math.asin(high)
    phi = np.array([np.clip(np.arctan2(-ny, nx), first, last), np.full_like(nx, first), np.full_like(nx, last)])
    reach = radius * np.max(nx * np.cos(phi) - ny * np.sin(phi), axis=0)
    passed = ((offsets - ny * y - reach) / nx - x) / feed
    begin, end = max([-math.inf, *passed[nx < 0]]), min([math.inf, *passed[nx > 0]])
    if not begin < end:
        raise ValueError(
            "stock: so short along the feed that the tool is never in it from its first to its last engaged angle"
        )
    return Steady(float(low), float(high), float(begin), float(end))
