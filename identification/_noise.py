"""How what was measured scatters about the model: normal or with outliers, white or coloured.

The residuals r of a channel become numbers e that are independent, and of which a sum of squares is the likelihood:

    e = s f(L r / s),   -2 log p(r) = sum (e / s)² + const,

s being the scale of the channel's noise. L takes the correlation in time away, and f the weight of outliers:

- L is the whitening of an autoregressive process of order p, given by its reflection coefficients k_1 ... k_p: a lattice of
  forward and backward errors of prediction, f_m(t) = f_(m-1)(t) - k_m b_(m-1)(t-1), b_m(t) = b_(m-1)(t-1) - k_m f_(m-1)(t)
  (Makhoul 1977). The first p samples are predicted from those before them alone, so that it is exact.
- For Student's t with nu degrees of freedom f(z) = sign(z) sqrt((nu + 1) log(1 + z²/nu)); for normal noise f(z) = z.

So every solver, interval and sampler sees a problem of least squares, whatever the noise.
"""

from dataclasses import dataclass
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.integrate import quad
from scipy.stats import t as student_t

from millax._types import Scalar, as_number

HIGHEST_ORDER = 20
"""Of an autoregressive noise that is part of a fit."""

DISTRIBUTIONS = ("normal", "student")


@dataclass(frozen=True)
class NoiseModel:
    """What is known of the kind of noise; its size is estimated in every channel where a trace does not state it.

    **Arguments:**

    - `distribution`: "normal", or "student" where there are outliers: Student's t, under which a sample far off counts less
      the farther off it is. The size of the noise is then its scale, which outliers hardly change.
    - `degrees`: of freedom of Student's t, > 2: the fewer, the more outliers.
    - `order`: p of autoregressive noise, 0 to 20; its coefficients are estimated, for each channel of each trace. 0: white.
      Without it noise that is not white is recognised after a fit, and intervals are widened for it.

    Raises `ValueError` for anything else.
    """

    distribution: Literal["normal", "student"] = "normal"
    degrees: float = 4.0
    order: int = 0

    def __post_init__(self):
        if self.distribution not in DISTRIBUTIONS:
            raise ValueError(f'noise: distribution {self.distribution!r} given; it must be "normal" or "student"')
        if not (isinstance(self.degrees, int | float) and 2 < self.degrees < np.inf):
            raise ValueError(f"noise: degrees {self.degrees!r} given; it must be a number greater than 2, such as 4")
        if isinstance(self.order, bool) or not isinstance(self.order, int) or not 0 <= self.order <= HIGHEST_ORDER:
            raise ValueError(f"noise: order {self.order!r} given; it must be a whole number from 0 to {HIGHEST_ORDER}")

    @property
    def plain(self) -> bool:
        """Whether residuals need only be divided by the size of the noise."""
        return self.distribution == "normal" and self.order == 0

    def of(self, sigma: Float[np.ndarray, " channels"]) -> "Noise":
        """Noise of this kind and of this size; white, for as long as nothing is known of its colour."""
        degrees = self.degrees if self.distribution == "student" else None
        return Noise(sigma, np.zeros((len(sigma), self.order)), degrees)


class Noise(eqx.Module):
    """The noise of channels, in numbers.

    **Arguments:**

    - `sigma`: standard deviation, of Student's t the scale [SI], shape (channels,).
    - `reflection`: k of the autoregressive process, between -1 and 1, shape (channels, p).
    - `degrees`: nu; None for normal noise.
    """

    sigma: Float[Array, " channels"] = eqx.field(converter=as_number)
    reflection: Float[Array, "channels p"] = eqx.field(converter=as_number)
    degrees: Scalar | None = eqx.field(converter=lambda x: None if x is None else as_number(x), default=None)

    @property
    def order(self) -> int:
        return self.reflection.shape[1]

    def part(self, begin: int, end: int) -> "Noise":
        """That of some of the channels."""
        return Noise(self.sigma[begin:end], self.reflection[begin:end], self.degrees)

    def white(self, residuals: Float[Array, "channels samples"]) -> Float[Array, "channels samples"]:
        """L r: without correlation in time, of the same size."""
        forward = backward = residuals
        left, time = jnp.ones_like(residuals), np.arange(residuals.shape[1])
        for m in range(self.order):
            k = self.reflection[:, m, None]
            late = jnp.where(time > m, jnp.roll(backward, 1, axis=1), 0.0)
            forward, backward = forward - k * late, late - k * forward
            left = left * jnp.where(time > m, 1 - k**2, 1.0)
        return forward / jnp.sqrt(left)

    def independent(self, residuals: Float[Array, "channels samples"]) -> Float[Array, "channels samples"]:
        """e = s f(L r / s), of the residuals [SI]. Differentiable, at 0 too."""
        white = self.white(residuals)
        if self.degrees is None:
            return white
        scale = self.sigma[:, None]
        z = white / scale
        square = z**2 / self.degrees
        # log(1 + x)/x, which is 1 - x/2 where rounding would leave nothing of it.
        small = square < 1e-8
        ratio = jnp.where(small, 1 - square / 2, jnp.log1p(square) / jnp.where(small, 1.0, square))
        return scale * z * jnp.sqrt((1 + 1 / self.degrees) * ratio)

    @property
    def information(self) -> float:
        """The Fisher information of a residual, in units of 1/sigma², over the mean of f'²: what makes the square of the
        Jacobian of e the information. 1 for normal noise; of Student's t the information is (nu + 1)/(nu + 3)."""
        if self.degrees is None:
            return 1.0
        nu = float(self.degrees)

        def slope(z):
            x = z**2 / nu
            return (1 + 1 / nu) / ((1 + x) ** 2 * np.log1p(x) / x)  # f'(z)²

        mean = 2 * quad(lambda z: slope(z) * student_t.pdf(z, nu), 1e-9, np.inf)[0]
        return (nu + 1) / (nu + 3) / mean


def reflections(residuals: Float[np.ndarray, "channels samples"], order: int) -> Float[np.ndarray, "channels p"]:
    """Reflection coefficients of autoregressive noise, by Burg's method: each is the one with which the forward and the
    backward error of prediction are the smallest together, and so lies between -1 and 1."""
    forward, backward, found = residuals[:, 1:], residuals[:, :-1], []
    for _ in range(order):
        power = np.sum(forward**2 + backward**2, axis=1)
        k = 2 * np.sum(forward * backward, axis=1) / np.where(power > 0, power, 1.0)
        found.append(k)
        k = k[:, None]
        forward, backward = (forward - k * backward)[:, 1:], (backward - k * forward)[:, :-1]
    return np.stack(found, axis=1) if found else np.zeros((len(residuals), 0))


def predictor(reflection: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
    """a of r(t) = a_1 r(t-1) + ... + a_p r(t-p) + error, from the reflection coefficients (Levinson's recursion)."""
    a = np.zeros(0)
    for k in reflection:
        a = np.append(a - k * a[::-1], k)
    return a


def student_scale(white: Float[np.ndarray, " samples"], degrees: float, taken: float) -> float:
    """The scale s of Student's t that is most likely for these numbers, from which `taken` parameters were taken:
    sum w z² = samples - taken with z = white/s and w = (nu + 1)/(nu + z²)."""
    left = max(len(white) - taken, 1.0)
    square = white**2
    scale = np.median(np.abs(white)) / student_t.ppf(0.75, degrees) or np.sqrt(square.mean())
    for _ in range(200):
        if not scale > 0:
            return 0.0
        updated = np.sqrt(np.sum((degrees + 1) / (degrees + square / scale**2) * square) / left)
        if abs(updated / scale - 1) < 1e-9:
            break
        scale = updated
    return float(scale)
