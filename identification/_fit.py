"""Fitting parameters of a case to measurements: weighted least squares by Levenberg-Marquardt."""

import importlib.metadata
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from millax import Case
from millax._gain import MOST_SWEEPS
from millax._simulate import STATUS as SIMULATION_STATUS

from ._evaluate import Evaluation, evaluate
from ._identifiability import checked, not_finite
from ._loadtest import LoadTest
from ._parameters import FreeParameters, Parameter, Tie
from ._question import Question, question
from ._result import STATUS, Estimate, FitResult, TraceFit
from ._solver import Steps
from ._traces import Trace
from ._uncertainty import RANK, Uncertainty, at_bounds, insensitive, none_known, uncertainty

CONVERGED = 1e-3
"""The fit ends where the Gauss-Newton step left is this many standard errors long."""

STALLED = 0.1
"""Where the solver finds no better point, rounding allowed, this many standard errors still count as the optimum."""

SWEEPS_MISSING = 1
"""The status of a simulation whose fixed-point sweeps have not converged."""

NOISE_ROUNDS = 10
"""Most rounds of estimating the noise; two or three are usual."""

NOISE_CHANGE = 1e-3
"""Relative change of every estimated noise below which the rounds end."""

NOISE_FLOOR = 1e-6
"""Smallest noise claimed, relative to the channel's root mean square: the simulation is not more accurate than this."""

NOT_BEGUN = "The fit was not begun, and the parameters are as guessed."
"""What is said of a question that has no answer."""

MEASURE = (
    "Measure what tells them apart (another channel, pose or cut, longer), free fewer numbers, or fit without this check."
)
"""What to try then."""

TRY = "Start from a better guess, give bounds, or free fewer parameters."


@dataclass(frozen=True)
class Progress:
    """Where a fit is: `cost` is the mean square of the residuals over their noise, 1 for a perfect model."""

    stage: str
    iteration: int
    cost: float
    seconds: float


def fit(
    case: Case | Sequence[Case],
    measured: Trace | LoadTest | Sequence[Trace | LoadTest],
    parameters: Sequence[Parameter | Tie | str],
    *,
    check: bool = True,
    max_iterations: int = 100,
    progress: Callable[[Progress], None] | None = None,
) -> FitResult:
    """Find the parameters with which the case is nearest to what was measured.

    The sum over channels of ((measured - model)/sigma)² is made smallest, which is maximum likelihood for independent
    normal noise; terms of priors are added, which makes it the most probable point. Where the noise sigma of a channel is
    not known, it is estimated together with the parameters: fit and sigma = root mean square of the residuals, in turns
    until nothing changes.

    **Arguments:**

    - `case`: the cut that was measured, or one per trace and load test: cuts at several speeds, or with the robot in several
      poses. The free parameters are shared: they have one value in all of them, where a `Parameter` does not say `each`.
      Numbers that are not free are taken as they are.
    - `measured`: one `Trace` or `LoadTest`, or several in any order. Where there are only load tests, no cut is simulated.
    - `parameters`: `Parameter`s, or names of parameters to start from the case's own value; `Tie`s to them.
    - `check`: whether a question to which the measurements have no answer at the guess, see `identification.check`, is not
      begun: the status then is "not_identifiable", and the message names the combinations that cannot be known.
    - `max_iterations`: evaluations of model and Jacobian after which the fit gives up.
    - `progress`: called with a `Progress` after every evaluation.

    Returns a `FitResult`, also where there is no good answer: look at `success`, `status` and `message`. Ctrl-C ends a
    fit with the best estimates so far.

    Raises `ValueError` for parameters and measurements that cannot be used, and where JAX is not set to float64.
    """
    return _Fit(question(case, measured, parameters), check, max_iterations, progress or (lambda _: None)).run()


class _Failed(Exception):
    """The fit cannot go on: a status, a message, and what is known of the parameters where it was not begun."""

    def __init__(self, status: str, message: str, known: Uncertainty | None = None):
        super().__init__(message)
        self.status = status
        self.message = message
        self.known = known


class _Fit:
    """The state of a running fit: where it is best, and with which noise."""

    def __init__(self, asked: Question, check: bool, max_iterations: int, progress: Callable[[Progress], None]):
        self.asked = asked
        self.cases = asked.cases
        self.numbers = asked.numbers
        self.check = check
        self.max_iterations = max_iterations
        self.progress = progress
        self.begin = time.perf_counter()
        self.iterations = 0
        self.y = np.zeros(len(asked.numbers))
        self.best: Evaluation | None = None
        self.samples, self.size = asked.samples, asked.size
        self.estimated = np.isnan(asked.noise)
        self.sigma = np.where(self.estimated, self.size, asked.noise)

    def run(self) -> FitResult:
        known = None
        try:
            self._start()
            self._rounds()
            status, message = "converged", ""
        except KeyboardInterrupt:
            status, message = "interrupted", "Stopped by the user; these are the best values so far."
        except _Failed as failure:
            status, message, known = failure.status, failure.message, failure.known
        if self.best is None and status == "interrupted":
            raise KeyboardInterrupt
        return self._result(status, message, known)

    def _start(self) -> None:
        self.progress(Progress("compiling", 0, np.nan, time.perf_counter() - self.begin))
        first, failure = self._evaluate(self.y)
        if failure:
            raise _Failed("cannot_start", f"The simulation fails at the guess: {failure}. Guess nearer to the truth.")
        self.best = first
        dead = insensitive(self._whitened(first)[:, :-1])
        if dead.any():
            names = ", ".join(np.array(self.numbers.names)[dead])
            raise _Failed(
                "cannot_start",
                f"At the guess the measurements do not depend on {names}: nothing shows in which direction to go. Take "
                "the parameter out of the fit, measure a channel that feels it, or guess where it matters.",
            )
        before = checked(self.asked, first)
        if self.check and not before.identifiable:
            reasons = tuple(parameter.reason or NOT_BEGUN for parameter in before.parameters)
            known = tuple(parameter.reason is None for parameter in before.parameters)
            raise _Failed("not_identifiable", f"{before.message} {NOT_BEGUN} {MEASURE}", none_known(reasons, known))

    def _rounds(self) -> None:
        # Damping starts at 1. Residuals per sample make that cautious, as is right far from the optimum; near it,
        # residuals in units of the noise make it bold.
        self._least_squares("fit", caution=np.sqrt(self.samples.sum()))
        for number in range(1, NOISE_ROUNDS + 1):
            if not self._update_noise():
                return
            self._least_squares(f"noise {number}", caution=1.0)
        raise _Failed("not_converged", f"The estimated noise still changes after {NOISE_ROUNDS} rounds.")

    def _least_squares(self, stage: str, caution: float) -> None:
        """Go to the optimum for the present noise; the solver sees the residuals divided by `caution`."""
        steps = Steps(self.y)
        steps.tell(self._whitened(self._best()) / caution)
        wall = None
        while self._distance() > CONVERGED:
            if steps.stalled:
                if self._distance() > STALLED:
                    why = f": beyond it {wall}" if wall else ""
                    raise _Failed("not_converged", f"No step makes the fit better, yet this is no optimum{why}. {TRY}")
                return
            if self.iterations >= self.max_iterations:
                raise _Failed("not_converged", f"No optimum after {self.iterations} iterations. {TRY}")
            y = steps.proposal
            evaluation, failure = self._evaluate(y)
            wall = failure or wall
            if steps.tell(None if failure else self._whitened(evaluation) / caution):
                self.y, self.best = y, evaluation
            self._report(stage)

    def _evaluate(self, y: np.ndarray) -> tuple[Evaluation, str | None]:
        """The evaluation at `y`, and why it must not be used, if so."""
        self.iterations += 1
        while True:
            asked = self.asked
            evaluation = evaluate(self.cases, asked.case_of, self.numbers, asked.comparisons, jnp.asarray(y))
            status = int(evaluation.status)
            if status != SWEEPS_MISSING or self.sweeps >= MOST_SWEEPS:
                break
            # Not a property of the point, but of settings chosen for other parameters: it would bar the way.
            self._more_sweeps()
        if status:
            return evaluation, SIMULATION_STATUS[status]
        if not bool(evaluation.covered):
            return evaluation, "the simulation ends before the trace does"
        if not np.isfinite(evaluation.triangles).all():
            return evaluation, not_finite(asked)
        return evaluation, None

    def _more_sweeps(self) -> None:
        sweeps = min(self.sweeps + 2, MOST_SWEEPS)
        self.cases = tuple(case.with_settings(sweeps=max(sweeps, case.settings.sweeps)) for case in self.cases)
        stage = f"compiling with {sweeps} sweeps"
        self.progress(Progress(stage, self.iterations, np.nan, time.perf_counter() - self.begin))

    @property
    def sweeps(self) -> int:
        """The fewest of all cases."""
        return min(case.settings.sweeps for case in self.cases)

    def _whitened(self, evaluation: Evaluation) -> np.ndarray:
        """At the present noise."""
        return evaluation.whitened(self.sigma)

    def _distance(self) -> float:
        """Length of the Gauss-Newton step in standard errors; parameters at their bounds go no further."""
        whitened = self._whitened(self._best())
        return float(np.linalg.norm(self._reached(whitened[:, :-1]).T @ whitened[:, -1]))

    def _taken(self) -> np.ndarray:
        """How many parameters, in parts, each channel tells: their sum over the channels is the number of those known."""
        rows = np.asarray(self._best().triangles)[:, :, :-1] / self.sigma[:, None, None]
        every = np.concatenate([rows.reshape(-1, rows.shape[-1]), np.asarray(self._best().prior)[:, :-1]])
        basis = self._reached(every)[: len(rows) * rows.shape[1]]
        return np.sum(basis.reshape(*rows.shape[:2], -1) ** 2, axis=(1, 2))

    def _reached(self, jacobian: np.ndarray) -> np.ndarray:
        """An orthonormal basis of the changes that the parameters within their bounds bring about."""
        inner = ~at_bounds(self.numbers, self.y) & ~insensitive(jacobian)
        if not inner.any():
            return np.zeros((len(jacobian), 0))
        jacobian = jacobian[:, inner]
        basis, s, _ = np.linalg.svd(jacobian / np.linalg.norm(jacobian, axis=0), full_matrices=False)
        return basis[:, s > RANK * s[0]]

    def _update_noise(self) -> bool:
        """Estimate the noise that is not known from the residuals; whether it changed."""
        # The residuals of a channel have lost as many degrees of freedom as parameters were taken from it.
        # At least one is left: `question` sees to it, but for channels whose noise is known.
        size = np.linalg.norm(self._best().triangles[:, :, -1], axis=1)
        left = np.maximum(self.samples - self._taken(), 1.0)
        updated = np.maximum(size / np.sqrt(left), NOISE_FLOOR * self.size)
        updated = np.where(self.estimated, updated, self.sigma)
        changed = bool((np.abs(updated / self.sigma - 1) > NOISE_CHANGE).any())
        self.sigma = updated
        return changed

    def _report(self, stage: str) -> None:
        cost = float(np.sum(self._whitened(self._best())[:, -1] ** 2) / self.samples.sum())
        self.progress(Progress(stage, self.iterations, cost, time.perf_counter() - self.begin))

    def _best(self) -> Evaluation:
        assert self.best is not None
        return self.best

    def _result(self, status: str, message: str, known: Uncertainty | None) -> FitResult:
        numbers, y, begun = self.numbers, self.y, known is None and status != "cannot_start"
        if status == "converged":
            known = uncertainty(numbers, y, self._whitened(self._best())[:, :-1])
            status, message = _verdict(numbers, known)
        elif known is None:
            known = none_known((STATUS[status],) * len(numbers))
        before = min(case.settings.sweeps for case in self.asked.cases)
        if self.sweeps > before:
            message += f" The sweeps were raised from {before} to {self.sweeps} on the way."
        fitted = [numbers.insert(case, jnp.asarray(y), place) for place, case in enumerate(self.cases)]
        return FitResult(
            status=status,
            message=message,
            parameters=_estimates(numbers, y, known),
            correlation=known.correlation,
            traces=self._trace_fits(),
            cases=tuple(fitted[i] for i in self.asked.case_of),
            begun=begun,
            iterations=self.iterations,
            seconds=time.perf_counter() - self.begin,
            versions=versions(),
        )

    def _trace_fits(self) -> tuple[TraceFit, ...]:
        if self.best is None:
            return ()
        sigma = iter(self.sigma)
        return tuple(
            TraceFit(one, np.asarray(fitted).T, {channel: float(next(sigma)) for channel in one.channels})
            for one, fitted in zip(self.asked.measured, self.best.fitted, strict=True)
        )


def _verdict(numbers: FreeParameters, known: Uncertainty) -> tuple[str, str]:
    """Status and message of a fit that reached an optimum."""
    reasons = dict.fromkeys(reason for reason in known.reason if reason)
    if not all(known.identifiable):
        status = "not_identifiable"
    elif any(known.at_bound):
        status = "at_bound"
    else:
        return "converged", f"All {len(numbers)} parameters found."
    return status, ". ".join(reason[0].upper() + reason[1:] for reason in reasons) + "."


def _estimates(numbers: FreeParameters, y: np.ndarray, known: Uncertainty) -> tuple[Estimate, ...]:
    values = np.asarray(numbers.values(jnp.asarray(y)))

    def estimate(i: int) -> Estimate:
        def shown(x):
            return numbers.shown(i, float(x))

        std, ci95, bounds = known.std[i], known.ci95[i], (numbers.low[i], numbers.high[i])
        return Estimate(
            name=numbers.names[i],
            value=shown(values[i]),
            unit=numbers.units[i],
            std=None if std is None else shown(std),
            ci95=None if ci95 is None else (shown(ci95[0]), shown(ci95[1])),
            at_bound=known.at_bound[i],
            identifiable=known.identifiable[i],
            reason=known.reason[i],
            guess=shown(numbers.guess[i]),
            bounds=(
                shown(bounds[0]) if np.isfinite(bounds[0]) else None,
                shown(bounds[1]) if np.isfinite(bounds[1]) else None,
            ),
        )

    return tuple(estimate(i) for i in range(len(numbers)))


def versions() -> dict[str, str]:
    """The programs that a fit rests on."""
    packages = ("millax", "jax", "optimistix", "equinox", "numpy")
    return {"python": platform.python_version()} | {name: importlib.metadata.version(name) for name in packages}
