"""Solvers of least squares behind one call: optimistix, SciPy, jaxopt.

A solver gets an objective and a start, and asks the objective for the triangular factor of [J, r] at one point after the
other: it holds all that J^T J, J^T r and r^T r are made of, and so all that a solver can use. The objective is evaluated
outside, in one compiled program that also serves the checks before a fit and the uncertainties after it; it counts,
reports, knows the optimum and ends the solver by an exception. Where a simulation fails it has no answer, and the solver is
told of a residual so large that it turns back.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Float

from ._parameters import FreeParameters

Triangle = Float[np.ndarray, "n+1 n+1"]

Objective = Callable[[np.ndarray], Triangle | None]
"""The triangular factor of [J, r] at the coordinates y; None where the simulation fails."""

REJECTED = 1e100
"""Residual of a point that must not be accepted: its square is still finite."""


@dataclass(frozen=True)
class Solver:
    """A solver by its `name`: `minimise(objective, y, numbers)` starts at y, and returns where it finds no further step.

    `evaluations`: of model and Jacobian after which a fit gives up by default: those that do without the Jacobian's
    curvature need many.
    """

    name: str
    minimise: Callable[[Objective, np.ndarray, FreeParameters], None]
    evaluations: int


# ---- optimistix


class Steps:
    """The path of a solver of optimistix from the coordinates `y`.

    Ask for the next point (`proposal`), evaluate it, and `tell` the result. optimistix evaluates the function once per step,
    at `state.y_eval`. It is handed the linear model of the residuals around that point: at the point itself it has their
    value and their Jacobian, and neither a Gauss-Newton nor a quasi-Newton method asks for anything else.
    """

    def __init__(self, y: np.ndarray, method: str = "lm"):
        self._solver = _solver(method, len(y))
        self._y = jnp.asarray(y)
        self._state = eqx.tree_at(lambda state: state.y_eval, self._solver.state, self._y)

    @property
    def proposal(self) -> np.ndarray:
        """Where to evaluate next; the first one is the start."""
        return np.asarray(self._state.y_eval)

    @property
    def stalled(self) -> bool:
        """Whether the solver itself finds no further step worth taking."""
        tiny = np.abs(self.proposal - np.asarray(self._y)).max() < 1e-12
        return bool(self._state.terminate) or (tiny and not bool(self._state.first_step))

    def tell(self, triangle: Triangle | None) -> bool:
        """Report the evaluation at `proposal`; True where it is accepted as the best so far."""
        triangle = rejected(len(self._y)) if triangle is None else triangle
        accepted = int(self._state.num_accepted_steps)
        linear = (jnp.asarray(triangle[:, -1]), jnp.asarray(triangle[:, :-1]), self._state.y_eval)
        self._y, self._state = self._solver.step(self._y, linear, self._state)
        return int(self._state.num_accepted_steps) > accepted


class _Compiled(NamedTuple):
    state: Any
    step: Any


def linear_model(y, linear):
    """Residuals at y of the linear model (residuals, Jacobian, the point where they are)."""
    residual, jacobian, at = linear
    return residual + jacobian @ (y - at), None


def _half_square(y, linear):
    residual, _ = linear_model(y, linear)
    return 0.5 * jnp.sum(residual**2), None


def levenberg_marquardt() -> optx.LevenbergMarquardt:
    """The damping falls after every step that keeps 75 % of its promise. With optimistix's 99 % a fit takes half as many
    steps again."""
    return eqx.tree_at(
        lambda m: m.search,
        optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10),
        optx.ClassicalTrustRegion(high_cutoff=0.75),
    )


_METHODS = {
    "lm": (levenberg_marquardt, linear_model, {"jac": "fwd"}),
    "dogleg": (lambda: optx.Dogleg(rtol=1e-10, atol=1e-10), linear_model, {"jac": "fwd"}),
    "bfgs": (lambda: optx.BFGS(rtol=1e-12, atol=1e-12), _half_square, {}),
}


@functools.cache
def _solver(name: str, n: int) -> _Compiled:
    """The compiled step for n parameters and its initial state.

    Made once: the state holds a function, and functions are compared by identity.
    """
    make, function, options = _METHODS[name]
    method, tags = make(), frozenset()
    zeros = (jnp.zeros(n + 1), jnp.zeros((n + 1, n)), jnp.zeros(n))
    struct = eqx.filter_eval_shape(lambda: function(zeros[2], zeros)[0])
    state = method.init(function, zeros[2], zeros, options, struct, None, tags)

    @eqx.filter_jit
    def step(y, linear, state):
        y, state, _ = method.step(function, y, linear, options, state, tags)
        return y, state

    return _Compiled(state, step)


def _optimistix(method: str):
    def minimise(objective: Objective, y: np.ndarray, numbers: FreeParameters) -> None:
        steps = Steps(y, method)
        while not steps.stalled:
            steps.tell(objective(steps.proposal))

    return minimise


def _optimistix_bfgs(objective: Objective, y: np.ndarray, numbers: FreeParameters) -> None:
    # It knows nothing of curvature at first: in units of the columns of the first Jacobian all directions are alike.
    first = objective(y)
    assert first is not None
    length = np.linalg.norm(first[:, :-1], axis=0)
    scale = 1 / np.where(length > 0, length, 1.0)

    def scaled(z):
        found = objective(y + scale * z)
        return None if found is None else np.column_stack([found[:, :-1] * scale, found[:, -1]])

    _optimistix("bfgs")(scaled, np.zeros(len(y)), numbers)


# ---- SciPy, in the values themselves and within their bounds


class _Bounded:
    """The objective in x = 1 + (v - guess)/(dv/dy at the guess), whose bounds a solver keeps itself. The guess is at 1, not
    at 0: SciPy's first step is as long as the vector it starts from."""

    def __init__(self, objective: Objective, y: np.ndarray, numbers: FreeParameters):
        self.objective, self.numbers = objective, numbers
        self.guess, self.scale = np.asarray(numbers.guess), np.asarray(numbers.slopes(jnp.zeros(len(y))))
        values = (numbers.values(jnp.asarray(y)), numbers.low, numbers.high)
        self.start, self.low, self.high = (1 + (np.asarray(v) - self.guess) / self.scale for v in values)

    def __call__(self, x: np.ndarray) -> Triangle:
        """The triangular factor of [dr/dx, r]."""
        # On a bound itself the coordinate y is infinite.
        room = 1e-9 * np.minimum(self.high - self.low, 1.0)
        inside = np.clip(np.asarray(x, dtype=float), self.low + room, self.high - room)
        y = np.asarray(self.numbers.coordinates(jnp.asarray(self.guess + self.scale * (inside - 1))))
        found = self.objective(y)
        if found is None:
            return rejected(len(y))
        slopes = np.asarray(self.numbers.slopes(jnp.asarray(y))) / self.scale
        return np.column_stack([found[:, :-1] / slopes, found[:, -1]])


def _scipy_trf(objective: Objective, y: np.ndarray, numbers: FreeParameters) -> None:
    from scipy.optimize import least_squares

    bounded = _Bounded(objective, y, numbers)
    least_squares(
        lambda x: bounded(x)[:, -1],
        bounded.start,
        lambda x: bounded(x)[:, :-1],  # pyright: ignore[reportArgumentType]
        bounds=(bounded.low, bounded.high),
        method="trf",
        x_scale="jac",
        xtol=1e-14,
        ftol=1e-14,
        gtol=None,  # pyright: ignore[reportArgumentType]
    )


# ---- jaxopt


def _jaxopt_lbfgsb(objective: Objective, y: np.ndarray, numbers: FreeParameters) -> None:
    import jaxopt

    bounded = _Bounded(objective, y, numbers)
    # Every direction alike, as of BFGS.
    length = np.linalg.norm(bounded(bounded.start)[:, :-1], axis=0)
    scale = 1 / np.where(length > 0, length, 1.0)

    def value_and_gradient(z):
        found = bounded(scale * np.asarray(z))
        return jnp.asarray(0.5 * np.sum(found[:, -1] ** 2)), jnp.asarray(scale * (found[:, :-1].T @ found[:, -1]))

    solver = jaxopt.ScipyBoundedMinimize(
        fun=value_and_gradient,
        method="L-BFGS-B",
        value_and_grad=True,
        jit=False,
        maxiter=10_000,
        options={"ftol": 0.0, "gtol": 0.0, "maxcor": 30, "maxfun": 10_000},
    )
    solver.run(
        jnp.asarray(bounded.start / scale), bounds=(jnp.asarray(bounded.low / scale), jnp.asarray(bounded.high / scale))
    )


def _jaxopt_lm(objective: Objective, y: np.ndarray, numbers: FreeParameters) -> None:
    import jaxopt

    def triangle(y):
        found = objective(np.asarray(y))
        return rejected(len(y)) if found is None else found

    solver = jaxopt.LevenbergMarquardt(
        residual_fun=lambda y: jnp.asarray(triangle(y)[:, -1]),
        damping_parameter=1e-3,
        solver="qr",
        materialize_jac=True,
        implicit_diff=False,
        jit=False,
        tol=0.0,
        maxiter=10_000,
    )
    # jaxopt 0.8.5 forgets its own argument `jac_fun` where the Jacobian is a matrix.
    solver._jac_fun = lambda y: jnp.asarray(triangle(y)[:, :-1])
    state, at = solver.init_state(jnp.asarray(y)), jnp.asarray(y)
    while True:
        updated, state = solver.update(at, state)
        # A step turned down leaves the point, and raises the damping.
        if np.abs(np.asarray(state.delta)).max() < 1e-14 or (float(state.damping_factor) > 1e30):
            return
        at = updated


def rejected(n: int) -> Triangle:
    """What is told of a point of n coordinates at which the simulation fails."""
    triangle = np.zeros((n + 1, n + 1))
    triangle[-1, -1] = REJECTED
    return triangle


SOLVERS = {
    solver.name: solver
    for solver in (
        Solver("optimistix_lm", _optimistix("lm"), 100),
        Solver("optimistix_dogleg", _optimistix("dogleg"), 100),
        Solver("optimistix_bfgs", _optimistix_bfgs, 2000),
        Solver("scipy_trf", _scipy_trf, 100),
        Solver("jaxopt_lm", _jaxopt_lm, 200),
        Solver("jaxopt_lbfgsb", _jaxopt_lbfgsb, 2000),
    )
}
"""Levenberg-Marquardt, dogleg and BFGS of optimistix; the trust region of SciPy and L-BFGS-B by jaxopt, which keep bounds
themselves; Levenberg-Marquardt of jaxopt."""
