# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Variable pitch: a tool against chatter at one speed
#
# **Question.** A slot has to be cut at 7500 rpm, where the equal tool chatters from 0.32 mm on. Can a tool whose teeth are
# not equally spaced cut 1.9 mm there, and by how much must the spacing differ?
#
# A tooth cuts the wave that the tooth before has left. With unequal teeth these waves come back with different phases, and
# with the right difference they cancel. The structure is that of notebook 04: one mode of 922 Hz along the feed, two teeth.

# %%
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import millax as mx
from millax.plots import tidy

mx.set_up()  # double precision, and faster code
RPM, WANTED = 2 * np.pi / 60, 1.9e-3

case = mx.load_case(Path("../docs/cases/lobes_1mode.toml"))
slot = mx.Stock(np.zeros((0, 2)), np.zeros(0))  # no border: the tool is inside the workpiece
case = eqx.tree_at(lambda c: (c.stock, c.cut.spindle_speed), case, (slot, jnp.asarray(7500 * RPM)))


def unequal(difference: float, case=case):
    """The case with pitch angles of 180 deg -/+ half of this difference [deg]."""
    pitch = np.radians([180 - difference / 2, 180 + difference / 2])
    return eqx.tree_at(lambda c: c.tool, case, mx.EndMill(case.tool.diameter, 2, pitch=pitch))


# %% [markdown]
# ## The limit over the pitch, with its derivative
#
# The pitch angles are leaves of the case like its other numbers, so the limit has derivatives by them. Of two teeth one
# number is free, the difference of the angles: one loses half of it, the other gains it.


# %%
def slope(difference: float) -> tuple[float, float]:
    """Limit depth [m], and its derivative by the pitch difference [m/deg]."""
    limit, gradient = jax.value_and_grad(mx.limit_depth)(unequal(difference))
    first, second = np.radians(gradient.tool.pitch)
    return float(limit), (second - first) / 2


at_rest = slope(0.0)
print(f"equal teeth: {1e3 * at_rest[0]:.3f} mm, {1e3 * at_rest[1]:+.5f} mm per deg")
assert abs(at_rest[1]) < 1e-8  # which of the teeth comes first is all the same

# %% [markdown]
# At equal teeth the derivative is zero: a search must not begin there. From 18 deg on, Newton's method in the logarithm of
# the limit finds the difference at which 1.9 mm are just stable.

# %%
found, limit, path = 18.0, 0.0, []
while abs(limit / WANTED - 1) > 1e-3 and len(path) < 8:
    limit, by_difference = slope(found)
    path.append((found, limit, by_difference))
    print(f"{found:.3f} deg: {1e3 * limit:.4f} mm, {1e3 * by_difference:+.4f} mm per deg")
    found += np.log(WANTED / limit) * limit / by_difference
assert abs(limit / WANTED - 1) < 1e-3
print(f"{limit / at_rest[0]:.1f} times as deep as with equal teeth")
assert limit > 5 * at_rest[0]

differences = np.linspace(0, 44, 23)
limits = np.array([float(mx.limit_depth(unequal(d))) for d in differences])
figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
axes.plot(differences, 1e3 * limits, color="black", linewidth=1.4, label="limit depth")
reach = np.array([-4, 4])
for d, limit, by_difference in [(0.0, *at_rest), *path]:
    axes.plot(d + reach, 1e3 * (limit + by_difference * reach), color="#D55E00", linewidth=1)
    axes.plot(d, 1e3 * limit, "o", color="#D55E00", markersize=4)
axes.plot([], [], "o-", color="#D55E00", markersize=4, linewidth=1, label="its derivative, at 0 and at Newton's steps")
axes.axhline(1e3 * WANTED, color="0.4", linewidth=0.8, linestyle="--", label="wanted")
axes.set(xlabel="pitch difference [deg]", ylabel="limit depth at 7500 rpm [mm]", xlim=(-5, 45), ylim=(0, 3.3))
axes.legend(frameon=False, loc="upper left")
tidy(axes)
plt.show()

# %% [markdown]
# ## Does the engine agree? And why not the peak?
#
# `floquet` asks the simulation itself. It finds the same limit for the tool above. At the peak of the curve, which an
# optimiser would pick, it finds no stable motion. Unequal teeth cut unequal chips, and so move the tool from tooth to tooth;
# at these depths by so much of a chip that a little vibration in addition, as from an abrupt entry, makes a tooth leave the
# cut, and then it does not settle. All that a linear limit promises is that small vibrations die away.

# %%
radii = {}
for name, d, depth in (("found", found, WANTED), ("peak", differences[limits.argmax()], limits.max())):
    at = eqx.tree_at(lambda c: c.cut.depth, unequal(d), jnp.asarray(depth))
    semi, radii[name] = (float(mx.spectral_radius(at, method=method)) for method in ("semi", "floquet"))
    print(f"{name}: {d:.1f} deg, {1e3 * depth:.2f} mm: spectral radius {semi:.4f} by semi, {radii[name]:.4f} by floquet")
assert abs(radii["found"] - 1) < 0.005
assert not abs(radii["peak"] - 1) < 0.05  # NaN: it found no motion that repeats itself

# %% [markdown]
# ## At the other speeds
#
# At a higher speed a turn has fewer waves, so each speed wants another difference. This tool is one for around 7500 rpm.

# %%
tools = {"equal teeth": 0.0, f"{180 - found / 2:.1f} and {180 + found / 2:.1f} deg": found}
lobes = {name: mx.stability(unequal(d), "5000:10000:21 rpm")["limit_depth"][0] for name, d in tools.items()}
figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
for (name, limit), colour in zip(lobes.items(), ("black", "#D55E00"), strict=True):
    axes.plot(limit["cut.spindle_speed"], 1e3 * limit, color=colour, linewidth=1.4, label=name)
axes.axvline(7500, color="0.4", linewidth=0.8, linestyle="--")
axes.set(xlabel="spindle speed [rpm]", ylabel="limit depth [mm]", ylim=(0, 3.6))
axes.legend(frameon=False, ncols=2, loc="upper left")
tidy(axes)
plt.show()

ratio = lobes[list(tools)[1]].to_numpy() / lobes["equal teeth"].to_numpy()
print(f"limit over that of equal teeth: {ratio.max():.1f} at best, {ratio.min():.2f} at worst")
assert ratio.max() > 5
assert ratio.min() < 0.8

# %% [markdown]
# ## Low speeds: process damping
#
# At low speeds the flank of a tooth presses on the waves it leaves, and damps the vibration. Its coefficient C is fitted to
# limits found at the machine, or taken from the literature for the material; the one here is assumed.

# %%
low = {}
for c in (0.0, 36e3, 43e3):
    force = mx.LinearLaw(case.force.kt, case.force.kr, process_damping=c)
    damped = eqx.tree_at(lambda c: c.force, case, force)
    low[c] = mx.stability(damped, "2100:4000:20 rpm")["limit_depth"][0]

figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
for (c, limit), colour, style in zip(low.items(), ("black", "#0072B2", "#0072B2"), ("-", "-", "--"), strict=True):
    label = f"C = {c / 1e3:.0f} kN/m" if c else "no process damping"
    axes.plot(limit["cut.spindle_speed"], 1e3 * limit, style, color=colour, linewidth=1.4, label=label)
axes.set(xlabel="spindle speed [rpm]", ylabel="limit depth [mm]", ylim=(0, None))
axes.legend(frameon=False)
tidy(axes)
plt.show()

none, some, more = (limit.to_numpy() for limit in low.values())
print(f"limit depth with C, over that without: {np.min(some / none):.2f} to {np.max(some / none):.2f}")
print(f"20 % more of C: {100 * np.min(more / some - 1):.0f} to {100 * np.max(more / some - 1):.0f} % deeper")
assert np.all(some > none)
assert np.max(more / some) > 2

# %% [markdown]
# A deeper cut has more process damping too. So at low speeds the limits with damping are flat in depth: the spectral radius
# hardly changes with it, and a small error of C moves the limit a lot.

# %%
depths = np.array([1.0, 1.5, 2.0, 3.0, 4.0])
at = eqx.tree_at(lambda c: c.cut.spindle_speed, damped, jnp.asarray(2100 * RPM))
radius = [float(mx.spectral_radius(eqx.tree_at(lambda c: c.cut.depth, at, 1e-3 * a))) for a in jnp.asarray(depths)]
for a, rho in zip(depths, radius, strict=True):
    print(f"{a:.1f} mm: spectral radius {rho:.3f}")
assert np.ptp(radius) < 0.2

# %% [markdown]
# ## Pitfalls
#
# - **One speed.** A difference belongs to a speed and a frequency of chatter. Elsewhere equal teeth may cut deeper.
# - **Kinks.** The limit is the first of several that cross. Its derivative jumps at the crossings, and an optimum is often
#   one of them: gradient methods crawl there.
# - **Linear means small.** `semi` linearises around the commanded path, and unequal teeth move the tool from tooth to tooth.
#   In a slot it agrees with `floquet` as long as no tooth leaves the cut; with partial immersion the two may differ by some
#   per cent, since a tooth then meets the border of the stock elsewhere.
# - **Unequal chips.** Each tooth cuts what is fed during its pitch: here one has 14 % more to cut than the other.
# - **Process damping** is that of one wear and one material: C of a sharp tool is not that of a worn one.
