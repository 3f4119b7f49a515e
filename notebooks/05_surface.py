# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # What the cut leaves behind: form error and feed marks
#
# **Question.** A wall is finished in one pass. Should it be up- or down-milled, at which spindle speed, and how far from the
# drawing will it lie?
#
# A wall is not where the tool is on average, but where it is *at the instants at which a tooth passes the wall*. A tool that
# vibrates in step with its teeth does so at the same place each time: the wall is smooth, but in the wrong place.

# %%
import matplotlib.pyplot as plt
import numpy as np

import millax as mx
from millax.plots import WALL_COLOURS, plot_wall, tidy

mx.set_up()  # double precision, and faster code

RADIUS, IMMERSION, MODE_HZ, DAMPING, MASS = 10e-3, 3e-3, 922.0, 0.011, 0.03993
KT, KR, DEPTH, FEED, TEETH = 6e8, 1 / 3, 0.1e-3, 0.05e-3, 2

# %% [markdown]
# ## Which side is which
#
# The spindle turns clockwise and the tool feeds along +x. Stock at the left of the tool, y > 0, is **up-milled**: a tooth
# begins at the wall, with a chip of zero thickness. Stock at the right, y < 0, is **down-milled**: a tooth ends there.


# %%
def case_of(side: str):
    return mx.load_case(
        {
            "tool": {"diameter": 2 * RADIUS, "teeth": TEETH},
            "force": {"law": "linear", "kt": KT, "kr": KR},
            "cut": {"spindle_speed": "20000 rpm", "feed_per_tooth": FEED, "depth": DEPTH, "start": [0.0, 0.0]},
            "stock": {
                "x": ["-100 mm", "100 mm"],
                "immersion": IMMERSION,
                "milling": {"left": "up", "right": "down"}[side],
            },
            "structure": {
                "axes": ["y"],
                "mass": MASS,
                "stiffness": MASS * (2 * np.pi * MODE_HZ) ** 2,
                "damping_ratio": DAMPING,
            },
            "simulation": {"duration": "0.3 s", "steps_per_tooth": 80, "width": "1 nm", "tolerance": 1e-8},
        }
    )


cases = {side: case_of(side) for side in ("left", "right")}
left = []
for side, case in cases.items():
    assert mx.walls(case) == (side,)
    left.append(mx.wall_profile(case, mx.simulate(case), side))
    ra, _, rz = mx.roughness(left[-1])
    print(f"{side}: form error {1e6 * mx.form_error(left[-1]):+.3f} µm, Ra {1e9 * ra:.1f} nm, Rz {1e9 * rz:.1f} nm")
print(f"feed marks of a rigid tool, f²/(8 R): {1e9 * FEED**2 / (8 * RADIUS):.1f} nm")

# %%
figure = plot_wall(left, cases["left"])
plt.show()

# %% [markdown]
# Positive is material left, negative is material lost: from the same structure and the same force law, the two sides of a
# tool come out with different signs. The scallops at the right are the feed marks, one for each tooth. The tool's vibration
# does not show in them: it repeats itself with each tooth.
#
# ## Over the spindle speed, beside a closed form
#
# In a stable cut the vibration of one tooth is that of the next, so that it cancels in the chip thickness. The force is then
# that of a rigid tool, and its Fourier series times the frequency response of the structure is the motion; the wall is left
# where the tool stands when a tooth is abreast of it (Schmitz and Mann, *Closed-form solutions for surface location error in
# milling*, 2006).


# %%
def closed_form(side: str, rpm: np.ndarray) -> np.ndarray:
    """Surface location error [m], > 0 where material is left."""
    inner = np.arcsin(1 - IMMERSION / RADIUS)
    low, high, wall, sign = (-np.pi / 2, -inner, -np.pi / 2, 1) if side == "left" else (inner, np.pi / 2, np.pi / 2, -1)
    phi = low + (np.arange(4000) + 0.5) * (high - low) / 4000
    force = DEPTH * KT * FEED * np.cos(phi) * (np.cos(phi) + KR * np.sin(phi))
    n = TEETH * np.arange(-200, 201)[:, None]
    series = TEETH / (2 * np.pi) * (force * np.exp(-1j * n * phi)).sum(axis=1) * (phi[1] - phi[0])
    ratio = n * rpm / 60 / MODE_HZ
    response = 1 / (MASS * (2 * np.pi * MODE_HZ) ** 2 * (1 - ratio**2 + 2j * DAMPING * ratio))
    return -sign * (series[:, None] * response * np.exp(1j * n * wall)).sum(axis=0).real + FEED**2 / (24 * RADIUS)


speeds = np.linspace(8000, 32000, 961)
figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
grid = {"cut.spindle_speed": "8000:32000:49 rpm", "cut.feed_per_tooth": "0.05 mm"}
for side, case in cases.items():
    # A reduction keeps of each simulation what is asked for: here, one number.
    error = {"form_error": lambda sim, case, side=side: mx.form_error(mx.wall_profile(case, sim, side))}
    result = mx.sweep(case, grid=grid, reduce=error)
    assert (result["status"] == 0).all()
    found, expected = result["form_error"].to_numpy(), closed_form(side, result["cut.spindle_speed"].to_numpy())
    words = "up-milling" if side == "left" else "down-milling"
    axes.plot(speeds, 1e6 * closed_form(side, speeds), color=WALL_COLOURS[side], linewidth=1, label=f"{words}, closed form")
    axes.plot(
        result["cut.spindle_speed"], 1e6 * found, "o", color=WALL_COLOURS[side], markersize=4, label=f"{words}, millax"
    )
    print(f"{words}: largest difference {1e9 * abs(found - expected).max():.0f} nm of {1e9 * abs(expected).max():.0f} nm")
    assert abs(found - expected).max() < 0.03 * abs(expected).max()
axes.axhline(0, color="0.4", linewidth=0.8)
axes.set(xlabel="spindle speed [rpm]", ylabel="material left [µm]", title="surface location error of a finishing pass")
axes.legend(frameon=False)
tidy(axes)
plt.show()

# %% [markdown]
# Near the speeds at which the mode swings once, twice or three times per tooth (27 660, 13 830 and 9220 rpm) the error of
# down-milling is large and changes its sign within a few hundred turns per minute. These are also the speeds at which a
# deep cut is most stable: what is best against chatter is worst for a finishing pass. Beside each peak the error crosses
# zero, too steeply to aim for.
#
# ## Pitfalls
#
# - **The nominal wall is that of the commanded path**, a radius away from it: a tool that wears, or is ground undersize, is
#   not in the model.
# - **`form_error` looks at the last half of the wall** unless it is given a `stretch`. A slow robot may still be swinging
#   there; look at the picture first.
# - **Feed marks are a lower bound of a roughness.** Runout, tearing and the cutter's edge are not in it. Ra and Rz are those
#   of the unfiltered profile along the feed: a swinging robot raises them, although an instrument would count that as
#   waviness.
# - **An unstable cut has a wall too**, but no location error: it is not periodic. Look at the vibration first (notebook 02).
# - **The gates of the chip thickness are smoothed** over 1 µm unless told otherwise (`simulation.width`). Where the error
#   itself is below that, make it smaller, as here.
