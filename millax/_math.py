"""Smooth gates and step averages: the only places where the model has a kink.

A gate has one half-width ``w``. It equals its hard counterpart outside ``[-w, w]`` and is a quadratic inside, so it is
continuously differentiable; its largest bias is ``w / 4``, at the kink itself, and its mean bias over a crossing is
second order in ``w``. The same quadratic is the exact mean of the hard gate over an interval of half-length ``w``: the
model uses one formula to smooth in space and to average over a time step.

At ``w = 0`` the gates are the hard functions; the derivative at the kink is then the mean of those on its two sides.
"""

import math

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

_TINY = 1e-30


def positive_part(x: Float[Array, "..."], width: Float[Array, "..."]) -> Float[Array, "..."]:
    """max(x, 0), blended: (x + w)²/(4 w) for abs(x) < w, exactly 0 below and exactly x above."""
    inside = jnp.clip(x, -width, width)
    return (inside + width) ** 2 / (4.0 * width + _TINY) + jnp.maximum(x - width, 0.0)


def minimum(a: Float[Array, "..."], b: Float[Array, "..."], width: Float[Array, "..."]) -> Float[Array, "..."]:
    """min(a, b), blended: differs from the hard minimum only where abs(a - b) < w, by at most w/4 and downwards."""
    return a - positive_part(a - b, width)


def half_change(rate: Float[Array, "..."], step: float, width: Float[Array, "..."]) -> Float[Array, "..."]:
    """Half of what a quantity changes by in a step of the tooth angle, widened to `width`: a mean over both."""
    return jnp.sqrt(width**2 + (rate * step / 2) ** 2 + _TINY)


def preferred(
    a: Float[Array, "..."], b: Float[Array, "..."], width: Float[Array, "..."]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """1 where a > b and b is to be taken as the smaller, 0 where a < b; smooth where they differ by less than w/4. And its
    derivative by a."""
    scale = 2 / (width + 1e-15)
    t = jnp.clip((a - b) * scale + 0.5, 0.0, 1.0)
    return t * t * (3 - 2 * t), 6 * t * (1 - t) * scale


def stored(condition: Bool[Array, ""], function, *inputs):
    """What `function` makes of the inputs where the condition holds; zeros where it does not.

    What comes out of a condition is stored. Elsewhere XLA on a processor computes a value anew in each of the kernels that
    use it, and in long chains, above all in derivatives, most of the time goes there.
    """

    def nothing(*_):
        return jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(function, *inputs))

    return lax.cond(condition, function, nothing, *inputs)


def summed(x: Float[Array, "*n m"]) -> Float[Array, "*m"]:
    """Sum over the axis before the last, written out: a sum over an axis XLA does not compute in vectors."""
    parts = [x[..., i, :] for i in range(x.shape[-2])]
    return sum(parts[1:], parts[0])


_LAYOUT = {jnp.dtype("float64"): (jnp.int64, 52), jnp.dtype("float32"): (jnp.int32, 23)}
"""Integers of the same size, and how many of their bits hold the mantissa."""


@jax.custom_jvp
def log1p(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """ln(1 + x) for x > -1, to a few units in the last place.

    y = 1 + x = 2^e m with m in [sqrt(1/2), sqrt(2)), and ln m = 2 artanh((m - 1)/(m + 1)) as a series; what the sum 1 + x
    loses by rounding is put back. Plain arithmetic, of which a compiler makes vector instructions: XLA's own logarithm on a
    processor is several times slower, and would be most of a simulation.
    """
    x = jnp.asarray(x)
    y = 1 + x
    integer, digits = _LAYOUT[jnp.dtype(y.dtype)]
    bits = lax.bitcast_convert_type(y, integer)
    root = lax.bitcast_convert_type(jnp.asarray(math.sqrt(0.5), y.dtype), integer)
    exponent = (bits - root) >> digits
    m = lax.bitcast_convert_type(bits - (exponent << digits), y.dtype)
    s = (m - 1) / (m + 1)
    square = s * s  # at most 0.0295: the first term left out is 1e-17 of the sum
    series = jnp.zeros_like(s)
    for k in range(21, 1, -2):
        series = square * (series + 1 / k)
    lost = (x - (y - 1)) / y
    return exponent.astype(y.dtype) * math.log(2) + (2 * s * (1 + series) + lost)


@log1p.defjvp
def _log1p_jvp(primals, tangents):
    (x,), (dx,) = primals, tangents
    return log1p(x), dx / (1 + x)
