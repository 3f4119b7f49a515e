"""What a fit is asked, checked: traces and load tests, their cases, and the free numbers."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from millax import Case
from millax._runtime import double_precision

from ._compare import Comparison, compare
from ._deflection import Deflection, deflection
from ._evaluate import Model
from ._loadtest import LoadTest
from ._measured import TraceError
from ._parameters import FreeParameters, Parameter, Tie, free
from ._traces import Trace


@dataclass(frozen=True)
class Question:
    """What a fit is asked: what was measured, the case of each, its free numbers, and both ready to be compared."""

    measured: tuple[Trace | LoadTest, ...]
    cases: tuple[Case, ...]
    """Each once."""
    case_of: tuple[int, ...]
    """Of each measured."""
    numbers: FreeParameters
    comparisons: tuple[Comparison | Deflection, ...]
    parameters: tuple[Parameter | Tie, ...]
    """As they were asked for."""

    @property
    def model(self) -> Model:
        """What its points are evaluated with."""
        return Model(self.cases, self.case_of, self.numbers, self.comparisons)

    @property
    def samples(self) -> np.ndarray:
        """How many there are of each channel of each trace or load test."""
        return np.array([one.samples for one in self.measured for _ in one.channels])

    @property
    def size(self) -> np.ndarray:
        """Root mean square of each channel."""
        return np.sqrt([np.mean(column**2) for one in self.measured for column in one.values.T])

    @property
    def noise(self) -> np.ndarray:
        """Standard deviation of each channel's noise, NaN where it is not known."""
        return np.array([one.noise.get(channel, np.nan) for one in self.measured for channel in one.channels])


def question(
    case: Case | Sequence[Case],
    measured: Trace | LoadTest | Sequence[Trace | LoadTest],
    parameters: Sequence[Parameter | Tie | str],
) -> Question:
    """Arguments as of `fit`, checked. Raises `ValueError`."""
    if not double_precision():
        raise ValueError("a fit needs float64: call millax.set_up() before anything else")
    measured = [measured] if isinstance(measured, Trace | LoadTest) else list(measured)
    if not measured:
        raise ValueError("no trace given, and no load test; a fit needs at least one")
    given = [case] * len(measured) if isinstance(case, Case) else list(case)
    if len(given) != len(measured):
        raise ValueError(
            f"{len(given)} cases given for {len(measured)} traces and load tests; give one case for all, or one for each"
        )
    asked = [Parameter(p) if isinstance(p, str) else p for p in parameters]
    # Where traces have numbers of their own, each has a case of its own.
    apart = any(isinstance(p, Parameter) and p.each for p in asked)
    cases: list[Case] = []
    case_of = []
    for one in given:
        same = [] if apart else [i for i, other in enumerate(cases) if other is one]
        case_of.append(same[0] if same else len(cases))
        cases += [] if same else [one]
    numbers = free(cases, asked)
    comparisons = [compared(one, its, numbers.leaves) for one, its in zip(measured, given, strict=True)]
    for one in measured:
        _enough(one, len(numbers))
    return Question(tuple(measured), _settled(cases), tuple(case_of), numbers, tuple(comparisons), tuple(asked))


def compared(one: Trace | LoadTest, case: Case, free_names: Collection[str]) -> Comparison | Deflection:
    """A trace or load test, checked against its case and ready to be compared. Raises `TraceError`."""
    return deflection(one, case) if isinstance(one, LoadTest) else compare(one, case, free_names)


def _enough(one: Trace | LoadTest, free: int) -> None:
    """Raise `TraceError` where there are so few samples that the fit could take their noise for zero."""
    if one.samples > free:
        return
    if isinstance(one, Trace):
        raise TraceError(f"{one.name}: {one.samples} samples for {free} free parameters; give a longer trace")
    unknown = [channel for channel in one.channels if channel not in one.noise]
    if unknown:
        raise TraceError(
            f"{one.name}: the noise of {unknown[0]} is not given, and {one.samples} measurements do not tell it "
            f"beside {free} free parameters; give the noise"
        )


def _settled(cases: Sequence[Case]) -> tuple[Case, ...]:
    """Cases of one resolution with one choice of blocks and sweeps, the safest, so that one program serves them."""
    settled = []
    for case in cases:
        alike = [c.settings for c in cases if c.settings.steps_per_tooth == case.settings.steps_per_tooth]
        settled.append(case.with_settings(blocks=max(s.blocks for s in alike), sweeps=max(s.sweeps for s in alike)))
    return tuple(settled)
