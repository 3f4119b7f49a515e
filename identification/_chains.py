"""Chains of the No-U-Turn sampler (Hoffman and Gelman 2014) through the posterior of a fit.

The chains go through whitened coordinates z, y = y_hat + L z, y_hat being the optimum of the fit and L L^T its covariance:
where the posterior is nearly normal z is nearly of unit variance in all directions, and nothing but the length of a step is
left to be adapted.
"""

import functools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from blackjax import nuts
from blackjax.adaptation.step_size import DualAveragingAdaptationState, dual_averaging_adaptation
from blackjax.mcmc.hmc import HMCState
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from ._evaluate import Model, evaluate
from ._noise import Noise
from ._result import FitResult

BLOCK = 25
"""Draws of a chain between two looks at it."""

FIRST_STEP = 0.8
SPREAD = 2.0
"""Of the points at which chains begin, in standard errors."""


class Density(eqx.Module):
    """The logarithm of the posterior of z, up to a constant.

    - `sizes`: samples of each channel, and `estimated`: whether its noise was; of such the size sigma is integrated out with
      the prior 1/sigma: of the sum of squares S over n samples, -S/2 becomes -(n/2) log S.
    """

    model: Model
    noise: Noise
    centre: Float[Array, " n"]
    spread: Float[Array, "n n"]
    sizes: tuple[int, ...] = eqx.field(static=True)
    estimated: tuple[bool, ...] = eqx.field(static=True)

    @staticmethod
    def of(result: FitResult) -> "Density":
        """The posterior of a fit that reached its optimum."""
        # The scale of Student's t is part of its shape: there is no closed form.
        normal = result.noise.degrees is None
        return Density(
            result.asked.model,
            result.noise,
            jnp.asarray(result.y),
            jnp.asarray(np.linalg.cholesky(result.covariance)),
            tuple(int(n) for n in result.asked.samples),
            tuple(bool(unknown) and normal for unknown in np.isnan(result.asked.noise)),
        )

    def y(self, z: Float[Array, " n"]) -> Float[Array, " n"]:
        """The solver's coordinates."""
        return self.centre + self.spread @ z

    def total(self, squares: Float[Array, " channels"], y: Float[Array, " n"]) -> Array:
        """The logarithm, from the sum of squares of each channel over the noise that was fitted."""
        n, numbers = jnp.array(self.sizes, float), self.model.numbers
        given = jnp.where(jnp.array(self.estimated), n * jnp.log(squares / n), squares)
        # What is flat in a value is its slope in y; of a prior of the logarithm it is the logarithm that has the density.
        values = numbers.values(y)
        logarithms = [jnp.log(values[i]) for i, log in zip(numbers.known.of, numbers.known.log, strict=True) if log]
        return jnp.sum(jnp.log(numbers.slopes(y))) - sum(logarithms) - (jnp.sum(given) + jnp.sum(numbers.prior(y) ** 2)) / 2

    def log(self, z: Float[Array, " n"]) -> tuple[Array, Array]:
        """The logarithm, and whether the simulation may be used there."""
        errors, usable = self.model.errors(self.noise, self.y(z))
        parts = jnp.split(errors, np.cumsum(self.sizes))[:-1]  # the last are those of what was known before
        return self.total(jnp.stack([jnp.sum(part**2) for part in parts]), self.y(z)), usable

    def with_gradient(self, z: Float[Array, " n"]) -> tuple[Array, Float[Array, " n"]]:
        """The logarithm and its gradient; where the simulation may not be used, -inf and 0."""
        (value, usable), gradient = jax.value_and_grad(self.log, has_aux=True)(z)
        good = usable & jnp.isfinite(value) & jnp.isfinite(gradient).all()
        return jnp.where(good, value, -jnp.inf), jnp.where(good, gradient, 0.0)

    def __call__(self, z: Float[Array, " n"]) -> Array:
        """The logarithm. What JAX takes for its gradient is that of `with_gradient`: finite everywhere."""

        @jax.custom_vjp
        def value(z):
            return self.with_gradient(z)[0]

        value.defvjp(self.with_gradient, lambda gradient, change: (change * gradient,))
        return value(z)


class Chain(NamedTuple):
    """Where a chain is, its random numbers to come, and the length of its steps."""

    state: HMCState
    key: PRNGKeyArray
    steps: DualAveragingAdaptationState


class Draws(NamedTuple):
    """Of every draw: its point, whether its path diverged, whether that was where the simulation cannot be used, how many
    gradients it took, and the mean rate of acceptance along its path."""

    z: Float[Array, "draws n"]
    diverged: Bool[Array, " draws"]
    failed: Bool[Array, " draws"]
    gradients: Int[Array, " draws"]
    acceptance: Float[Array, " draws"]


def begin(density: Density, key: PRNGKeyArray) -> Chain:
    """A chain at a point drawn from twice the standard errors of the fit, or nearer to the optimum where the simulation may
    not be used there."""
    where, key = jax.random.split(key)
    z = SPREAD * jax.random.normal(where, density.centre.shape)
    while (start := at(density, z)) is None:
        z = z / 2
    first, _, _ = dual_averaging_adaptation(0.0)
    steps = jax.tree.map(lambda x: jnp.asarray(x, jnp.result_type(x)), first(FIRST_STEP))
    return Chain(start, key, steps)


def at(density: Density, z: Float[Array, " n"]) -> HMCState | None:
    """A point with its logarithm and gradient, by the program that the fit has compiled; None where the simulation may not
    be used."""
    found = evaluate(density.model, density.noise, density.y(z))
    state, finite = _state(density, z, found.triangles)
    return state if int(found.status) == 0 and found.covered and finite else None


@eqx.filter_jit
def _state(density: Density, z: Float[Array, " n"], triangles: Float[Array, "channels n+1 n+1"]) -> tuple[HMCState, Array]:
    """From the triangular factors of residuals and Jacobian; and whether all of it is finite."""
    weight = density.noise.sigma[:, None, None] ** -2
    jacobian, errors = triangles[:, :, :-1], triangles[:, :, -1:]
    squares, slopes = jnp.sum(weight * errors**2, axis=(1, 2)), jnp.sum(2 * weight * errors * jacobian, axis=1)
    value, (by_squares, by_y) = jax.value_and_grad(density.total, (0, 1))(squares, density.y(z))
    gradient = density.spread.T @ (by_squares @ slopes + by_y)
    return HMCState(z, value, gradient), jnp.isfinite(value) & jnp.isfinite(gradient).all()


def drawn(
    density: Density,
    *,
    chains: int,
    warmup: int,
    kept: int,
    acceptance: float,
    seed: int,
    report: Callable[[str, int], None],
) -> tuple[Draws, int, bool]:
    """The draws of so many chains in `kept` blocks, after `warmup` others; how many gradients they took, and whether the
    user stopped them early. `report` is told what is done and how many draws are."""
    found, gradients, interrupted = [], 0, False
    with ThreadPoolExecutor(min(chains, os.cpu_count() or 1)) as pool:
        try:
            running = [begin(density, key) for key in jax.random.split(jax.random.key(seed), chains)]
            for number in range(warmup + kept):
                block = functools.partial(_block, density, jnp.asarray(number < warmup), jnp.asarray(acceptance))
                # The first compiles, which every thread would do by itself.
                together = pool.map if number else map
                running, draws = zip(*together(block, running), strict=True)
                gradients += sum(int(one.gradients.sum()) for one in draws)
                if number >= warmup:
                    found.append(jax.tree.map(lambda *one: np.stack(one), *draws))
                report("warming up" if number < warmup else "sampling", (number + 1) * chains * BLOCK)
        except KeyboardInterrupt:
            pool.shutdown(cancel_futures=True)
            interrupted = True
            if not found:
                raise
    return jax.tree.map(lambda *parts: np.concatenate(parts, axis=1), *found), gradients, interrupted


def _block(density: Density, adapting: Array, acceptance: Array, chain: Chain) -> tuple[Chain, Draws]:
    """`go_on`, and wait for it."""
    return jax.block_until_ready(go_on(density, adapting, acceptance, chain))


@eqx.filter_jit
def go_on(density: Density, adapting: Array, acceptance: Array, chain: Chain) -> tuple[Chain, Draws]:
    """The chain `BLOCK` draws on; `adapting` says whether the length of its steps still is, to this rate of acceptance."""
    transition, mass = nuts.build_kernel(), jnp.ones_like(density.centre)
    _, updated, adapted = dual_averaging_adaptation(acceptance)  # pyright: ignore[reportArgumentType]

    def draw(chain: Chain, _):
        now, key = jax.random.split(chain.key)
        length = jnp.where(adapting, jnp.exp(chain.steps.log_step_size), adapted(chain.steps))
        state, info = transition(now, chain.state, density, length, mass)
        longer = updated(chain.steps, info.acceptance_rate)
        steps = jax.tree.map(lambda new, old: jnp.where(adapting, new, old), longer, chain.steps)
        ends = info.trajectory_leftmost_state.logdensity, info.trajectory_rightmost_state.logdensity
        found = Draws(
            state.position,
            info.is_divergent,
            jnp.isneginf(jnp.minimum(*ends)),
            info.num_integration_steps,
            info.acceptance_rate,
        )
        return Chain(state, key, steps), found

    return jax.lax.scan(draw, chain, length=BLOCK)
