"""The picture of a run: time per step of everything, and how the cost grows."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from millax.plots import tidy

from ..timing import exponent
from .run import Run

OURS, OTHERS = "#0072B2", "0.6"
YARDSTICKS = {"C, same model": "#D55E00", "C, sampled": "#CC79A7"}
GROWTH = ("#0072B2", "#D55E00", "#56B4E9", "#009E73", "#CC79A7")


def draw(run: Run) -> Figure:
    """Bars of nanoseconds per step and simulation, the C loops as lines; seconds against sizes."""
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    bars, growth = figure.subplots(1, 2, width_ratios=[1.25, 1])
    _bars(bars, run)
    _growth(growth, run)
    for axes in (bars, growth):
        tidy(axes)
        axes.title.set_size("medium")
    return figure


def _bars(axes, run: Run) -> None:
    names = sorted(run.bars, key=run.bars.__getitem__, reverse=True)
    values = [run.bars[name] for name in names]
    shown = axes.barh(names, values, color=[OURS if name.startswith("millax") else OTHERS for name in names], height=0.7)
    axes.bar_label(shown, [_short(value) for value in values], padding=3, fontsize="small")
    for name, value in run.lines.items():
        axes.axvline(
            value, color=YARDSTICKS.get(name, "0.3"), linewidth=1.2, linestyle="--", label=f"{name}: {_short(value)}"
        )
    axes.set(xscale="log", xlabel="time", title="time per step and simulation")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: _short(value)))
    axes.set_xlim(10, 3 * max([*values, 100]))
    if run.lines:
        axes.legend(frameon=False, fontsize="small", loc="upper right")


def _growth(axes, run: Run) -> None:
    for (name, (sizes, seconds)), colour in zip(run.growth.items(), GROWTH, strict=False):
        sizes, seconds = np.asarray(sizes, float), np.asarray(seconds)
        p = exponent(sizes, seconds)
        through = np.exp(np.mean(np.log(seconds)) - p * np.mean(np.log(sizes)))
        axes.loglog(sizes, seconds, "o", color=colour, markersize=5)
        axes.loglog(sizes, through * sizes**p, color=colour, linewidth=1.2, label=f"{name}: exponent {p:.2f}")
    axes.set(xlabel="size", ylabel="seconds", title="growth of the cost, lines fitted")
    if run.growth:
        axes.legend(frameon=False, fontsize="small", loc="lower right")
        axes.set_ylim(bottom=axes.get_ylim()[0] / 6)  # room for the legend


def _short(nanoseconds: float) -> str:
    if nanoseconds >= 1e5:
        return f"{nanoseconds / 1e6:.2g} ms"
    return f"{nanoseconds:.0f} ns" if nanoseconds < 1e4 else f"{nanoseconds / 1e3:.0f} µs"
