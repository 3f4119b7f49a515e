"""Draw the pictures of the documentation: python docs/make_figures.py"""

from pathlib import Path

import jax
import numpy as np
from matplotlib.figure import Figure

from identification import FitProblem, FitResult, fit, load_fit
from millax import simulate
from millax.plots import COLOURS, tidy

DOCS = Path(__file__).parent
TOOTH_PERIODS = 3


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    problem = load_fit(DOCS.parent / "data_synthetic/kr240_slot.toml")
    result = fit(problem.cases, problem.traces, problem.parameters)
    draw_fit(problem, result).savefig(DOCS / "fit.png", dpi=110, metadata={"Software": None})


def draw_fit(problem: FitProblem, result: FitResult) -> Figure:
    """Displacement, force and parameters: measured, at the guess and fitted."""
    (trace_fit,) = result.traces
    trace, guess = trace_fit.trace, simulate(problem.case)
    last = slice(-TOOTH_PERIODS * problem.case.settings.steps_per_tooth, None)

    figure = Figure(figsize=(11, 3.3), layout="constrained")
    slow, fast, parameters = figure.subplots(1, 3, width_ratios=[1.15, 1, 0.85])
    for i, axis in enumerate("xy"):
        x, force = trace.channels.index(axis), trace.channels.index(f"F{axis}")
        colour = COLOURS[axis]
        slow.plot(trace.time, 1e3 * trace.values[:, x], color=colour, alpha=0.35, linewidth=5)
        slow.plot(trace.time, 1e3 * trace_fit.fitted[:, x], color=colour, linewidth=1.2, label=f"${axis}$")
        slow.plot(guess.time, 1e3 * guess.displacement[:, i], color=colour, linewidth=0.8, linestyle="--")
        ms = 1e3 * trace.time[last]
        fast.plot(ms, trace.values[last, force], ".", color=colour, alpha=0.5, markersize=4)
        fast.plot(ms, trace_fit.fitted[last, force], color=colour, linewidth=1.2, label=f"$F_{axis}$")
        fast.plot(ms, guess.force[last, i], color=colour, linewidth=0.8, linestyle="--")
    slow.set(xlabel="time [s]", ylabel="displacement of the tool [mm]", title="whole trace")
    fast.set(xlabel="time [ms]", ylabel="force on the tool [N]", title=f"last {TOOTH_PERIODS} tooth periods")

    names = [e.name for e in result.parameters]
    scale = [problem.truth[e.name] / problem.file.leaf(e.name).express(problem.truth[e.name]) for e in result.parameters]
    true = np.array([problem.truth[name] for name in names]) / scale
    for values, style in (
        ([e.guess for e in result.parameters], {"mfc": "none", "label": "guess"}),
        ([e.value for e in result.parameters], {"label": "fitted"}),
    ):
        parameters.semilogx(values / true, names, "o", color="0.25", markersize=5, **style)
    parameters.set_xticks([0.5, 1, 2], ["½", "1", "2"], minor=False)
    parameters.set_xticks([], minor=True)
    parameters.set(xlabel="value/truth", title="parameters", xlim=(0.4, 2.5), ylim=(len(names) + 0.3, -0.5))
    for axes, place in ((slow, "upper right"), (fast, "center right"), (parameters, "lower center")):
        tidy(axes)
        axes.title.set_size("medium")
        axes.legend(frameon=False, ncols=2, fontsize="small", loc=place)
    return figure


if __name__ == "__main__":
    main()
