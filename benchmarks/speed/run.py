"""One run of the benchmarks: how long it may take, and what its picture will show."""

from dataclasses import dataclass, field

import numpy as np

from millax._program import cores


@dataclass
class Run:
    """How much to measure, and what has been measured for the picture.

    **Arguments:**

    - `duration`: of the cut in a simulation [s]; at 10 000 rpm and 40 steps per tooth, 1 s is 26 680 steps.
    - `rounds`: repetitions of what is timed.
    - `long`: measure in full what is otherwise extrapolated.
    - `members`: sizes of the batches that have a target.
    - `lengths`: durations [s] over which the growth of the cost is fitted.
    - `minute`: length of the trace whose memory is measured [s].
    """

    duration: float = 1.0
    rounds: int = 21
    long: bool = False
    members: tuple[int, ...] = (64, 1024)
    lengths: tuple[float, ...] = (0.1, 1.0, 10.0, 100.0)
    minute: float = 60.0
    bars: dict[str, float] = field(default_factory=dict)
    """Nanoseconds per time step and simulation."""
    lines: dict[str, float] = field(default_factory=dict)
    """Bars to be drawn as lines through all the others: the yardsticks."""
    growth: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    """Name of a size -> sizes, seconds."""

    @property
    def cores(self) -> int:
        """Cores that this process may use."""
        return cores()
