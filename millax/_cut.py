"""The commanded motion of the tool: what the operator sets."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._check import finite, not_negative, positive
from ._tool import EndMill
from ._types import Scalar, as_number


class Cut(eqx.Module):
    """Spindle speed, feed and depth of a straight cut along +x.

    The commanded tool centre is c_0(t) = start + v_f t (1, 0). One tooth points along the feed at t = 0.

    **Arguments:**

    - `spindle_speed`: Omega [rad/s], > 0.
    - `feed_rate`: v_f [m/s], >= 0.
    - `depth`: axial depth of cut a [m], > 0.
    - `start`: tool centre at t = 0 in the workpiece frame [m], shape (2,).
    """

    spindle_speed: Scalar = eqx.field(converter=as_number)
    feed_rate: Scalar = eqx.field(converter=as_number)
    depth: Scalar = eqx.field(converter=as_number)
    start: Float[Array, "2"] = eqx.field(converter=as_number)

    def __check_init__(self):
        positive("cut.spindle_speed", self.spindle_speed, "rad/s")
        not_negative("cut.feed_rate", self.feed_rate, "m/s")
        positive("cut.depth", self.depth, "m")
        finite("cut.start", self.start, "m")
        if self.start.shape != (2,):
            raise ValueError(f"cut.start: shape {self.start.shape} given; it is the tool centre (x, y), two numbers")

    @staticmethod
    def touching(tool: EndMill, spindle_speed, feed_rate, depth) -> "Cut":
        """A cut whose tool touches the border x = 0 at t = 0: start = (-R, 0), as in the papers."""
        return Cut(spindle_speed, feed_rate, depth, start=jnp.stack([-tool.radius, jnp.zeros(())]))

    def tooth_period(self, tool: EndMill) -> Scalar:
        """tau = 2 pi/(Omega N_z) [s]: the mean time between two teeth at the same angle."""
        return 2 * jnp.pi / (self.spindle_speed * tool.teeth)

    def feed_per_tooth(self, tool: EndMill) -> Scalar:
        """f_z = v_f tau [m], the mean of all teeth."""
        return self.feed_rate * self.tooth_period(tool)
