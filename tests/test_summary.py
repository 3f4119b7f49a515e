"""The summary of a simulation, on signals whose answers are known in closed form."""

import jax.numpy as jnp
import numpy as np
import pytest

import millax as mx

PERIODS, STEPS, TEETH = 1334, 40, 4
TOOTH_PERIOD = 1.5e-3
STATIC, FREQUENCY, DAMPING = -1.3e-4, 8.7, 0.05


def case(periods: int = PERIODS) -> mx.Case:
    tool = mx.EndMill(diameter=0.02, teeth=TEETH)
    return mx.Case(
        tool=tool,
        force=mx.FractionalLaw(k0=5e9, hs=18e-6, r=0.1, kr=0.3),
        cut=mx.Cut.touching(tool, spindle_speed=2 * np.pi / (TOOTH_PERIOD * TEETH), feed_rate=0.066, depth=1e-3),
        stock=mx.Stock.box(),
        structure=mx.Structure(("x",), 100.0, 3e5, damping_ratio=0.05),
        settings=mx.Settings(periods, STEPS),
    )


def instants(periods: int = PERIODS) -> np.ndarray:
    return (np.arange(periods * STEPS) + 0.5) * TOOTH_PERIOD / STEPS


def summary(x=None, force=None, periods: int = PERIODS) -> dict:
    t = instants(periods)
    sim = mx.Simulation(
        time=jnp.asarray(t),
        force=jnp.zeros((t.size, 3)) if force is None else jnp.asarray(force),
        displacement=jnp.zeros((t.size, 0)) if x is None else jnp.asarray(x)[:, None],
        chip_thickness=jnp.zeros((t.size, TEETH)),
        residual=jnp.zeros(()),
        status=jnp.zeros((), int),
        axes=() if x is None else ("x",),
    )
    return mx.summarize(sim, case(periods))


def step_response(t: np.ndarray) -> np.ndarray:
    """Displacement of a damped oscillator under a force applied at t = 0; FREQUENCY is that of the damped vibration."""
    decay = 2 * np.pi * FREQUENCY * DAMPING / np.sqrt(1 - DAMPING**2)
    angle = 2 * np.pi * FREQUENCY * t
    return STATIC * (1 - np.exp(-decay * t) * (np.cos(angle) + DAMPING / np.sqrt(1 - DAMPING**2) * np.sin(angle)))


def test_step_response_of_an_oscillator():
    t = instants()
    found = summary(step_response(t))
    assert found["static_displacement.x"]["value"] == pytest.approx(STATIC, rel=1e-3)
    overshoot = 100 * np.exp(-np.pi * DAMPING / np.sqrt(1 - DAMPING**2))
    assert found["overshoot.x"]["value"] == pytest.approx(overshoot, abs=0.2)
    assert found["first_frequency.x"]["value"] == pytest.approx(FREQUENCY, abs=0.05)
    fine = np.linspace(0, 2, 2_000_001)
    last = fine[np.flatnonzero(np.abs(step_response(fine) / STATIC - 1) > 0.03)[-1]]
    assert found["settling_time.x"]["value"] == pytest.approx(last, abs=TOOTH_PERIOD)


def test_the_tooth_passage_is_not_the_first_frequency():
    """Nor does it widen the band: both are defined on the average over a tooth period."""
    t = instants()
    ripple = 0.2 * STATIC * np.sin(2 * np.pi * t / TOOTH_PERIOD)
    smooth, rough = summary(step_response(t)), summary(step_response(t) + ripple)
    for name in ("first_frequency.x", "settling_time.x"):
        assert rough[name]["value"] == pytest.approx(smooth[name]["value"], rel=1e-6)


def test_every_entry_has_value_unit_and_definition():
    found = summary(step_response(instants()))
    for entry in found.values():
        assert {"value", "unit", "definition"} <= set(entry)
        assert entry["definition"]
        assert (entry["value"] is None) == ("reason" in entry)
    assert found["overshoot.x"]["unit"] == "%"
    assert found["settling_time.x"]["unit"] == "s"


def test_forces_over_whole_revolutions():
    t = instants()
    revolution = TOOTH_PERIOD * TEETH
    # Once per revolution, as with runout: only a whole number of revolutions averages it out.
    force = np.stack([-40 + 25 * np.sin(2 * np.pi * t / revolution), 130 + 0 * t, 0 * t], axis=1)
    force[: t.size // 4] = 1e6
    found = summary(force=force)
    assert found["mean_force.x"]["value"] == pytest.approx(-40, abs=1e-9)
    assert found["peak_force.x"]["value"] == pytest.approx(65, rel=1e-3)
    assert found["mean_force.y"]["value"] == pytest.approx(130)
    assert found["mean_force.z"]["value"] == 0


def undefined(found: dict, *names: str) -> None:
    for name in names:
        assert found[name]["value"] is None, name
        assert found[name]["reason"], name


ALL = ("static_displacement", "overshoot", "settling_time", "first_frequency")


def test_a_rigid_tool_has_no_displacement():
    undefined(summary(), *(f"{name}.{axis}" for name in ALL for axis in "xy"))


def test_a_tool_that_moves_in_x_only_has_no_displacement_in_y():
    undefined(summary(step_response(instants())), *(f"{name}.y" for name in ALL))


def test_a_tool_that_stays_where_it_is():
    found = summary(np.zeros(PERIODS * STEPS))
    assert found["static_displacement.x"]["value"] == 0
    undefined(found, "overshoot.x", "settling_time.x", "first_frequency.x")


def test_a_trace_that_is_too_short():
    found = summary(step_response(instants(3)), periods=3)
    undefined(found, *(f"{name}.x" for name in ALL), "mean_force.x", "peak_force.y")


def test_a_vibration_that_does_not_settle():
    found = summary(STATIC * (1 + 0.5 * np.sin(2 * np.pi * FREQUENCY * instants())))
    undefined(found, "settling_time.x")
    assert "simulate longer" in found["settling_time.x"]["reason"]
    assert found["first_frequency.x"]["value"] == pytest.approx(FREQUENCY, abs=0.05)


def test_a_push_without_vibration_has_no_frequency():
    t = instants()
    undefined(summary(STATIC * np.clip(t / 0.15, 0, 1)), "first_frequency.x")
    undefined(summary(STATIC * (1 - np.exp(-t / 0.1))), "first_frequency.x")
