"""Quantities at the border: values against definitions of the units, errors against what a user must learn from them."""

import math
import subprocess
import sys

import pytest

from millax._units import UnitError, express, parse, si_scale, written_unit


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("10000 rpm", "rad/s", 10000 * 2 * math.pi / 60),
        ("4 m/min", "m/s", 4 / 60),
        ("18 um", "m", 18e-6),
        ("18µm", "m", 18e-6),
        ("5000 N/mm^2", "N/m^2", 5e9),
        ("5000 N/mm²", "N/m^2", 5e9),
        ("5 GPa", "N/m^2", 5e9),
        ("3e5 N/m", "N/m", 3e5),
        ("500 N s/m", "N s/m", 500.0),
        ("-90 deg", "rad", -math.pi / 2),
        ("5 %", "", 0.05),
        ("0.05", "", 0.05),
        (" 100 kg ", "kg", 100.0),
        ("2e3 N/mm^1.7", "N/m^1.7", 2e3 * 1000**1.7),
        (3, "m", 3.0),
        (2.5e-3, "m", 2.5e-3),
    ],
)
def test_a_quantity_is_read_in_si(text, unit, value):
    assert parse("key", text, unit) == pytest.approx(value, rel=1e-14)


def test_lists_and_matrices_keep_their_shape():
    given = [["1 N/um", 2e5], ["-0.5 N/um", "3 N/mm"]]
    rows = parse("structure.stiffness", given, "N/m")
    assert rows == [[pytest.approx(1e6), 2e5], [pytest.approx(-5e5), pytest.approx(3e3)]]


@pytest.mark.parametrize("unit", ["m", "N/m^2", "rad/s", "kg", ""])
@pytest.mark.parametrize("value", [True, None, math.nan, math.inf, -math.inf, "", "ten", "nan m", "1e999 m", {"a": 1}])
def test_what_is_no_finite_number_is_an_error_that_names_the_key(value, unit):
    with pytest.raises(UnitError, match=r"^force\.k0: "):
        parse("force.k0", value, unit)


@pytest.mark.parametrize(
    ("text", "unit", "words"),
    [
        ("5000 N/mm", "N/m^2", ['"5000 N/mm" given', "N/mm cannot be converted to N/m^2", "5000 N/mm^2", "bare number"]),
        ("20", "m", ["without a unit", '"10 mm"']),
        ("20 furlongz", "m", ["furlongz is not a unit", '"10 mm"']),
        ("1,5 mm", "m", ['"1,5 mm" given', '"10 mm"']),
        ("1 mm + 2 mm", "m", ["not a unit"]),
        ("1 m/(s", "m", ["not a unit"]),
        ("20 degC", "m", ["offset"]),
        ("5 mm", "", ["does not belong here", "0.05"]),
    ],
)
def test_a_wrong_unit_is_an_error_that_says_what_is_right(text, unit, words):
    with pytest.raises(UnitError) as error:
        parse("tool.diameter", text, unit)
    for word in ["tool.diameter", *words]:
        assert word in str(error.value)


@pytest.mark.parametrize(("text", "unit"), [("167 Hz", "rad/s"), ("167 1/s", "rad/s"), ("3 deg", "")])
def test_angles_are_not_plain_numbers(text, unit):
    """An angular speed in Hz would be wrong by a factor 2 pi without anyone noticing."""
    with pytest.raises(UnitError, match=r"cut\.spindle_speed"):
        parse("cut.spindle_speed", text, unit)


def test_the_item_of_a_list_is_named():
    with pytest.raises(UnitError, match=r"structure\.stiffness\[1\]\[0\]"):
        parse("structure.stiffness", [[1, 2], ["3 kg", 4]], "N/m")


@pytest.mark.parametrize("text", ["10000 rpm", "4 m/min", "18 um", "5000 N/mm^2", "5 %"])
def test_express_undoes_parse(text):
    unit = text.split()[1]
    si = {"rpm": "rad/s", "m/min": "m/s", "um": "m", "N/mm^2": "N/m^2", "%": ""}[unit]
    assert written_unit(text, si) == unit
    assert express(parse("key", text, si), unit) == pytest.approx(float(text.split()[0]), rel=1e-14)
    assert si_scale(unit) == pytest.approx(parse("key", f"1 {unit}", si))


def test_a_bare_number_is_written_in_si():
    assert written_unit(5e9, "N/m^2") == "N/m^2"


def test_importing_millax_does_not_import_what_only_files_and_plots_need():
    code = "import sys, millax; print({'pint', 'tomlkit', 'matplotlib', 'rich'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
