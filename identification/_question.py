"""What a fit is asked, checked: traces, their cases, and the free numbers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from millax import Case
from millax._runtime import double_precision

from ._compare import Comparison, compare
from ._parameters import FreeParameters, Parameter, free
from ._traces import Trace, TraceError


@dataclass(frozen=True)
class Question:
    """What a fit is asked: traces, the case of each, its free numbers, and both ready to be compared."""

    traces: tuple[Trace, ...]
    cases: tuple[Case, ...]
    """Each once."""
    case_of: tuple[int, ...]
    """Of each trace."""
    numbers: FreeParameters
    comparisons: tuple[Comparison, ...]

    @property
    def samples(self) -> np.ndarray:
        """How many there are of each channel of each trace."""
        return np.array([len(trace.time) for trace in self.traces for _ in trace.channels])

    @property
    def size(self) -> np.ndarray:
        """Root mean square of each channel."""
        return np.sqrt([np.mean(column**2) for trace in self.traces for column in trace.values.T])

    @property
    def noise(self) -> np.ndarray:
        """Standard deviation of each channel's noise, NaN where it is not known."""
        return np.array([trace.noise.get(channel, np.nan) for trace in self.traces for channel in trace.channels])


def question(
    case: Case | Sequence[Case], traces: Trace | Sequence[Trace], parameters: Sequence[Parameter | str]
) -> Question:
    """Arguments as of `fit`, checked. Raises `ValueError`."""
    if not double_precision():
        raise ValueError("a fit needs float64: call millax.set_up() before anything else")
    traces = [traces] if isinstance(traces, Trace) else list(traces)
    if not traces:
        raise ValueError("no trace given; a fit needs at least one")
    given = [case] * len(traces) if isinstance(case, Case) else list(case)
    if len(given) != len(traces):
        raise ValueError(f"{len(given)} cases given for {len(traces)} traces; give one case for all, or one per trace")
    cases: list[Case] = []
    case_of = []
    for one in given:
        same = [i for i, other in enumerate(cases) if other is one]
        case_of.append(same[0] if same else len(cases))
        cases += [] if same else [one]
    asked = [Parameter(p) if isinstance(p, str) else p for p in parameters]
    numbers = free(cases[0], asked)
    for i, other in enumerate(cases[1:], 2):
        try:
            free(other, asked)
        except ValueError as error:
            raise ValueError(f"case {i} of {len(cases)}: {error}") from error
    comparisons = [compare(trace, one, numbers.names) for trace, one in zip(traces, given, strict=True)]
    for trace in traces:
        if len(trace.time) <= len(numbers):
            raise TraceError(
                f"{trace.name}: {len(trace.time)} samples for {len(numbers)} free parameters; give a longer trace"
            )
    return Question(tuple(traces), _settled(cases), tuple(case_of), numbers, tuple(comparisons))


def _settled(cases: Sequence[Case]) -> tuple[Case, ...]:
    """Cases of one resolution with one choice of blocks and sweeps, the safest, so that one program serves them."""
    settled = []
    for case in cases:
        alike = [c.settings for c in cases if c.settings.steps_per_tooth == case.settings.steps_per_tooth]
        settled.append(case.with_settings(blocks=max(s.blocks for s in alike), sweeps=max(s.sweeps for s in alike)))
    return tuple(settled)
