# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # What if: sweeps over speed, depth and uncertain coefficients
#
# **Question.** A slot is to be cut on a spindle whose first mode is known. Which spindle speed and depth leave the tool
# quiet? And how sure is a prediction, given that the coefficients in it come from a fit?
#
# Both are the same task: simulate one case many times with other numbers in it. `millax.sweep` does that on all cores,
# keeps of every simulation what is asked for, and returns it with names and units.
#
# The cut starts in full material (`start`): at these feeds the tool would need up to half a second to enter it.

# %%
from pathlib import Path

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import millax as mx
from identification import fit, load_fit
from millax.plots import COLOURS, plot_sweep, tidy

mx.set_up()  # double precision, and faster code
mx.use_all_cores()  # before anything is computed

case = mx.load_case(
    {
        "tool": {"diameter": "20 mm", "teeth": 4},
        "force": {"law": "fractional", "k0": "5000 N/mm^2", "hs": "18 um", "r": 0.1, "kr": 0.3},
        "cut": {"spindle_speed": "10000 rpm", "feed_per_tooth": "0.1 mm", "depth": "1 mm", "start": ["20 mm", "0 mm"]},
        "structure": {"axes": ["x", "y"], "mass": "5 kg", "stiffness": "20 N/um", "damping_ratio": 0.03},
        "simulation": {"duration": "0.1 s", "tolerance": 1e-9},  # far below what is left of a vibration that dies away
    }
)
mode = float(jnp.sqrt(case.structure.stiffness / case.structure.mass) / (2 * jnp.pi))
print(f"the mode is at {mode:.0f} Hz: as fast as the teeth at {mode * 60 / case.tool.teeth:.0f} rpm")

# %% [markdown]
# ## Every combination of speed and depth
#
# Numbers are named as in a case file. A feed per tooth is held here: a case holds the feed *rate*, and at the same rate
# faster teeth would cut thinner chips.
#
# What is kept of a simulation is computed with it, so that traces need not be. Some reductions come with millax; any
# function of a `Simulation` can be added. Here: in a stable cut every tooth finds the tool where the tooth before it did.
# Sampled once per tooth period, the displacement wanders until the start has died away. If it does not wander less in the
# last quarter of the cut than in the quarter before, the cut is unstable.

# %%


def growth(sim, case):
    """Wander of the displacement, sampled once per tooth period: in the last quarter over that in the quarter before [-]."""
    per_tooth = slice(None, None, case.settings.steps_per_tooth)
    time, u = sim.time[per_tooth, None] / jnp.nanmax(sim.time), sim.displacement[per_tooth]
    before = jnp.nanstd(jnp.where((time > 0.5) & (time < 0.75), u, jnp.nan), axis=0)
    last = jnp.nanstd(jnp.where(time > 0.75, u, jnp.nan), axis=0)
    return jnp.linalg.norm(last) / jnp.linalg.norm(before)


# %% [markdown]
# The tooth period depends on the speed, and so does the number of time steps in 0.1 s. Members of different length share
# a program; behind its own end the trace of a member is NaN, hence `nanmax` and `nanstd`.

# %%
grid = {"cut.spindle_speed": "3500:14000:29 rpm", "cut.depth": "0.2:3.2:16 mm", "cut.feed_per_tooth": "0.1 mm"}
result = mx.sweep(case, grid=grid, reduce={**mx.REDUCTIONS, "growth": growth})
print(f"{result['status'].size} members, {int((result['status'] != 0).sum())} of them failed")
print(result)

# %%
figure = plot_sweep(result, "std_displacement")
plt.show()

# %% [markdown]
# Vibration has two causes, which this picture mixes: the teeth force the tool to vibrate, at any depth, and most where they
# pass as fast as the mode swings or at a fraction of that; and a deep cut excites itself. `growth` tells them apart: below 1
# what the start has set off dies away, and only the teeth are left. Members that failed swung further than the radius
# of the tool.

# %%
speeds, depths = result["cut.spindle_speed"], result["cut.depth"]
unstable = (result["growth"] > 0.95) | (result["status"] != 0)
limit = depths.where(unstable).min("cut.depth")

figure, axes = plt.subplots(figsize=(8, 3.6), layout="constrained")
shown = result["growth"].where(result["status"] == 0, np.inf).clip(max=2)
image = axes.pcolormesh(speeds, depths, shown.T, shading="nearest", cmap="RdBu_r", vmin=0, vmax=2)
axes.step(speeds, limit, where="mid", color="black", linewidth=1, label="lowest depth that is unstable")
figure.colorbar(image, label="growth over a quarter of the cut [-]", extend="max")
axes.set(xlabel="spindle speed [rpm]", ylabel="axial depth of cut [mm]", title="blue: stable; red: the cut excites itself")
axes.legend(loc="upper right")
plt.show()

best = speeds[int(np.argmax(limit.fillna(np.inf).to_numpy()))]
print(f"the deepest stable cut is at {float(best):.0f} rpm")
assert not unstable.sel({"cut.depth": 0.2}).any()
assert abs(float(best) * case.tool.teeth / 60 / mode - 1) < 0.05

# %% [markdown]
# The best speed is the one at which a tooth passes as often as the mode swings: every tooth then meets the wave that the
# one before left behind in step with its own, and the chip hardly changes. It is also where the forced vibration is
# largest. Far above the limit the tool leaves the cut in every swing; the vibration then neither grows nor dies away.

# %% [markdown]
# ## How sure is a prediction?
#
# Notebook 01 fits seven parameters to a trace. Their standard errors are not independent: $k_0$ and $h_s$ are almost
# perfectly correlated. What does that leave open in a cut that was not measured, twice as deep?
#
# Random members are drawn from the fit's estimates, once with the correlation and once without it.

# %%
problem = load_fit(Path("../data_synthetic/kr240_slot.toml"))
fitted = fit(problem.cases, problem.traces, problem.parameters)
estimates = {e.name: f"{e.value} ± {e.std} {e.unit}" for e in fitted.parameters}

spread = {}
for label, correlation in {"with": fitted.correlation, "without": None}.items():
    samples = mx.sample(estimates, 64, seed=0, method="sobol", correlation=correlation)
    members = mx.sweep(fitted.case, samples={**samples, "cut.depth": "2 mm"}, reduce=["mean_force", "peak_displacement"])
    assert (members["status"] == 0).all()
    spread[label] = 100 * members["mean_force"].std("sample") / abs(members["mean_force"].mean("sample"))
    forces = "  ".join(f"F{axis} {float(spread[label].sel(axis=axis)):.3f} %" for axis in "xy")
    print(f"standard error of the mean force at 2 mm, {label:7} the correlation: {forces}")

# %% [markdown]
# Taken as independent, the errors of $k_0$, $h_s$ and $r$ would make the forecast look many times less certain than it is.
# What the fit does not know, it does not know *along* a direction in which the force hardly changes.

# %%
figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
for offset, (label, percent) in zip((-0.2, 0.2), spread.items(), strict=True):
    colours = [COLOURS[axis] for axis in "xy"]
    bars = axes.bar(
        np.arange(2) + offset, percent.sel(axis=["x", "y"]), 0.36, color=colours, alpha=1.0 if label == "with" else 0.4
    )
    axes.bar_label(bars, [f"{label}"] * 2, fontsize="small")
axes.set_xticks([0, 1], ["$F_x$", "$F_y$"])
axes.set(ylabel="standard error [%]", title="mean force at 2 mm")
tidy(axes)
plt.show()
assert spread["with"].sel(axis="y") < 0.5 * spread["without"].sel(axis="y")

# %% [markdown]
# ## Long sweeps
#
# With a file, everything that is done is kept while the sweep is under way. Stop it, let the machine crash: the same call
# goes on where it was, and refuses to if the case, the numbers or a function have changed in between.
#
# ```python
# mx.sweep(case, grid=grid, out="lobes.nc")
# ```
#
# The same on the command line: `millax sweep case.toml --vary "cut.depth=0.2:3.2:16 mm" --out lobes.nc`. On more than one
# machine, with [Dask](https://distributed.dask.org): `mx.sweep(case, grid=grid, out="lobes.nc",
# client=distributed.Client("tcp://..."))`. Start its workers with one thread per core.
#
# ## Pitfalls
#
# - **What is held?** Varying the speed holds the feed rate, unless `cut.feed_per_tooth` is given. Varying the diameter
#   holds `cut.start`: the tool then no longer touches the border at $t = 0$. Vary `cut.start.x` with it, as samples.
# - **Long enough?** Reductions look at the last half of a trace. A slow tool may still be entering the workpiece then, a
#   weakly damped one still ringing, and near the limit of stability vibrations grow slowly: simulate longer, and see
#   whether the limit moves.
# - **A failed member is NaN**, never a number; `status` says why (`millax.STATUS`). Count them before you average.
# - **A large deflection is extrapolation.** The model is linear in the structure; an unstable cut ends in loss of contact,
#   which it describes, or in a broken tool, which it does not.
# - **Random members of what?** Standard errors hold the noise of one trace and nothing else. See the pitfalls of
#   notebook 01.
