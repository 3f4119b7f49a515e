"""What a dynamometer and its amplifier make of the force on the tool: gain, bias, delay, resonances and a low-pass filter.

The force of a simulation is its mean over each step, and so is what is measured here. Of a force that is held over each step
the mean of the response is computed exactly. Holding it and taking the mean leave sinc² of a tone; the force
f[j] - (f[j+1] - 2 f[j] + f[j-1]) / 12 in place of f[j] makes up for it, to fourth order. A section of the chain (the
resonances, or two orders of a low-pass filter) is then right to 0.3 % for a tone with 10 steps per period, 0.02 % with 20.
Where the force jumps the error is second order in the step, as the simulation's.

Before t = 0 there is no force and the chain is at rest. What this start excites dies out as exp(-zeta w_n t); a trace that
begins inside the cut does not show it, and should be compared with later parts of the simulation.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ._check import finite, positive
from ._response import _exponential_minus_one
from ._types import AXES, Scalar, as_number

Traces = Float[Array, "steps 3"]
"""Along x, y and z of the workpiece frame, one row per time step."""


class Resonances(eqx.Module):
    """f + sum_m R_m (H_m - 1) f with H_m(s) = w_m² / (s² + 2 zeta_m w_m s + w_m²): a static force passes as it is.

    Modal superposition, with what modes beyond these would add taken as static. A resonance of each axis for itself is
    R_m = e_m e_m^T, see `per_axis`; a dynamometer whose axes are coupled has full matrices.

    **Arguments:**

    - `frequency`: natural frequencies w_m / (2 pi) [Hz], > 0, shape (m,). Above half the rate of the model's steps it
      cannot be told from a static gain; beyond twice that rate the recursion breaks down.
    - `damping_ratio`: zeta_m [-], > 0, up to 3, and smooth at 1, shape (m,).
    - `residue`: R_m [-], shape (m, 3, 3).

    Raises `ValueError` for other shapes, and numbers out of these ranges.
    """

    frequency: Float[Array, " m"] = eqx.field(converter=as_number)
    damping_ratio: Float[Array, " m"] = eqx.field(converter=as_number)
    residue: Float[Array, "m 3 3"] = eqx.field(converter=as_number)

    def __check_init__(self):
        m = self.frequency.shape[:1]
        for name, shape in (("frequency", m or (1,)), ("damping_ratio", m), ("residue", (*m, 3, 3))):
            value = getattr(self, name)
            if value.shape != shape:
                raise ValueError(f"sensor.resonances.{name}: shape {value.shape} given; it must be {shape}")
        positive("sensor.resonances.frequency", self.frequency, "Hz")
        positive("sensor.resonances.damping_ratio", self.damping_ratio, "")
        finite("sensor.resonances.residue", self.residue, "")

    @staticmethod
    def per_axis(frequency, damping_ratio, axes: Sequence[str] = AXES) -> "Resonances":
        """One resonance for each of `axes`, by itself; the others have none. Raises `ValueError` for other axes."""
        if not set(axes) <= set(AXES):
            raise ValueError(f"sensor.resonances: axes {list(axes)} given; they are x, y and z")
        along = np.eye(3)[[AXES.index(axis) for axis in axes]]
        return Resonances(frequency, damping_ratio, along[:, :, None] * along[:, None, :])

    def __call__(self, force: Traces, step: Scalar) -> Traces:
        """The measured force for the one on the tool [N], both means over time steps of length `step` [s]."""
        followed = _followed(force, self.frequency, _second_order(self.damping_ratio), self.residue, step)
        return force - force @ jnp.sum(self.residue, axis=0).T + followed


class LowPass(eqx.Module):
    """A Butterworth filter: |H(i w)|² = 1 / (1 + (w / w_c)^(2 n)), the same for all channels.

    Sections of second order with zeta_k = sin((2 k - 1) pi / (2 n)), k = 1 ... n // 2, one after the other, and where n is
    odd w_c / (s + w_c).

    **Arguments:**

    - `cutoff`: w_c / (2 pi) [Hz], > 0: where -3 dB are left. Below twice the rate of the model's steps, as of `Resonances`.
    - `order`: n, >= 1. Static.

    Raises `ValueError` for other numbers.
    """

    cutoff: Scalar = eqx.field(converter=as_number)
    order: int = eqx.field(static=True, default=2)

    def __check_init__(self):
        if self.cutoff.shape != ():
            raise ValueError(f"sensor.low_pass.cutoff: shape {self.cutoff.shape} given; it must be one number")
        positive("sensor.low_pass.cutoff", self.cutoff, "Hz")
        if isinstance(self.order, bool) or not isinstance(self.order, int) or self.order < 1:
            raise ValueError(f"sensor.low_pass.order: {self.order!r} given; it must be a whole number of at least 1")

    def __call__(self, force: Traces, step: Scalar) -> Traces:
        """As of `Resonances`."""
        ratios = np.sin((2 * np.arange(self.order // 2) + 1) * np.pi / (2 * self.order))
        sections = [_second_order(jnp.asarray([ratio])) for ratio in ratios]
        for rates in sections + [jnp.asarray(FIRST_ORDER)] * (self.order % 2):
            force = _followed(force, self.cutoff[None], rates, jnp.eye(3)[None], step)
        return force


class Sensor(eqx.Module):
    """measured(t) = bias + (low-pass ∘ gain ∘ resonances)(force)(t - delay).

    **Arguments:**

    - `gain`: static gain of each channel [-], negative where its sign is the other one, shape (3,).
    - `bias`: what each channel shows without a force [N], shape (3,).
    - `delay`: of all channels [s]. For a trace of forces alone it is the same as a later start of its clock.
    - `resonances`, `low_pass`: None where there are none.

    Raises `ValueError` for other shapes, and numbers that are not finite.
    """

    gain: Float[Array, " 3"] = eqx.field(converter=as_number, default=(1.0, 1.0, 1.0))
    bias: Float[Array, " 3"] = eqx.field(converter=as_number, default=(0.0, 0.0, 0.0))
    delay: Scalar = eqx.field(converter=as_number, default=0.0)
    resonances: Resonances | None = None
    low_pass: LowPass | None = None

    def __check_init__(self):
        for name, shape, unit in (("gain", (3,), ""), ("bias", (3,), "N"), ("delay", (), "s")):
            value = getattr(self, name)
            if value.shape != shape:
                raise ValueError(f"sensor.{name}: shape {value.shape} given; it must be {shape}")
            finite(f"sensor.{name}", value, unit)

    def __call__(self, force: Traces, step: Scalar) -> Traces:
        """What is measured [N] of the force on the tool [N], both means over time steps of length `step` [s]; all but the
        delay: what the trace shows at a time t, this has at t - delay."""
        if self.resonances is not None:
            force = self.resonances(force, step)
        if self.low_pass is not None:
            force = self.low_pass(force, step)
        return self.gain * force + self.bias


FIRST_ORDER = np.array([[[-1.0, 0.0, 1.0], [0.0, -1.0, 0.0]]])
"""Rates of (x, x' / w) by themselves and by the input u, in units of w, for x' = w (u - x)."""


def _second_order(ratio: Float[Array, " m"]) -> Float[Array, "m 2 3"]:
    """The same for x'' + 2 zeta w x' + w² x = w² u."""
    undamped = jnp.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 1.0]])
    return undamped + ratio[:, None, None] * jnp.array([[0.0, 0.0, 0.0], [0.0, -2.0, 0.0]])


@jax.jit
def _followed(force: Traces, frequency: Array, rates: Array, residue: Array, step: Scalar) -> Traces:
    """sum_m R_m x_m, where the sections x_m follow the force."""
    # The mean over a step under a force that is held is the value under one that goes on linearly from the middle of one
    # step to that of the next (first-order hold): van Loan's matrix of (x, x' / w, force, its change in a step).
    sections = jnp.pad(rates * (2 * jnp.pi * frequency * step)[:, None, None], ((0, 0), (0, 2), (0, 1)))
    hold = jax.vmap(_exponential_minus_one)(sections.at[:, 2, 3].set(1.0)) + jnp.eye(4)
    over, ramp = hold[:, :2, :2], hold[:, :2, 3]
    before = hold[:, :2, 2] - ramp

    def advance(carry, now):
        x, v, last = carry
        x, v = (
            over[:, i, :1] * x + over[:, i, 1:] * v + before[:, i, None] * last + ramp[:, i, None] * now for i in range(2)
        )
        return (x, v, now), jnp.sum(residue * x[:, None, :], axis=(0, 2))

    around = jnp.concatenate([force[:1], force, force[-1:]])
    rest = jnp.zeros((len(residue), 3))
    return lax.scan(advance, (rest, rest, jnp.zeros(3)), force - jnp.diff(around, 2, axis=0) / 12)[1]
