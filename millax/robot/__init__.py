"""The robot that carries the tool: a serial chain of links, from a table, a file or a built-in model. It knows nothing of
cutting."""

from . import models
from ._chain import Frames, Placement, Robot
from ._load import load_urdf
from ._torch import from_pytorch_kinematics

__all__ = ["Frames", "Placement", "Robot", "from_pytorch_kinematics", "load_urdf", "models"]
