"""The kinds of joint: one file a kind, one line here."""

from __future__ import annotations

from robodyn_cli.joints.base import Joint
from robodyn_cli.joints.cylindrical import Cylindrical
from robodyn_cli.joints.fixed import Fixed
from robodyn_cli.joints.floating import Floating
from robodyn_cli.joints.helical import Helical
from robodyn_cli.joints.planar import Planar
from robodyn_cli.joints.prismatic import Prismatic
from robodyn_cli.joints.revolute import Revolute
from robodyn_cli.joints.spherical import Spherical
from robodyn_cli.joints.universal import Universal

joint_types: dict[str, Joint] = {
    "revolute": Revolute(),
    "prismatic": Prismatic(),
    "fixed": Fixed(),
    "helical": Helical(),
    "cylindrical": Cylindrical(),
    "universal": Universal(),
    "spherical": Spherical(),
    "planar": Planar(),
    "floating": Floating(),
}
