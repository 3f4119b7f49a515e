"""The picture of a design: how much surer each candidate makes, over the first two numbers that are varied."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

from millax.plots import tidy

from ._design import Design
from ._words import unit_words

if TYPE_CHECKING:
    import xarray

SHRINKS = {
    "D": "standard errors shrink by this factor\n(geometric mean along the axes of the ellipsoid)",
    "A": "standard errors over values shrink by this factor\n(root mean square)",
}
LEFT = {
    "D": "standard error that is left, relative\n(geometric mean along the axes of the ellipsoid)",
    "A": "standard error over value that is left\n(root mean square)",
}


def plot_design(result: Design) -> Figure:
    """By which factor each candidate makes the chosen uncertainty smaller; where today's has no bound, what is left of it.

    A curve over one varied number, a map over two; of further ones the best value is taken. The best cut is marked, and what
    is not ranked, or leaves more open than the best, is crossed out.
    """
    bounded = result.today.left == 0
    values = result.table["uncertainty"].where(result.table["left_open"] == result.table["left_open"].min())
    values = result.today.uncertainty / values if bounded else values
    dims = [str(dim) for dim in values.dims]
    values = (values.max if bounded else values.min)(dims[2:]) if dims[2:] else values
    named = result.criterion
    label = f"standard error of {named} shrinks by this factor" if bounded else f"standard error of {named} that is left"
    label = (SHRINKS if bounded else LEFT).get(named, label)
    figure = Figure(figsize=(7, 4.4), layout="constrained")
    axes = figure.subplots()
    best = {name: value for name, (value, _) in result.next[0].cut.items()}
    if len(dims) == 1:
        _curve(axes, values, label, best)
    else:
        _map(figure, axes, values, label, best)
    axes.set_title(f"best: {result.next[0].words}", loc="left", fontsize="medium")
    axes.set_xlabel(_label(values, dims[0]))
    if dims[2:]:
        figure.supxlabel(f"of {', '.join(dims[2:])}: the best value at each place", fontsize="small")
    return figure


def _curve(axes: Axes, values: "xarray.DataArray", label: str, best: dict[str, float]) -> None:
    (dim,) = map(str, values.dims)
    x, y = values[dim].to_numpy(), values.to_numpy()
    tidy(axes)
    axes.plot(x, y, ".-", color="#0072B2")
    axes.plot(best[dim], float(values.sel({dim: best[dim]})), "*", color="#D55E00", markersize=14, label="best")
    out = ~np.isfinite(y)
    if out.any():
        bottom = np.zeros(out.sum())
        axes.plot(x[out], bottom, "x", color="0.4", transform=axes.get_xaxis_transform(), clip_on=False, label="not ranked")
    axes.set_ylabel(label)
    axes.legend(frameon=False)


def _map(figure: Figure, axes: Axes, values: "xarray.DataArray", label: str, best: dict[str, float]) -> None:
    dims = [str(dim) for dim in values.dims]
    x, y = (values[dim].to_numpy() for dim in dims)
    z = values.to_numpy().T
    norm = LogNorm(np.nanmin(z), np.nanmax(z)) if np.nanmax(z) > np.nanmin(z) else None
    image = axes.pcolormesh(x, y, np.ma.masked_invalid(z), shading="nearest", norm=norm)
    axes.set_facecolor("0.85")
    rows, columns = np.nonzero(~np.isfinite(z))
    axes.plot(x[columns], y[rows], "x", color="0.4", markersize=4, linestyle="none")
    axes.plot(best[dims[0]], best[dims[1]], "*", color="#D55E00", markeredgecolor="white", markersize=15, clip_on=False)
    bar = figure.colorbar(image, label=label)
    if norm and np.nanmax(z) < 1e4 * np.nanmin(z) and np.nanmin(z) > 1e-2:
        bar.ax.yaxis.set_major_locator(LogLocator(subs=(1, 1.5, 2, 3, 5, 7)))
        bar.ax.yaxis.set_major_formatter(ScalarFormatter())
        bar.ax.yaxis.set_minor_formatter(NullFormatter())
    axes.set_ylabel(_label(values, dims[1]))


def _label(values: "xarray.DataArray", dim: str) -> str:
    unit = unit_words(values[dim].attrs["units"])
    return f"{dim} [{unit}]" if unit else dim
