"""Built-in robots, each number with its source and how sure it is.

C = COROUSSO deliverable 1.4 (2013), H = Ha 2019 (inverse dynamics and calibration of cutting force). The joint coordinates
of the two KUKA arms are those of their controller: at zero the arm is stretched out horizontally along +x, positive
coordinates turn joint 1 clockwise seen from above and lower the arm at joints 2, 3 and 5. C does not say how its angles
count; they are read so.
"""

import numpy as np

from ._chain import Placement, Robot, rotation_of

HALF = np.pi / 2


def kuka_kr270() -> Robot:
    """KUKA KR270: kinematics and masses, rods for its links, no limits.

    The lengths are widely used values for an arm of this series (a floor-mounted first generation KR QUANTEC of 2.7 m reach
    with a wrist of 240 mm). C does not print them and the maker has not published them for this robot that we know of: a few
    centimetres may be wrong, a_3 first. The masses are those of C (Table 1). C reduces the links as beams and prints neither
    centres of mass nor inertia: here they are a placeholder, `Robot.with_rods`, 0.15 m thick. Nothing of it was measured.
    """
    return Robot.from_dh(
        a=[0.350, 1.150, -0.041, 0.0, 0.0, 0.0],  # a_1, a_2, a_3: widely used
        d=[-0.675, 0.0, 0.0, -1.200, 0.0, -0.240],  # d_1, d_4, d_6: widely used
        alpha=[HALF, 0.0, HALF, -HALF, HALF, np.pi],
        theta=[0.0, 0.0, -HALF, 0.0, 0.0, np.pi],
        base=Placement((0.0, 0.0, 0.0), (np.pi, 0.0, 0.0)),  # joint 1 turns about an axis that points down
    ).with_rods(0.15, mass=[336.8, 259.4, 85.2, 54.5, 36.3, 18.2])  # C, Table 1


KR210_PLACES = (  # of each joint in the frame of the link before: x, y, z [m], roll, pitch, yaw [rad]
    (0.0, 0.0, 0.0, np.pi, 0.0, 0.0),
    (0.33, 0.0, -0.645, HALF, 0.0, 0.0),
    (1.15, 0.0, 0.0, 0.0, 0.0, -HALF),
    (0.115, 0.0, 0.0, HALF, 0.0, 0.0),
    (0.0, 0.0, -1.22, -HALF, 0.0, 0.0),
    (0.0, 0.0, 0.0, HALF, 0.0, 0.0),
)
KR210_LIMITS = ((-185, 185), (-140, -5), (-120, 168), (-350, 350), (-125, 125), (-350, 350))  # [deg]
KR210_MASSES = (363.07, 232.06, 190.33, 42.411794929, 16.991732133, 6.6)  # [kg]
KR210_CENTRES = (  # of mass, in the frame of the link [m]
    (0.0287871760266615, 0.011875249400942, -0.23402828104773202),
    (0.486870981642679, -0.00190295613203482, -0.11763677497199),
    (0.17377229023275398, -0.07596253874848949, 0.136185412704251),
    (-7.5764465140740704e-6, 0.0192023882938968, -0.197888748752496),
    (0.062235569792816796, 3.0314811620972e-4, -0.0657532427101687),
    (0.0, 0.0, -0.0065),
)
KR210_INERTIAS = (  # principal moments [kg m²], and roll, pitch, yaw of the principal axes in the frame of the link [rad]
    (
        (13.2088588047575, 31.4949853249961, 33.8838908182464),
        (1.8661968490595335, 0.10258164628689437, -0.21632411420056308),
    ),
    ((57.7957098112911, 5.63272995683345, 58.559845591006), (-2.820395530490072, -1.218114484700482, 1.2776348095029473)),
    (
        (3.46995402943128, 21.1713007283949, 22.2067749058774),
        (2.182263605188562, -0.06560775132626494, -0.05349640342552061),
    ),
    ((0.161324366141546, 1.3645139545175, 1.39158127634524), (1.5711454552070345, -1.4368320268822927, -1.5712071247684845)),
    (
        (0.200111908543801, 0.120553626775201, 0.220956494925724),
        (1.5704759351872302, -0.8762558401259876, -0.0022796281329216955),
    ),
    ((0.0114565, 0.0114565, 0.014535), (0.0, 0.0, 0.0)),
)


def kuka_kr210_r2700_2() -> Robot:
    """KUKA KR210 R2700-2: kinematics, limits, masses, centres of mass, inertia.

    All numbers are those of the description in kroshu/kuka_robot_descriptions (Apache-2.0); the flange is its frame tool0.
    The links carry nothing: no load, no tool.
    """
    places = np.array(KR210_PLACES)
    moments, axes = (np.array(column) for column in zip(*KR210_INERTIAS, strict=True))
    turned = rotation_of(axes)
    lower, upper = np.deg2rad(KR210_LIMITS).T
    return Robot(
        names=tuple(f"joint_{i}" for i in range(1, 7)),
        kinds=("revolute",) * 6,
        xyz=places[:, :3],
        rpy=places[:, 3:],
        axis=[(0.0, 0.0, 1.0)] * 6,
        zero=np.zeros(6),
        flange=Placement((0.0, 0.0, -0.215), (0.0, np.pi, 0.0)),
        lower=lower,
        upper=upper,
        mass=KR210_MASSES,
        centre_of_mass=KR210_CENTRES,
        inertia=np.einsum("nij,nj,nkj->nik", turned, moments, turned),
    )


def abb_irb6660() -> Robot:
    """ABB IRB 6660-205/1.90: kinematics and limits, no masses.

    All numbers are those of the description in ros-industrial/abb_experimental (Apache-2.0; not yet merged there), the
    flange its frame tool0. The arm's parallelogram is a serial joint here: joint 3 is the angle between the two arms, which
    the drive of the real arm does not set alone. At zero the upper arm stands upright, the forearm points along +x.
    """
    lower, upper = np.deg2rad([(-180, 180), (-42, 85), (-70, 70), (-300, 300), (-120, 120), (-360, 360)]).T
    return Robot(
        names=tuple(f"joint_{i}" for i in range(1, 7)),
        kinds=("revolute",) * 6,
        xyz=[(0, 0, 0.8145), (0.300, 0, 0), (0, 0, 0.700), (0, 0, 0.280), (0.893, 0, 0), (0.200, 0, 0)],
        rpy=np.zeros((6, 3)),
        axis=[(0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0)],
        zero=np.zeros(6),
        flange=Placement((0.0, 0.0, 0.0), (0.0, HALF, 0.0)),
        lower=lower,
        upper=upper,
    )


def abb_irb6660_ha() -> Robot:
    """The ABB IRB 6660 of H: its table of Denavit and Hartenberg (H Table 1) with its lengths (H Table 3), and no more.

    Not the arm of `abb_irb6660`: other lengths, other zeros of the joints. a_6 is not printed and 0 here. As printed,
    alpha_3 = -pi/2 puts the axis of the forearm below the elbow where the forearm points forwards; on the maker's arm it
    lies above. H's tool angles (Table 3) are left out, as their order is not printed: the flange is frame 6.
    """
    return Robot.from_dh(
        a=[0.300, 0.700, 0.280, 0.0, 0.0, 0.0],
        d=[0.5145, 0.0, 0.0, 1.06024, 0.0, 0.377],
        alpha=[HALF, 0.0, -HALF, HALF, -HALF, 0.0],
        theta=np.zeros(6),
    )
