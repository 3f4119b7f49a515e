# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # How sure is a coefficient?
#
# **Question.** A fit gives `k0 = 4915 ± 545 N/mm²`. When is that to be believed? Five things may be wrong with it: the
# optimum is not the best one, the likelihood is no parabola, the noise is not white, a few samples are far off, or nothing
# of it was to be known in the first place.
#
# The trace is synthetic, a short cut with a rigid tool: its truth is known.

# %%
import matplotlib.pyplot as plt
import numpy as np
from scipy.signal import lfilter

import millax as mx
from identification import NoiseModel, Parameter, Trace, check, fit, profile
from millax.plots import COLOURS, tidy

mx.set_up()

tool = mx.EndMill(diameter=0.02, teeth=4)
law = mx.FractionalLaw(k0=5e9, hs=18e-6, r=0.1, kr=0.3)
cut = mx.Cut.touching(tool, spindle_speed=10000 * 2 * np.pi / 60, feed_rate=4 / 60, depth=1e-3)
rigid = mx.Structure.rigid()
case = mx.Case(tool, law, cut, mx.Stock.box(), rigid, mx.Settings.suited(tool, law, rigid, cut, duration=0.03))
sim = mx.simulate(case)
clean, time = np.asarray(sim.force[:, :2]), np.asarray(sim.time)
rng = np.random.default_rng(0)
trace = Trace(time, ("Fx", "Fy"), clean + rng.normal(scale=2.0, size=clean.shape))
truth = {"force.k0": 5e9, "force.hs": 18e-6, "force.r": 0.1, "force.kr": 0.3}

# %% [markdown]
# ## Can it be known at all?
#
# Before anything is fitted, `check` looks at the Fisher information at the guess. Force is `k0` times depth: of the two
# together nothing but their product is known.

# %%
print(check(case, trace, ["force.k0", "cut.depth", "force.kr"]).message)

# %% [markdown]
# ## Is it the best optimum?
#
# Sixteen starts, each number off by up to a factor of five, in one compiled program.

# %%
guesses = [Parameter(name, 2.0 * value) for name, value in truth.items()]
found = fit(case, trace, guesses, starts=16, seed=1)
print(found.waterfall.words)
for e in found.parameters:
    print(f"{e.name} = {e.value:.4g} ± {e.std:.2g} {e.unit}")

# %% [markdown]
# ## Is the likelihood a parabola?
#
# A profile holds one parameter beside its estimate and fits the others again. Were standard errors the whole truth, the root
# of the rise of the cost would be a straight line. For `k0` and `hs` it is not: the farther from the estimate, the more it
# bends, and the intervals of both kinds differ at their ends.

# %%
profiles = {one.name: one for one in profile(found)}
figure, axes = plt.subplots(1, 4, figsize=(11, 2.9), sharey=True, layout="constrained")
for a, (name, one) in zip(axes, profiles.items(), strict=True):
    e = found[name]
    tidy(a)
    a.plot(one.values, one.root, ".-", color=COLOURS["x"])
    a.plot(one.values, (one.values - e.value) / e.std, "--", color="0.5", linewidth=0.8)
    a.axvspan(*one.ci95, color=COLOURS["x"], alpha=0.12, linewidth=0)
    a.axvline(truth[name], color=COLOURS["y"], linewidth=1)
    a.set_xlabel(f"{name} [{one.unit or '-'}]")
axes[0].set_ylabel("±√D [standard errors]")
figure.suptitle("profiles; dashed: standard error alone; shaded: 95 %; line: truth", fontsize=10)
plt.show()
assert all(p.ci95[0] < truth[name] < p.ci95[1] for name, p in profiles.items())

# %% [markdown]
# ## Is the noise white?
#
# Amplifiers, filters and vibrations of a machine make noise that remembers. Here each sample keeps 0.9 of the last one.
# Least squares is still right on average, but its usual standard error is too small. `fit` looks at what is left, says so
# and widens; with `NoiseModel(order=1)` the correlation is part of the fit, which then knows more.

# %%
remembered = lfilter([np.sqrt(1 - 0.9**2)], [1.0, -0.9], rng.normal(size=clean.shape), axis=0) * 2.0
coloured = Trace(time, ("Fx", "Fy"), clean + remembered)
widened = fit(case, coloured, guesses)
inside = fit(case, coloured, guesses, noise=NoiseModel(order=1))
print(widened.message)
for name, value in truth.items():
    a, b = widened[name], inside[name]
    print(
        f"{name}: as if white ± {a.std / a.widened:.2g}, widened ± {a.std:.2g}, in the fit ± {b.std:.2g}; "
        f"errors {a.value - value:+.2g}, {b.value - value:+.2g}"
    )
assert widened["force.kr"].widened > 2

# %% [markdown]
# ## Are there outliers?
#
# Two samples in a hundred are off by 100 N: chips, a loose cable. Squares follow them, and where they leave a number open
# they say so; Student's t lets them be.

# %%
shocks = np.where(rng.random(clean.shape) < 0.02, 100.0, 0.0)
spoilt = Trace(time, ("Fx", "Fy"), trace.values + shocks)
squares, robust = fit(case, spoilt, guesses), fit(case, spoilt, guesses, noise=NoiseModel("student"))
for name, value in truth.items():
    a, b = squares[name], robust[name]
    known = f"{a.value:.3g} ± {a.std:.2g}" if a.std else "not known"
    print(f"{name}: true {value:.3g}; squares {known}; Student's t {b.value:.3g} ± {b.std:.2g}")
assert abs(robust["force.kr"].value - 0.3) < 4 * robust["force.kr"].std
assert robust["force.kr"].std < 0.3 * squares["force.kr"].std

# %% [markdown]
# ## Pitfalls
#
# - An interval rests on the model being right. What the model misses is no noise: look at the spectrum of the residuals in
#   the report, and at lines in it.
# - A profile is as good as the optimum it starts from: fit from several starts first.
# - Widened intervals allow for correlation in time within a channel, not between channels.
# - Where a posterior is skewed, draw from it: `identification.sample`.
