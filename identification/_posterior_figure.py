"""The picture of a posterior, as SVG."""

import textwrap

import matplotlib
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import chi2, norm

from millax.plots import COLOURS, tidy

from ._figures import DARK, STYLE, svg
from ._posterior_result import Posterior
from ._result import FitResult
from ._words import unit_words

MOST = 6
"""Parameters drawn."""

_DOTS = 1000
_CIRCLE = np.stack([np.cos(angle := np.linspace(0, 2 * np.pi, 100)), np.sin(angle)])


def posterior(found: Posterior, result: FitResult) -> str:
    """Along the diagonal the draws of each parameter, and the normal curve of the fit; below it those of each pair, and
    lines around 50 % and 95 % of the fit's normal distribution. Of more than six parameters those that differ the most from
    what the fit says."""
    unlike = np.abs(found.shift) + np.abs(found.ratio - 1)
    shown = np.sort(np.argsort(-unlike, kind="stable")[:MOST])
    n, draws = len(shown), found.draws.reshape(-1, len(found.names))
    labels = [_label(name, unit) for name, unit in zip(found.names, found.units, strict=True)]
    dots = draws[np.linspace(0, len(draws) - 1, min(_DOTS, len(draws))).astype(int)]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(1 + 1.7 * n, 0.8 + 1.5 * n), layout="constrained", dpi=200)
        grid = figure.subplots(n, n, squeeze=False, sharex="col")
        for (row, column), axes in np.ndenumerate(grid):
            i, j = int(shown[row]), int(shown[column])
            if column > row:
                axes.set_visible(False)
                continue
            tidy(axes)
            axes.ticklabel_format(useOffset=False)
            axes.locator_params(nbins=3)
            axes.tick_params(axis="x", labelrotation=30)
            if row == column:
                _marginal(axes, draws[:, i], float(found.estimate[i]), float(found.error[i]))
            else:
                axes.plot(dots[:, j], dots[:, i], ".", color=COLOURS["x"], alpha=0.3, markersize=2, rasterized=True)
                _normal(axes, found, result, j, i)
            if row == n - 1:
                axes.set_xlabel(labels[j], fontsize=8)
            if column == 0 and row > 0:
                axes.set_ylabel(labels[i], fontsize=8)
            elif column > 0:
                axes.tick_params(labelleft=False)
        grid[0, 0].set_title("blue: draws; lines: as the fit says")
        return svg(figure, "posterior of the parameters")


def _label(name: str, unit: str) -> str:
    """Name and unit, in lines short enough for the side of a square."""
    return "\n".join(textwrap.wrap(name.replace(".", ". "), 20)).replace(". ", ".") + f"\n[{unit_words(unit) or '-'}]"


def _marginal(axes: Axes, draws: Float[np.ndarray, " draws"], estimate: float, error: float) -> None:
    axes.hist(draws, bins=40, density=True, color=COLOURS["x"], alpha=0.5)
    value = np.linspace(min(draws.min(), estimate - 3 * error), max(draws.max(), estimate + 3 * error), 200)
    axes.plot(value, norm.pdf(value, estimate, error), color=DARK, linewidth=0.9)
    axes.set_yticks([])


def _normal(axes: Axes, found: Posterior, result: FitResult, j: int, i: int) -> None:
    """Lines around 50 % and 95 % of two parameters."""
    pair = [j, i]
    root = np.linalg.cholesky(result.correlation[np.ix_(pair, pair)])
    for part in (0.5, 0.95):
        line = found.estimate[pair, None] + found.error[pair, None] * (root @ _CIRCLE) * np.sqrt(chi2.ppf(part, 2))
        axes.plot(*line, color=DARK, linewidth=0.8)
