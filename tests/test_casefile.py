"""Case files: what they mean, what is refused and in which words, and numbers written back."""

import math
from pathlib import Path

import numpy as np
import pytest
import tomlkit
from cases import SLOT_FILE

import millax as mx

CASES = Path(__file__).parents[1] / "docs" / "cases"

TEXT = f"""\
# a case
{SLOT_FILE}
[structure]
axes = ["x", "y"]
mass = "100 kg"
stiffness = [
    "0.3 N/um",      # along the feed
    3e5,             # across
]
damping_ratio = 0.05
[simulation]
duration = "0.3 s"
"""


def case_file(*changes: tuple[str, str]) -> mx.CaseFile:
    text = TEXT
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return mx.CaseFile.from_text(text, "cut.toml")


def test_the_numbers_of_a_case():
    case = case_file().case
    assert case.tool.teeth == 4
    assert float(case.tool.diameter) == pytest.approx(0.02)
    assert isinstance(case.force, mx.FractionalLaw)
    assert float(case.force.k0) == pytest.approx(5e9)
    assert float(case.force.hs) == pytest.approx(18e-6)
    assert float(case.cut.spindle_speed) == pytest.approx(10000 * 2 * math.pi / 60)
    assert float(case.cut.feed_rate) == pytest.approx(4 / 60)
    np.testing.assert_allclose(case.cut.start, [-0.01, 0])
    np.testing.assert_allclose(case.structure.stiffness, [3e5, 3e5])
    assert case.structure.axes == ("x", "y")
    # 0.3 s at 1.5 ms per tooth: exactly 200 periods, which rounding must not make 201.
    assert case.settings.periods == 200
    assert (case.settings.steps_per_tooth, case.settings.passes) == (40, 3)


def test_a_duration_is_rounded_up_to_whole_tooth_periods():
    assert case_file(('"0.3 s"', '"0.3001 s"')).case.settings.periods == 201


def test_feed_per_tooth_is_another_way_to_give_the_feed_rate():
    case = case_file(('feed_rate = "4 m/min"', 'feed_per_tooth = "0.1 mm"')).case
    assert float(case.cut.feed_rate) == pytest.approx(4 / 60)


def test_without_structure_the_tool_is_rigid():
    start, end = TEXT.index("[structure]"), TEXT.index("[simulation]")
    case = mx.CaseFile.from_text(TEXT[:start] + TEXT[end:]).case
    assert case.structure.axes == ()


def test_borders_of_the_stock():
    without = case_file().case.stock
    np.testing.assert_allclose(without.normals, [[-1, 0]])
    np.testing.assert_allclose(without.offsets, [0])
    sides = case_file(("[cut]", '[stock]\ny = ["-5 mm", "10 mm"]\n[cut]')).case.stock
    np.testing.assert_allclose(sides.normals, [[-1, 0], [0, -1], [0, 1]])
    np.testing.assert_allclose(sides.offsets, [0, 5e-3, 10e-3])


def immersed(immersion: str, milling: str) -> tuple[str, str]:
    return "[cut]", f'[stock]\nimmersion = "{immersion}"\nmilling = "{milling}"\n[cut]'


@pytest.mark.parametrize(
    ("milling", "normal", "offset"), [("down", [0, 1], 3e-3 - 10e-3 + 5e-3), ("up", [0, -1], -(3e-3 + 10e-3 - 5e-3))]
)
def test_radial_immersion_counts_from_the_edge_of_the_tool(milling, normal, offset):
    start = ("depth =", 'start = ["-10 mm", "3 mm"]\ndepth =')
    stock = case_file(immersed("5 mm", milling), start).case.stock
    np.testing.assert_allclose(stock.normals, [[-1, 0], normal])
    np.testing.assert_allclose(stock.offsets, [0, offset], atol=1e-15)


@pytest.mark.parametrize("milling", ['milling = "up"\n', ""])
def test_an_immersion_of_the_diameter_is_a_full_slot(milling):
    stock = case_file(("[cut]", f'[stock]\nx = ["0 mm", "80 mm"]\nimmersion = "2 cm"\n{milling}[cut]')).case.stock
    np.testing.assert_allclose(stock.normals, [[-1, 0], [1, 0]])


def test_an_immersion_is_not_a_leaf_and_the_edge_it_counts_from_cannot_be_written():
    file = case_file(immersed("5 mm", "down"))
    assert "stock.immersion" not in file.leaves
    again = mx.CaseFile.from_text(file.with_values({"force.k0": 4.8e9})).case
    np.testing.assert_array_equal(again.stock.offsets, file.case.stock.offsets)
    with pytest.raises(mx.CaseError, match=r"another tool\.diameter cannot be written, since stock\.immersion"):
        file.leaf("tool.diameter")


def test_numbers_that_would_move_another_one_cannot_be_written():
    with pytest.raises(mx.CaseError, match=r"another tool\.diameter cannot be written, since cut\.start.*; give cut\.start"):
        case_file().leaf("tool.diameter")
    file = case_file(('feed_rate = "4 m/min"', 'feed_per_tooth = "0.1 mm"'))
    with pytest.raises(mx.CaseError, match=r"another cut\.spindle_speed cannot be written.*; give cut\.feed_rate"):
        file.leaf("cut.spindle_speed")


def test_pitch_angles_stay_a_turn():
    file = case_file(("teeth = 4", 'teeth = 4\npitch = ["82 deg", "97 deg", "86 deg", "95 deg"]'))
    again = mx.CaseFile.from_text(file.with_values({"tool.pitch.0": math.radians(84)})).case
    np.testing.assert_allclose(np.degrees(again.tool.pitch), [84, 97, 86, 93])
    with pytest.raises(mx.CaseError, match=r"another tool\.pitch\.3 cannot be written, since the last pitch angle is what"):
        file.leaf("tool.pitch.3")
    with pytest.raises(mx.CaseError, match=r"tool\.pitch: the angles given sum to 361 deg"):
        case_file(("teeth = 4", 'teeth = 4\npitch = ["83 deg", "97 deg", "86 deg", "95 deg"]'))
    with pytest.raises(mx.CaseError, match=r'force\.process_damping: "-1 N/m" given; it must be 0 or greater'):
        case_file(("kr = 0.3", 'kr = 0.3\nprocess_damping = "-1 N/m"'))


def test_a_tool_that_starts_in_the_stock_needs_no_feed():
    case_file(("depth =", "start = [0, 0]\ndepth ="), ('"4 m/min"', "0"))


def test_a_tooth_that_stands_out_may_meet_what_the_others_do_not():
    beside = ("[cut]", '[stock]\ny = ["10.004 mm", "80 mm"]\n[cut]')
    with pytest.raises(mx.CaseError, match="passes beside"):
        case_file(beside)
    case_file(beside, ("teeth = 4", 'teeth = 4\noffset = "5 um"\noffset_angle = 0'))


def test_the_other_laws():
    fractional = TEXT[TEXT.index("law =") : TEXT.index("[cut]")]
    linear = case_file((fractional, 'law = "linear"\nkt = "700 N/mm^2"\nke = "20 N/mm"\nkr = 0.3\n')).case.force
    assert isinstance(linear, mx.LinearLaw)
    assert (float(linear.kt), float(linear.ke)) == (pytest.approx(7e8), pytest.approx(2e4))
    for unit in ("N/mm^1.7", "N/mm^(1+m)"):
        power = case_file((fractional, f'law = "exponential"\nkf = "300 {unit}"\nm = 0.7\nkr = 0.3\n')).case.force
        assert isinstance(power, mx.ExponentialLaw)
        assert float(power.kf) == pytest.approx(300 * 1000**1.7)
    with pytest.raises(mx.CaseError, match=r'force\.kf: "300 N/mm\^1\.6" given; .* N/m\^1\.7'):
        case_file((fractional, 'law = "exponential"\nkf = "300 N/mm^1.6"\nm = 0.7\nkr = 0.3\n'))


def test_tables_of_fits_and_traces_are_left_alone():
    case_file(("[tool]", "[fit]\nanything = true\n[[trace]]\nfile = 3\n[tool]"))


def test_a_dictionary_is_a_case_too():
    case = mx.load_case(tomlkit.parse(TEXT).unwrap())
    assert float(case.force.k0) == pytest.approx(5e9)


@pytest.mark.parametrize("path", sorted(CASES.glob("*.toml")), ids=lambda path: path.name)
def test_the_documented_cases_load(path):
    mx.load_case(path)


BAD = {
    "unknown key": ("hs =", "hz =", ["force.hz is not a key", "Did you mean hs?", "k0* [N/m^2]"]),
    "misspelt key": ("teeth = 4", "teeht = 4", ["tool.teeht", "Did you mean teeth?", "diameter* [m]"]),
    "key of another table": ("teeth = 4", 'teeth = 4\ndepth = "1 mm"', ["tool.depth", "belongs to [cut]"]),
    "key of another law": ('k0 = "5000 N/mm^2"', "kt = 1e9", ["force.kt", 'the force law "linear"']),
    "helix too steep": ("teeth = 4", 'teeth = 4\nhelix = "80 deg"', ['tool.helix: "80 deg" given', "at most 1.309"]),
    "runout of another number of teeth": ("teeth = 4", 'teeth = 4\nrunout = ["1 um", "2 um"]', ["tool.runout", "4 teeth"]),
    "runout of one number": ("teeth = 4", 'teeth = 4\nrunout = "1 um"', ["tool.runout", "a list with one number per tooth"]),
    "offset without direction": ("teeth = 4", 'teeth = 4\noffset = "1 um"', ["offset and offset_angle together"]),
    "missing key": ('k0 = "5000 N/mm^2"', "", ["force.k0 is missing", "k0* [N/m^2]"]),
    "missing law": ('law = "fractional"', "", ["force.law is missing", "fractional | linear | exponential"]),
    "unknown law": ('"fractional"', '"quadratic"', ['force.law: "quadratic" given', '"exponential"']),
    "law of another type": ('"fractional"', "3", ["force.law: 3 given", '"exponential"']),
    "unknown table": ("[tool]", "[toool]", ["[toool] is not a table", "Did you mean tool?", "simulation"]),
    "missing table": ('[simulation]\nduration = "0.3 s"', "", ["table [simulation] is missing", "duration* [s]"]),
    "key outside a table": ("# a case", "depth = 1", ["depth", "belongs to [cut]"]),
    "table of another type": ("# a case", "stock = 1", ["stock: 1 given", "a table"]),
    "wrong unit": ("5000 N/mm^2", "5000 N/mm", ['force.k0: "5000 N/mm" given', "N/m^2", '"5000 N/mm^2"']),
    "unit of a plain number": ("r = 0.1", 'r = "0.1 mm"', ["force.r", '"0.1 mm" given']),
    "speed in hertz": ("10000 rpm", "167 Hz", ["cut.spindle_speed", "Hz", "rad/s", '"10000 rpm"']),
    "no number": ('"1 mm"', "true", ["cut.depth: true given"]),
    "nan": ('"1 mm"', "nan", ["cut.depth: nan given", "finite"]),
    "list for a number": ('"1 mm"', '["1 mm", "2 mm"]', ["cut.depth", '["1 mm", "2 mm"] given', "one number"]),
    "negative diameter": ('"20 mm"', '"-20 mm"', ['tool.diameter: "-20 mm" given', "greater than 0"]),
    "zero diameter": ('"20 mm"', '"0 mm"', ['tool.diameter: "0 mm" given', "greater than 0"]),
    "negative depth": ('"1 mm"', '"-1 mm"', ['cut.depth: "-1 mm" given', "greater than 0"]),
    "no teeth": ("teeth = 4", "teeth = 0", ["tool.teeth: 0 given", "at least 1"]),
    "half a tooth": ("teeth = 4", "teeth = 3.5", ["tool.teeth: 3.5 given", "whole number"]),
    "true teeth": ("teeth = 4", "teeth = true", ["tool.teeth: true given", "whole number"]),
    "negative stiffness of the cut": ('"5000 N/mm^2"', '"-5 N/mm^2"', ["force.k0", '"-5 N/mm^2"', "greater than 0"]),
    "negative speed": ('"10000 rpm"', '"-1 rpm"', ['cut.spindle_speed: "-1 rpm" given', "greater than 0"]),
    "negative feed": ('"4 m/min"', '"-4 m/min"', ['cut.feed_rate: "-4 m/min" given', "0 or greater"]),
    "two feeds": ("depth =", "feed_per_tooth = 1e-4\ndepth =", ["cut.feed_rate or cut.feed_per_tooth", "only one"]),
    "no feed": ('feed_rate = "4 m/min"', "", ["cut.feed_rate or cut.feed_per_tooth"]),
    "start of three": ("depth =", "start = [0, 0, 0]\ndepth =", ["cut.start", "two numbers"]),
    "stock reversed": ("[cut]", '[stock]\nx = ["80 mm", "0 mm"]\n[cut]', ['stock.x: ["80 mm", "0 mm"]', "smaller first"]),
    "no immersion": (*immersed("0 mm", "up"), ["stock.immersion: 0 mm given", "greater than 0", "at most", "20 mm"]),
    "immersion beyond the diameter": (*immersed("21 mm", "up"), ["stock.immersion: 21 mm given", "tool.diameter, 20 mm"]),
    "immersion without side": (
        "[cut]",
        "[stock]\nimmersion = 0.005\n[cut]",
        ["stock.milling: none given", '"up"', '"down"'],
    ),
    "side without immersion": ("[cut]", '[stock]\nmilling = "up"\n[cut]', ["stock.milling", "without stock.immersion"]),
    "immersion on another side": (*immersed("5 mm", "left"), ['stock.milling: "left" given', '"up", "down"']),
    "immersion and borders": ("[cut]", "[stock]\ny = [0, 1]\nimmersion = 0.005\n[cut]", ["stock: y and immersion given"]),
    "stock too far": (
        "depth =",
        "start = [-0.06, 0]\ndepth =",
        ["-60 mm (cut.start) to -40 mm", "x = -10 mm, after 0.75 s"],
    ),
    "stock behind": ("[cut]", "[stock]\nx = [-1, -0.1]\n[cut]", ["x = -10 mm (cut.start)", "behind at x = -90 mm"]),
    "stock beside": ("[cut]", "[stock]\ny = [0.01, 0.04]\n[cut]", ["radius is 10 mm", "at y = 10 mm and 40 mm"]),
    "tool at rest before the stock": ('"4 m/min"', "0", ["has no feed", "beyond x = -10 mm"]),
    "negative mass": ('"100 kg"', '"-100 kg"', ['structure.mass: "-100 kg" given', "greater than 0"]),
    "mass not positive definite": ('"100 kg"', "[[1, 2], [2, 1]]", ["structure.mass", "positive definite"]),
    "ragged matrix": ('"100 kg"', "[[1, 2], [2]]", ["structure.mass: [[1, 2], [2]] given", "matrix"]),
    "empty list": ('"100 kg"', "[]", ["structure.mass: [] given"]),
    "three dampings for two axes": ("ratio = 0.05", "ratio = [1, 2, 3]", ["structure.damping_ratio", "2 coordinates"]),
    "negative damping": ("ratio = 0.05", "ratio = -0.05", ["structure.damping_ratio: -0.05 given", "0 or greater"]),
    "two dampings": ("[simulation]", "damping = 3\n[simulation]", ["structure.damping_ratio or structure.damping"]),
    "unknown axis": ('["x", "y"]', '["x", "u"]', ['structure.axes: ["x", "u"] given', '"z"']),
    "axis as text": ('["x", "y"]', '"xy"', ['structure.axes: "xy" given', "list"]),
    "axes in another order": ('["x", "y"]', '["y", "x"]', ["structure.axes", "order"]),
    "no duration": ('"0.3 s"', '"0 s"', ['simulation.duration: "0 s" given', "greater than 0"]),
    "few steps": ("[simulation]", "[simulation]\nsteps_per_tooth = 4", ["simulation.steps_per_tooth: 4 given", "10"]),
    "steps too few for the fastest mode": ('"100 kg"', '"1e-6 kg"', ["simulation.steps_per_tooth"]),
    "no passes": ("[simulation]", "[simulation]\npasses = 0", ["simulation.passes: 0 given", "at least 1"]),
    "blocks that do not divide": ("[simulation]", "[simulation]\nblocks = 7", ["simulation.blocks: 7 given", "divi"]),
    "broken toml": ("[force]", "[force", ["not valid TOML", "line 5"]),
    "key twice": ("teeth = 4", "teeth = 4\nteeth = 5", ["not valid TOML", "teeth"]),
}


@pytest.mark.parametrize(("old", "new", "words"), BAD.values(), ids=BAD.keys())
def test_bad_input_is_refused_in_words_that_help(old, new, words):
    with pytest.raises(mx.CaseError) as error:
        case_file((old, new))
    message = str(error.value)
    for word in ["cut.toml: ", *words]:
        assert word in message
    assert len(message.splitlines()) <= 3


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(mx.CaseError, match=r"nothing\.toml: the case file cannot be read: No such file"):
        mx.load_case(tmp_path / "nothing.toml")


def test_a_file_that_is_not_text(tmp_path):
    (tmp_path / "case.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(mx.CaseError, match=r"case\.toml: not a text file"):
        mx.load_case(tmp_path / "case.toml")


def test_every_leaf_has_the_value_of_the_case_under_its_name():
    file = case_file()
    assert list(file.leaves) == [
        "tool.diameter",
        "force.k0",
        "force.hs",
        "force.r",
        "force.kr",
        "cut.spindle_speed",
        "cut.feed_rate",
        "cut.depth",
        "structure.mass",
        "structure.stiffness.x",
        "structure.stiffness.y",
        "structure.damping_ratio",
    ]
    for leaf in file.leaves.values():
        section, key = leaf.field
        assert leaf.value == pytest.approx(float(getattr(getattr(file.case, section), key)[leaf.index]), rel=1e-15)
    assert file.leaf("force.k0").unit == "N/mm^2"
    assert file.leaf("structure.stiffness.x").unit == "N/um"
    assert file.leaf("structure.stiffness.y").unit == "N/m"
    assert file.leaf("cut.spindle_speed").express(2 * math.pi) == pytest.approx(60)


def test_entries_of_matrices_and_coordinates_without_axis_have_numbers_for_names():
    file = case_file(
        ('"100 kg"', '["1 kg", "2 kg", "3 kg"]'),
        ('[\n    "0.3 N/um",      # along the feed\n    3e5,             # across\n]', "[[9,1,0],[1,8,0],[0,0,7]]"),
        ("[simulation]", "mode_shapes = [[1, 0, 0.5], [0, 1, 0.5]]\n[simulation]"),
    )
    assert file.leaf("structure.mass.2").value == 3
    assert file.leaf("structure.stiffness.1.0").value == 1
    assert file.leaf("structure.mode_shapes.0.2").value == 0.5


def test_a_feed_per_tooth_is_not_a_leaf():
    file = case_file(('feed_rate = "4 m/min"', 'feed_per_tooth = "0.1 mm"'))
    assert not {"cut.feed_rate", "cut.feed_per_tooth"} & set(file.leaves)


def test_an_unknown_leaf_is_an_error_with_the_nearest_name():
    with pytest.raises(mx.CaseError, match=r"forc\.k0 is not a number of this case file\. Did you mean force\.k0\?"):
        case_file().leaf("forc.k0")
    with pytest.raises(mx.CaseError, match=r"structure\.stiffness is not a number"):
        case_file().with_values({"structure.stiffness": 1.0})


def test_new_values_are_written_in_the_units_of_the_file_and_nothing_else_changes():
    file = case_file()
    text = file.with_values(
        {"force.k0": 4.8e9, "force.r": 0.12, "structure.stiffness.x": 2.5e5, "structure.stiffness.y": 3.5e5}
    )
    expected = (
        TEXT.replace('"5000 N/mm^2"', '"4800 N/mm^2"')
        .replace("r = 0.1\n", "r = 0.12\n")
        .replace('"0.3 N/um"', '"0.25 N/um"')
        .replace("3e5,", "350000.0,")
    )
    assert text == expected
    assert float(mx.CaseFile.from_text(text).case.force.k0) == pytest.approx(4.8e9, rel=1e-12)


def test_a_new_exponent_changes_the_unit_of_kf():
    fractional = TEXT[TEXT.index("law =") : TEXT.index("[cut]")]
    file = case_file((fractional, 'law = "exponential"\nkf = "300 N/mm^1.7"\nm = 0.7\nkr = 0.3\n'))
    force = mx.CaseFile.from_text(file.with_values({"force.m": 0.6, "force.kf": 2e6})).case.force
    assert (float(force.m), float(force.kf)) == (0.6, 2e6)
    # kf alone keeps its SI value when m changes, which its old unit would not allow.
    force = mx.CaseFile.from_text(file.with_values({"force.m": 0.6})).case.force
    assert float(force.kf) == pytest.approx(300 * 1000**1.7)


def test_coefficients_of_each_tooth_have_names_of_their_own():
    file = case_file(("kr = 0.3", 'kr = [0.3, 0.4, 0.3, 0.2]\nke = ["10 N/mm", "30 N/mm", 0, 2e3]'))
    np.testing.assert_allclose(file.case.force.ke, [1e4, 3e4, 0.0, 2e3])
    assert not file.case.equal_teeth
    written = mx.CaseFile.from_text(file.with_values({"force.ke.1": 2.5e4, "force.kr.3": 0.25}), "cut.toml")
    assert 'ke = ["10 N/mm", "25 N/mm", 0, 2e3]' in written.text
    assert float(written.case.force.kr[3]) == 0.25
    assert mx.load_case(written.tables).force.ke[1] == 2.5e4
    with pytest.raises(mx.CaseError, match=r"force.kr: .* given; it must be one number, or a list with one per tooth"):
        case_file(("kr = 0.3", "kr = [[0.3, 0.4], [0.3, 0.2]]"))
