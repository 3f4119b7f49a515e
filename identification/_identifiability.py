"""Before a fit: can the measurements say what is asked?"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from millax import Case, SimulationError
from millax._simulate import STATUS

from ._evaluate import Evaluation, evaluate
from ._loadtest import LoadTest
from ._noise import NoiseModel
from ._parameters import Parameter, Tie
from ._question import Question, question
from ._traces import Trace
from ._uncertainty import Uncertainty, uncertainty

ASSUMED = 0.01
"""Noise of a channel whose noise is not known, as a part of its root mean square."""


@dataclass(frozen=True)
class Prospect:
    """What a fit can be expected to say about a parameter, at the guess.

    - `name`, `unit`: of the parameter.
    - `guess`: in `unit`.
    - `std`: expected standard error in `unit`; None where the measurements leave the parameter open.
    - `reason`: why, in words, with the others that it cannot be told apart from.
    """

    name: str
    unit: str
    guess: float
    std: float | None
    reason: str | None


@dataclass(frozen=True)
class Check:
    """Whether the measurements can say what is asked: the Fisher information at the guess.

    - `parameters`: what is to be expected of each.
    - `correlation`: of the estimates, shape (n, n); NaN where there will be none.
    - `condition`: of the Jacobian whose columns are scaled to length 1: 1 where parameters have nothing in common. It is the
      square root of that of the scaled Fisher information.
    """

    parameters: tuple[Prospect, ...]
    correlation: Float[np.ndarray, "n n"]
    condition: float

    @property
    def identifiable(self) -> bool:
        """Whether every parameter is."""
        return all(parameter.reason is None for parameter in self.parameters)

    def pairs(self, least: float) -> list[tuple[str, str, float]]:
        """Pairs of parameters whose estimates have at least this correlation, up or down; the strongest first."""
        names = [parameter.name for parameter in self.parameters]
        first, second = np.triu_indices(len(names), 1)
        every = zip(first, second, self.correlation[first, second], strict=True)
        strong = [(names[i], names[j], float(c)) for i, j, c in every if abs(c) >= least]
        return sorted(strong, key=lambda pair: -abs(pair[2]))

    @property
    def message(self) -> str:
        """What the measurements leave open, in words."""
        if self.identifiable:
            return f"The measurements determine all {len(self.parameters)} parameters."
        reasons = dict.fromkeys(parameter.reason for parameter in self.parameters if parameter.reason)
        return "At the guess " + "; ".join(reasons) + "."


def check(
    case: Case | Sequence[Case],
    measured: Trace | LoadTest | Sequence[Trace | LoadTest],
    parameters: Sequence[Parameter | Tie | str],
) -> Check:
    """Ask before a fit what it can find: which parameters and combinations the measurements determine, and how well.

    At the guess what is measured changes in the model by J with the parameters; the covariance that a fit can reach is
    (J^T J)^-1, J in units of the noise; what priors say is added as measurements are. What was measured does not matter,
    only where, when and how well. Where the noise of a channel is not known, 1 % of its root mean square is assumed.

    **Arguments:** as of `fit`.

    Raises `ValueError` for parameters and measurements that cannot be used, and `SimulationError` where the simulation fails
    at the guess, or the springs of a robot do not hold its loads.
    """
    asked = question(case, measured, parameters)
    return checked(asked, at_guess(asked))


def at_guess(asked: Question) -> Evaluation:
    """The evaluation at the guess. Raises `SimulationError` where it cannot be used."""
    evaluation = evaluate(asked.model, NoiseModel().of(assumed(asked)), jnp.zeros(len(asked.numbers)))
    if status := int(evaluation.status):
        raise SimulationError(f"At the guess: {STATUS[status]}")
    if not np.isfinite(evaluation.triangles).all():
        raise SimulationError(f"At the guess: {not_finite(asked)}")
    return evaluation


def assumed(asked: Question) -> Float[np.ndarray, " channels"]:
    """Noise of each channel, assumed where it is not known."""
    return np.where(np.isnan(asked.noise), ASSUMED * asked.size, asked.noise)


def not_finite(asked: Question) -> str:
    """What is said of an evaluation that is not finite."""
    loaded = any(isinstance(one, LoadTest) for one in asked.measured)
    why = ": the springs of the robot may not hold the loads of a load test" if loaded else ""
    return f"the model or its derivatives are not finite{why}"


def checked(asked: Question, evaluation: Evaluation) -> Check:
    """The `Check` of an evaluation at the guess."""
    numbers = asked.numbers
    jacobian = evaluation.whitened(assumed(asked))[:, :-1]
    known = uncertainty(numbers, np.zeros(len(numbers)), jacobian)
    prospects = tuple(_prospect(asked, known, i) for i in range(len(numbers)))
    length = np.linalg.norm(jacobian, axis=0)
    # A parameter that nothing depends on has no direction: as far from the others as can be counted.
    s = np.linalg.svd(jacobian / np.where(length > 0, length, 1.0), compute_uv=False)
    return Check(prospects, known.correlation, float(s[0] / s[-1]) if s[-1] > 0 else np.inf)


def _prospect(asked: Question, known: Uncertainty, i: int) -> Prospect:
    numbers, std = asked.numbers, known.std[i]
    return Prospect(
        name=numbers.names[i],
        unit=numbers.units[i],
        guess=numbers.shown(i, float(numbers.guess[i])),
        std=None if std is None else numbers.shown(i, std),
        reason=known.reason[i],
    )
