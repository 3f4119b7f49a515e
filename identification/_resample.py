"""The model at the sample times of a trace, whose clock is another one: band-limited, and differentiable by the times.

The value at a position p, counted in steps of the model, is sum_j h(p - j) v_j with a kernel h that keeps a band of
frequencies and removes what a trace sampled at its rate cannot hold: a sinc under a Kaiser window (Oppenheim and Schafer,
Discrete-Time Signal Processing). Means over the steps, which is what the engine gives, are first made the values at their
middle: a tone of f cycles per step has lost sinc(f) = sin(pi f) / (pi f) in the mean, and a short sum of cosines undoes it.

Between two neighbouring samples of the model every weight is a polynomial of the position (Farrow 1988). So the values are
multiplied by the coefficients of these polynomials once, where the model has its samples, and a sample of the trace takes
one row of the result: products of matrices instead of one gathered window per sample.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial import chebyshev

PASSBAND = 0.8
"""Of the lower of the two Nyquist frequencies: tones up to there are right to `RIPPLE`."""

RIPPLE = 1e-4
"""What is wrong of a tone within the pass band at most, and what is left of one in the stop band (80 dB)."""

Kernel = Float[np.ndarray, "coefficients taps"]
"""Coefficients of the powers of 2 u - 1, for a position u between two samples, of the weights of the samples around them."""


def kernel(cutoff: float, averaged: bool = True) -> Kernel:
    """The kernel that reads the model for a trace with its Nyquist frequency at `cutoff`.

    **Arguments:**

    - `cutoff`: half the sampling rate of the trace times the step of the model [-], > 0; 0.5 where both have the same rate.
    - `averaged`: whether the values are means over the steps, and those at the times are wanted. If not, nothing is undone.

    It passes tones up to 0.8 of `cutoff`, or of 0.5, the model's own Nyquist frequency, where that is lower. The stop band
    begins at `cutoff`, or at 0.6 at the latest: images of the pass band lie beyond. Between 0.8 and 1 of the Nyquist
    frequency of the model a tone is attenuated and, unless the trace's lies there too, followed by its image. The kernel has
    52 taps, 80 where the rates are the same, and about 30 / `cutoff` where the trace is coarser.

    Raises `ValueError` for a cutoff that is not a number greater than 0.
    """
    if not 0 < cutoff < np.inf:
        raise ValueError(f"cutoff: {cutoff:g} given; it must be greater than 0")
    low = PASSBAND * min(cutoff, 0.5)
    high = min(cutoff, 1 - low)
    attenuation = -20 * np.log10(RIPPLE) + 10  # ripples add, and are raised where the mean is undone
    shape = 0.1102 * (attenuation - 8.7)  # Kaiser's rules for the window's shape and length
    half = int(np.ceil((attenuation - 8) / (4 * np.pi * 2.285 * (high - low)))) + 1
    cosines = _undone_mean(low) if averaged else np.ones(1)
    reach = half + len(cosines) - 1
    taps = np.arange(1 - reach, reach + 1)

    def windowed(x):
        # Less its value at the ends: the window falls to 0 there, and what is read has no jump.
        window = (np.i0(shape * np.sqrt(np.clip(1 - (x / half) ** 2, 0, None))) - 1) / (np.i0(shape) - 1)
        return (low + high) * np.sinc((low + high) * x) * window

    def weights(t):
        x = taps - (np.asarray(t)[:, None] + 1) / 2
        return sum(c * (windowed(x - lag) + windowed(x + lag)) / 2 for lag, c in enumerate(cosines))

    between = np.linspace(-1, 1, 41)
    degree = 1
    while True:
        degree += 1
        nodes = chebyshev.chebpts1(degree + 1)
        series = chebyshev.chebfit(nodes, weights(nodes), degree)
        if np.abs(chebyshev.chebval(between, series).T - weights(between)).max() < RIPPLE / 100:
            return np.stack([chebyshev.cheb2poly(column) for column in series.T], axis=1)


@jax.jit
def resample(
    values: Float[Array, "channels steps"], position: Float[Array, " samples"], kernel: Kernel
) -> Float[Array, "channels samples"]:
    """The values at these positions.

    **Arguments:**

    - `values`: of the model, evenly spaced, at least two.
    - `position`: (t - t_0) / dt [-], where sample j of the model is at t_0 + j dt: real numbers in any order, from which
      derivatives by the times, by the start and by the rate of a clock follow.
    - `kernel`: of `kernel`.

    Before its first and after its last sample the model is continued by that sample. Half the taps of the kernel at each
    end are affected. Beyond the ends there is no derivative by the position.
    """
    channels, steps = values.shape
    coefficients, taps = kernel.shape
    position = jnp.clip(position, 0, steps - 1)
    before = jnp.minimum(jnp.floor(position), steps - 2).astype(int)
    t = 2 * (position - before) - 1
    # In blocks as long as the kernel, each of which needs itself and the next one.
    blocks = -(-steps // taps)
    missing = (blocks + 1) * taps - steps - (taps // 2 - 1)
    padded = jnp.pad(values, ((0, 0), (taps // 2 - 1, missing)), mode="edge").reshape(channels, blocks + 1, taps)
    lag = np.arange(2 * taps)[:, None] - np.arange(taps)
    inside = (lag >= 0) & (lag < taps)
    spread = jnp.where(inside[..., None], jnp.asarray(kernel).T[np.clip(lag, 0, taps - 1)], 0.0)
    windows = jnp.concatenate([padded[:, :-1], padded[:, 1:]], axis=-1).reshape(channels * blocks, 2 * taps)
    polynomials = (windows @ spread.reshape(2 * taps, -1)).reshape(channels, blocks * taps, coefficients)[:, before]
    result = polynomials[..., -1]
    for power in range(coefficients - 2, -1, -1):
        result = result * t + polynomials[..., power]
    return result


def _undone_mean(band: float) -> Float[np.ndarray, " n"]:
    """c with sum_k c_k cos(2 pi k f) = 1 / sinc(f) for f up to `band`, to a fifth of `RIPPLE`."""
    f = band * (1 + chebyshev.chebpts2(100)) / 2
    n = 0
    while True:
        n += 1
        cosines = np.cos(2 * np.pi * f[:, None] * np.arange(n))
        found = np.linalg.lstsq(cosines, 1 / np.sinc(f))[0]
        if np.abs(cosines @ found - 1 / np.sinc(f)).max() < RIPPLE / 5:
            return found
