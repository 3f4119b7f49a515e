"""The pictures of a fit, as SVG."""

import io
import re
from html import escape
from typing import Any

import matplotlib
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from scipy.signal import welch
from scipy.stats import norm

from millax.plots import COLOURS, si_prefix, tidy

from ._loadtest import CHANNELS as DEFLECTIONS
from ._result import FitResult, TraceFit
from ._traces import CHANNELS, Trace
from ._uncertainty import NORMAL_95

MEASURED = "#8a9099"
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "font.family": "sans-serif",
    "axes.edgecolor": "#9aa0a6",
    "axes.labelcolor": "#3c4043",
    "xtick.color": "#5f6368",
    "ytick.color": "#5f6368",
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titlecolor": "#3c4043",
    "legend.frameon": False,
    # Text stays text, in the font of the page.
    "svg.fonttype": "none",
}
DARK = "#3c4043"
GUIDE: dict[str, Any] = {"color": DARK, "linewidth": 0.7, "linestyle": (0, (4, 3))}
_POINTS = 900
"""Points drawn of a long trace: about one per pixel."""


def measured_and_fitted(fit: TraceFit, tooth_period: float, zoom_periods: int = 4) -> str:
    """Per channel the whole trace, as the range over each pixel, and its last `zoom_periods` tooth periods, where the model
    has its band of 95 %."""
    trace = _trace(fit)
    zoom = trace.time > trace.time[-1] - zoom_periods * tooth_period
    with matplotlib.rc_context(STYLE):
        figure, grid = _grid(len(trace.channels), [2.1, 1], 1.75)
        stds = [None] * len(trace.channels) if fit.fitted_std is None else fit.fitted_std.T
        for (whole, close), channel, measured, fitted, std in zip(
            grid, trace.channels, trace.values.T, fit.fitted.T, stds, strict=True
        ):
            scale, label = _axis(channel, measured)
            _envelope(whole, trace.time, measured / scale, color=MEASURED, alpha=0.4, label="measured")
            _envelope(whole, trace.time, fitted / scale, color=_colour(channel), alpha=0.6, label="fitted")
            ms = 1e3 * trace.time[zoom]
            close.plot(ms, measured[zoom] / scale, ".", color=MEASURED, markersize=3)
            close.plot(ms, fitted[zoom] / scale, color=_colour(channel), linewidth=1.3)
            if std is not None:
                low, high = (fitted + sign * NORMAL_95 * std for sign in (-1, 1))
                close.fill_between(ms, low[zoom] / scale, high[zoom] / scale, color=_colour(channel), alpha=0.3, linewidth=0)
            whole.set_ylabel(label)
            for axes in (whole, close):
                axes.margins(x=0)
            whole.legend(loc="lower right", bbox_to_anchor=(1, 0.97), ncols=2, fontsize=8, borderaxespad=0)
        grid[0, 0].set_title("whole trace: range of the values")
        grid[0, 1].set_title(f"last {zoom_periods} tooth periods: samples and model")
        grid[-1, 0].set_xlabel("time [s]")
        grid[-1, 1].set_xlabel("time [ms]")
        return svg(figure, f"traces of {trace.name}, measured and fitted")


def residuals(fit: TraceFit, tooth_period: float) -> str:
    """Per channel measured - fitted against time, its spectral density, and its distribution beside the normal one."""
    trace = _trace(fit)
    z = np.linspace(-4.5, 4.5, 181)
    with matplotlib.rc_context(STYLE):
        figure, grid = _grid(len(trace.channels), [1.7, 1.7, 1], 1.55)
        for (over_time, spectrum, histogram), channel, residual in zip(grid, trace.channels, fit.residuals.T, strict=True):
            colour, sigma = _colour(channel), fit.sigma[channel]
            scale, label = _axis(channel, residual)
            _envelope(over_time, trace.time, residual / scale, color=colour, alpha=0.5)
            for level in (-2 * sigma, 2 * sigma):
                over_time.axhline(level / scale, **GUIDE)
            over_time.set_ylabel(label)
            over_time.margins(x=0)

            frequency, density = welch(residual, 1 / trace.step, nperseg=min(2048, len(residual)))
            spectrum.loglog(frequency[1:], np.sqrt(density[1:]) / scale, color=colour, linewidth=0.9)
            spectrum.axhline(sigma * np.sqrt(2 * trace.step) / scale, **GUIDE)
            spectrum.axvline(1 / tooth_period, color=MEASURED, linewidth=0.8)
            spectrum.set_ylabel(label.replace("]", "/√Hz]"))
            spectrum.yaxis.set_minor_formatter(NullFormatter())  # else every tick of a decade has one

            histogram.hist(residual / sigma, bins=z[::4], density=True, color=colour, alpha=0.5)
            histogram.plot(z, norm.pdf(z), color=DARK, linewidth=0.8)
            histogram.set_yticks([])
        for axes, title, label in zip(
            grid[0],
            ("against time; dashed: ± 2 σ", "spectral density; dashed: white noise", "distribution; line: normal"),
            ("time [s]", "frequency [Hz]; vertical line: tooth passage", "residual/σ"),
            strict=True,
        ):
            axes.set_title(title)
            grid[-1, list(grid[0]).index(axes)].set_xlabel(label)
        return svg(figure, f"residuals of {trace.name}")


def measured_against_fitted(fit: TraceFit) -> str:
    """Per channel of a load test what was measured, with its noise, above what the model says."""
    test = fit.trace
    with matplotlib.rc_context(STYLE):
        columns = min(len(test.channels), 3)
        rows = -(-len(test.channels) // columns)
        figure = Figure(figsize=(11 if columns > 1 else 6, 0.3 + 3.4 * rows), layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes in grid[len(test.channels) :]:
            axes.set_visible(False)
        for axes, channel, measured, fitted in zip(grid, test.channels, test.values.T, fit.fitted.T, strict=False):
            tidy(axes)
            scale, label = _axis(channel, np.concatenate([measured, fitted]))
            axes.axline((0, 0), slope=1, **GUIDE)
            axes.errorbar(
                fitted / scale,
                measured / scale,
                yerr=fit.sigma[channel] / scale,
                fmt="o",
                markersize=3.5,
                elinewidth=0.9,
                color=_colour(channel),
            )
            axes.set_xlabel(f"fitted {label}")
            axes.set_ylabel(f"measured {label}")
        return svg(figure, f"{test.name}, measured against fitted")


def residuals_by_number(fit: TraceFit) -> str:
    """Per channel of a load test measured - fitted by the number of the measurement."""
    test, number = fit.trace, np.arange(1, fit.trace.samples + 1)
    with matplotlib.rc_context(STYLE):
        figure, grid = _grid(len(test.channels), [1], 1.4)
        for axes, channel, residual in zip(grid[:, 0], test.channels, fit.residuals.T, strict=True):
            sigma = fit.sigma[channel]
            scale, label = _axis(channel, np.append(residual, 2 * sigma))
            axes.axhline(0, color=MEASURED, linewidth=0.7)
            for level in (-2 * sigma, 2 * sigma):
                axes.axhline(level / scale, **GUIDE)
            axes.plot(number, residual / scale, "o", markersize=3.5, color=_colour(channel))
            axes.set_ylabel(label)
        grid[0, 0].set_title("by measurement; dashed: ± 2 σ")
        grid[0, 0].xaxis.get_major_locator().set_params(integer=True)
        grid[-1, 0].set_xlabel("number of the measurement")
        return svg(figure, f"residuals of {test.name}")


def correlation(result: FitResult) -> str:
    """The correlation matrix of the estimates."""
    names = [estimate.name for estimate in result.parameters]
    n = len(names)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(2.4 + 0.52 * n, 1.5 + 0.42 * n), layout="constrained")
        axes = figure.subplots()
        mesh = axes.pcolormesh(
            np.arange(n + 1), np.arange(n + 1), result.correlation, cmap="RdBu_r", vmin=-1, vmax=1, edgecolor="white"
        )
        axes.set_aspect("equal")
        axes.invert_yaxis()
        for (i, j), value in np.ndenumerate(result.correlation):
            text = f"{value:.2f}".replace("-", "−") if np.isfinite(value) else "–"
            strong = np.isfinite(value) and abs(value) > 0.6
            axes.text(j + 0.5, i + 0.5, text, ha="center", va="center", fontsize=8, color="white" if strong else DARK)
        axes.set_xticks(np.arange(n) + 0.5, names, rotation=40, ha="right", rotation_mode="anchor")
        axes.set_yticks(np.arange(n) + 0.5, names)
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        bar = figure.colorbar(mesh, ax=axes, shrink=0.8, ticks=[-1, 0, 1])
        bar.set_label("correlation [-]")
        bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
        return svg(figure, "correlation of the estimates")


def _trace(fit: TraceFit) -> Trace:
    assert isinstance(fit.trace, Trace)
    return fit.trace


def _grid(rows: int, widths: list[float], height: float):
    figure = Figure(figsize=(11, 0.6 + height * rows), layout="constrained")
    grid = figure.subplots(rows, len(widths), squeeze=False, sharex="col", width_ratios=widths)
    for axes in grid.flat:
        tidy(axes)
    return figure, grid


def _colour(channel: str) -> str:
    return COLOURS[channel[-1]]


def _axis(channel: str, values: Float[np.ndarray, " samples"]) -> tuple[float, str]:
    """The scale in which to draw a channel, and the label of its axis."""
    scale, prefix = si_prefix([values])
    return scale, f"{channel} [{prefix}{(CHANNELS | DEFLECTIONS)[channel]}]"


def _envelope(axes: Axes, time: Float[np.ndarray, " n"], values: Float[np.ndarray, " n"], **style) -> None:
    """Draw the range of `values` over each of at most `_POINTS` parts, or the line itself where it is short."""
    part = -(-len(values) // _POINTS)
    if part < 3:
        axes.plot(time, values, linewidth=0.9, **style)
        return
    starts = np.arange(0, len(values), part)
    low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
    axes.fill_between(time[starts], low, high, linewidth=0.8, **style)


def svg(figure: Figure, description: str) -> str:
    """The figure as an element for a page, wide as the page."""
    with io.StringIO() as file, matplotlib.rc_context({"svg.hashsalt": description}):
        figure.savefig(file, format="svg", metadata={"Date": None}, transparent=True)
        text = file.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(
        r'<svg [^>]*?viewBox="([^"]*)"[^>]*>',
        rf'<svg viewBox="\1" role="img" aria-label="{escape(description)}">',
        text,
        count=1,
    )
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    # Half the size, and no difference that could be seen; numbers that are text stay as they are.
    return re.sub(r"<[^>]*>", lambda tag: re.sub(r"(\d\.\d\d)\d+", r"\1", tag[0]), text)
