"""A measured slot, fitted: R² beside the ceiling of any periodic model, laws compared, coefficients with intervals.

    python -m benchmarks.measured_slot FOLDER [--write docs/measured_slot.md]

FOLDER holds three recordings of a dynamometer, n6000_f300_ap3_ae25.csv and those of 900 and 1500 mm/min: a slot cut by an
end mill of 25 mm with two teeth and a helix of 45°, 3 mm deep at 6000 rpm, fed along the dynamometer's Y. All three are
fitted at once. Exit code 1 where a floor is missed.

What is the same in every run, whatever the scores. It was not settled blindly, though: some seven weightings, per-tooth
terms, chains and priors were tried on these same recordings with their R² in sight, so R² here is no forecast for others:

- The model: force law with an edge force in each direction, every coefficient but the bend of the law one of each tooth;
  runout; a measuring chain of one resonance per axis, or of five that couple the axes. A static force passes either as it
  is. Laws are compared with one resonance per axis; the linear one, the classical one here, is held against the floor, and
  has the coupled chain.
- The weights: what such a model misses is no noise. It repeats with every turn and grows with the force, whose axes leak
  into each other: sigma is three tenths of the varying force of a trace, root mean square over its three axes; and, square
  to square, what does not repeat in a channel, which no such model can explain.
- The starts: coefficients from the mean forces, resonances at 1 or 2 kHz with 5 % damping, phases by alignment, runout a
  third or two thirds of the smallest feed per tooth. Of several starts the best by cost is taken. The five modes start from
  the resonances per axis, and from where most is left of the spectrum.
- What counts as data: one turn per trace and axis, the synchronous average, less its correlation.
"""

import argparse
import dataclasses
import platform
import time
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import millax as mx

mx.set_up()

from rich.console import Console  # noqa: E402

from identification import (  # noqa: E402
    Estimate,
    FitResult,
    Parameter,
    Prior,
    SynchronousAverage,
    Trace,
    align,
    check,
    fit,
    mean_force_fit,
    read_trace,
    synchronous_average,
)
from identification._compare import compare  # noqa: E402

from .figures import Figure, markdown, show  # noqa: E402

FEEDS = (300, 900, 1500)
AXES = {"X": "Fy", "Y": "Fx", "Z": "Fz"}
"""The axes of the dynamometer by the forces of the model: the feed is along its Y."""

FLOOR = {"X": (0.88, 0.89, 0.70), "Y": (0.92, 0.93, 0.85)}
AIM = {"X": (0.91, 0.94, 0.87), "Y": (0.92, 0.97, 0.93), "Z": (0.89, 0.88, 0.77)}
MEANS = 7.0
"""By how much mean forces may be off [N]."""

PUBLISHED = {"ktc": 958.86, "krc": 250.86, "kac": 146.36, "kte": 15.76, "kre": 19.43, "kae": 18.21}
"""From five feeds, [N/mm²] and [N/mm]."""

ANY_LAW = mx.LinearLaw(kt=1e9, kr=0.3, ka=0.1)
"""For what does not depend on the law."""

EARLIEST = 0.05
"""Time of the simulation from which it is compared [s]: what the start excites in the chain has died out."""

STARTS = ((1000.0, -8e-6), (2000.0, -16e-6))
"""Frequencies of resonances [Hz] and runout [m]."""

AGAIN = 1
"""How often a fit that is stuck goes on from where it is, with steps as bold as at first."""

MODES = 5

MISSED = 0.3
"""What is missed, in parts of the varying force."""

OFFSETS = Prior(mean=0.0, std=10.0)
"""Of a charge amplifier that drifts [N]."""

RESIDUES = Prior(mean=0.0, std=1.0)
"""What is known of a coupled chain: its residues are of the order of the static gain, 1."""


def case_of(feed: float, law: mx.ForceLaw, duration: float = 0.1) -> mx.Case:
    """The cut at a feed [mm/min]."""
    tables = {
        "tool": {"diameter": "25 mm", "teeth": 2, "helix": "45 deg", "runout": [0, "-16 um"]},
        "force": {"law": "linear", "kt": "1000 N/mm^2", "kr": 0.3},
        "cut": {"spindle_speed": "6000 rpm", "feed_rate": f"{feed} mm/min", "depth": "3 mm", "start": ["50 mm", 0]},
        "clock": {"start": f"{EARLIEST} s"},
        "simulation": {"duration": f"{duration} s"},
    }
    return dataclasses.replace(mx.load_case(tables), force=law)


@dataclasses.dataclass(frozen=True)
class Data:
    """The recordings: as they are, and the turn that repeats in each, with its weights."""

    whole: list[Trace]
    averages: list[SynchronousAverage]

    @property
    def turns(self) -> list[Trace]:
        return [weighted(average) for average in self.averages]


def weighted(average: SynchronousAverage) -> Trace:
    """With the sigma that the head of this file says."""
    missed = MISSED**2 * average.trace.values.var(axis=0).mean()
    sigma = {channel: float(np.sqrt(missed + rest**2)) for channel, rest in average.rest.items()}
    return dataclasses.replace(average.trace, noise=sigma)


def read(folder: Path) -> Data:
    columns = {"time": "Time", **{force: f"F{axis.lower()}" for axis, force in AXES.items()}}
    whole = [read_trace(folder / f"n6000_f{feed}_ap3_ae25.csv", columns=columns) for feed in FEEDS]
    return Data(whole, averaged(whole))


def averaged(traces: list[Trace]) -> list[SynchronousAverage]:
    return [synchronous_average(case_of(f, ANY_LAW), trace) for f, trace in zip(FEEDS, traces, strict=True)]


def laws(found: mx.LinearLaw) -> dict[str, tuple[mx.ForceLaw, list[Parameter]]]:
    """The laws that are compared, guessed from the coefficients of mean forces, and what they have beside coefficients of
    each tooth."""
    kt, edges = float(found.kt), {name: getattr(found, name) for name in ("kr", "ka", "ke", "kre", "kae")}
    alone = {"kr": found.kr, "ka": found.ka}
    bend = [Parameter("force.hs", bounds=("1 um", "1 mm")), Parameter("force.r", bounds=(0, 1))]
    exponent = [Parameter("force.m", bounds=(0.05, 1))]

    def power(m):  # as large as the linear law at 50 um
        return {"kf": kt * 50e-6 ** (1 - m), "m": m}

    def bent(hs):
        return {"k0": kt * (1 + 50e-6 / hs), "hs": hs, "r": 0.1}

    return {
        "linear": (mx.LinearLaw(kt=kt, **edges), []),
        "exponential": (mx.ExponentialLaw(**power(0.8), **edges), exponent),
        "fractional": (mx.FractionalLaw(**bent(100e-6), **edges), bend),
        "exponential, no edge": (mx.ExponentialLaw(**power(0.5), **alone), exponent),
        "fractional, no edge": (mx.FractionalLaw(**bent(20e-6), **alone), bend),
    }


def by_tooth(law: mx.ForceLaw, teeth: int = 2) -> tuple[mx.ForceLaw, list[Parameter]]:
    """The law with coefficients of each tooth, and these as free parameters; what bends it stays one number."""
    names = [name for name in ("kt", "k0", "kf", "kr", "ka", "ke", "kre", "kae") if getattr(law, name, None) is not None]
    listed = {name: jnp.full(teeth, getattr(law, name)) for name in names}
    return dataclasses.replace(law, **listed), [Parameter(f"force.{name}.{i}") for name in names for i in range(teeth)]


OF_TRACES = [
    Parameter("tool.runout.1"),
    Parameter("clock.start", each=True),
    *[Parameter(f"sensor.bias.{axis}", each=True, prior=OFFSETS) for axis in "xyz"],
]


def chain(resonances: mx.Resonances, names: list[str], prior: Prior | None) -> list[Parameter]:
    """The numbers of a measuring chain that are free: every frequency, damping ratio, and residues of these names."""
    modes = range(1, len(resonances.frequency) + 1)
    return [
        *[Parameter(f"sensor.resonances.frequency.mode_{m}", bounds=("0.4 kHz", "4.5 kHz")) for m in modes],
        *[Parameter(f"sensor.resonances.damping_ratio.mode_{m}", bounds=(0.01, 0.5)) for m in modes],
        *[Parameter(f"sensor.resonances.residue.{name}", prior=prior) for name in names],
    ]


def per_axis(frequency: float) -> tuple[mx.Resonances, list[Parameter]]:
    resonances = mx.Resonances.per_axis((frequency,) * 3, (0.05,) * 3)
    return resonances, chain(resonances, [f"mode_{m}.{a}.{a}" for m, a in zip((1, 2, 3), "xyz", strict=True)], None)


class Fitted(NamedTuple):
    """A fit and what was free in it."""

    result: FitResult
    parameters: list[Parameter]


def best_of(data: Data, cases_of_starts: list[list[mx.Case]], parameters: list[Parameter], say) -> Fitted:
    """The fit with the lowest cost; the starts share one compiled program."""
    results = []
    for cases in cases_of_starts:
        results.append(fit(cases, data.turns, parameters, check=False))
        say(f"  {len(results)} of {len(cases_of_starts)}: cost {results[-1].cost:.1f}, {results[-1].status}")
    best = min(results, key=lambda result: result.cost)
    for _ in range(AGAIN):
        if best.status != "not_converged":
            break
        best = fit(list(best.cases), data.turns, parameters, check=False)
        say(f"  from there: cost {best.cost:.2f}, {best.status}")
    return Fitted(best, parameters)


def fit_per_axis(data: Data, law: mx.ForceLaw, bend: list[Parameter], say) -> Fitted:
    """One resonance per axis."""
    law, coefficients = by_tooth(law)
    starts, parameters = [], []
    for frequency, runout in STARTS:
        resonances, parameters = per_axis(frequency)
        cases = []
        for feed, average in zip(FEEDS, data.averages, strict=True):
            case = case_of(feed, law)
            case = dataclasses.replace(case, tool=dataclasses.replace(case.tool, runout=(0.0, runout)))
            clock = dataclasses.replace(align(case, average.trace), speed_error=jnp.zeros(()))
            cases.append(dataclasses.replace(case, sensor=mx.Sensor(resonances=resonances), clock=clock))
        starts.append(cases)
    return best_of(data, starts, [*coefficients, *bend, *OF_TRACES, *parameters], say)


def fit_coupled(data: Data, before: FitResult, bend: list[Parameter], say) -> Fitted:
    """Modes that couple the axes, from the result with one resonance per axis."""
    own = resonances_of(before)
    more = [line.frequency for line in lines(before)]
    more = [f for i, f in enumerate(more) if f > 300 and f not in more[:i]][: MODES - 3]
    # Off the zero, or nothing would show in which direction the frequencies of the new ones have to go.
    residue = jnp.concatenate([jnp.clip(own.residue, -1.5, 1.5), jnp.zeros((len(more), 3, 3))]) + 0.05
    inner = jnp.clip(own.damping_ratio, 0.02, 0.3)
    resonances = mx.Resonances(
        jnp.concatenate([own.frequency, 1.02 * jnp.asarray(more)]), [*inner, *[0.1] * len(more)], residue
    )
    cases = [eqx.tree_at(lambda c: c.sensor.resonances, case, resonances) for case in before.cases]
    return best_of(data, [cases], coupled_parameters(resonances, before, bend), say)


def coupled_parameters(resonances: mx.Resonances, result: FitResult, bend: list[Parameter]) -> list[Parameter]:
    """What is free in a coupled fit with the law of a result."""
    names = [f"mode_{m + 1}.{a}.{b}" for m in range(len(resonances.frequency)) for a in "xyz" for b in "xyz"]
    return [*by_tooth(case_law(result))[1], *bend, *OF_TRACES, *chain(resonances, names, RESIDUES)]


def resonances_of(result: FitResult) -> mx.Resonances:
    sensor = result.cases[0].sensor
    assert sensor is not None
    assert sensor.resonances is not None
    return sensor.resonances


def case_law(result: FitResult) -> mx.ForceLaw:
    """The fitted law with the mean of the teeth: what `by_tooth` asks which coefficients there are."""
    return jax.tree.map(lambda x: jnp.mean(x), result.cases[0].force)


@dataclasses.dataclass(frozen=True)
class Line:
    """A line of the residuals: its amplitude [N] at a multiple of the spindle frequency."""

    axis: str
    feed: int
    multiple: int
    frequency: float
    amplitude: float

    def __str__(self):
        tooth = f" = {self.multiple // 2} × tooth" if self.multiple % 2 == 0 else ""
        return f"{self.frequency:.0f} Hz = {self.multiple} × spindle{tooth}"


def lines(result: FitResult) -> list[Line]:
    """Of what is left of the turns, all lines, the largest first."""
    found = []
    for feed, one in zip(FEEDS, result.traces, strict=True):
        n = 100  # one turn
        amplitude = 2 * np.abs(np.fft.rfft(one.residuals[:n], axis=0)) / n
        for axis, force in AXES.items():
            column = amplitude[:, one.trace.channels.index(force)]
            found += [Line(axis, feed, h, 100.0 * h, float(column[h])) for h in range(1, 50)]
    return sorted(found, key=lambda line: -line.amplitude)


def effective(result: FitResult) -> float:
    """How many independent numbers the residuals are: per channel (sum P)²/sum P² of the power P of their lines."""
    total = 0.0
    for one in result.traces:
        power = np.abs(np.fft.fft(one.residuals[:100] - one.residuals[:100].mean(axis=0), axis=0)) ** 2
        total += float(np.sum(power.sum(axis=0) ** 2 / (power**2).sum(axis=0)))
    return total


def misfit(result: FitResult) -> float:
    """Mean square of the residuals over sigma."""
    return float(np.mean([(one.residuals / [one.sigma[c] for c in one.trace.channels]) ** 2 for one in result.traces]))


def bic(result: FitResult, n: float) -> float:
    """n log(misfit) + k log(n): normal residuals of a size that is not known, n of them independent."""
    return n * np.log(misfit(result)) + len(result.parameters) * np.log(n)


def of_turn(result: FitResult, force: str) -> str:
    """R² of a force in the turns, feed by feed."""
    return " ".join(f"{one.r2[force]:.2f}" for one in result.traces)


def intervals(data: Data, fitted: Fitted, n: float) -> dict[str, float | None]:
    """Half of the 95 % intervals: from the Fisher information at the estimates, as if the residuals were n independent
    numbers of the size they have. None where a bound decides, or the measurements leave a parameter open."""
    result, samples = fitted.result, sum(one.residuals.size for one in fitted.result.traces)
    factor = np.sqrt(misfit(result) * samples / max(n - len(result.parameters), 1.0))
    free = [p for p in fitted.parameters if p.name not in {e.name for e in result.parameters if bounded(e)}]
    known = check(list(result.cases), data.turns, [dataclasses.replace(p, guess=None) for p in free])
    std = {prospect.name: prospect.std for prospect in known.parameters}
    found = {e.name: std.get(e.name) for e in result.parameters}
    return {name: None if one is None else float(1.96 * factor * one) for name, one in found.items()}


def bounded(e: Estimate) -> bool:
    """Whether an estimate is at a bound."""
    return any(b is not None and abs(e.value - b) <= 1e-3 * max(abs(b), 1e-9) for b in e.bounds)


def predicted(case: mx.Case, trace: Trace, speed_error: float) -> np.ndarray:
    """A fitted case beside a recording as it is, shape (samples, channels)."""
    assert case.clock is not None
    clock = mx.Clock(case.clock.start, speed_error)
    length = EARLIEST + 0.05 + (trace.time[-1] - trace.time[0])
    longer = mx.Settings.suited(case.tool, case.force, case.structure, case.cut, length)
    case = dataclasses.replace(case, clock=clock, settings=longer)
    return np.asarray(compare(trace, case).predict(mx.simulate(case), case)).T


def r2(measured: np.ndarray, model: np.ndarray) -> np.ndarray:
    return 1 - ((measured - model) ** 2).sum(axis=0) / ((measured - measured.mean(axis=0)) ** 2).sum(axis=0)


def scores(data: Data, result: FitResult, floor, aim) -> tuple[list[Figure], list[Figure]]:
    """R² of the whole recordings per axis and feed, and mean forces."""
    fits, means = [], []
    for i, (feed, trace, average) in enumerate(zip(FEEDS, data.whole, data.averages, strict=True)):
        model = predicted(result.cases[i], trace, average.speed_error)
        found = dict(zip(trace.channels, r2(trace.values, model), strict=True))
        sensor = result.cases[i].sensor
        assert sensor is not None
        bias = np.asarray(sensor.bias)
        for axis, force in AXES.items():
            least = floor.get(axis, (None,) * 3)[i]
            target = f"{'' if least is None else f'≥ {least:.2f}, '}aim {aim[axis][i]:.2f}, ceiling {average.r2[force]:.3f}"
            # As it is printed, so that the table agrees with itself.
            met = None if least is None else bool(round(float(found[force]), 3) >= least)
            fits.append(Figure(f"R² of {axis} at {feed} mm/min", f"{found[force]:.3f}", target, met))
            place = trace.channels.index(force)
            here, there = trace.values[:, place].mean(), model[:, place].mean()
            off = bias["xyz".index(force[1])]
            met = bool(abs(here - there) <= MEANS)
            words = f"{there:.1f} N, of which offset {off:.1f} N"
            means.append(Figure(f"mean of {axis} at {feed} mm/min", words, f"{here:.1f} ± {MEANS:g} N", met))
    order = [3 * i + j for j in range(3) for i in range(3)]
    return [fits[k] for k in order], [means[k] for k in order]


def halves(data: Data) -> tuple[Data, list[Trace]]:
    """The first half of every recording, to be fitted, and the second, to be predicted."""
    first, second = [], []
    for trace in data.whole:
        middle = trace.samples // 2
        first.append(dataclasses.replace(trace, time=trace.time[:middle], values=trace.values[:middle]))
        second.append(dataclasses.replace(trace, time=trace.time[middle:], values=trace.values[middle:]))
    return Data(first, averaged(first)), second


def prediction(data: Data, fitted: Fitted, say) -> list[Figure]:
    """R² of the second halves under the model of the first ones, beside what a fit of the whole has there."""
    first, second = halves(data)
    result = fitted.result
    again = best_of(first, [list(result.cases)], fitted.parameters, say).result
    found = []
    for i, feed in enumerate(FEEDS):
        whole, middle = data.whole[i], len(first.whole[i].time)
        of_half = predicted(again.cases[i], whole, first.averages[i].speed_error)[middle:]
        of_whole = predicted(result.cases[i], whole, data.averages[i].speed_error)[middle:]
        for axis, force in AXES.items():
            place = whole.channels.index(force)
            one, other = (r2(second[i].values, model)[place] for model in (of_half, of_whole))
            found.append(Figure(f"R² of {axis} at {feed} mm/min, second half", f"{one:.3f}", f"{other:.3f} fitted", None))
    return found


def estimates(data: Data, fitted: Fitted, n: float) -> list[Figure]:
    """Every estimate with its interval, but for residues."""
    half = intervals(data, fitted, n)
    return [
        Figure(e.name, f"{e.value:.5g} {e.unit}", "open" if half[e.name] is None else f"± {half[e.name]:.2g}", None)
        for e in fitted.result.parameters
        if not e.name.startswith("sensor.resonances.residue")
    ]


def classical(data: Data) -> tuple[mx.LinearLaw, list[Figure]]:
    """Coefficients from mean forces beside the published ones."""
    found = mean_force_fit([case_of(feed, ANY_LAW) for feed in FEEDS], data.whole)
    figures = []
    for one in found.coefficients:
        scale, unit = (1e6, "N/mm²") if one.name.endswith("c") else (1e3, "N/mm")
        assert one.value is not None, one.reason
        assert one.std is not None
        told = f"{one.value / scale:.1f} ± {one.std / scale:.1f} {unit}"
        figures.append(Figure(f"{one.name} of three feeds", told, f"{PUBLISHED[one.name]} {unit}, of five feeds", None))
    return found.law(), figures


def report(title: str, data: Data, fitted: Fitted, floor, page) -> None:
    """All pages of a fit."""
    result, n = fitted.result, effective(fitted.result)
    fits, means = scores(data, result, floor, AIM)
    page(f"{title}: R² of the whole recordings, {len(result.parameters)} parameters", fits)
    page(f"{title}: mean forces", means)
    page(f"{title}: numbers, 95 % intervals for {n:.0f} independent residuals", estimates(data, fitted, n))
    page(f"{title}: largest lines that are left", told(lines(result)))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="with the three recordings")
    parser.add_argument("--write", type=Path, metavar="FILE", help="also write the tables to a Markdown file")
    options = parser.parse_args()
    console, begin, pages, every = Console(width=130), time.perf_counter(), [], []

    def say(text: str) -> None:
        console.print(f"[{time.perf_counter() - begin:5.0f} s] {text}", highlight=False, markup=False)

    def page(title: str, figures: list[Figure]) -> None:
        every.extend(show(console, title, figures))
        pages.append(markdown(title, figures))

    data = read(options.folder)
    law, figures = classical(data)
    page("Coefficients from mean forces", figures)
    tried = {}
    for name, (guess, bend) in laws(law).items():
        say(f"one resonance per axis, {name} law")
        tried[name] = fit_per_axis(data, guess, bend, say)
    results = {name: fitted.result for name, fitted in tried.items()}
    n = effective(min(results.values(), key=misfit))
    least = min(bic(result, n) for result in results.values())
    rows = [
        Figure(
            f"{name}: {len(result.parameters)} parameters",
            f"{bic(result, n) - least:.1f}",
            f"X {of_turn(result, 'Fy')}, Y {of_turn(result, 'Fx')}, Z {of_turn(result, 'Fz')}",
            None,
        )
        for name, result in results.items()
    ]
    page(f"Laws: BIC above the least, with {n:.0f} independent residuals; R² of the turn that repeats", rows)
    report("One resonance per axis, linear law", data, tried["linear"], FLOOR, page)
    say(f"{MODES} coupled modes")
    coupled = fit_coupled(data, results["linear"], [], say)
    report(f"{MODES} coupled modes, linear law", data, coupled, {}, page)
    say("fits of the first halves")
    page("Coupled modes: the first half predicts the second", prediction(data, coupled, say))
    missed = [figure for figure in every if figure.met is False]
    made = f"Made in {time.perf_counter() - begin:.0f} s; {platform.machine()}, JAX {jax.__version__}."
    console.print(made)
    for figure in missed:
        console.print(f"missed: {figure.what}: {figure.measured}, target {figure.target}", style="bold red")
    if options.write:
        options.write.write_text("\n".join([HEAD, made, "", *pages]).rstrip() + "\n", encoding="utf-8")
    return 1 if missed else 0


def told(found: list[Line], count: int = 12) -> list[Figure]:
    """The largest lines in words."""
    return [Figure(f"{one.axis} at {one.feed} mm/min", f"{one.amplitude:.0f} N", str(one), None) for one in found[:count]]


HEAD = """# A measured slot

Made by `python -m benchmarks.measured_slot FOLDER --write docs/measured_slot.md`; the head of that file says what is fitted
and how it is weighed. Weights, per-tooth terms, chains and priors were settled while looking at R² of these same recordings,
after some seven weightings: the numbers are a description of them, no forecast for others. Differences of BIC below 4
between laws decide nothing. The offsets take up what the mean forces of the model miss.
"""


if __name__ == "__main__":
    raise SystemExit(main())
