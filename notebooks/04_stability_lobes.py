# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Stability lobes: how deep may the tool cut, and how sure is that?
#
# **Question.** A tool mode was measured by tapping, the cutting coefficient by a fit; both have an error. Up to which depth
# is the cut stable, at which speed, and how sure is the answer?
#
# The truth is synthetic: a classic benchmark, one mode of 922 Hz along the feed, two teeth, half immersion, down-milling.

# %%
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import millax as mx
from millax.plots import plot_stability, tidy

mx.set_up()  # double precision, and faster code
case = mx.load_case(Path("../docs/cases/lobes_1mode.toml"))

# %% [markdown]
# ## The diagram, three times
#
# `semi` linearises the force of a tool that stays on its path, and semi-discretises the delay equation. `floquet` finds the
# periodic orbit of the simulation itself and differentiates one tooth period around it. `time` simulates, and looks whether
# a kick dies away. They share the model of the cut, and nothing of how stability is decided.

# %%
few = mx.stability(case, "7000:23000:7 rpm", methods=("semi", "floquet", "time"))
semi, *others = few["limit_depth"].to_numpy()
for name, limit in zip(("floquet", "time"), others, strict=True):
    print(f"{name} beside semi: {100 * np.abs(limit / semi - 1).max():.2f} % at most")
    assert np.abs(limit / semi - 1).max() < 0.02

lobes = mx.stability(case, "5000:25000:81 rpm")
figure = plot_stability(lobes)
axes = figure.axes[0]
for limit, marker in zip(others, "ox", strict=True):
    axes.plot(few["cut.spindle_speed"], 1e3 * limit, marker, fillstyle="none", color="#D55E00")
plt.figure(figure)
plt.show()

# %% [markdown]
# ## What the limit depends on
#
# At the limit the largest multiplier has modulus 1. That defines the depth as a function of every other number, which
# therefore has derivatives. In per cent per per cent:

# %%
speed = 9000 * 2 * np.pi / 60
at = eqx.tree_at(lambda c: c.cut.spindle_speed, case, jnp.asarray(speed))
limit, slope = jax.value_and_grad(mx.limit_depth)(at)
numbers = {
    "k_T": lambda c: c.force.kt,
    "k_r": lambda c: c.force.kr,
    "stiffness": lambda c: c.structure.stiffness,
    "damping ratio": lambda c: c.structure.damping_ratio,
    "spindle speed": lambda c: c.cut.spindle_speed,
}
print(f"limit depth at 9000 rpm: {1e3 * limit:.3f} mm")
relative = {name: float(where(slope) * where(at) / limit) for name, where in numbers.items()}
for name, value in relative.items():
    print(f"{name:14} {value:+.2f} % per %")
assert abs(relative["k_T"] + 1) < 1e-3  # of a linear law, only the product of depth and coefficient counts

# %% [markdown]
# The frequency of the mode counts far more than its damping: on the flank of a lobe a small change of frequency moves the
# whole lobe. So say how sure the frequency is, before asking for the damping.
#
# ## How sure is the limit?
#
# With standard errors of 5 % for k_T, 1 % for the stiffness and 10 % for the damping ratio, to first order:

# %%
errors = {"k_T": 0.05, "stiffness": 0.01, "damping ratio": 0.10}
forecast = float(np.sqrt(sum((relative[name] * error) ** 2 for name, error in errors.items())))

rng, drawn = np.random.default_rng(0), []
for _ in range(60):
    other = at
    for name, error in errors.items():
        other = eqx.tree_at(numbers[name], other, numbers[name](at) * (1 + error * rng.normal()))
    drawn.append(float(mx.limit_depth(other)))
print(
    f"standard error of the limit: {100 * forecast:.1f} % to first order, {100 * np.std(drawn) / limit:.1f} % of 60 samples"
)
assert abs(np.std(drawn) / limit / forecast - 1) < 0.35

figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
axes.hist(1e3 * np.array(drawn), bins=12, color="#0072B2", alpha=0.7)
axes.axvline(1e3 * float(limit), color="black")
axes.set(xlabel="limit depth at 9000 rpm [mm]", ylabel="samples")
tidy(axes)
plt.show()

# %% [markdown]
# ## Pitfalls
#
# - **Near a cusp** two multipliers reach the unit circle together. The limit has a kink there, and first-order errors belong
#   to one side of it: sample.
# - **Linear means small.** Below the limit a large kick may still end in chatter, and with coarse feeds the forced vibration
#   moves the tool against the border of the stock: `floquet` and `time` know of it, `semi` does not.
# - **Islands.** Limits are looked for from below in steps of 10 %. Give `depths` to see the whole map.
# - **Feed.** The feed per tooth is held while the speed varies. Of a law that is not linear, the limit depends on it.
# - **One structure for all speeds.** Spindles change with speed; give the mode of each speed.
