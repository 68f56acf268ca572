"""The kinds of joint: one file a kind, one line here."""

from __future__ import annotations

from robodyn_cli.joints.base import Joint
from robodyn_cli.joints.fixed import Fixed
from robodyn_cli.joints.prismatic import Prismatic
from robodyn_cli.joints.revolute import Revolute

joint_types: dict[str, Joint] = {
    "revolute": Revolute(),
    "prismatic": Prismatic(),
    "fixed": Fixed(),
}
