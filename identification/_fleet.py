"""Many fits of one shape in one compiled program: other starts, parameters held, other measurements, other noise.

Levenberg-Marquardt of optimistix, step by step as in `_solver`, inside a loop that is vectorised over the fits. A
simulation that fails on the way is a step turned down.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from millax._gain import MOST_SWEEPS

from ._evaluate import Evaluation, Model, evaluation
from ._noise import Noise
from ._solver import REJECTED, levenberg_marquardt, linear_model

TOGETHER = 8
"""Fits in one batch: beyond that blocks of simulations no longer fit the cache of a processor."""

MORE_SWEEPS = 4
"""Fixed-point sweeps of the simulations beyond those of a single one."""

CONVERGED = 1e-3
"""As of a single fit: length of the step left, in standard errors."""

STEPS = 60
"""Most evaluations of model and Jacobian of each fit."""


@dataclass(frozen=True)
class Ended:
    """Where one of many fits ended.

    - `y`: the coordinates.
    - `evaluation`: model and Jacobian there.
    - `cost`: sum of the squares of the independent residuals over their noise; infinite where the simulation fails.
    - `distance`: of the optimum, in standard errors; parameters held do not count.
    - `steps`: evaluations that it took.
    """

    y: Float[np.ndarray, " n"]
    evaluation: Evaluation
    cost: float
    distance: float
    steps: int


def solve_many(
    model: Model,
    noise: Noise | Sequence[Noise],
    starts: Float[np.ndarray, "m n"],
    held: Bool[np.ndarray, "m n"] | None = None,
    measured: Sequence[tuple[Float[np.ndarray, "channels samples"], ...]] | None = None,
    *,
    caution: float = 1.0,
    done: Callable[[int], None] = lambda count: None,
) -> Iterator[Ended]:
    """Fit from every start, in turn where they are more than a batch.

    **Arguments:**

    - `noise`: of all fits, or of each.
    - `starts`: coordinates.
    - `held`: parameters that stay where they start. None: none.
    - `measured`: what each fit compares the model with, for every trace and load test. None: what the model holds.
    - `caution`: residuals are divided by it for the solver, see `fit`.
    - `done`: called with how many fits are done, after every batch.
    """
    m, n = starts.shape
    held = np.zeros((m, n), dtype=bool) if held is None else held
    noises = [noise] * m if isinstance(noise, Noise) else list(noise)
    given = [tuple(one.measured for one in model.comparisons)] * m if measured is None else list(measured)
    # The fits may lead far away, and need more sweeps there than where they start.
    cases = (case.with_settings(sweeps=min(case.settings.sweeps + MORE_SWEEPS, MOST_SWEEPS)) for case in model.cases)
    model = dataclasses.replace(model, cases=tuple(cases))
    for begin in range(0, m, TOGETHER):
        # The last batch is filled up, so that one program serves all.
        which = [min(begin + i, m - 1) for i in range(TOGETHER)]
        batch = [_stacked([one[i] for i in which]) for one in (noises, starts, held, given)]
        y, found, cost, distance, steps = _batch(
            model, batch[0], batch[1], batch[2], batch[3], jnp.asarray(caution, dtype=float)
        )
        y, cost, distance, steps, found = jax.tree.map(np.asarray, (y, cost, distance, steps, found))
        for i in range(min(TOGETHER, m - begin)):
            one = jax.tree.map(lambda leaf, i=i: leaf[i], found)
            yield Ended(y[i], one, float(cost[i]), float(distance[i]), int(steps[i]))
        done(min(begin + TOGETHER, m))


def _stacked(parts):
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *parts)


@eqx.filter_jit
def _batch(model: Model, lanes, caution: Array):
    return jax.vmap(lambda lane: _one(model, *lane, caution))(lanes)


def _one(model: Model, noise: Noise, start: Array, held: Array, measured, caution: Array):
    """One fit: coordinates, evaluation, cost, distance of the optimum and steps."""
    model = eqx.tree_at(lambda m: [one.measured for one in m.comparisons], model, list(measured))
    n = len(start)

    def look(y):
        """[J, r] as a triangle, and whether it may be used; parameters held change nothing."""
        found = evaluation(model, noise, y)
        triangles = found.triangles / noise.sigma[:, None, None]
        rows = jnp.concatenate([triangles.reshape(-1, n + 1), found.prior])
        triangle = jnp.linalg.qr(rows, mode="r")[: n + 1] * jnp.append(~held, True)
        usable = (found.status == 0) & found.covered & jnp.isfinite(triangle).all()
        return triangle, usable, found

    method, options, tags = levenberg_marquardt(), {"jac": "fwd"}, frozenset()
    linear = (jnp.zeros(n + 1), jnp.zeros((n + 1, n)), start)
    struct = eqx.filter_eval_shape(lambda: linear[0])
    state = method.init(linear_model, start, linear, options, struct, None, tags)
    numbers, rest = eqx.partition(state, eqx.is_array)

    def step(carry):
        y, numbers, _, count = carry
        state = eqx.combine(numbers, rest)
        triangle, usable, _ = look(state.y_eval)
        jacobian = jnp.where(usable, triangle[:, :-1], 0.0)
        residual = jnp.where(usable, triangle[:, -1], jnp.zeros(n + 1).at[-1].set(REJECTED * caution))
        away = jnp.where(usable, _distance(jacobian, residual), jnp.inf)
        before = state.num_accepted_steps
        y, state, _ = method.step(
            linear_model, y, (residual / caution, jacobian / caution, state.y_eval), options, state, tags
        )
        arrived = (state.num_accepted_steps > before) & (away <= CONVERGED)
        stalled = state.terminate | (jnp.abs(state.y_eval - y).max() < 1e-12)
        return y, eqx.filter(state, eqx.is_array), arrived | stalled, count + 1

    def going(carry):
        return ~carry[2] & (carry[3] < STEPS)

    y, _, _, count = lax.while_loop(going, step, (start, numbers, jnp.array(False), jnp.array(0)))
    triangle, usable, found = look(y)
    cost = jnp.where(usable, jnp.sum(triangle[:, -1] ** 2), jnp.inf)
    return y, found, cost, jnp.where(usable, _distance(triangle[:, :-1], triangle[:, -1]), jnp.inf), count


def _distance(jacobian: Float[Array, "k n"], residual: Float[Array, " k"]) -> Float[Array, ""]:
    """Length of the part of the residuals that the parameters reach; of those that change nothing there is none."""
    length = jnp.linalg.norm(jacobian, axis=0)
    dead = length == 0
    basis = jacobian / jnp.where(dead, 1.0, length)
    along = basis.T @ residual
    return jnp.sqrt(jnp.maximum(along @ jnp.linalg.solve(basis.T @ basis + jnp.diag(dead.astype(float)), along), 0.0))
