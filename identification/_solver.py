"""Levenberg-Marquardt, one step at a time, on a problem whose evaluation is made outside.

optimistix evaluates the residual function once per step, at `state.y_eval`. We evaluate the simulation there ourselves,
in one compiled program that also serves the checks before a fit and the uncertainties after it, and hand optimistix the
linear model of the residuals around that point: at the point itself it has their value and their Jacobian, and a
Gauss-Newton method asks for nothing else. So the step is a small program, the simulation is compiled once, and between
two steps Python can report, stop, or turn down a point at which the simulation failed.
"""

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx

_REJECTED = 1e100
"""Residual of a point that must not be accepted: its square is still finite."""


class Steps:
    """The path of Levenberg-Marquardt from the coordinates `y`.

    Ask for the next point (`proposal`), evaluate it, and `tell` the result.
    """

    def __init__(self, y: np.ndarray):
        self._solver = _solver(len(y))
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

    def tell(self, triangle: np.ndarray | None) -> bool:
        """Report the evaluation at `proposal`; True where it is accepted as the best so far.

        `triangle` is the triangular factor of [Jacobian, residuals], (n + 1, n + 1); None for a failed evaluation.
        """
        n = len(self._y)
        if triangle is None:
            triangle = np.zeros((n + 1, n + 1))
            triangle[-1, -1] = _REJECTED
        accepted = int(self._state.num_accepted_steps)
        linear = (jnp.asarray(triangle[:, -1]), jnp.asarray(triangle[:, :-1]), self._state.y_eval)
        self._y, self._state = self._solver.step(self._y, linear, self._state)
        return int(self._state.num_accepted_steps) > accepted


class _Solver(NamedTuple):
    state: Any
    step: Any


def _linear_model(y, linear):
    residual, jacobian, at = linear
    return residual + jacobian @ (y - at), None


@functools.cache
def _solver(n: int) -> _Solver:
    """The compiled step for n parameters and its initial state.

    Made once: the state holds a function, and functions are compared by identity.
    """
    # The damping falls after every step that keeps 75 % of its promise. With optimistix's 99 % a fit takes half as many
    # steps again.
    method = eqx.tree_at(
        lambda m: m.search,
        optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10),
        optx.ClassicalTrustRegion(high_cutoff=0.75),
    )
    options, tags = {"jac": "fwd"}, frozenset()
    zeros = (jnp.zeros(n + 1), jnp.zeros((n + 1, n)), jnp.zeros(n))
    state = method.init(_linear_model, zeros[2], zeros, options, eqx.filter_eval_shape(lambda: zeros[0]), None, tags)

    @eqx.filter_jit
    def step(y, linear, state):
        y, state, _ = method.step(_linear_model, y, linear, options, state, tags)
        return y, state

    return _Solver(state, step)
