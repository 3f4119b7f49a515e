"""The uncut workpiece."""

from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._check import concrete, finite
from ._tool import EndMill
from ._types import Scalar, as_number

Milling = Literal["up", "down"]

ROUNDING = 1e-6
"""Relative difference of an immersion from the diameter that is none: 2 cm and 20 mm differ in their last digit."""


class Stock(eqx.Module):
    """A convex region of the plane: the points p with normals[i] . p <= offsets[i] for every border i.

    Entry, exit, slot and partial radial immersion are all borders of this one region. No border at all is a workpiece
    without end, in which the tool has always been cutting.

    **Arguments:**

    - `normals`: outward unit normals of the borders, shape (borders, 2).
    - `offsets`: distance of each border from the origin along its normal [m], shape (borders,).
    """

    normals: Float[Array, "borders 2"] = eqx.field(converter=as_number)
    offsets: Float[Array, " borders"] = eqx.field(converter=as_number)

    def __check_init__(self):
        finite("stock.normals", self.normals, "")
        finite("stock.offsets", self.offsets, "m")
        if self.normals.shape != (*self.offsets.shape, 2) or self.offsets.ndim != 1:
            raise ValueError(
                f"stock: normals of shape {self.normals.shape} and offsets of shape {self.offsets.shape} given; "
                "they must be (borders, 2) and (borders,)"
            )

    @staticmethod
    def box(x=(0.0, None), y=(None, None)) -> "Stock":
        """A rectangle with sides along x and y [m]; None is no border on that side.

        The default is the papers' workpiece: everything beyond the border x = 0.
        """
        normals, offsets = [], []
        for axis, name, (low, high) in ((0, "x", x), (1, "y", y)):
            start, end = (None if side is None else concrete(side) for side in (low, high))
            if start is not None and end is not None and not start < end:
                raise ValueError(f"stock.{name}: from {start:g} m to {end:g} m given; the first must be the smaller")
            for sign, border in ((-1.0, low), (1.0, high)):
                if border is not None:
                    normals.append([sign if i == axis else 0.0 for i in range(2)])
                    offsets.append(sign * as_number(border))
        return Stock(
            jnp.array(normals, dtype=float).reshape(-1, 2),
            jnp.stack(offsets) if offsets else jnp.zeros(0),
        )

    @staticmethod
    def immersed(
        tool: EndMill, immersion: Scalar | float, milling: Milling | None = None, x=(0.0, None), axis_y: Scalar | float = 0.0
    ) -> "Stock":
        """The stock that a tool, fed along +x with its axis on y = y_0, meets with the radial immersion a_e:

            y <= y_0 - R + a_e    down-milling, at the right of the feed,
            y >= y_0 + R - a_e    up-milling, at the left.

        The other side has no border: the stock goes on beyond the tool, where the wall is left, and a tool that is pushed
        there cuts deeper. A full slot, a_e = D, has no border along the feed at all.

        **Arguments:**

        - `tool`: of diameter D = 2 R.
        - `immersion`: radial immersion a_e [m], 0 < a_e <= D.
        - `milling`: "up" or "down"; None for a full slot.
        - `x`: as in `box` [m].
        - `axis_y`: y_0 [m], `cut.start[1]`.

        Differentiable by diameter, immersion and y_0. A traced diameter or immersion is taken to be that of less than a full
        slot. Raises `ValueError` for an immersion out of its range, another `milling`, and none where it is needed.
        """
        given, diameter = concrete(as_number(immersion)), concrete(tool.diameter)
        if given is not None and diameter is not None:
            if not 0 < given <= diameter * (1 + ROUNDING):
                raise ValueError(
                    f"stock.immersion: {1e3 * given:g} mm given; it must be greater than 0 and at most tool.diameter, "
                    f"{1e3 * diameter:g} mm, which is a full slot"
                )
            if given >= diameter * (1 - ROUNDING):
                return Stock.box(x)
        inwards = tool.radius - immersion
        borders = {"up": (axis_y + inwards, None), "down": (None, axis_y - inwards)}
        if milling not in borders:
            raise ValueError(
                f"stock.milling: {'none' if milling is None else repr(milling)} given; with an immersion of less than "
                'tool.diameter it must be "up" (the stock is at the left of the feed) or "down" (at the right)'
            )
        return Stock.box(x, borders[milling])


def passage(stock: Stock, y: float, radius: float) -> tuple[float, float] | None:
    """From where to where the centre of a disc of radius R that moves along x at `y` is, while it overlaps the stock: two x
    [m], infinite where the stock does not end. None where it passes beside the stock: to touch it is not to overlap.

    At y + d the disc reaches w = sqrt(R² - d²) to either side of its centre, and the stock from l(d) to h(d): they overlap
    for l(d) - w < x < h(d) + w. The first end is convex in d and the other concave, so that the extremes are at a corner of
    the stock, where the disc touches a border (d = -R n_y), or at the ends of the range of d. Needs concrete numbers.
    """
    (nx, ny), offsets = np.asarray(stock.normals, dtype=float).T, np.asarray(stock.offsets, dtype=float)
    room = offsets - ny * y
    level = np.abs(nx) < 1e-12
    right, left = ((room / np.where(level, ny, 1.0))[level & (sign * ny > 0)] for sign in (-1, 1))
    lowest, highest = max([-radius, *right]), min([radius, *left])
    if not lowest < highest:
        return None
    nx, ny, room = nx[~level], ny[~level], room[~level]

    def ends(d):
        x = (room - ny * d[:, None]) / nx
        return np.max(x, axis=1, where=nx < 0, initial=-np.inf), np.min(x, axis=1, where=nx > 0, initial=np.inf)

    i, j = np.triu_indices(len(nx), 1)
    across = ny[i] * nx[j] - ny[j] * nx[i]
    meeting = np.abs(across) > 1e-12
    corners = (room[i] * nx[j] - room[j] * nx[i])[meeting] / across[meeting]
    places = np.unique(np.clip([lowest, highest, *(-radius * ny), *corners], lowest, highest))
    low, high = ends((places[:-1] + places[1:]) / 2)
    some = low < high
    if not some.any():
        return None
    d = np.concatenate([places[:-1][some], places[1:][some]])
    (low, high), w = ends(d), np.sqrt(np.maximum(radius**2 - d**2, 0.0))
    return float(np.min(low - w)), float(np.max(high + w))
