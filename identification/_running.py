"""A running fit: from the guess to the optimum, in turns with the noise; what it keeps, and how it ends."""

import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from millax._gain import MOST_SWEEPS
from millax._simulate import STATUS as SIMULATION_STATUS

from ._checkpoint import Checkpoint, End, State
from ._colour import colour
from ._evaluate import Evaluation, evaluate
from ._fleet import ARRIVED, CONVERGED, Ended, solve_many
from ._identifiability import checked, not_finite
from ._noise import Noise, NoiseModel, reflections, student_scale
from ._outcome import Optimum, outcome, verdict
from ._question import Question
from ._result import STATUS, FitResult
from ._solver import SOLVERS, Triangle
from ._starts import SAME, Waterfall, waterfall
from ._uncertainty import RANK, Uncertainty, at_bounds, insensitive, none_known, uncertainty

ROUNDING = 1e-12
"""A cost that is higher by this part is the same one."""

SWEEPS_MISSING = 1
"""The status of a simulation whose fixed-point sweeps have not converged."""

NOISE_ROUNDS = 20
"""Most rounds of estimating the noise; two or three are usual, more with outliers."""

NOISE_CHANGE = 1e-3
"""Relative change of every estimated noise below which the rounds end; of a reflection coefficient the change itself."""

NOISE_FLOOR = 1e-6
"""Smallest noise claimed, relative to the channel's root mean square: the simulation is not more accurate than this."""

NOT_BEGUN = "The fit was not begun, and the parameters are as guessed."
"""What is said of a question that has no answer."""

MEASURE = (
    "Measure what tells them apart (another channel, pose or cut, longer), free fewer numbers, or fit without this check."
)
"""What to try then."""

TRY = "Start from a better guess or from several, give bounds, or free fewer parameters."


@dataclass(frozen=True)
class Progress:
    """Where a fit is: `cost` is the mean square of the residuals over their noise, 1 for a perfect model."""

    stage: str
    iteration: int
    cost: float
    seconds: float


class Failed(Exception):
    """The fit cannot go on: a status, a message, what is known of the parameters where it was not begun, and whether it
    could go on with more iterations."""

    def __init__(self, status: str, message: str, known: Uncertainty | None = None, unfinished: bool = False):
        super().__init__(message)
        self.status = status
        self.message = message
        self.known = known
        self.unfinished = unfinished


class Begin(NamedTuple):
    """Coordinates of many starts, and the seed they were drawn with."""

    y: np.ndarray
    seed: int


class AtOptimum(Exception):
    """The point evaluated is the optimum: nothing is left to do for the solver."""


class Running:
    """The state of a running fit: where it is best, and with which noise."""

    def __init__(
        self,
        asked: Question,
        kind: NoiseModel,
        solver: str,
        starts: Begin | None,
        check: bool,
        most: int,
        progress: Callable[[Progress], None],
        kept: Checkpoint | None,
    ):
        self.asked = asked
        self.numbers = asked.numbers
        self.before = self.sweeps
        self.kind = kind
        self.solver = solver
        self.starts = starts
        self.waterfall: Waterfall | None = None
        self.check = check
        self.max_iterations = most
        self.progress = progress
        self.begin = time.perf_counter()
        self.iterations = 0
        self.y = np.zeros(len(asked.numbers))
        self.best: Evaluation | None = None
        self.wall: str | None = None
        self.samples, self.size = asked.samples, asked.size
        self.estimated = np.isnan(asked.noise)
        self.noise = kind.of(np.where(self.estimated, self.size, asked.noise))
        self.round = 0
        self.ends: list[End] = []
        self.kept = kept
        self.resumed = kept.found() if kept else None
        if self.resumed:
            self._resume(self.resumed)

    def run(self) -> FitResult:
        known, unfinished = None, False
        try:
            self._start()
            if self.starts is None:
                self._rounds()
            else:
                self._from_many(self.starts)
            status, message = "converged", ""
        except KeyboardInterrupt:
            status, message, unfinished = "interrupted", "Stopped by the user; these are the best values so far.", True
        except Failed as failure:
            status, message, known, unfinished = failure.status, failure.message, failure.known, failure.unfinished
        if self.best is None and status == "interrupted":
            raise KeyboardInterrupt
        result = self._result(status, message, known)
        return dataclasses.replace(result, message=f"{result.message}{self._leave(unfinished)}")

    def _leave(self, unfinished: bool) -> str:
        """Keep the last state of a fit that can go on, or remove the checkpoint; what is said of it."""
        said = f" Resumed after {self.resumed.iterations} iterations." if self.resumed else ""
        if self.kept and unfinished:
            self._keep(now=True)
            return f"{said} The same fit goes on from {self.kept.path}."
        if self.kept:
            self.kept.remove()
        return said

    def _resume(self, state: State) -> None:
        self.y, self.noise, self.round, self.ends = state.y, state.noise, state.round, list(state.ends)
        self.iterations, self.max_iterations = state.iterations, self.max_iterations + state.iterations
        self.begin -= state.seconds

    def _keep(self, *, now: bool = False) -> None:
        if self.kept:
            seconds = time.perf_counter() - self.begin
            state = State(self.y, self.noise, self.round, tuple(self.ends), self.iterations, seconds)
            self.kept.keep(state, now=now)

    def _start(self) -> None:
        self._tell(f"resuming after {self.iterations} iterations" if self.resumed else "compiling")
        first, failure = self._evaluate(self.y)
        if failure:
            raise Failed("cannot_start", f"The simulation fails at the guess: {failure}. Guess nearer to the truth.")
        self.best = first
        if self.resumed:
            return  # what follows was looked at when the fit began
        dead = insensitive(self._whitened(first)[:, :-1])
        if dead.any():
            names = ", ".join(np.array(self.numbers.names)[dead])
            raise Failed(
                "cannot_start",
                f"At the guess the measurements do not depend on {names}: nothing shows in which direction to go. Take "
                "the parameter out of the fit, measure a channel that feels it, or guess where it matters.",
            )
        before = checked(self.asked, first)
        if self.check and not before.identifiable:
            reasons = tuple(parameter.reason or NOT_BEGUN for parameter in before.parameters)
            known = tuple(parameter.reason is None for parameter in before.parameters)
            raise Failed("not_identifiable", f"{before.message} {NOT_BEGUN} {MEASURE}", none_known(reasons, known))

    def _from_many(self, starts: Begin) -> None:
        """Fit from many starts, and go on from the best end; then all go to their optima, for the noise that was found."""
        left = starts.y[len(self.ends) :]
        if len(left):
            for one in self._search(left, "from all starts"):
                self.ends.append(End(one.y, one.cost))
        self._take_best(self.ends)
        self._rounds()
        ends = list(self._search(np.stack([one.y for one in self.ends]), "from all ends"))
        if min(one.cost for one in ends) < self._cost(self._best()) - SAME:
            self._take_best(ends)
            self.round = 0
            self._rounds()
        self.waterfall = waterfall(self.numbers, starts.y, ends, starts.seed)

    def _search(self, y: np.ndarray, stage: str) -> Iterator[Ended]:
        def done(count: int) -> None:
            self._keep(now=True)
            self._tell(f"{stage}: {count} of {len(y)}")

        self._tell(f"compiling for {len(y)} starts")
        for one in solve_many(self.asked.model, self.noise, y, caution=np.sqrt(self.samples.sum()), done=done):
            self.iterations += one.steps
            self.max_iterations += one.steps
            yield one

    def _take_best(self, ends: Sequence[Ended] | Sequence[End]) -> None:
        best = min(ends, key=lambda one: one.cost)
        evaluation, failure = self._evaluate(best.y)
        if not failure and self._cost(evaluation) < self._cost(self._best()):
            self.y, self.best = best.y, evaluation

    def _rounds(self) -> None:
        # Damping starts at 1. Residuals per sample make that cautious, as is right far from the optimum; near it,
        # residuals in units of the noise make it bold.
        if self.round == 0:
            self._least_squares("fit", caution=np.sqrt(self.samples.sum()))
        else:
            self._least_squares(f"noise {self.round}", caution=1.0)
        while self.round < NOISE_ROUNDS:
            if not self._update_noise():
                return
            self.round += 1
            self._keep(now=True)
            if not self.kind.plain:
                self.best, failure = self._evaluate(self.y)
                assert not failure  # it was good with the noise before
            self._least_squares(f"noise {self.round}", caution=1.0)
        raise Failed("not_converged", f"The estimated noise still changes after {NOISE_ROUNDS} rounds.")

    def _least_squares(self, stage: str, caution: float) -> None:
        """Go to the optimum for the present noise; the solver sees the residuals divided by `caution`."""
        self.wall = None

        def objective(y: np.ndarray) -> Triangle | None:
            found = self._visit(y, stage)
            return None if found is None else self._whitened(found) / caution

        try:
            self._end_at_optimum()
            SOLVERS[self.solver].minimise(objective, self.y, self.numbers)
        except AtOptimum:
            return
        if self._distance() > ARRIVED:
            why = f": beyond it {self.wall}" if self.wall else ""
            raise Failed("not_converged", f"No step makes the fit better, yet this is no optimum{why}. {TRY}")

    def _visit(self, y: np.ndarray, stage: str) -> Evaluation | None:
        """Evaluate where the solver asks, unless that is known; None where the simulation fails."""
        best = self._best()
        if np.array_equal(y, self.y):
            return best
        if self.iterations >= self.max_iterations:
            raise Failed("not_converged", f"No optimum after {self.iterations} iterations. {TRY}", unfinished=True)
        evaluation, failure = self._evaluate(y)
        if failure:
            self.wall = failure
            return None
        if self._cost(evaluation) <= self._cost(best) * (1 + ROUNDING):
            self.y, self.best = np.array(y), evaluation
            self._keep()
            self._tell(stage, self._cost(evaluation) / self.samples.sum())
            self._end_at_optimum()
        return evaluation

    def _end_at_optimum(self) -> None:
        if self._distance() <= CONVERGED:
            raise AtOptimum

    def _evaluate(self, y: np.ndarray) -> tuple[Evaluation, str | None]:
        """The evaluation at `y`, and why it must not be used, if so."""
        self.iterations += 1
        while True:
            evaluation = evaluate(self.asked.model, self.noise, jnp.asarray(y))
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
            return evaluation, not_finite(self.asked)
        return evaluation, None

    def _more_sweeps(self) -> None:
        # By half: every rise compiles the program again, which costs more than sweeps do.
        sweeps = min(self.sweeps + max(2, self.sweeps // 2), MOST_SWEEPS)
        raised = [case.with_settings(sweeps=max(sweeps, case.settings.sweeps)) for case in self.asked.cases]
        self.asked = dataclasses.replace(self.asked, cases=tuple(raised))
        self._tell(f"compiling with {sweeps} sweeps")

    @property
    def sweeps(self) -> int:
        """The fewest of all cases."""
        return min(case.settings.sweeps for case in self.asked.cases)

    @property
    def sigma(self) -> np.ndarray:
        return np.asarray(self.noise.sigma)

    def _whitened(self, evaluation: Evaluation) -> np.ndarray:
        """At the present noise."""
        return evaluation.whitened(self.sigma)

    def _cost(self, evaluation: Evaluation) -> float:
        return evaluation.cost(self.sigma)

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
        """Estimate what is not known of the noise from the residuals; whether it changed."""
        before, model = self.noise, self.asked.model
        # The residuals of a channel have lost as many degrees of freedom as parameters were taken from it.
        # At least one is left: `question` sees to it, but for channels whose noise is known.
        taken = self._taken()
        residuals = model.residuals(self._best().fitted)
        coloured = [reflections(np.asarray(r), self.kind.order) for r in residuals]
        found = Noise(before.sigma, np.concatenate(coloured), before.degrees)
        white = [np.asarray(c) for part, r in zip(model.noises(found), residuals, strict=True) for c in part.white(r)]
        size = np.array([self._size(one, gone) for one, gone in zip(white, taken, strict=True)])
        updated = np.where(self.estimated, np.maximum(size, NOISE_FLOOR * self.size), self.sigma)
        self.noise = Noise(updated, found.reflection, before.degrees)
        moved = np.abs(np.asarray(found.reflection) - np.asarray(before.reflection)).max(initial=0.0)
        return bool(max(np.abs(updated / np.asarray(before.sigma) - 1).max(), moved) > NOISE_CHANGE)

    def _size(self, white: np.ndarray, taken: float) -> float:
        """Of the noise of a channel, from its residuals without correlation, from which so many parameters were taken."""
        if self.kind.distribution == "student":
            return student_scale(white, self.kind.degrees, taken)
        return float(np.linalg.norm(white) / np.sqrt(max(len(white) - taken, 1.0)))

    def _tell(self, stage: str, cost: float = np.nan) -> None:
        self.progress(Progress(stage, self.iterations, cost, time.perf_counter() - self.begin))

    def _best(self) -> Evaluation:
        assert self.best is not None
        return self.best

    def _result(self, status: str, message: str, known: Uncertainty | None) -> FitResult:
        numbers, begun = self.numbers, known is None and status != "cannot_start"
        left = None
        if status == "converged":
            left = colour(self.asked.model, self.noise, self._best())
            jacobian = self._best().whitened(self.sigma, self.noise.information)[:, :-1]
            known = uncertainty(numbers, self.y, jacobian, left.information)
            status, message = verdict(self.asked, known, left)
        elif known is None:
            known = none_known((STATUS[status],) * len(numbers))
        if self.sweeps > self.before:
            message += f" The sweeps were raised from {self.before} to {self.sweeps} on the way."
        optimum = Optimum(self.y, self.noise, self.best, known, left)
        return outcome(
            self.asked,
            optimum,
            status=status,
            message=message,
            begun=begun,
            noise_model=self.kind,
            solver=self.solver,
            iterations=self.iterations,
            seconds=time.perf_counter() - self.begin,
            waterfall=self.waterfall,
        )
