"""The uncut workpiece."""

from typing import Literal

import equinox as eqx
import jax.numpy as jnp
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
