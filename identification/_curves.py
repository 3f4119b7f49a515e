"""Pictures of what a fit says about its optimum: where other starts ended, and profiles of the likelihood."""

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from millax.plots import COLOURS, tidy

from ._figures import DARK, GUIDE, MEASURED, STYLE, svg
from ._profile import LIMIT, Profile
from ._result import Estimate
from ._starts import SAME, Waterfall
from ._words import unit_words

BEST, WORSE = COLOURS["x"], "#b3412e"


def waterfall(found: Waterfall) -> str:
    """The cost of every start's end over that of the best, in order; and where the starts of each parameter lay and
    ended."""
    reached = np.isfinite(found.cost)
    order = np.argsort(found.cost)[: int(reached.sum())]
    colours = np.where(found.optimum == 0, BEST, np.where(found.optimum > 0, WORSE, MEASURED))
    with matplotlib.rc_context(STYLE):
        n = len(found.names)
        figure = Figure(figsize=(11, max(2.8, 0.6 + 0.3 * n)), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=[1, 1.4])
        tidy(left)
        # What rounding leaves of the difference of two costs is drawn at the lower edge.
        height = np.maximum(found.cost[order], SAME / 100)
        left.scatter(np.arange(1, len(order) + 1), height, s=16, c=colours[order], zorder=3)
        left.axhline(SAME, **GUIDE)
        left.set_yscale("log")
        left.set_ylim(bottom=SAME / 200)
        left.set_xlabel("starts, the best first")
        left.set_ylabel("cost over that of the best [-]")
        left.xaxis.get_major_locator().set_params(integer=True)
        tidy(right)
        first = found.ends[order[0]]
        for i in range(n):
            if first[i] == 0:
                continue
            right.scatter(found.starts[:, i] / first[i], np.full(len(found.starts), i), s=10, c=MEASURED, alpha=0.5)
            right.scatter(found.ends[order, i] / first[i], np.full(len(order), i), s=14, c=colours[order], zorder=3)
        right.axvline(1.0, color=MEASURED, linewidth=0.7)
        ratios = (found.starts / np.where(first == 0, 1.0, first))[:, first != 0]
        if ratios.size and (ratios > 0).all():
            right.set_xscale("log")
        right.set_yticks(np.arange(n), found.names)
        right.invert_yaxis()
        right.set_xlabel("value over that of the best [-]; grey: starts, colour: where they ended")
        return svg(figure, "fits from other starts")


def profiles(found: Sequence[Profile], estimates: Sequence[Estimate]) -> str:
    """sqrt(D) over each parameter, which is straight where standard errors tell the whole, and the intervals of both
    kinds."""
    drawn = [(one, e) for one in found for e in estimates if e.name == one.name and len(one.values)]
    columns = min(len(drawn), 4)
    rows = -(-len(drawn) // columns)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11, 0.3 + 2.5 * rows), layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
        for axes in grid.ravel()[len(drawn) :]:
            axes.set_visible(False)
        for axes, (one, e) in zip(grid.ravel(), drawn, strict=False):
            tidy(axes)
            assert e.std is not None
            straight = (one.values - e.value) / e.std
            axes.plot(one.values, straight, **GUIDE)
            axes.plot(one.values, one.root, ".-", color=BEST, markersize=4, linewidth=1.1)
            for level in (-LIMIT, LIMIT):
                axes.axhline(level, color=MEASURED, linewidth=0.7)
            if one.ci95 is not None:
                axes.axvspan(*one.ci95, color=BEST, alpha=0.1, linewidth=0)
            axes.set_ylim(-4, 4)
            unit = unit_words(one.unit)
            axes.set_xlabel(f"{one.name} [{unit or '-'}]", fontsize=8, color=DARK)
            axes.ticklabel_format(axis="x", useOffset=False)
            axes.locator_params(axis="x", nbins=3)
        for row in grid:
            row[0].set_ylabel("±√D [standard errors]")
        return svg(figure, "profile likelihoods")
