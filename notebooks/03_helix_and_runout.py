# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # A real tool: helix, runout, axial force
#
# **Question.** The forces of a cut are not the same from tooth to tooth. How far does the tool run out, in which direction,
# and what would coefficients be worth that were fitted without asking?
#
# A straight tool with equal teeth repeats itself with every tooth. A tool whose axis lies beside that of the spindle repeats
# itself only with every turn: the tooth that stands out cuts more, the one after it finds less. The helix spreads the entry
# of a tooth over the depth, and makes an axial force.

# %%
import dataclasses

import matplotlib.pyplot as plt
import numpy as np

import millax as mx
from identification import Parameter, Trace, fit
from millax.plots import COLOURS, tidy

mx.set_up()  # double precision, and faster code

straight = {
    "tool": {"diameter": "20 mm", "teeth": 4},
    "force": {"law": "fractional", "k0": "5000 N/mm^2", "hs": "18 um", "r": 0.1, "kr": 0.3, "ka": -0.2},
    "cut": {"spindle_speed": "8000 rpm", "feed_per_tooth": "0.08 mm", "depth": "1 mm", "start": ["0 mm", "0 mm"]},
    "stock": {"y": ["-10 mm", "0 mm"]},  # half of the slot is there: down-milling
    "structure": {"axes": ["x", "y"], "mass": "60 kg", "stiffness": "4e6 N/m", "damping_ratio": 0.05},
    "simulation": {"duration": "0.1 s"},
}
real = straight | {
    "tool": straight["tool"] | {"helix": "30 deg", "offset": "8 um", "offset_angle": "50 deg"},
}
ideal, case = mx.load_case(straight), mx.load_case(real)
print(f"{case.settings.slices} slices, {case.settings.passes} earlier passes remembered")

# %% [markdown]
# ## What it does to the forces
#
# The last turn: four equal teeth, and the same cut with helix and runout. The axial force pulls the tool out of its holder,
# along $-z$.

# %%
turn = case.tool.teeth * case.settings.steps_per_tooth
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.4), sharey=True, layout="constrained")
for axes, each, title in ((left, ideal, "straight flutes, equal teeth"), (right, case, "helix 30°, axis off by 8 µm")):
    sim = mx.simulate(each)
    angle = np.arange(turn) * 360 / turn
    for i, axis in enumerate("xyz"):
        axes.plot(angle, np.asarray(sim.force)[-turn:, i], color=COLOURS[axis], label=f"$F_{axis}$")
    axes.set(title=title, xlabel="angle of the tool [°]", xticks=np.arange(0, 361, 90))
    tidy(axes)
left.set_ylabel("force on the tool [N]")
left.set_ylim(top=420)  # room for the legend
left.legend(frameon=False, ncols=3, loc="upper center")
plt.show()

# %% [markdown]
# ## Found from a noisy trace
#
# The forces are measured with noise of 3 N. The fit does not know the runout; it starts with a small one in a
# wrong direction.

# %%
sim = mx.simulate(case)
rng = np.random.default_rng(20261122)
channels = ("Fx", "Fy", "Fz")
measured = np.asarray(sim.force) + 3 * rng.normal(size=(len(sim.time), 3))
trace = Trace(np.asarray(sim.time), channels, measured, dict.fromkeys(channels, 3.0))

coefficients = [Parameter("force.k0", "4000 N/mm^2"), Parameter("force.kr", 0.2), Parameter("force.ka", -0.1)]
runout = [Parameter("tool.offset", "3 um"), Parameter("tool.offset_angle", "10 deg")]
truth = {"force.k0": 5000, "force.kr": 0.3, "force.ka": -0.2, "tool.offset": 8, "tool.offset_angle": 50}

with_runout = fit(case, trace, [*coefficients, *runout])
even = dataclasses.replace(case.tool, offset=None, offset_angle=None)
without = fit(dataclasses.replace(case, tool=even), trace, coefficients)

print(f"{'':20}{'truth':>8}{'estimate':>10}{'std error':>11}   unit")
for e in with_runout.parameters:
    print(f"{e.name:20}{truth[e.name]:8g}{e.value:10.5g}{e.std:11.2g}   {e.unit}")
    assert abs(e.value - truth[e.name]) < 4 * e.std

# %% [markdown]
# ## Pitfalls
#
# A fit that takes all teeth for equal still converges. What tells is the residual: many times the noise, and repeated with
# every turn.

# %%
for name, result in (("with runout", with_runout), ("teeth taken for equal", without)):
    r2 = {channel: f"{value:.4f}" for channel, value in result.traces[0].r2.items()}
    print(f"{name:22} status {result.status}: R² {r2}")
biased = next(e for e in without.parameters if e.name == "force.k0")
print(f"k0 without runout: {biased.value:.0f} ± {biased.std:.1f} N/mm², true 5000: an error bar that means nothing")
assert with_runout.traces[0].r2["Fx"] > without.traces[0].r2["Fx"] + 0.01
