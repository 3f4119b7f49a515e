"""How good a fit is: R² beside the ceiling, mean forces, lines that are left, laws beside each other, intervals."""

import dataclasses

import numpy as np

import millax as mx
from identification import Estimate, FitResult, Parameter, Tie, check, mean_force_fit

from ..figures import Figure
from .fits import Fitted, Say, best_of, predicted, spectrum
from .models import Free
from .recordings import ANY_LAW, AXES, FEEDS, TURN, TURNING, Data, case_of, halves

FLOOR = {"X": (0.88, 0.89, 0.70), "Y": (0.92, 0.93, 0.85)}
"""With one resonance per axis."""

AIM = {"X": (0.91, 0.94, 0.87), "Y": (0.92, 0.97, 0.93), "Z": (0.89, 0.88, 0.77)}
"""With coupled modes."""

MEANS = 7.0
"""By how much mean forces may be off [N]."""

PUBLISHED = {"ktc": 958.86, "krc": 250.86, "kac": 146.36, "kte": 15.76, "kre": 19.43, "kae": 18.21}
"""From five feeds, [N/mm²] and [N/mm]."""

LARGEST = 12
"""How many lines are told."""


def r2(measured: np.ndarray, model: np.ndarray) -> np.ndarray:
    return 1 - ((measured - model) ** 2).sum(axis=0) / ((measured - measured.mean(axis=0)) ** 2).sum(axis=0)


def scores(data: Data, result: FitResult, target: dict[str, tuple[float, ...]]) -> tuple[list[Figure], list[Figure]]:
    """R² of the whole recordings per axis and feed, and mean forces."""
    fits, means = [], []
    for i, (feed, trace, average) in enumerate(zip(FEEDS, data.whole, data.averages, strict=True)):
        model = predicted(result.cases[i], trace, average.speed_error)
        found = dict(zip(trace.channels, r2(trace.values, model), strict=True))
        sensor = result.cases[i].sensor
        assert sensor is not None
        bias = np.asarray(sensor.bias)
        for axis, force in AXES.items():
            ceiling = f"ceiling {average.r2[force]:.3f}"
            wanted, met = ceiling, None
            if axis in target:
                least = target[axis][i]
                # As it is printed, so that the table agrees with itself.
                wanted, met = f"≥ {least:.2f}, {ceiling}", bool(round(float(found[force]), 3) >= least)
            fits.append(Figure(f"R² of {axis} at {feed} mm/min", f"{found[force]:.3f}", wanted, met))
            place = trace.channels.index(force)
            here, there = trace.values[:, place].mean(), model[:, place].mean()
            off = bias["xyz".index(force[1])]
            met = bool(abs(here - there) <= MEANS)
            words = f"{there:.1f} N, of which offset {off:.1f} N"
            means.append(Figure(f"mean of {axis} at {feed} mm/min", words, f"{here:.1f} ± {MEANS:g} N", met))
    order = [3 * i + j for j in range(3) for i in range(3)]
    return [fits[k] for k in order], [means[k] for k in order]


def told(result: FitResult) -> list[Figure]:
    """The largest lines of what is left of the turns."""
    found = []
    for feed, one in zip(FEEDS, result.traces, strict=True):
        amplitude = 2 * np.abs(spectrum(one.residuals))
        for axis, force in AXES.items():
            column = amplitude[:, one.trace.channels.index(force)]
            found += [(float(size), axis, feed, h + 1) for h, size in enumerate(column)]
    return [
        Figure(f"{axis} at {feed} mm/min", f"{size:.0f} N", f"{TURNING * h:.0f} Hz = {multiple(h)}", None)
        for size, axis, feed, h in sorted(found, reverse=True)[:LARGEST]
    ]


def multiple(h: int) -> str:
    """In words."""
    return f"{h} × spindle = {h // 2} × tooth" if h % 2 == 0 else f"{h} × spindle"


def effective(result: FitResult) -> float:
    """How many independent numbers the residuals are: per channel (sum P)²/sum P² of the power P of their lines."""
    total = 0.0
    for one in result.traces:
        power = np.abs(np.fft.fft(one.residuals[:TURN] - one.residuals[:TURN].mean(axis=0), axis=0)) ** 2
        total += float(np.sum(power.sum(axis=0) ** 2 / (power**2).sum(axis=0)))
    return total


def misfit(result: FitResult) -> float:
    """Mean square of the residuals over sigma."""
    return float(np.mean([(one.residuals / [one.sigma[c] for c in one.trace.channels]) ** 2 for one in result.traces]))


def bic(result: FitResult, n: float) -> float:
    """n log(misfit) + k log(n): normal residuals of a size that is not known, n of them independent."""
    return n * np.log(misfit(result)) + len(result.parameters) * np.log(n)


def compared(results: dict[str, FitResult]) -> tuple[float, list[Figure]]:
    """Laws beside each other, and the number of independent residuals it is done with."""

    def of_turn(result: FitResult, force: str) -> str:
        return " ".join(f"{one.r2[force]:.2f}" for one in result.traces)

    n = effective(min(results.values(), key=misfit))
    least = min(bic(result, n) for result in results.values())
    return n, [
        Figure(
            f"{name}: {len(result.parameters)} parameters",
            f"{bic(result, n) - least:.1f}",
            f"X {of_turn(result, 'Fy')}, Y {of_turn(result, 'Fx')}, Z {of_turn(result, 'Fz')}",
            None,
        )
        for name, result in results.items()
    ]


def intervals(data: Data, fitted: Fitted, n: float) -> dict[str, float | None]:
    """Half of the 95 % intervals: from the Fisher information at the estimates, as if the residuals were n independent
    numbers of the size they have. None where a bound decides, or the measurements leave a parameter open."""
    result, samples = fitted.result, sum(one.residuals.size for one in fitted.result.traces)
    factor = np.sqrt(misfit(result) * samples / max(n - len(result.parameters), 1.0))
    held = {e.name for e in result.parameters if bounded(e)}
    free: Free = []
    for p in fitted.parameters:
        if isinstance(p, Parameter) and p.name not in held:
            free.append(dataclasses.replace(p, guess=None))
        elif isinstance(p, Tie) and p.to not in held:
            free.append(p)
    known = check(list(result.cases), data.turns, free)
    std = {prospect.name: prospect.std for prospect in known.parameters}
    found = {e.name: std.get(e.name) for e in result.parameters}
    return {name: None if one is None else float(1.96 * factor * one) for name, one in found.items()}


def bounded(e: Estimate) -> bool:
    """Whether an estimate is at a bound."""
    return any(b is not None and abs(e.value - b) <= 1e-3 * max(abs(b), 1e-9) for b in e.bounds)


def estimates(data: Data, fitted: Fitted) -> tuple[float, list[Figure]]:
    """Every estimate with its interval, but for residues; and for how many independent residuals that is."""
    n = effective(fitted.result)
    half = intervals(data, fitted, n)
    return n, [
        Figure(e.name, f"{e.value:.5g} {e.unit}", "open" if half[e.name] is None else f"± {half[e.name]:.2g}", None)
        for e in fitted.result.parameters
        if not e.name.startswith("sensor.resonances.residue")
    ]


def prediction(data: Data, fitted: Fitted, say: Say) -> list[Figure]:
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


def classical(data: Data) -> tuple[mx.LinearLaw, list[Figure]]:
    """Coefficients from mean forces beside the published ones."""
    found = mean_force_fit([case_of(feed, ANY_LAW) for feed in FEEDS], data.whole)
    figures = []
    for one in found.coefficients:
        scale, unit = (1e6, "N/mm²") if one.name.endswith("c") else (1e3, "N/mm")
        assert one.value is not None, one.reason
        assert one.std is not None
        words = f"{one.value / scale:.1f} ± {one.std / scale:.1f} {unit}"
        figures.append(Figure(f"{one.name} of three feeds", words, f"{PUBLISHED[one.name]} {unit}, of five feeds", None))
    return found.law(), figures
