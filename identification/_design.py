"""The next cut: of those that can be made, the one that tells most about what is still uncertain.

Before a cut is made its derivatives are known, and so is the information J^T J that it will add. What was measured already
has its own, and so do priors; information of independent measurements adds. The covariance that a fit of everything
together will reach is the inverse of the sum (Cramer and Rao's bound, which least squares reaches where the model is nearly
linear within the errors). Optimal design of experiments: Fedorov, Theory of Optimal Experiments, 1972.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np

from millax import STATUS, Case
from millax._members import FEED_PER_TOOTH, Members, members_of
from millax._runtime import double_precision
from millax._values import Given

from ._aim import CRITERIA, Aim, Forecast
from ._candidates import UNFIT, Told, told
from ._identifiability import assumed, at_guess
from ._information import Knowledge, added, knowledge, marginal
from ._loadtest import LoadTest
from ._parameters import FreeParameters, Parameter, Tie, free
from ._question import question
from ._recording import Recording
from ._traces import Trace

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True)
class Design:
    """Candidates for the next cut, and what each promises.

    - `parameters`, `units`, `values`: those that all cuts share; a number that a trace has of its own is no aim.
    - `criterion`: "D", "A" or the name of a parameter.
    - `today`: what is known without another cut.
    - `next`: the best cut, then the best after that one was made, and so on, as many as were asked for. Empty where no
      candidate can be ranked.
    - `ranking`: all candidates that can be, the best first.
    - `table`: a dataset over the varied numbers: `standard_error` of each parameter, `uncertainty`, `left_open`, `status`
      (0, a key of `millax.STATUS`, or -1 for what is not simulated) and `reason`. Where the status is not 0 the rest is NaN.
    """

    parameters: tuple[str, ...]
    units: tuple[str, ...]
    values: tuple[float, ...]
    criterion: str
    today: Forecast
    next: tuple[Forecast, ...]
    ranking: tuple[Forecast, ...]
    table: "xarray.Dataset"

    def best(self, n: int = 5) -> tuple[Forecast, ...]:
        """The n best candidates, each for itself."""
        return self.ranking[:n]


def design(
    case: Case,
    measured: Trace | LoadTest | Sequence[Trace | LoadTest],
    parameters: Sequence[Parameter | Tie | str],
    grid: Mapping[str, Given],
    *,
    cases: Case | Sequence[Case] | None = None,
    recording: Recording | None = None,
    criterion: str = "D",
    count: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Design:
    """Find the cut that tells most about the parameters, given what was measured.

    A candidate's information is J^T J, J the derivatives of what would be recorded, each sample in units of its noise,
    which is taken to be white; at the guesses of the parameters, so give them the estimates that there are. A number that
    each trace has of its own (`each`) is unknown in the new cut too: what the cut must tell about it is taken off (the Schur
    complement). A candidate that chatters, cannot be simulated or cannot be recorded is not ranked.

    **Arguments:**

    - `case`: of the cut, from which the candidates differ by `grid`.
    - `measured`, `parameters`: as of `fit`; nothing measured yet is `()`, and only priors are known then.
    - `grid`: as of `millax.sweep`: {"cut.spindle_speed": "4000:16000:13 rpm", "cut.depth": "0.5, 1, 2 mm"}; every
      combination is a candidate. What is free cannot be varied.
    - `cases`: of what was measured, where it is another one or several, as of `fit`. None: `case`.
    - `recording`: what a candidate is recorded with, where it is not as the first trace was.
    - `criterion`: "D": the determinant of the covariance of the parameters, in the coordinates of the fit, in which 1 is a
      factor e for a parameter with one bound and its own value for one with none, see `_transforms`; what counts is the
      volume of the ellipsoid of confidence, whatever these scales are. "A": the sum of (standard error / value)², with the
      scale of the transform where the value is 0. Or the name of the one parameter whose standard error counts. First of
      all, a cut is better that leaves less open.
    - `count`: how many cuts are to be planned, >= 1, one after the other: each is the best after those before it. One may
      come twice.
    - `progress`: called with how many candidates are simulated, and of how many.

    Raises `ValueError` for what cannot be used: names that are unknown or free, a grid with nothing in it, a criterion that
    is none, and whatever `fit` cannot use; `SimulationError` where the simulation of what was measured fails at the guess.
    """
    if not double_precision():
        raise ValueError("a design needs float64: call millax.set_up() before anything else")
    measured = [measured] if isinstance(measured, Trace | LoadTest) else list(measured)
    asked = question(case if cases is None else cases, measured, parameters) if measured else None
    earlier = asked.cases if asked else ()
    numbers, place = free((*earlier, case), [Parameter(p) if isinstance(p, str) else p for p in parameters]), len(earlier)
    members = _candidates(case, grid, numbers)
    if isinstance(count, bool) or not isinstance(count, int) or count < 1:
        raise ValueError(f"count: {count!r} given; it must be a whole number of at least 1")
    shared, here = (np.array([at in which for at in numbers.places]) for which in ((None,), (None, place)))
    aim = Aim(numbers, np.flatnonzero(shared), criterion)
    blank = (recording or Recording()).blank([one for one in measured if isinstance(one, Trace)])
    prior = np.asarray(jax.jacfwd(numbers.prior)(jnp.zeros(len(numbers)))).reshape(-1, len(numbers))
    if asked:
        jacobian = at_guess(asked).whitened(assumed(asked))[:, :-1]
        factor = marginal(jacobian, np.array([at is None for at in asked.numbers.places]))
    else:
        factor = marginal(prior, shared)
    new = told(case, members, numbers, place, tuple(map(int, np.flatnonzero(here))), blank, progress)
    ranked = np.flatnonzero(new.status == 0)
    sigma = np.array([blank.noise[channel] for channel in blank.channels])
    # What is known beforehand of the shared numbers is in `factor`.
    own = prior[~prior[:, shared].any(axis=1)][:, here]
    factors = np.empty((len(ranked), shared.sum(), shared.sum()))
    for i, triangles in enumerate(new.triangles[ranked]):
        rows = (triangles / sigma[:, None, None]).reshape(-1, here.sum())
        factors[i] = marginal(np.concatenate([rows, own]), shared[here])
    after = knowledge(added(factor, factors))
    return Design(
        parameters=aim.names,
        units=aim.units,
        values=aim.values,
        criterion=criterion,
        today=aim.forecast(knowledge(factor), {}),
        next=tuple(_sequence(aim, members, factor, factors, ranked, count)),
        ranking=tuple(aim.forecast(after.of(i), _cut(members, int(ranked[i]))) for i in aim.order(after)),
        table=_table(aim, members, new, ranked, after),
    )


def _sequence(aim: Aim, members: Members, factor, factors, ranked, count: int) -> Iterator[Forecast]:
    """The best cut, then the best after it, and so on."""
    for _ in range(count if len(ranked) else 0):
        after = knowledge(added(factor, factors))
        best = aim.order(after)[0]
        yield aim.forecast(after.of(best), _cut(members, int(ranked[best])))
        factor = added(factor, factors[best])


def _candidates(case: Case, grid: Mapping[str, Given], numbers: FreeParameters) -> Members:
    """Every combination of the grid, checked."""
    if not grid:
        raise ValueError('grid: empty; say what can be chosen: {"cut.spindle_speed": "4000:16000:13 rpm"}')
    given = {*numbers.leaves, *(leaf for leaf, *_ in numbers.ties)}
    for name in grid:
        if name in given or (name == FEED_PER_TOOTH and "cut.feed_rate" in given):
            raise ValueError(f"{name}: it is to be found, so it cannot be chosen; vary numbers that are not free")
    members = members_of(case, grid, None)
    if not members.dims:
        raise ValueError("grid: one cut given; there is nothing to choose from. Give several values of a number")
    return members


def _cut(members: Members, i: int) -> dict[str, tuple[float, str]]:
    """What is varied of a candidate, as it was given."""
    at = dict(zip(members.dims, np.unravel_index(i, members.shape), strict=True))
    return {
        name: (float(numbers if dim is None else numbers[at[dim]]), members.units[name])
        for name, (dim, numbers) in members.coordinates.items()
    }


def _table(aim: Aim, members: Members, new: Told, ranked: np.ndarray, after: Knowledge) -> "xarray.Dataset":
    import xarray

    left, uncertainty = aim.judged(after)
    dims, n = tuple(members.dims), len(aim.names)

    def over_grid(values, *more: int) -> np.ndarray:
        filled = np.full((len(members), *more), np.nan)
        filled[ranked] = values
        return filled.reshape(*members.shape, *more)

    what = CRITERIA.get(aim.criterion, f"standard error of {aim.criterion}")
    unit = aim.units[aim.names.index(aim.criterion)] if aim.criterion in aim.names else ""
    codes = "; ".join(f"{code} = {words}" for code, words in STATUS.items())
    variables = {
        "standard_error": (
            (*dims, "parameter"),
            over_grid(after.std * aim.shown, n),
            {"long_name": "standard error after this cut, in the unit of the parameter; infinite where it is left open"},
        ),
        "uncertainty": (dims, over_grid(uncertainty), {"units": unit, "long_name": what}),
        "left_open": (dims, over_grid(left), {"units": "", "long_name": "how much stays unknown"}),
        "status": (
            dims,
            new.status.reshape(members.shape).astype(np.int8),
            {"units": "", "long_name": f"0 where it is ranked: {codes}; {UNFIT} = not simulated, see the reason"},
        ),
        "reason": (dims, np.array(new.reason, dtype=object).reshape(members.shape), {"long_name": "why it is not ranked"}),
    }
    coordinates = {
        name: (() if dim is None else (dim,), numbers, {"units": members.units[name]})
        for name, (dim, numbers) in members.coordinates.items()
    }
    coordinates |= {"parameter": list(aim.names), "unit": ("parameter", list(aim.units))}
    return xarray.Dataset(variables, coordinates, {"title": "what the next cut would tell", "criterion": aim.criterion})
