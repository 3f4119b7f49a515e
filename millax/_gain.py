"""How strongly the force feels the displacement within a block, and how many sweeps that takes.

One sweep, force -> displacement -> force, multiplies the error of the force by at most kappa G: kappa is the force per
displacement of the teeth in contact (the secant of the law at the feed per tooth; thin chips are stiffer, but carry little
force), and G the response within the block. Both depend on the lag between two steps alone, so the gain is a kernel, the
first column of a lower triangular Toeplitz matrix. Its powers fall faster than geometrically.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ._cut import Cut
from ._forces import ForceLaw
from ._response import block_response
from ._structure import Structure
from ._tool import EndMill
from ._types import Scalar

RESIDUAL_TOLERANCE = 1e-6
"""Largest residual of a simulation in float64 that counts as converged."""

RERUNS = 2
"""How often a simulation whose sweeps have not converged is repeated, each time with twice as many."""

FIRST_ERROR = 4e-3
"""Error of the first guess, the force one tooth period earlier, over the largest force. A few times what is found in slots
from 1 kg to 100 kg; where it is more, as in strong chatter, the residual says so, and sweeps are added."""

MOST_SWEEPS = 30


def tolerance(dtype) -> float:
    """Largest residual of a simulation in this precision that counts as converged."""
    return max(RESIDUAL_TOLERANCE, 32 * float(jnp.finfo(dtype).eps))


@eqx.filter_jit
def gain_kernel(tool: EndMill, force: ForceLaw, structure: Structure, cut: Cut, width: Scalar, steps: int) -> Array:
    """The gain over the lag in steps [-], shape (steps,); `steps` is the number of steps per tooth period."""
    if structure.coordinates == 0:
        return jnp.zeros(steps)
    thickness = jnp.maximum(cut.feed_per_tooth(tool), width)
    in_contact = (tool.teeth + 1) // 2
    kappa = in_contact * cut.depth * force.tangential(thickness) / thickness * jnp.sqrt(1 + force.kr**2)
    position = block_response(structure, cut.tooth_period(tool) / steps, steps).position
    by_lag = jnp.stack([position.by_x[0], position.by_y[0]]).reshape(4, steps)
    return kappa * jnp.linalg.norm(by_lag, axis=0)


def sweeps_needed(kernel: Float[np.ndarray, "n steps"], blocks: Int[np.ndarray, " options"]) -> Int[np.ndarray, "n options"]:
    """Sweeps until the error falls below the tolerance, for n simulations and numbers of blocks per tooth period.

    Two at least: what they change tells how fast the error falls.
    """
    n, steps = kernel.shape
    spectrum = np.fft.rfft(kernel, 2 * steps, axis=1)
    needed = np.ones((n, len(blocks)), dtype=int)
    power = kernel
    for _ in range(MOST_SWEEPS - 1):
        # The largest row sum over a block is the sum of the first coefficients.
        needed += FIRST_ERROR * np.cumsum(power, axis=1)[:, steps // blocks - 1] > RESIDUAL_TOLERANCE
        power = np.maximum(np.fft.irfft(spectrum * np.fft.rfft(power, 2 * steps, axis=1), axis=1)[:, :steps], 0.0)
    return np.maximum(needed, 2)


def cost(blocks, sweeps):
    """Seconds per tooth period of 40 steps, measured: what is the same in all blocks, and what grows with their length."""
    return 1e-6 * (blocks * (1.0 + 0.55 * sweeps) + 0.8 + 1.85 * sweeps)
