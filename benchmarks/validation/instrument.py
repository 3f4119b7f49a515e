"""Traces of an instrument: how exactly the model is read for them; coefficients, runout, sensor and clock found together."""

import dataclasses
from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np

import millax as mx
from identification import Parameter, align, fit, mean_force_fit, synthetic_trace
from identification._resample import PASSBAND, kernel, resample
from millax._names import replace, value_of

from ..figures import Figure, below

SEEDS, MORE = 5, 20
TIME = 3.0 + np.arange(2000) / 10e3
"""0.2 s at 10 kHz, from a recorder that has been running."""

NOISE = {"Fx": 1.0, "Fy": 1.0}
WRONG = {
    "force.k0": 0.7,
    "force.hs": 1.7,
    "tool.runout.1": 0.5,
    "sensor.bias.x": 0.0,
    "sensor.bias.y": 0.0,
    "sensor.resonances.frequency.mode_1": 0.9,
    "sensor.resonances.frequency.mode_2": 1.1,
    "sensor.resonances.damping_ratio.mode_1": 2.0,
    "sensor.resonances.damping_ratio.mode_2": 0.5,
}
"""The guesses over the truth; of the clock nothing is known."""


def figures():
    yield from _reading()
    yield from _recovery()
    yield from _means()


def case() -> mx.Case:
    """A rigid slot with runout, recorded by a dynamometer with a resonance along x and one along y."""
    tool = mx.EndMill(0.02, 4, runout=(0.0, -8e-6, 3e-6, 5e-6))
    law = mx.FractionalLaw(k0=5e9, hs=18e-6, r=0.1, kr=0.3)
    cut = mx.Cut(10000 * 2 * np.pi / 60, 4 / 60, 1e-3, (0.02, 0.0))
    rigid = mx.Structure.rigid()
    sensor = mx.Sensor(
        bias=(12.0, -7.0, 0.0),
        resonances=mx.Resonances.per_axis((1500.0, 1900.0), (0.05, 0.04), ("x", "y")),
        low_pass=mx.LowPass(3500.0, 2),
    )
    settings = mx.Settings.suited(tool, law, rigid, cut, 0.25)
    return mx.Case(tool, law, cut, mx.Stock.box(), rigid, settings, sensor, mx.Clock(0.0217, 8e-5))


def _reading() -> Iterator[Figure]:
    """Tones, as the means over steps that the engine gives, at the times of a clock of its own."""
    steps, rng = 4000, np.random.default_rng(0)
    for words, cutoff in (("finer than the model", 0.8), ("coarser", 0.2)):
        band, position = kernel(cutoff), 500 + np.sort(rng.uniform(0, 3000, 2000))
        kept, gone = 0.0, 0.0
        for tone in np.linspace(0.02, 0.99, 25) * PASSBAND * min(cutoff, 0.5):
            mean = np.sinc(tone) * np.exp(2j * np.pi * tone * np.arange(steps))
            found = np.asarray(resample(jnp.asarray([mean.real, mean.imag]), jnp.asarray(position), band))
            kept = max(kept, float(np.abs(found[0] + 1j * found[1] - np.exp(2j * np.pi * tone * position)).max()))
        yield below(
            f"trace {words}: largest error of a tone up to 0.8 of the lower Nyquist frequency", 100 * kept, 0.01, unit=" %"
        )
        if cutoff < 0.5:
            for tone in np.linspace(1.01 * cutoff, 0.5, 25):
                mean = np.sinc(tone) * np.cos(2 * np.pi * tone * np.arange(steps) + 0.3)
                found = np.asarray(resample(jnp.asarray([mean]), jnp.asarray(position), band))
                gone = max(gone, float(np.abs(found).max()))
            yield below(f"trace {words}: what is left of a tone beyond its Nyquist frequency", 100 * gone, 0.01, unit=" %")


def _recovery() -> Iterator[Figure]:
    true = case()
    guess = {name: jnp.asarray(factor * value_of(true, name)) for name, factor in WRONG.items()}
    start = dataclasses.replace(replace(true, guess), clock=mx.Clock(0.02))
    names = [*WRONG, "clock.start", "clock.speed_error"]
    errors = []
    for seed in range(MORE):
        trace = synthetic_trace(true, TIME, ("Fx", "Fy"), NOISE, seed)
        aligned = dataclasses.replace(start, clock=align(start, trace))
        result = fit(aligned, trace, [Parameter(name) for name in names])
        if not result.success:
            yield Figure(f"seed {seed}", result.status, "converged", False)
            continue
        errors.append([(e.value - value_of(true, e.name)) / e.std for e in result.parameters if e.std])
        if seed < SEEDS:
            worst = int(np.argmax(np.abs(errors[-1])))
            words = f"seed {seed}: largest of {len(names)} errors, in standard errors ({names[worst]})"
            yield below(words, abs(errors[-1][worst]), 3.5)
    spread = np.sqrt(np.mean(np.square(errors)))
    yield Figure(f"{MORE} seeds: errors over the standard errors given", f"{spread:.3f}", "0.9 to 1.1", 0.9 <= spread <= 1.1)


def _means() -> Iterator[Figure]:
    """Mean forces of the engine, of a linear law with edge forces, at three feeds."""
    law = mx.LinearLaw(kt=9e8, kr=0.3, ke=1.5e4, kre=1.8e4, ka=0.15, kae=1.2e4)
    tool, rigid = mx.EndMill(0.025, 2), mx.Structure.rigid()
    cases, traces = [], []
    for feed in (0.3, 0.9, 1.5):
        cut = mx.Cut(6000 * 2 * np.pi / 60, feed / 60, 3e-3, (0.05, 0.0))
        one = mx.Case(tool, law, cut, mx.Stock.box(), rigid, mx.Settings.suited(tool, law, rigid, cut, 0.1))
        time = (np.arange(one.settings.steps) + 0.5) * float(cut.tooth_period(tool)) / one.settings.steps_per_tooth
        cases.append(one)
        traces.append(synthetic_trace(one, time, ("Fx", "Fy", "Fz")))
    found = mean_force_fit(cases, traces)
    true = {"ktc": 9e8, "krc": 2.7e8, "kac": 1.35e8, "kte": 1.5e4, "kre": 1.8e4, "kae": 1.2e4}
    for name, value in true.items():
        estimate = found[name].value
        assert estimate is not None
        yield below(f"mean forces at three feeds: {name} beside the truth", 100 * abs(estimate / value - 1), 2.0, unit=" %")
