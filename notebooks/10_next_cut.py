# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # The next cut
#
# One cut is measured, and the force law is fitted. Two of its numbers are poorly known. Another cut costs an hour of the
# machine: **at which feed and depth does it tell most?** The gradients know before it is made.
#
# The trace is synthetic: the truth is known.

# %%
import matplotlib.pyplot as plt
import numpy as np

import millax as mx
from identification import Parameter, design, fit, synthetic_trace
from millax.plots import tidy

mx.set_up()

tool = mx.EndMill(diameter=0.02, teeth=4)
truth = mx.FractionalLaw(k0=5e9, hs=18e-6, r=0.1, kr=0.3)
noise = {"Fx": 2.0, "Fy": 2.0}  # N
time = 0.002 + np.arange(500) / 10e3  # 50 ms at 10 kHz


def cut(feed_per_tooth: float, depth: float, law: mx.FractionalLaw = truth) -> mx.Case:
    speed = 10000 * 2 * np.pi / 60
    cut = mx.Cut(speed, feed_per_tooth * tool.teeth * speed / (2 * np.pi), depth, start=(0.03, 0.0))
    rigid = mx.Structure.rigid()
    return mx.Case(tool, law, cut, mx.Stock.box(), rigid, mx.Settings.suited(tool, law, rigid, cut, 0.054))


first = synthetic_trace(cut(40e-6, 1e-3), time, ("Fx", "Fy"), noise, seed=0, name="first")
names = ("force.k0", "force.hs", "force.r", "force.kr")
units = ("N/mm^2", "um", None, None)
guess = [Parameter(name, unit=unit) for name, unit in zip(names, units, strict=True)]
known = fit(cut(40e-6, 1e-3, mx.FractionalLaw(k0=4e9, hs=30e-6, r=0.2, kr=0.4)), first, guess)
for e in known.parameters:
    print(f"{e.name} = {e.value:.4g} ± {e.std:.2g} {e.unit}")

# %% [markdown]
# Chips of 40 µm show little of where the law ends up for thick ones: $r$ and $h_s$ are known to some percent, and their
# errors go together.
#
# ## What each candidate would tell
#
# The information of the first cut is $J^\top J$, with $J$ the derivatives of its trace in units of the noise. A candidate
# adds its own, $J_c^\top J_c$, which needs no measurement, only the model at the estimates. The volume of the ellipsoid of
# confidence after both, $\det(J^\top J + J_c^\top J_c)^{-1/2}$, is what D-optimal design makes small.

# %%
grid = {"cut.feed_per_tooth": "0.02:0.2:10 mm", "cut.depth": "0.5, 1, 1.5, 2 mm"}
found = design(known.case, first, guess, grid, count=2)
print("next:", found.next[0].words, f"(errors shrink {found.next[0].shrinks(found.today):.2g} times)")
print("then:", found.next[1].words)
for name in names:
    print(f"{name}: today ± {found.today.std[name]:.2g}, then ± {found.next[0].std[name]:.2g}")

# %% [markdown]
# ## Is it true?
#
# The cut is made, and both traces are fitted together. Beside it the lazy choice: the first cut once more.

# %%
feed, depth = (1e-3 * value for value, _ in found.next[0].cut.values())
choices = {"the first cut again": (40e-6, 1e-3), "the best candidate": (feed, depth)}
results = {}
for name, (its_feed, its_depth) in choices.items():
    second = synthetic_trace(cut(its_feed, its_depth), time, ("Fx", "Fy"), noise, seed=1, name=name)
    cases = [cut(40e-6, 1e-3, known.case.force), cut(its_feed, its_depth, known.case.force)]
    results[name] = fit(cases, [first, second], guess)
    print(name, {e.name: f"{e.value:.4g} ± {e.std:.2g}" for e in results[name].parameters})

best = results["the best candidate"]
for e in best.parameters:
    assert abs(np.log(e.std / found.next[0].std[e.name])) < 0.4, e.name  # predicted at the estimates, not at the truth
exact = {"force.k0": 5000.0, "force.hs": 18.0, "force.r": 0.1, "force.kr": 0.3}
assert all(abs(e.value - exact[e.name]) < 4 * e.std for e in best.parameters)
assert best["force.r"].std < 0.6 * results["the first cut again"]["force.r"].std

# %%
figure, (chart, bars) = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained")
shrinks = found.today.uncertainty / found.table["uncertainty"]
image = chart.pcolormesh(shrinks["cut.feed_per_tooth"], shrinks["cut.depth"], shrinks.T, shading="nearest")
figure.colorbar(image, label="standard errors shrink by this factor")
chart.plot(1e3 * feed, 1e3 * depth, "*", color="#D55E00", markeredgecolor="white", markersize=16)
chart.set(xlabel="feed per tooth [mm]", ylabel="axial depth [mm]")
rows = {"first cut": known} | results
for i, (name, result) in enumerate(rows.items()):
    errors = [100 * e.std / exact[e.name] for e in result.parameters]
    bars.bar(np.arange(4) + 0.25 * (i - 1), errors, 0.25, label=name)
bars.plot(
    np.arange(4) + 0.25,
    [100 * found.next[0].std[name] / exact[name] for name in names],
    "_",
    color="black",
    markersize=14,
    label="predicted",
)
bars.set(xticks=range(4), xticklabels=[name.partition(".")[2] for name in names], ylabel="standard error [% of the truth]")
bars.set_yscale("log")
bars.legend(frameon=False)
tidy(bars)
plt.show()

# %% [markdown]
# ## Pitfalls
#
# - The forecast is that of a right model. A thick chip that breaks the tool, a spindle that cannot hold the speed, a law
#   that is another one there: the design does not know. Leave out of the grid what cannot be done.
# - Derivatives are those at the estimates. Where these are poor, ask again after the cut.
# - A candidate that chatters is left out: its derivatives grow with the vibration, and promise what a model that is a
#   little wrong takes back.
# - White noise, sampled twice as fast, would be worth twice the measurements. Give the noise at the rate of your samples.
# - The best of a grid is often at its end, as here. The end is a decision too.
