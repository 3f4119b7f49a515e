"""Many fits of one shape in one compiled program: other starts, parameters held, other measurements, other noise.

Levenberg-Marquardt of optimistix, step by step as in `_solver`, inside a loop that is vectorised over the fits. A
simulation that fails on the way is a step turned down.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from millax._gain import MOST_SWEEPS

from ._evaluate import Model, evaluation
from ._noise import Noise
from ._solver import REJECTED, Triangle, levenberg_marquardt, linear_model

TOGETHER = 8
"""Fits in one batch: beyond that blocks of simulations no longer fit the cache of a processor."""

MORE_SWEEPS = 4
"""Fixed-point sweeps of the simulations beyond those of a single one."""

CONVERGED = 1e-3
"""A fit ends where the Gauss-Newton step left is this many standard errors long."""

ARRIVED = 0.1
"""Where a solver finds no better point, rounding allowed, this many standard errors still count as the optimum."""

STEPS = 60
"""Most evaluations of model and Jacobian of each fit."""


@dataclass(frozen=True)
class Ended:
    """Where one of many fits ended.

    - `y`: the coordinates.
    - `triangle`: the triangular factor of [J, r] there, in units of the noise; parameters held have no derivatives.
    - `cost`: sum of the squares of the independent residuals over their noise; infinite where the simulation fails.
    - `distance`: of the optimum, in standard errors; parameters held do not count.
    - `steps`: evaluations that it took.
    """

    y: Float[np.ndarray, " n"]
    triangle: Triangle
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
    begin = 0
    for count, lanes in batches(noises, starts, held, given):
        y, triangle, distance, steps = (np.asarray(x) for x in _batch(model, lanes, jnp.asarray(caution, dtype=float)))
        for i in range(count):
            failed = abs(triangle[i, -1, -1]) >= REJECTED
            cost = np.inf if failed else float(np.sum(triangle[i, :, -1] ** 2))
            yield Ended(y[i], triangle[i], cost, np.inf if failed else float(distance[i]), int(steps[i]))
        begin += count
        done(begin)


def batches(*columns: Sequence[Any] | np.ndarray) -> Iterator[tuple[int, tuple[Any, ...]]]:
    """Rows of these columns, `TOGETHER` at a time: how many of them count, and each column as one pytree with a leading
    axis. The last batch is filled up with its last row, so that one program serves all."""
    m = len(columns[0])
    for begin in range(0, m, TOGETHER):
        which = [min(begin + i, m - 1) for i in range(TOGETHER)]
        yield min(TOGETHER, m - begin), tuple(_stacked([column[i] for i in which]) for column in columns)


def _stacked(parts: Sequence[Any]) -> Any:
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *parts)


@eqx.filter_jit
def _batch(model: Model, lanes: Any, caution: Array):
    def fit(lane):
        noise, start, held, measured = lane
        return _one(model, noise, start, held, measured, caution)

    return jax.vmap(fit)(lanes)


def _one(model: Model, noise: Noise, start: Array, held: Array, measured, caution: Array):
    """One fit: coordinates, the triangle and the distance of the optimum there, and steps."""
    model = eqx.tree_at(lambda m: [one.measured for one in m.comparisons], model, list(measured))
    n = len(start)

    def look(y):
        """The triangle of [J, r]; parameters held change nothing."""
        found = evaluation(model, noise, y)
        triangles = found.triangles / noise.sigma[:, None, None]
        rows = jnp.concatenate([triangles.reshape(-1, n + 1), found.prior])
        triangle = jnp.linalg.qr(rows, mode="r")[: n + 1] * jnp.append(~held, True)
        usable = (found.status == 0) & found.covered & jnp.isfinite(triangle).all()
        return jnp.where(usable, triangle, jnp.zeros((n + 1, n + 1)).at[-1, -1].set(REJECTED))

    method, options, tags = levenberg_marquardt(), {"jac": "fwd"}, frozenset()
    linear = (jnp.zeros(n + 1), jnp.zeros((n + 1, n)), start)
    struct = eqx.filter_eval_shape(lambda: linear[0])
    state = method.init(linear_model, start, linear, options, struct, None, tags)
    numbers, rest = eqx.partition(state, eqx.is_array)

    def step(carry):
        y, numbers, best, _, _, count = carry
        state = eqx.combine(numbers, rest)
        triangle, before = look(state.y_eval), state.num_accepted_steps
        linear = (triangle[:, -1] / caution, triangle[:, :-1] / caution, state.y_eval)
        y, state, _ = method.step(linear_model, y, linear, options, state, tags)
        best = jnp.where(state.num_accepted_steps > before, triangle, best)
        distance = _distance(best[:, :-1], best[:, -1])
        ended = (distance <= CONVERGED) | state.terminate | (jnp.abs(state.y_eval - y).max() < 1e-12)
        return y, eqx.filter(state, eqx.is_array), best, distance, ended, count + 1

    def going(carry):
        return ~carry[4] & (carry[5] < STEPS)

    nothing = jnp.zeros((n + 1, n + 1))
    carry = (start, numbers, nothing, jnp.array(jnp.inf), jnp.array(False), jnp.array(0))
    y, _, best, distance, _, count = lax.while_loop(going, step, carry)
    return y, best, distance, count


def _distance(jacobian: Float[Array, "k n"], residual: Float[Array, " k"]) -> Float[Array, ""]:
    """Length of the part of the residuals that the parameters reach; of those that change nothing there is none."""
    length = jnp.linalg.norm(jacobian, axis=0)
    dead = length == 0
    basis = jacobian / jnp.where(dead, 1.0, length)
    along = basis.T @ residual
    return jnp.sqrt(jnp.maximum(along @ jnp.linalg.solve(basis.T @ basis + jnp.diag(dead.astype(float)), along), 0.0))
