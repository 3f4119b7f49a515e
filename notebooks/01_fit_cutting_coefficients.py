# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Cutting coefficients, damping and stiffness from one cut
#
# **Question.** A robot mills a slot. Forces are measured under the workpiece, displacements at the spindle. Which force
# law, and which structure, made these traces, and how well do the traces tell?
#
# The trace is synthetic: the truth is known, so every answer can be checked. It was simulated with time steps four times
# finer than those used below, with white sensor noise of 2 N and 1 µm (`data_synthetic/README.md`).

# %%
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import millax as mx
from identification import Parameter, fit, load_fit
from millax.plots import COLOURS, tidy

mx.set_up()  # double precision, and faster code

problem = load_fit(Path("../data_synthetic/kr240_slot.toml"))
case, (trace,) = problem.case, problem.traces
measured = dict(zip(trace.channels, trace.values.T, strict=True))
tooth_period = float(case.cut.tooth_period(case.tool))

# %% [markdown]
# ## The model
#
# A tooth that meets the chip thickness $h$ feels, per unit of axial depth $a$, the tangential force
#
# $$\frac{F_t}{a} = k_0 h_s\,\frac{u + r u^2}{1 + u},\qquad u = \frac{h}{h_s},\qquad F_r = k_r F_t.$$
#
# Its slope is $k_0$ for thin chips and falls to $r k_0$ for thick ones; $h_s$ is where it bends. The chip thickness is
# what the tool's path $c(t)$ leaves between this tooth and those before it,
#
# $$h \approx \max\bigl(0,\ \min_k\ n\cdot[c(t) - c(t - k\tau)]\bigr),$$
#
# with $n$ the direction of the tooth and $\tau$ the tooth period (`millax/_chip.py` has the second-order terms). The path
# is the feed and the deflection of the robot under the sum of the forces,
#
# $$m\,\ddot\delta + 2\zeta\sqrt{km}\,\dot\delta + k\,\delta = F(t)\quad\text{in } x \text{ and in } y.$$
#
# Free are $k_0, h_s, r, k_r$, the stiffness along the feed and both damping ratios; mass and lateral stiffness are known.
#
# ## The data
#
# The tool enters the workpiece at $t = 0$. The forces of single teeth are fast, the robot is slow: the two halves of the
# figure carry information on different parameters.

# %%
figure, (fast, slow) = plt.subplots(1, 2, figsize=(11, 3.4), layout="constrained")
end = trace.time > trace.time[-1] - 4 * tooth_period
for axis in "xy":
    fast.plot(1e3 * trace.time[end], measured[f"F{axis}"][end], ".", markersize=4, color=COLOURS[axis], label=f"$F_{axis}$")
    slow.plot(trace.time, 1e3 * measured[axis], linewidth=0.6, color=COLOURS[axis], label=f"${axis}$")
fast.set(title="last four tooth periods", xlabel="time [ms]", ylabel="force on the tool [N]")
slow.set(title="whole trace", xlabel="time [s]", ylabel="displacement [mm]")
for axes in (fast, slow):
    tidy(axes)
    axes.legend(frameon=False, ncols=2, loc="best")
plt.show()

# %% [markdown]
# ## The fit
#
# Every guess is wrong by a factor of about two. The cost is the mean square of the residuals over their noise: near 1
# the model explains the trace down to the noise, and no further fit is possible.

# %%
result = fit(case, trace, problem.parameters)
print(f"{result.status} after {result.iterations} evaluations, {result.seconds:.0f} s with compilation: {result.message}\n")

in_file = {name: problem.file.leaf(name) for name in problem.truth}
print(f"{'':27}{'guess':>10}{'truth':>10}{'estimate':>12}{'std error':>11}   unit")
for e in result.parameters:
    true = in_file[e.name].express(problem.truth[e.name])
    print(f"{e.name:27}{e.guess:10.4g}{true:10.5g}{e.value:12.6g}{e.std:11.2g}   {e.unit}")

# %% [markdown]
# ## Is it the truth?
#
# Three checks. The estimates lie within a few standard errors of the truth; the residuals are as large as the noise; and
# they are as white, so nothing systematic is left in them. Without a known truth only the last two can be made, which is
# why they matter.

# %%
(fitted,) = result.traces
deviation = [(e.value - in_file[e.name].express(problem.truth[e.name])) / e.std for e in result.parameters]
assert result.success
assert np.abs(deviation).max() < 3.5
assert all(abs(rmse / fitted.sigma[channel] - 1) < 0.02 for channel, rmse in fitted.rmse.items())

figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.4), layout="constrained", width_ratios=[1, 1.2])
left.axvspan(-1.96, 1.96, color="0.93")
left.axvline(0, color="0.6", linewidth=0.8)
left.plot(deviation, [e.name for e in result.parameters], "o", color="0.2")
left.set(title="estimates; grey: 95 %", xlabel="(estimate − truth)/standard error", xlim=(-4, 4))
left.invert_yaxis()
lags = np.arange(1, 3 * case.settings.steps_per_tooth + 1)
for channel, residual in zip(trace.channels, fitted.residuals.T, strict=True):
    autocorrelation = np.array([np.mean(residual[:-lag] * residual[lag:]) for lag in lags]) / np.mean(residual**2)
    style = {"linestyle": "-" if channel[0] == "F" else ":", "color": COLOURS[channel[-1]]}
    right.plot(lags / case.settings.steps_per_tooth, autocorrelation, linewidth=1, label=channel, **style)
right.axhspan(-1.96 / np.sqrt(len(trace.time)), 1.96 / np.sqrt(len(trace.time)), color="0.93")
right.set(title="residuals; grey: 95 % of white noise", xlabel="lag [tooth periods]", ylabel="autocorrelation [-]")
right.set_ylim(-0.1, 0.1)
right.legend(frameon=False, ncols=4)
for axes in (left, right):
    tidy(axes)
plt.show()

# %% [markdown]
# ## What the cut tells, and what it does not
#
# $k_0$ and $h_s$ are known thirty to fifty times less well than $k_r$, and almost perfectly correlated. This is no fault of
# the fit. For chips much thicker than $h_s$ the law is a straight line,
#
# $$\frac{F_t}{a} \to k_0 r\,h + k_0 h_s (1 - r),$$
#
# which holds two combinations, the slope $k_0 r$ and the offset $k_0 h_s (1 - r)$, and not the three numbers. What tells
# $k_0$ and $h_s$ apart is the bend, and most chips of this cut (0.1 mm per tooth) are far beyond it.

# %%
names = [e.name for e in result.parameters]
relative = np.array([e.std / e.value for e in result.parameters])
covariance = result.correlation * np.outer(relative, relative)  # of the logarithms: products become sums
k0, hs, r = (names.index(f"force.{key}") for key in ("k0", "hs", "r"))
for text, parts in {"k0": [k0], "hs": [hs], "r": [r], "slope k0 r": [k0, r], "product k0 hs": [k0, hs]}.items():
    print(f"standard error of {text:14} {100 * np.sqrt(covariance[np.ix_(parts, parts)].sum()):.3f} %")
print(f"correlation of k0 and hs {result.correlation[k0, hs]:+.4f}, of k0 and r {result.correlation[k0, r]:+.2f}")

sim = mx.simulate(result.case)
chips = np.asarray(sim.chip_thickness)
chips = chips[chips > 1e-6]  # in cut
h = np.linspace(0, 120e-6, 200)
figure, (law, share) = plt.subplots(2, 1, figsize=(7, 4.6), layout="constrained", sharex=True, height_ratios=[2, 1])
true_case = mx.CaseFile.from_text(problem.file.with_values(problem.truth)).case
law.plot(1e6 * h, 1e-3 * true_case.force.tangential(h), color="0.75", linewidth=5, label="truth")
law.plot(1e6 * h, 1e-3 * result.case.force.tangential(h), color="0.1", linewidth=1.2, label="fitted")
law.plot(1e6 * h, 1e-3 * case.force.tangential(h), color="0.1", linewidth=1, linestyle="--", label="guess")
law.axvline(1e6 * result.case.force.hs, color=COLOURS["z"], linewidth=1)
law.annotate("$h_s$", (1e6 * result.case.force.hs + 1, 3), color=COLOURS["z"])
law.set(ylabel="$F_t/a$ [N/mm]", ylim=(0, None))
law.legend(frameon=False)
share.hist(1e6 * chips, bins=60, weights=np.full(chips.size, 100 / chips.size), color="0.6")
share.set(xlabel="chip thickness $h$ [µm]", ylabel="share of the\nsamples in cut [%]")
for axes in (law, share):
    tidy(axes)
plt.show()

# %% [markdown]
# The law itself is known better than its coefficients: where there are chips, the fitted curve lies on the true one. A
# slot cuts every thickness from nothing to the feed per tooth, so there are chips on both sides of the bend, and that is
# what makes the three numbers known at all: a tenth of this feed would leave $r$ and $h_s$ open, and a cut that never
# gets below $h_s$ would leave $k_0$ open. Outside the range of chips that were cut, the law is an extrapolation.
#
# ## What if
#
# The fitted case is an ordinary JAX value: it can be simulated at other depths, all at once with `jax.vmap`. How far is
# the tool pushed aside, and how much does it vibrate, at depths that were never measured?

# %%
depths = jnp.linspace(0.25e-3, 2e-3, 8)


@jax.jit
@jax.vmap
def at_depth(depth):
    sim = mx.simulate(eqx.tree_at(lambda c: c.cut.depth, result.case, depth), throw=False)
    last = sim.displacement[-4 * case.settings.steps_per_tooth :]  # one revolution
    return sim.status, last.mean(axis=0), jnp.max(jnp.abs(sim.displacement), axis=0)


status, settled, largest = at_depth(depths)
assert not status.any(), "under vmap nothing can be raised: look at the status"

figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
for i, axis in enumerate("xy"):
    axes.plot(1e3 * depths, 1e3 * jnp.abs(settled[:, i]), "-o", color=COLOURS[axis], label=f"$|{axis}|$, end of the trace")
    axes.plot(1e3 * depths, 1e3 * largest[:, i], ":o", mfc="none", color=COLOURS[axis], label=f"$|{axis}|$, largest")
axes.axvline(1e3 * case.cut.depth, color="0.6", linewidth=0.8)
axes.annotate("measured", (1e3 * case.cut.depth + 0.02, 0.02), color="0.4")
axes.set(xlabel="axial depth of cut [mm]", ylabel="displacement [mm]", ylim=(0, None))
axes.legend(frameon=False)
tidy(axes)
plt.show()

# %% [markdown]
# ## What if something that is taken for granted is wrong
#
# The intervals say how far the *noise* can move the estimates. They know nothing of an error in what was given. Two
# small ones, each fitted again from the good answer: a mass that is 1 % too large, and a trace that starts one sample
# (37.5 µs, a turn of the cutter by 2.25°) too late.

# %%
heavier = eqx.tree_at(lambda c: c.structure.mass, result.case, 1.01 * result.case.structure.mass)
late = replace(trace, values=np.roll(trace.values, 1, axis=0))
again = [Parameter(e.name, unit=e.unit) for e in result.parameters]  # from the case's own numbers
wrong = {"mass + 1 %": fit(heavier, trace, again), "one sample late": fit(result.case, late, again)}

print(f"{'change of the estimate':27}" + "".join(f"{text:>18}" for text in wrong) + f"{'standard error':>18}")
for i, name in enumerate(names):
    changes = [100 * (w[name].value / result[name].value - 1) for w in wrong.values()]
    print(f"{name:27}" + "".join(f"{change:+16.2f} %" for change in changes) + f"{100 * relative[i]:16.2f} %")
for channel in trace.channels:
    ratios = [w.traces[0].rmse[channel] / w.traces[0].sigma[channel] for w in wrong.values()]
    print(f"rms residual/noise of {channel:5}" + "".join(f"{ratio:18.2f}" for ratio in ratios))

# %% [markdown]
# The coefficients of the force law move by tens of standard errors, $k_0$ against $h_s$ as their correlation allows, while
# the estimated stiffness hardly leaves its place. What gives both away is the last block: the residuals are no longer
# as small as the noise. That check is worth more than any interval.

# %% [markdown]
# ## Pitfalls
#
# - **Intervals are for white, normal noise of known size.** Noise that is correlated in time, as drift and sensor
#   resonances are, carries less information than its number of samples: the standard errors are then too small. Look at
#   the autocorrelation of the residuals before you believe them.
# - **A good fit is not a right model.** Runout, helix, wear or a mode that is missing go into the parameters that imitate
#   them best. They show in the residuals, mostly at the tooth passage and its fractions, and in estimates that change
#   from cut to cut. Fit one cut, predict another.
# - **The chips must span the bend.** Where they are all far above $h_s$, or all below, the fit says so: large standard
#   errors, or parameters that it calls not identifiable. Fix one from other cuts rather than trusting the optimiser.
# - **What is taken as known is not in the error.** Masses from a modal test are rarely good to 1 %. Repeat the fit with
#   the given numbers at the ends of what you believe, as above, and report that range.
# - **Time.** The trace's clock is the simulation's: $t = 0$ is where the tool touches the border, with one tooth
#   pointing along the feed. Align to better than a sample.
# - **Discretisation.** At 40 steps per tooth it shifts these estimates by less than one standard error. With ten times
#   the data the noise would not hide it any more: halve the step and look whether the estimates move.
# - **Smoothing.** The gates of the model are smooth over `simulation.width` (1 µm by default) so that gradients exist at
#   contact and at loss of contact; it biases forces by less than the noise here, and must stay small against $h_s$.
