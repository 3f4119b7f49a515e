"""How strongly the force feels the displacement within a block, and how many sweeps that takes.

One sweep, force -> displacement -> force, multiplies the error of the force by at most kappa G: kappa is the force per
displacement of the teeth in contact (the secant of the law at the feed per tooth; thin chips are stiffer, but carry little
force), and G the response within the block. Both depend on the lag between two steps alone, so the gain is a kernel, the
first column of a lower triangular Toeplitz matrix. Its powers fall faster than geometrically.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ._cut import Cut
from ._forces import ForceLaw
from ._response import response_to_one_step
from ._structure import Structure
from ._tool import EndMill
from ._types import Scalar

TOLERANCE = 1e-6
"""Error of the force that the sweeps may leave, over the largest force, unless the settings say otherwise."""

RERUNS = 2
"""How often a simulation whose sweeps have not converged is repeated, each time with twice as many."""

FIRST_ERROR = 4e-3
"""Error of the first guess, the force one tooth period earlier, over the largest force. A few times what is found in slots
from 1 kg to 100 kg; where it is more, as in strong chatter, the residual says so, and sweeps are added."""

SPARE = 1
"""Sweeps that the settings allow beyond those expected. A block takes them only where it needs them."""

MOST_SWEEPS = 30


def reachable(tolerance, dtype):
    """The tolerance, or what this precision can reach."""
    return jnp.maximum(tolerance, 32 * float(jnp.finfo(dtype).eps))


@eqx.filter_jit
def gain_kernel(tool: EndMill, force: ForceLaw, structure: Structure, cut: Cut, width: Scalar, steps: int) -> Array:
    """The gain over the lag in steps [-], shape (steps,); `steps` is the number of steps per tooth period."""
    if structure.coordinates == 0:
        return jnp.zeros(steps)
    return gain_of(tool, force, cut, width, response_to_one_step(structure, cut.tooth_period(tool) / steps, steps))


def gain_of(tool: EndMill, force: ForceLaw, cut: Cut, width: Scalar, by_lag: Float[Array, "2 felt m"]) -> Float[Array, " m"]:
    """The gain over the lag in steps [-], from the position after a force in one step, and the velocity."""
    thickness = jnp.maximum(cut.feed_per_tooth(tool), width)
    in_contact = (tool.teeth + 1) // 2
    of_teeth = force.tangential(thickness) / thickness * jnp.sqrt(1 + force.kr**2)
    kappa = in_contact * cut.depth * jnp.max(of_teeth)

    def size(response):
        return jnp.linalg.norm(response.reshape(4, -1), axis=0)

    gain = kappa * size(by_lag[:, :2])
    if force.process_damping is None:
        return gain
    by_velocity = in_contact * cut.depth * jnp.max(force.process_damping) / (cut.spindle_speed * tool.radius)
    return gain + by_velocity * size(by_lag[:, 2:])


def sweeps_needed(
    kernel: Float[np.ndarray, "n steps"], blocks: Int[np.ndarray, " options"], tolerance: float
) -> Int[np.ndarray, "n options"]:
    """Sweeps until the error falls below the tolerance, for n simulations and numbers of blocks per tooth period."""
    n, steps = kernel.shape
    spectrum = np.fft.rfft(kernel, 2 * steps, axis=1)
    needed = np.ones((n, len(blocks)), dtype=int)
    power, largest = kernel, 1.0
    for _ in range(MOST_SWEEPS - 1):
        # The largest row sum over a block is the sum of the first coefficients.
        total = np.cumsum(power, axis=1)
        needed += FIRST_ERROR * total[:, steps // blocks - 1] > tolerance
        largest = max(largest, total.max())
        if FIRST_ERROR * total.max() * largest <= tolerance:  # a later sum is at most the product of two earlier ones
            break
        power = np.maximum(np.fft.irfft(spectrum * np.fft.rfft(power, 2 * steps, axis=1), axis=1)[:, :steps], 0.0)
    return needed


class Cost(NamedTuple):
    """What the blocks of a tooth period cost [ns], measured. Their steps go through the processor in vectors of `vector`.
    The response is a matrix as large as the square of the steps of a block."""

    vector: int
    block: float
    block_and_sweep: float
    step: float
    step_and_sweep: float
    square: float = 0.0
    square_and_sweep: float = 0.0

    def __call__(self, steps_per_tooth: int, blocks, sweeps):
        """Of a tooth period in so many blocks, each with so many sweeps."""
        steps = steps_per_tooth / blocks
        filled = np.ceil(steps / self.vector) * self.vector
        return blocks * (
            self.block
            + self.block_and_sweep * sweeps
            + filled * (self.step + self.step_and_sweep * sweeps)
            + steps**2 * (self.square + self.square_and_sweep * sweeps)
        )


DISPATCHED = Cost(1, 1000, 550, 20, 46)
"""One simulation, the kernels of which are dispatched one by one: what JAX does unless told otherwise."""

COMPILED = Cost(8, 90, 60, 20, 8, 0.1, 0.7)
"""One simulation after `millax.set_up`: a compiled loop."""

IN_BATCH = Cost(8, 60, 0, 17, 22, 1.0, 0.3)
"""A member of a batch; its matrices are its own."""
