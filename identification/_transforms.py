"""From an unbounded coordinate to a parameter within its bounds.

A solver moves freely in y; the parameter v(y) never leaves its bounds. y = 0 is the guess, and a change of y by 1 is a
large but sensible change of v: a factor e, a good part of the range, or the size of the guess or of its prior.
"""

import abc
import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from millax._types import Scalar, as_number


class Transform(eqx.Module):
    """A smooth, strictly increasing map from the real line to the values that a parameter may take."""

    @abc.abstractmethod
    def __call__(self, y: Float[Array, ""]) -> Float[Array, ""]:
        """v(y)."""

    @abc.abstractmethod
    def inverse(self, v: Float[Array, ""]) -> Float[Array, ""]:
        """y(v), for a v strictly within the bounds."""


class Scaled(Transform):
    """No bounds: v = centre + scale y."""

    centre: Scalar = eqx.field(converter=as_number)
    scale: Scalar = eqx.field(converter=as_number)

    def __call__(self, y):
        return self.centre + self.scale * y

    def inverse(self, v):
        return (v - self.centre) / self.scale


class Above(Transform):
    """A lower bound: v = low + scale e^y; the logarithm where low = 0."""

    low: Scalar = eqx.field(converter=as_number)
    scale: Scalar = eqx.field(converter=as_number)

    def __call__(self, y):
        return self.low + self.scale * jnp.exp(y)

    def inverse(self, v):
        return jnp.log((v - self.low) / self.scale)


class Below(Transform):
    """An upper bound: v = high - scale e^-y."""

    high: Scalar = eqx.field(converter=as_number)
    scale: Scalar = eqx.field(converter=as_number)

    def __call__(self, y):
        return self.high - self.scale * jnp.exp(-y)

    def inverse(self, v):
        return -jnp.log((self.high - v) / self.scale)


class Between(Transform):
    """Two bounds: v = low + (high - low)/(1 + e^-(y + offset)), the logit."""

    low: Scalar = eqx.field(converter=as_number)
    high: Scalar = eqx.field(converter=as_number)
    offset: Scalar = eqx.field(converter=as_number)

    def __call__(self, y):
        return self.low + (self.high - self.low) * jax.nn.sigmoid(y + self.offset)

    def inverse(self, v):
        return jnp.log((v - self.low) / (self.high - v)) - self.offset


def transform_for(guess: float, low: float, high: float, spread: float = 0.0) -> Transform:
    """The transform for low < guess < high, either of which may be infinite; y = 0 is the guess. `spread` is the
    standard deviation of the prior, 0 where there is none."""
    if math.isinf(low) and math.isinf(high):
        return Scaled(guess, max(abs(guess), spread) or 1.0)
    if math.isinf(high):
        return Above(low, guess - low)
    if math.isinf(low):
        return Below(high, high - guess)
    return Between(low, high, math.log((guess - low) / (high - guess)))
