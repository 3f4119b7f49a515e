# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # A trace as a dynamometer records it
#
# **Question.** A dynamometer has a resonance, its amplifier an offset, and its clock began at no particular moment of the
# cut. What do the coefficients become when that is ignored, and can it be found from the same trace?
#
# The two recordings are synthetic: their truth is known. They were made with time steps twice as fine as those of the fits.

# %%
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import millax as mx
from identification import Parameter, Trace, align, fit, mean_force_fit, synthetic_trace
from millax.plots import COLOURS, tidy

mx.set_up()

tool = mx.EndMill(diameter=0.02, teeth=2, runout=(0.0, -6e-6))
law = mx.LinearLaw(kt=9e8, kr=0.3, ke=1.5e4, kre=1.8e4)
sensor = mx.Sensor(bias=(14.0, -9.0, 0.0), resonances=mx.Resonances.per_axis((1300.0, 1100.0), (0.06, 0.05), ("x", "y")))
feeds = (1.2, 3.0)  # m/min
clocks = (mx.Clock(0.0263, 6e-5), mx.Clock(0.0231, -4e-5))


def cut(feed: float, **others) -> mx.Case:
    cut = mx.Cut(spindle_speed=6000 * 2 * np.pi / 60, feed_rate=feed / 60, depth=2e-3, start=(0.03, 0.0))
    rigid = mx.Structure.rigid()
    return mx.Case(tool, law, cut, mx.Stock.box(), rigid, mx.Settings.suited(tool, law, rigid, cut, 0.34), **others)


# %% [markdown]
# ## What is recorded
#
# The model of the instrument, in millax part of the case:
#
# $$\text{measured}(t) = \text{bias} + \text{gain}\cdot\bigl(F + \textstyle\sum_m R_m\,(H_m - 1)\,F\bigr)(t),\qquad
# H_m(s) = \frac{\omega_m^2}{s^2 + 2\zeta_m\omega_m s + \omega_m^2},$$
#
# read at $t = \text{start} + (1 + e)\,(t_\text{trace} - t_1)$: the phase of the spindle, and a speed that is off by $e$. The
# trace has 10 kHz; what such a trace cannot hold is filtered out of the model before it is compared.

# %%
time = 12.0 + np.arange(3000) / 10e3  # 0.3 s at 10 kHz; the recorder had been running for 12 s


def recorded(feed: float, clock: mx.Clock, seed: int) -> Trace:
    true = cut(feed, sensor=sensor, clock=clock).with_settings(steps_per_tooth=128)
    noisy = synthetic_trace(true, time, ("Fx", "Fy"), {"Fx": 3.0, "Fy": 3.0}, seed, f"{feed:g} m/min")
    return replace(noisy, noise={})  # nobody tells the fit


traces = [recorded(feed, clock, seed) for seed, (feed, clock) in enumerate(zip(feeds, clocks, strict=True))]

# %% [markdown]
# ## A start that needs no guess
#
# Mean forces neither know a resonance nor a phase, but they keep the offsets: with two feeds the slopes are right, and the
# edge forces take what the offsets add.

# %%
plain = [cut(feed) for feed in feeds]
means = mean_force_fit(plain, traces)
for name in ("ktc", "krc", "kte", "kre"):
    print(f"{name}: {means[name].value:.4g} {means[name].unit}")

# %% [markdown]
# ## The clock
#
# `align` compares amplitudes and phases at multiples of the spindle frequency. It is a guess, good to a few degrees of
# spindle rotation: the fit does the rest.

# %%
start = replace(means.law(), ka=None, kae=None)
blind = [replace(case, force=start, clock=mx.Clock(0.02)) for case in plain]
blind = [replace(case, clock=align(case, trace)) for case, trace in zip(blind, traces, strict=True)]
for case, clock in zip(blind, clocks, strict=True):
    print(f"start {1e3 * float(case.clock.start):.2f} ms (truth {1e3 * float(clock.start):.2f} ms), ", end="")
    print(f"speed off by {1e6 * float(case.clock.speed_error):.0f} ppm (truth {1e6 * float(clock.speed_error):.0f} ppm)")

# %% [markdown]
# ## Without and with the instrument
#
# The clocks belong to each trace, `each=True`; coefficients and runout are shared. The second fit adds offsets of each
# trace and one resonance per axis, guessed 20 % off.

# %%
names = ("force.kt", "force.kr", "force.ke", "force.kre")
shared = [*names, Parameter("tool.runout.1", unit="um")]
clock = [Parameter("clock.start", each=True), Parameter("clock.speed_error", each=True)]
ignored = fit(blind, traces, [*shared, *clock], check=False)

guessed = mx.Sensor(resonances=mx.Resonances.per_axis((1600.0, 900.0), (0.1, 0.1), ("x", "y")))
whole = [replace(case, sensor=guessed) for case in blind]
instrument = [Parameter(f"sensor.bias.{axis}", each=True) for axis in "xy"]
instrument += [Parameter(f"sensor.resonances.{key}.mode_{i}") for key in ("frequency", "damping_ratio") for i in (1, 2)]
found = fit(whole, traces, [*shared, *clock, *instrument])
print(found.status, found.message)

truth = {"force.kt": law.kt, "force.kr": law.kr, "force.ke": law.ke, "force.kre": law.kre, "tool.runout.1": -6.0}
for name, value in truth.items():
    e = found[name]
    print(f"{name}: truth {float(value):.4g}, ignored {ignored[name].value:.4g}, found {e.value:.4g} ± {e.std:.2g} {e.unit}")

# %% [markdown]
# Ignored, the resonance is mistaken for cutting: the coefficients are off by many standard errors, and the fit says nothing
# about it but its residuals. With the instrument in the model they are found, and so is the instrument. Only the runout is
# off by more than its error: by 0.3 µm, what 64 time steps per tooth leave (0.1 % of the force).

# %%
errors = {name: (found[name].value - float(truth[name])) / found[name].std for name in names}
assert max(map(abs, errors.values())) < 4, errors
assert abs(found["tool.runout.1"].value - truth["tool.runout.1"]) < 0.5
assert abs(found["sensor.resonances.frequency.mode_1"].value - 1300) < 4 * found["sensor.resonances.frequency.mode_1"].std
assert abs(ignored["force.kr"].value - float(law.kr)) > 20 * found["force.kr"].std

figure, panels = plt.subplots(1, 2, figsize=(11, 3.4), layout="constrained", sharey=True)
part = slice(0, 200)
for axes, result, title in zip(panels, (ignored, found), ("instrument ignored", "instrument found"), strict=True):
    one = result.traces[1]
    since = 1e3 * (one.trace.time[part] - one.trace.time[0])
    axes.plot(since, one.trace.values[part, 1], ".", markersize=4, color="0.6", label="measured $F_y$")
    axes.plot(since, one.fitted[part, 1], color=COLOURS["y"], linewidth=1, label="model")
    axes.set(title=f"{title}: R² {one.r2['Fy']:.3f}", xlabel="time since the first sample [ms]")
    tidy(axes)
panels[0].set(ylabel="force [N]", ylim=(-150, 680))
panels[1].legend(frameon=False, loc="upper center", ncols=2)
plt.show()

# %% [markdown]
# ## Pitfalls
#
# - A resonance far above the harmonics that the cut has is not told by it: give it bounds, a prior, or leave it out.
# - The delay of the forces and the start of the clock are the same to forces alone. Free one of them.
# - With equal teeth the phase is known up to a tooth. Runout tells them apart, and may have a second optimum with the teeth
#   exchanged: start from both.
# - The first moments of a simulation hold the transient of the sensor. Let `clock.start` be later, by a few $1/\zeta\omega$.
