"""Cases that a robot holds: what [robot] in a file means, its numbers by name, what is refused, and that the simulation is
that of the structure which follows from the pose."""

import dataclasses
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arms import standing, worst
from cases import SLOT_FILE

import millax as mx
from benchmarks.kr270 import COMPLIANCE
from benchmarks.kr270 import JOINTS as Q
from identification import Parameter
from identification._parameters import free
from millax._names import quantity_of, read_value, replace, valid_names, value_of
from millax.robot import Arm, Beam, Loads, Payload, Placement, Robot, Spindle, models

MILLING = SLOT_FILE + 'start = ["20 mm", 0]\n'  # all of the tool in the stock from the start
ROBOT = """\
[robot]
model = "kuka_kr270"
joints = ["90 deg", "-50 deg", "120 deg", "180 deg", "25 deg", 3.14159265358979312]  # of C
compliance = ["0.26 urad/(N m)", "0.15 urad/(N m)", 0.26e-6, 1.79e-6, 1.52e-6, "2.13e-6 rad/(N m)"]
damping_ratio = "5 %"
feed_angle = "30 deg"
[robot.tool]
xyz = ["0 mm", "50 mm", "300 mm"]
rpy = ["0 deg", "90 deg", 0.1]
mass = "40 kg"
centre_of_mass = [0, "5 cm", 0.1]
inertia = [[1, 0.1, 0], [0.1, 1, 0], ["0 kg m^2", 0, 0.5]]
[robot.loads]
force = ["0.1 kN", 0, "-20 N"]
moment = [0, "3 N m", 0]
gravity = [0, 0, -9.81]
"""
END = '[simulation]\nduration = "15 ms"\nsteps_per_tooth = 20\nblocks = 2\nsweeps = 6\n'
TEXT = MILLING + ROBOT + END
FREE = MILLING + ROBOT[: ROBOT.index("[robot.loads]")] + END
"""The same under no loads."""


def case_file(*changes: tuple[str, str], text: str = TEXT) -> mx.CaseFile:
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return mx.CaseFile.from_text(text, "cut.toml")


@pytest.fixture(scope="module")
def file() -> mx.CaseFile:
    return case_file()


def held(**changes) -> Arm:
    """The robot of `TEXT`, made in Python."""
    given = {
        "robot": models.kuka_kr270(),
        "joints": Q,
        "compliance": COMPLIANCE,
        "damping_ratio": 0.05,
        "feed_angle": np.deg2rad(30),
        "tool": Spindle(
            (0.0, 0.05, 0.3), (0.0, np.pi / 2, 0.1), 40.0, (0.0, 0.05, 0.1), [[1, 0.1, 0], [0.1, 1, 0], [0, 0, 0.5]]
        ),
        "loads": Loads((100.0, 0.0, -20.0), (0.0, 3.0, 0.0), (0.0, 0.0, -9.81)),
    }
    return Arm(**(given | changes))


def same(one, other, rtol=1e-14) -> None:
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(a, b, rtol=rtol, atol=1e-15)


# What a file means


def test_every_key_of_a_robot(file):
    same(file.case.robot, held())
    assert file.case.robot is file.case.structure


def test_the_other_keys_of_damping():
    for damping in ([100, 200, 300, 40, 50, 60], ["100 N m s/rad", 200, 300, 40, 50, 60]):
        robot = case_file(('damping_ratio = "5 %"', f"damping = {damping}")).case.robot
        same(robot, held(damping=[100.0, 200, 300, 40, 50, 60], damping_ratio=None))
    ratios = [0.01, 0.02, 0.03, 0.04, 0.05, 0.06]
    same(case_file(('"5 %"', str(ratios))).case.robot, held(damping_ratio=ratios))


def test_what_is_not_given_is_not_there():
    text = MILLING + ROBOT[: ROBOT.index("feed_angle")] + END
    robot = case_file(text=text).case.robot
    same(robot, held(feed_angle=0.0, tool=None, loads=None))
    robot = case_file(("[simulation]", '[robot.loads]\nforce = [0, 0, "1 N"]\n[simulation]'), text=text).case.robot
    same(robot, held(feed_angle=0.0, tool=None, loads=Loads((0.0, 0.0, 1.0))))


def urdf(robot: Robot) -> str:
    """The robot as a file, with the names of its joints."""

    def numbers(of):
        return " ".join(repr(float(x)) for x in of)

    links, joints = ['<link name="link_0"/>'], []
    for i, name in enumerate(robot.names):
        inertia = np.asarray(robot.inertia[i])
        moments = " ".join(f'i{"xyz"[a]}{"xyz"[b]}="{float(inertia[a, b])!r}"' for a in range(3) for b in range(a, 3))
        links.append(
            f'<link name="link_{i + 1}"><inertial><origin xyz="{numbers(robot.centre_of_mass[i])}"/>'
            f'<mass value="{float(robot.mass[i])!r}"/><inertia {moments}/></inertial></link>'
        )
        joints.append(
            f'<joint name="{name}" type="revolute"><origin xyz="{numbers(robot.xyz[i])}" rpy="{numbers(robot.rpy[i])}"/>'
            f'<parent link="link_{i}"/><child link="link_{i + 1}"/><axis xyz="{numbers(robot.axis[i])}"/>'
            f'<limit lower="{float(robot.lower[i])!r}" upper="{float(robot.upper[i])!r}" effort="1" velocity="1"/></joint>'
        )
    tip = robot.flange
    joints.append(
        f'<joint name="flange" type="fixed"><origin xyz="{numbers(tip.xyz)}" rpy="{numbers(tip.rpy)}"/>'
        f'<parent link="link_{len(robot.names)}"/><child link="flange"/></joint>'
    )
    return f'<robot name="arm">{"".join(links)}<link name="flange"/>{"".join(joints)}</robot>'


def test_a_robot_from_a_file_beside_the_case(tmp_path):
    robot = models.kuka_kr210_r2700_2()
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "arm.urdf").write_text(urdf(robot))
    (tmp_path / "cut.toml").write_text(TEXT.replace('model = "kuka_kr270"', 'urdf = "robots/arm.urdf"'))
    # Angles of the file are turned into rotations and back.
    same(mx.load_case(tmp_path / "cut.toml").structure.structure(), held(robot=robot).structure(), rtol=1e-11)
    (tmp_path / "robots" / "arm.urdf").unlink()
    with pytest.raises(mx.CaseError, match=r'robot\.urdf: "robots/arm\.urdf" cannot be read: No such file'):
        mx.load_case(tmp_path / "cut.toml")


TABLE = """\
dh = [
    ["350 mm", "90 deg", -0.675, 0],
    [1.150, 0, 0, 0],
    ["-41 mm", "90 deg", 0, "-90 deg"],
    [0, "-90 deg", "-1200 mm", 0],
    [0, "90 deg", 0, 0],
    [0, "180 deg", "-240 mm", "180 deg"],
]
link_mass = ["336.8 kg", 259.4, 85.2, 54.5, 36.3, 18.2]
link_thickness = "150 mm"
"""


def test_a_robot_from_a_table():
    upright = dataclasses.replace(models.kuka_kr270(), base=Placement())
    case = case_file(('model = "kuka_kr270"\n', TABLE)).case
    assert case.robot is not None
    same(case.robot.robot, upright)


def test_links_as_tubes():
    tubes = '[robot.links]\njoints = [1, 2]\nouter = ["500 mm", "300 mm"]\ninner = ["420 mm", 0.23]\nyoung = "70 GPa"\n'
    arm = case_file((END, tubes + END), text=FREE).case.robot
    assert list(arm.beams) == ["joint_1", "joint_2"]
    expected = Beam.tube(0.3, 0.23, young=70e9)
    assert jax.tree.all(jax.tree.map(np.allclose, arm.beams["joint_2"], expected))
    rigid = case_file(text=FREE).case.robot
    assert np.linalg.eigvalsh(arm.structure().stiffness)[0] < np.linalg.eigvalsh(rigid.structure().stiffness)[0]
    for old, new, words in (
        ("[1, 2]", "[1, 7]", "robot.links.joints: 7 given; name each link once, by the number of its joint, 1 to 6"),
        ("[1, 2]", "[1, 1]", "robot.links.joints: 1 given"),
        ("[1, 2]", "[5, 2]", "the link of joint_5 has no length"),
        ('"420 mm", 0.23', "0.5, 0.23", "robot.links.inner: 500 mm given; it must be less than the outer diameter, 500 mm"),
        ('"420 mm", ', "", "robot.links.inner: 1 numbers given; robot.links.joints names 2 links"),
    ):
        assert old in tubes
        with pytest.raises(mx.CaseError, match=re.escape(words)):
            case_file((END, tubes.replace(old, new) + END), text=FREE)


def test_rods_in_place_of_what_a_model_gives():
    rods = 'abb_irb6660"\nlink_mass = [400, 250, 200, 100, 60, 20]\nlink_thickness = 0.1'
    case = case_file(('kuka_kr270"', rods), ('"-50 deg", "120 deg"', '"20 deg", "-30 deg"')).case
    assert case.robot is not None
    same(case.robot.robot, models.abb_irb6660().with_rods(0.1, [400.0, 250, 200, 100, 60, 20]))


# Names


def test_every_number_of_the_file_has_a_name_and_a_value(file):
    named = [name for name in file.leaves if name.startswith("robot.") and ".inertia." not in name]
    assert set(named) == {name for name in valid_names(file.case) if name.startswith("robot.")}
    assert named[5:8] == ["robot.joints.joint_6", "robot.compliance.joint_1", "robot.compliance.joint_2"]
    assert {"robot.damping_ratio", "robot.feed_angle", "robot.tool.rpy.y", "robot.loads.gravity.z"} < set(named)
    for name in named:
        assert value_of(file.case, name) == pytest.approx(file.leaf(name).value, rel=1e-15)
    inertia = np.asarray(file.case.robot.tool.inertia)
    for i, j in np.ndindex(3, 3):  # entries of a matrix: in the file only
        assert file.leaf(f"robot.tool.inertia.{i}.{j}").value == inertia[i, j]
    assert file.leaf("robot.joints.joint_2").unit == "deg"
    assert file.leaf("robot.compliance.joint_1").unit == "urad/(N m)"
    by_mode = case_file(('"5 %"', "[0.01, 0.02, 0.03, 0.04, 0.05, 0.06]"))
    assert by_mode.leaf("robot.damping_ratio.mode_3").value == value_of(by_mode.case, "robot.damping_ratio.mode_3") == 0.03
    by_joint = case_file(('damping_ratio = "5 %"', "damping = [1, 2, 3, 4, 5, 6]"))
    assert by_joint.leaf("robot.damping.joint_4").value == value_of(by_joint.case, "robot.damping.joint_4") == 4
    assert not any(name.startswith("structure") for name in valid_names(file.case))


def test_what_the_file_leaves_out_has_no_name():
    case = case_file(text=f"{FREE}[robot.loads]\nforce = [1, 0, 0]\n").case
    names = valid_names(case)
    assert not any("gravity" in name for name in names)
    assert "robot.loads.moment.x" in names  # none, and as good as any other
    case = case_file(text=MILLING + ROBOT[: ROBOT.index("[robot.tool]")] + END).case
    assert not any(name.startswith(("robot.tool", "robot.loads")) for name in valid_names(case))


def test_values_that_are_written_back_are_read_again(file):
    rng = np.random.default_rng(0)
    names = [name for name in file.leaves if name.startswith("robot.") and "inertia" not in name]
    values = {name: file.leaf(name).value * rng.uniform(0.99, 1.01) for name in names}
    text = file.with_values(values)
    again = mx.CaseFile.from_text(text).case
    for name, value in values.items():
        assert value_of(again, name) == pytest.approx(value, rel=1e-11)  # 12 digits are written
    assert '"180 deg"' not in text
    assert "# of C" in text
    # Without other values it is the text of before.
    unchanged = file.with_values({name: file.leaf(name).value for name in ("robot.tool.mass", "robot.joints.joint_1")})
    assert unchanged == TEXT


LAYOUTS = {
    "keys with dots": ('tool.mass = "3 kg"\ntool.xyz = [0, 0, "100 mm"]\n', ""),
    "a table in the line": ('tool = {mass = "3 kg", xyz = [0, 0, "100 mm"]}\n', ""),
    "tables apart": ("", '[robot.tool]\nmass = "3 kg"\nxyz = [0, 0, "100 mm"]\n'),
}


@pytest.mark.parametrize(("inside", "behind"), LAYOUTS.values(), ids=LAYOUTS)
def test_tables_may_stand_where_toml_lets_them(inside, behind):
    text = MILLING + ROBOT[: ROBOT.index("[robot.tool]")] + inside + END + behind
    file = case_file(text=text)
    written = file.with_values({"robot.tool.mass": 4.0, "robot.tool.xyz.z": 0.2, "robot.joints.joint_1": np.pi / 3})
    assert written == text.replace("3 kg", "4 kg").replace("100 mm", "200 mm").replace('"90 deg"', '"60 deg"')
    again = mx.CaseFile.from_text(written).case
    assert value_of(again, "robot.tool.mass") == 4
    assert value_of(again, "robot.tool.xyz.z") == 0.2


def test_every_number_can_be_replaced_and_nothing_else_changes(file):
    names = [name for name in valid_names(file.case) if name.startswith("robot.")]
    before = {name: value_of(file.case, name) for name in names}
    for name in names:
        other = replace(file.case, {name: jnp.asarray(0.123)})
        assert {known: value_of(other, known) for known in names} == before | {name: 0.123}
    both = replace(file.case, {"robot.tool.mass": jnp.asarray(1.0), "force.k0": jnp.asarray(2.0)})
    assert (float(both.robot.tool.mass), float(both.force.k0)) == (1.0, 2.0)
    slope = jax.grad(lambda m: replace(file.case, {"robot.tool.mass": m}).robot.tool.mass ** 2)(3.0)
    assert float(slope) == 6.0


def test_units_and_ranges(file):
    assert quantity_of(file.case, "robot.joints.joint_2").unit == "rad"
    assert quantity_of(file.case, "robot.compliance.joint_2").unit == "rad/(N m)"
    assert not quantity_of(file.case, "robot.compliance.joint_2").range.admits(np.array(0.0))
    assert read_value(file.case, "robot.compliance.joint_2", "0.2 mrad/(kN m)") == pytest.approx(2e-7)
    assert read_value(file.case, "robot.tool.xyz.x", "2 mm") == pytest.approx(2e-3)
    with pytest.raises(ValueError, match=r"robot\.tool\.mass: .* cannot be converted to kg"):
        read_value(file.case, "robot.tool.mass", "2 mm")


def test_joints_keep_within_their_limits(file):
    # Of the KR270 none are known.
    assert quantity_of(file.case, "robot.joints.joint_2").range.admits(np.array([-100.0, 100.0]))
    case = case_file(("kuka_kr270", "kuka_kr210_r2700_2")).case
    limits = quantity_of(case, "robot.joints.joint_2").range
    assert limits.admits(np.deg2rad([-140.0, -5.0]))
    assert not limits.admits(np.deg2rad(-4.9))
    with pytest.raises(ValueError, match=r"robot\.joints\.joint_2: 0 deg given; it must be -2\.443\d+ or greater"):
        mx.sweep(case, grid={"robot.joints.joint_2": "-20, 0 deg"})


def test_a_fit_takes_them_as_parameters(file):
    numbers = free(file.case, [Parameter("robot.compliance.joint_1"), Parameter("robot.tool.mass", "50 kg")])
    case = numbers.insert(file.case, jnp.zeros(2))
    assert float(case.robot.tool.mass) == 50.0
    same(eqx.tree_at(lambda c: c.structure.tool.mass, case, jnp.asarray(40.0)), file.case)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("robot.compliance", ["the case gives 6 numbers; name them one by one: robot.compliance.joint_1, robot"]),
        (
            "robot.damping_ratio.mode_1",
            ["gives one number for all modes; name it robot.damping_ratio,", "one number per mode"],
        ),
        ("robot.tool.inertia", ["robot.tool.inertia as a matrix, whose entries have no names"]),
        ("robot.joint.joint_1", ["did you mean robot.joints.joint_1?"]),
        ("robot.tool.centre_of_mass.0", ["did you mean robot.tool.centre_of_mass."]),
    ],
)
def test_names_that_are_none_are_answered_with_those_that_are(file, name, words):
    with pytest.raises(ValueError, match=r".") as error:
        value_of(file.case, name)
    for word in words:
        assert word in str(error.value)
    assert "one number for all in the case" not in str(error.value)


# What is refused


MODEL = 'model = "kuka_kr270"'
DAMPING = 'damping_ratio = "5 %"'
LAST = '"2.13e-6 rad/(N m)"]'
BAD = {
    "two that hold the tool": (
        "[simulation]",
        '[structure]\naxes = ["x"]\nmass = 1\nstiffness = 1\ndamping_ratio = 0.1\n[simulation]',
        ["[structure] and [robot] given", "Give one of them"],
    ),
    "another table": ("[robot.loads]", "[robot.load]", ["robot.load is not a key", "Did you mean loads?", "[robot.tool]"]),
    "a table of a name unlike any": ("[robot.loads]", "[robot.xxx]", ["robot.xxx is not a key", "[robot.loads]"]),
    "a key of a table in it": ('mass = "40 kg"', "mas = 40", ["robot.tool.mas is not a key of [robot.tool]", "mass?"]),
    "a number for a table": ("[robot.tool]", "[robot.loads.tool]", ["robot.loads.tool is not a key"]),
    "no robot but its tool": (ROBOT[: ROBOT.index("[robot.tool]")], "", ["robot.joints is missing"]),
    "not a table": (ROBOT, "[robot]\ntool = 3\n" + ROBOT[8 : ROBOT.index("[robot.tool]")], ["robot.tool: 3 given", "table"]),
    "no robot": (MODEL, "", ["give robot.model or robot.urdf or robot.dh: one of them"]),
    "two robots": (MODEL, f'{MODEL}\nurdf = "a.urdf"', ["give robot.model or robot.urdf or robot.dh"]),
    "unknown robot": (MODEL, 'model = "kr270"', ['robot.model: "kr270" given', '"kuka_kr270"', '"abb_irb6660_ha"']),
    "no file": (MODEL, "urdf = 3", ["robot.urdf: 3 given; it must be the name of a file"]),
    "no joints": ("joints = [", "feed = [", ["robot.feed is not a key"]),
    "five joints": ('["90 deg", ', "[", ["robot.joints: 5 numbers given; the robot has 6 joints"]),
    "one joint": (
        '["90 deg", "-50 deg", "120 deg", "180 deg", "25 deg", 3.14159265358979312]',
        "1",
        ["robot.joints: 1 given"],
    ),
    "seven compliances": (LAST, '"2.13e-6 rad/(N m)", 1e-6]', ["robot.compliance: 7 numbers given; the robot has 6"]),
    "no compliance": (LAST, "0]", ["robot.compliance: [", "0] given; it must be greater than 0"]),
    "stiffness for compliance": (LAST, '"1e6 N m/rad"]', ['robot.compliance[5]: "1e6 N m/rad" given', "rad/(N m)"]),
    "no damping": (DAMPING, "", ["give robot.damping_ratio or robot.damping: one of them, and only one"]),
    "two dampings": (DAMPING, f"{DAMPING}\ndamping = [1, 1, 1, 1, 1, 1]", ["robot.damping_ratio or robot.damping"]),
    "five dampings": (DAMPING, "damping = [1, 1, 1, 1, 1]", ["robot.damping", "6 numbers, one per joint"]),
    "negative damping": (DAMPING, "damping = [1, 1, 1, 1, 1, -1]", ["robot.damping: [1, 1, 1, 1, 1, -1] given", "0 or gr"]),
    "two ratios": (DAMPING, "damping_ratio = [0.1, 0.2]", ["robot.damping_ratio: [0.1, 0.2] given", "six, one per mode"]),
    "negative ratio": (DAMPING, "damping_ratio = -0.1", ["robot.damping_ratio: -0.1 given; it must be 0 or greater"]),
    "feed along a length": ('feed_angle = "30 deg"', 'feed_angle = "30 mm"', ['robot.feed_angle: "30 mm" given', "rad"]),
    "a model without masses": (
        MODEL,
        'model = "abb_irb6660"',
        ['robot: "abb_irb6660" gives no masses, no centres of mass, no inertia', "robot.link_mass and robot.link_thickness"],
    ),
    "a table without masses": (
        MODEL,
        TABLE[TABLE.index("dh") : TABLE.index("link_mass")],
        ["robot: a table of lengths and angles gives no masses", "give robot.link_mass and robot.link_thickness"],
    ),
    "a row of three": (MODEL, "dh = [[0, 0, 0, 0], [0, 0, 0]]", ["robot.dh[1]: [0, 0, 0] given", "a m, alpha rad, d m"]),
    "no rows": (MODEL, "dh = []", ["robot.dh: [] given; it must be a list of rows"]),
    "a length for an angle": (MODEL, 'dh = [[0, 0, 0, "1 mm"]]', ["robot.dh[0], theta", '"1 mm" given', '"30 deg"']),
    "masses without thickness": (
        MODEL,
        f"{MODEL}\nlink_mass = [1, 1, 1, 1, 1, 1]",
        ["link_mass and link_thickness together"],
    ),
    "masses of five links": (
        MODEL,
        f"{MODEL}\nlink_mass = [1, 1, 1, 1, 1]\nlink_thickness = 0.1",
        ["robot.link_mass: 5 numbers given; the robot has 6 links"],
    ),
    "a link without mass": (
        MODEL,
        f"{MODEL}\nlink_mass = [1, 1, 1, 1, 1, 0]\nlink_thickness = 0.1",
        ["robot.link_mass: [1, 1, 1, 1, 1, 0] given; it must be greater than 0"],
    ),
    "stretched wrist": (
        '"25 deg"',
        '"0 deg"',
        ["robot.joints: the pose (90, -50, 120, 180, 0, 180) deg is singular", "joint_4 and joint_6", "Change joint_5"],
    ),
    "beyond a limit": (
        'kuka_kr270"\njoints = ["90 deg", "-50 deg"',
        'kuka_kr210_r2700_2"\njoints = ["90 deg", "0 deg"',
        ["robot.joints: 0 rad (0 deg) given for joint_2; it must be from -2.443 rad (-140 deg) to -0.08727 rad (-5 deg)"],
    ),
    "a tool of less than nothing": (
        'mass = "40 kg"',
        'mass = "-40 kg"',
        ['robot.tool.mass: "-40 kg" given', "0 or greater"],
    ),
    "a point in the plane": ('[0, "5 cm", 0.1]', '[0, "5 cm"]', ["robot.tool.centre_of_mass", "a list of three numbers"]),
    "inertia in the plane": (
        '[[1, 0.1, 0], [0.1, 1, 0], ["0 kg m^2", 0, 0.5]]',
        "[[1, 0], [0, 1]]",
        ["robot.tool.inertia: shape (2, 2) given; it must be (3, 3)"],
    ),
    "inertia that is not symmetric": ("[0.1, 1, 0]", "[0.2, 1, 0]", ["robot.tool.inertia: a matrix given is not symmetric"]),
    "inertia of less than nothing": (
        '[[1, 0.1, 0], [0.1, 1, 0], ["0 kg m^2", 0, 0.5]]',
        "[[-90, 0, 0], [0, -90, 0], [0, 0, -90]]",
        ["robot: the mass matrix is not positive definite: what is moved by", "joint_6"],
    ),
    "force in the plane": ('["0.1 kN", 0, "-20 N"]', "[1, 2]", ["robot.loads.force: [1, 2] given", "three numbers"]),
    "loads beyond the springs": ('["0.1 kN", 0, "-20 N"]', "[3e6, 0, 0]", ["robot.loads: no equilibrium found"]),
    "loads that throw it over": ('["0.1 kN", 0, "-20 N"]', "[3e6, 3e6, 3e6]", ["robot.loads: under them", "does not stand"]),
}


@pytest.mark.parametrize(("old", "new", "words"), BAD.values(), ids=BAD.keys())
def test_bad_input_is_refused_in_words_that_help(old, new, words):
    with pytest.raises(mx.CaseError) as error:
        case_file((old, new))
    for word in ["cut.toml: ", *words]:
        assert word in str(error.value)
    assert len(str(error.value).splitlines()) <= 2
    assert "with_rods" not in str(error.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"damping": np.ones(6)}, "robot: give damping or damping_ratio, and only one of them"),
        ({"damping_ratio": None}, "robot: give damping or damping_ratio, and only one of them"),
        ({"damping_ratio": [0.1, 0.2]}, r"robot\.damping_ratio: shape \(2,\) given; it must be one number, or 6"),
        ({"damping_ratio": -0.1}, r"robot\.damping_ratio: -0\.1 given; it must be 0 or greater"),
        ({"damping_ratio": None, "damping": -np.ones(6)}, r"robot\.damping: -1 N m s/rad given; it must be 0 or greater"),
        ({"damping_ratio": None, "damping": np.ones((6, 5))}, r"robot\.damping: shape \(6, 5\) given; .* 6 by 6"),
        ({"joints": Q[:5]}, r"robot\.joints: shape \(5,\) given; it must be 6 numbers, one per joint"),
        ({"joints": Q * np.nan}, r"robot\.joints: nan rad given"),
        ({"compliance": COMPLIANCE[:5]}, r"robot\.compliance: shape \(5,\) given; it must be 6 numbers"),
        ({"compliance": -COMPLIANCE}, r"compliance: -2\.6e-07 rad/\(N m\) given for joint_1"),
        ({"feed_angle": (0.0, 1.0)}, r"robot\.feed_angle: shape \(2,\) given; it must be one number"),
    ],
)
def test_bad_arms_are_named(changes, message):
    with pytest.raises(ValueError, match=message):
        held(**changes)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"xyz": (0.0, 1.0)}, r"robot\.tool\.xyz: shape \(2,\) given; it must be \(3,\)"),
        ({"rpy": (0.0, np.nan, 0.0)}, r"robot\.tool\.rpy: nan rad given"),
        ({"mass": -1.0}, r"robot\.tool\.mass: -1 kg given; it must be 0 or greater"),
        ({"inertia": np.eye(2)}, r"robot\.tool\.inertia: shape \(2, 2\) given; it must be \(3, 3\)"),
        ({"inertia": np.triu(np.ones((3, 3)))}, r"robot\.tool\.inertia: a matrix given is not symmetric"),
    ],
)
def test_bad_spindles_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        Spindle(**arguments)


# What the tool feels


def test_the_workpiece_stands_as_the_tool_and_the_feed_say():
    for angle in (0.0, 0.7, -2.0):
        arm = held(feed_angle=angle)
        tool = standing(arm.elastic, Q).rotation
        x, y, z = np.asarray(arm.workpiece).T
        np.testing.assert_allclose(x, np.cos(angle) * tool[:, 0] + np.sin(angle) * tool[:, 1], atol=1e-14)
        np.testing.assert_allclose(z, -tool[:, 2], atol=1e-14)
        np.testing.assert_allclose(np.cross(x, y), z, atol=1e-14)


def test_a_spindle_takes_the_place_of_tool_and_payload():
    spindle = held().tool
    assert spindle is not None
    before = dataclasses.replace(models.kuka_kr270(), tool=Placement((1.0, 2.0, 3.0)), payload=Payload(7.0))
    for robot in (models.kuka_kr270(), before):
        found = spindle.on(robot)
        same(found.tool, Placement(spindle.xyz, spindle.rpy))
        same(found.payload, Payload(spindle.mass, spindle.centre_of_mass, spindle.inertia))
    same(Arm(before, Q, COMPLIANCE, 0.05).elastic.robot, before)


def by_hand(arm: Arm) -> mx.Structure:
    """Stiffness, mass and damping in closed form, turned into the workpiece frame."""
    elastic, frame = arm.elastic, np.kron(np.eye(2), np.asarray(arm.workpiece))
    turn = np.asarray(arm.workpiece)
    assert arm.loads is not None
    loads = Loads(turn @ arm.loads.force, turn @ arm.loads.moment, arm.loads.gravity)
    x = elastic.equilibrium(arm.joints, loads)
    stands = standing(elastic, x)
    springs = np.diag(1 / np.asarray(arm.compliance)) - stands.load_slope(loads)
    to_joints = np.linalg.inv(stands.jacobian()) @ frame
    stiffness, mass = (to_joints.T @ of @ to_joints for of in (springs, stands.mass_matrix()))
    if arm.damping is not None:
        joints = np.diag(arm.damping) if arm.damping.ndim == 1 else np.asarray(arm.damping)
        damping = to_joints.T @ joints @ to_joints
    else:
        root = np.linalg.cholesky(mass)
        inverse = np.linalg.inv(root)
        square, shapes = np.linalg.eigh(inverse @ (stiffness + stiffness.T) / 2 @ inverse.T)
        rate = 2 * np.broadcast_to(np.asarray(arm.damping_ratio), 6) * np.sqrt(square)
        damping = root @ shapes @ np.diag(rate) @ shapes.T @ root.T
    return mx.Structure(("x", "y", "z"), mass, stiffness, damping=damping, mode_shapes=np.eye(3, 6))


DAMPED = {
    "one ratio": {},
    "a ratio per mode": {"damping_ratio": [0.01, 0.02, 0.03, 0.04, 0.05, 0.06]},
    "joints": {"damping_ratio": None, "damping": np.array([900.0, 800, 500, 90, 80, 30])},
    "a matrix of joints": {"damping_ratio": None, "damping": np.diag([900.0, 800, 500, 90, 80, 30]) + 20},
}


@pytest.mark.parametrize("changes", DAMPED.values(), ids=DAMPED)
def test_the_tool_feels_the_stiffness_mass_and_damping_of_the_pose(changes):
    arm = held(**changes)
    found, expected = arm.structure(), by_hand(arm)
    for name in ("mass", "stiffness", "damping"):
        # The condition number of the Jacobian is some 10, its square comes in.
        assert worst(getattr(found, name), np.asarray(getattr(expected, name))) < 1e-12
    assert (found.axes, found.coordinates) == (("x", "y", "z"), 6)
    # The force of the loads is in the axes of the workpiece: along base axes it would be another stiffness.
    wrong = dataclasses.replace(arm.loads, force=np.linalg.inv(arm.workpiece) @ arm.loads.force)
    assert worst(held(**changes, loads=wrong).structure().stiffness, np.asarray(found.stiffness)) > 1e-7


def test_elastic_links_and_what_follows_from_more_springs_than_six():
    beams = {"joint_2": Beam.tube(0.3, 0.25)}
    arm = held(beams=beams, loads=None, damping_ratio=None, damping=np.array([900.0, 800, 500, 90, 80, 30]))
    frame, elastic = np.kron(np.eye(2), np.asarray(arm.workpiece)), arm.elastic
    stands = standing(elastic, elastic.extended(Q))
    jacobian = stands.jacobian()
    yields = np.linalg.solve(np.asarray(elastic.springs), jacobian.T)
    stiffness = np.linalg.inv(jacobian @ yields)
    follow = yields @ stiffness @ frame
    joints = follow[[0, 1, 8, 9, 10, 11]]  # beyond joint 2 stand the motions of its link
    found = arm.structure()
    assert worst(found.stiffness, frame.T @ stiffness @ frame) < 1e-12
    assert worst(found.mass, follow.T @ stands.mass_matrix() @ follow) < 1e-12
    assert worst(found.damping, joints.T @ np.diag(arm.damping) @ joints) < 1e-12


# Simulations


def test_a_simulation_is_that_of_the_structure_made_by_hand(file):
    simulated = mx.simulate(file.case)
    case = eqx.tree_at(lambda c: c.structure, file.case, by_hand(file.case.robot), is_leaf=lambda x: isinstance(x, Arm))
    expected = mx.simulate(case)
    assert simulated.axes == ("x", "y", "z")
    assert np.abs(simulated.displacement).max() > 1e-6
    for name in ("force", "displacement"):
        assert worst(getattr(simulated, name), np.asarray(getattr(expected, name))) < 1e-10


def test_in_the_mean_the_tool_gives_way_as_the_force_and_the_compliance_say():
    # So stiff and damped that it comes to rest: at 130 Hz and a ratio of 0.4 e^-19 of the start is left after 60 ms.
    file = case_file(('"5 %"', "0.4"), ('"15 ms"', '"0.06 s"'), ("steps_per_tooth = 20", "steps_per_tooth = 60"), text=FREE)
    case = eqx.tree_at(lambda c: c.structure.compliance, file.case, COMPLIANCE / 100)
    sim = mx.simulate(case)
    force, moved = (np.asarray(of)[-60:].mean(axis=0) for of in (sim.force, sim.displacement))
    compliance = np.linalg.inv(case.at_tool.stiffness)[:3, :3]
    # What the sweeps leave is 4e-9.
    np.testing.assert_allclose(moved, compliance @ force, atol=1e-7 * np.abs(moved).max())
    assert np.abs(moved[2]) > 0.01 * np.abs(moved).max()


@pytest.mark.long
def test_a_sweep_over_joints_and_compliances(file):
    joints, compliance = np.deg2rad([-50.0, -55.0]), np.array([2.6e-7, 3e-7])
    grid = {"robot.joints.joint_2": joints, "robot.compliance.joint_1": compliance, "robot.loads.force.x": 100.0}
    found = mx.sweep(file.case, grid=grid, reduce={"moved": lambda sim: sim.displacement})
    assert found["moved"].dims[:2] == tuple(grid)[:2]
    assert found["robot.joints.joint_2"].units == "rad"
    for i, j in np.ndindex(2, 2):
        values = {"robot.joints.joint_2": joints[i], "robot.compliance.joint_1": compliance[j]}
        case = replace(file.case, {name: jnp.asarray(value) for name, value in values.items()})
        moved = np.asarray(found["moved"][i, j])
        # What sweeps may leave: programs that members share may have more of them.
        assert worst(moved, np.asarray(mx.simulate(case).displacement)) < 1e-5


def test_a_sweep_names_the_member_whose_loads_the_springs_do_not_hold(file):
    words = r"the member with .* robot\.loads\.force\.x = 3000 kN: robot\.loads: no equilibrium found"
    loads = {"robot.joints.joint_2": "-50 deg", "robot.compliance.joint_1": 2.6e-7, "robot.loads.force.x": "0.1, 3000 kN"}
    with pytest.raises(ValueError, match=words):
        mx.sweep(file.case, grid=loads)
