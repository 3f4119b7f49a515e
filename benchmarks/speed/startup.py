"""From nothing to the first result, in a fresh process."""

import numpy as np

from ..figures import Figure, below
from .child import ask
from .run import Run

PROCESSES = 3


def figures(run: Run):
    runs = [ask("start") for _ in range(PROCESSES)]
    seconds = {key: float(np.median([r[key] for r in runs])) for key in runs[0]}
    yield below("import of millax", seconds["import"], 1.5, form=".2f", unit=" s")
    yield Figure("building the case, settings chosen", f"{seconds['case']:.2f} s", "", None)
    yield below("first simulation, compilation included", seconds["first"], 3, form=".2f", unit=" s")
    yield Figure("second simulation", f"{1e3 * seconds['second']:.1f} ms", "", None)
