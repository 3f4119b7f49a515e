"""The uncut workpiece."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._check import concrete, finite
from ._types import as_number


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
