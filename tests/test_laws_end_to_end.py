"""Every force law from a case file through a simulation to a fit."""

import numpy as np
import pytest

import identification as ident
import millax as mx

LAWS = {
    "linear": ('kt = "900 N/mm^2"\nke = "12 N/mm"\nkr = 0.3', {"force.kt": 1.5, "force.ke": 0.7, "force.kr": 1.3}),
    "exponential": ('kf = "300 N/mm^1.7"\nm = 0.7\nkr = 0.3', {"force.kf": 1.5, "force.m": 0.9, "force.kr": 1.3}),
    "fractional": (
        'k0 = "5000 N/mm^2"\nhs = "18 um"\nr = 0.1\nkr = 0.3',
        {"force.k0": 1.5, "force.hs": 0.7, "force.kr": 1.3},
    ),
}


@pytest.mark.parametrize("law", ["linear", "exponential", pytest.param("fractional", marks=pytest.mark.long)])
def test_a_law_is_simulated_and_found_again(law, tmp_path):
    numbers, factors = LAWS[law]
    path = tmp_path / "case.toml"
    path.write_text(
        f'[tool]\ndiameter = "20 mm"\nteeth = 4\n[force]\nlaw = "{law}"\n{numbers}\n'
        '[cut]\nspindle_speed = "10000 rpm"\nfeed_rate = "4 m/min"\ndepth = "1 mm"\n'
        '[stock]\nx = ["-1 m", "1 m"]\n[simulation]\nduration = "0.03 s"\n',
        encoding="utf-8",
    )
    case = mx.load_case(path)
    sim = mx.simulate(case)
    noise = np.random.default_rng(1).normal(size=(len(sim.time), 2))
    trace = ident.Trace(np.asarray(sim.time), ("Fx", "Fy"), np.asarray(sim.force)[:, :2] + noise, {"Fx": 1.0, "Fy": 1.0})
    values = {name: float(getattr(case.force, name.partition(".")[2])) for name in factors}
    result = ident.fit(case, trace, [ident.Parameter(name, guess=values[name] * f) for name, f in factors.items()])
    assert result.success, result.message
    for estimate in result.parameters:
        assert abs(estimate.value - values[estimate.name]) < 3.5 * estimate.std
