"""The robot that carries the tool: a serial chain of links, from a table, a file or a built-in model, rigid or elastic. It
knows nothing of cutting."""

from . import models
from ._arm import Arm, Spindle, at_tool
from ._beam import Beam
from ._chain import Bodies, Frames, Payload, Placement, Robot
from ._elastic import AtTool, ElasticRobot, Loads
from ._felt import robot_at_tool
from ._load import load_urdf
from ._map import stiffness_map
from ._modes import Modes, modal_damping, modes
from ._parallel import ParallelRobot
from ._torch import from_pytorch_kinematics

__all__ = [
    "Arm",
    "AtTool",
    "Beam",
    "Bodies",
    "ElasticRobot",
    "Frames",
    "Loads",
    "Modes",
    "ParallelRobot",
    "Payload",
    "Placement",
    "Robot",
    "Spindle",
    "at_tool",
    "from_pytorch_kinematics",
    "load_urdf",
    "modal_damping",
    "models",
    "modes",
    "robot_at_tool",
    "stiffness_map",
]
