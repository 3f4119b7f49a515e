"""Fitting parameters of a case to measurements: maximum likelihood, as least squares of independent residuals."""

import os
from collections.abc import Callable, Sequence

from millax import Case

from ._checkpoint import Checkpoint
from ._loadtest import LoadTest
from ._noise import NoiseModel
from ._options import Options
from ._parameters import Parameter, Tie
from ._question import question
from ._result import FitResult
from ._running import Begin, Progress, Running
from ._solver import SOLVERS
from ._starts import SPREAD, draw_starts
from ._traces import Trace


def fit(
    case: Case | Sequence[Case],
    measured: Trace | LoadTest | Sequence[Trace | LoadTest],
    parameters: Sequence[Parameter | Tie | str],
    *,
    noise: NoiseModel | None = None,
    solver: str = "optimistix_lm",
    starts: int = 1,
    spread: float = SPREAD,
    seed: int = 0,
    check: bool = True,
    max_iterations: int | None = None,
    progress: Callable[[Progress], None] | None = None,
    checkpoint: str | os.PathLike | None = None,
) -> FitResult:
    """Find the parameters with which the case is nearest to what was measured.

    The sum over channels of ((measured - model)/sigma)² is made smallest, which is maximum likelihood for independent
    normal noise; terms of priors are added, which makes it the most probable point. Where the noise sigma of a channel is
    not known, it is estimated together with the parameters: fit and sigma = root mean square of the residuals, in turns
    until nothing changes. Noise with outliers, and noise that is correlated in time, are said with `noise`, and the sum is
    then that of their likelihood, see `_noise`.

    What is left is looked at: where it is correlated in time, standard errors and intervals are widened for it, and the
    message says so.

    **Arguments:**

    - `case`: the cut that was measured, or one per trace and load test: cuts at several speeds, or with the robot in several
      poses. The free parameters are shared: they have one value in all of them, where a `Parameter` does not say `each`.
      Numbers that are not free are taken as they are.
    - `measured`: one `Trace` or `LoadTest`, or several in any order. Where there are only load tests, no cut is simulated.
    - `parameters`: `Parameter`s, or names of parameters to start from the case's own value; `Tie`s to them.
    - `noise`: what kind of noise there is; None: normal and white.
    - `solver`: one of `identification.SOLVERS`. All go to the same optimum; the first is the quickest.
    - `starts`: how many starts to fit from, the guess among them, all in one compiled program, see `draw_starts`. The best
      optimum is the answer, and `waterfall` of the result says where the others ended.
    - `spread`: factor by which the starts differ from the guess at most, > 1.
    - `seed`: of the starts.
    - `check`: whether a question to which the measurements have no answer at the guess, see `identification.check`, is not
      begun: the status then is "not_identifiable", and the message names the combinations that cannot be known.
    - `max_iterations`: evaluations of model and Jacobian after which the fit gives up. None: as many as suit the solver.
      Those before a checkpoint do not count.
    - `progress`: called with a `Progress` after every evaluation that is the best so far.
    - `checkpoint`: a file in which the fit keeps where it is, about once a second. Where it is there already, from a fit of
      the same question that was killed, interrupted, or ended by `max_iterations`, the fit goes on from it, with any solver.
      It is removed when the fit ends otherwise. None: nothing is kept.

    Returns a `FitResult`, also where there is no good answer: look at `success`, `status` and `message`. Ctrl-C ends a
    fit with the best estimates so far.

    Raises `ValueError` for parameters and measurements that cannot be used, an unknown solver, a checkpoint of another
    question, and where JAX is not set to float64.
    """
    kind = noise or NoiseModel()
    Options(kind, solver, starts, spread, seed)  # checks them
    asked = question(case, measured, parameters)
    from_where = None if starts == 1 else Begin(draw_starts(asked.numbers, starts, spread, seed), seed)
    most = SOLVERS[solver].evaluations if max_iterations is None else max_iterations
    kept = None if checkpoint is None else Checkpoint(checkpoint, asked, kind, from_where and from_where.y)
    return Running(asked, kind, solver, from_where, check, most, progress or (lambda _: None), kept).run()
