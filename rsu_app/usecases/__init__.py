"""What the road side unit does, without any transport: HTTP, datagrams and tests call the same few functions."""

from rsu_app.usecases.changes import Subscription
from rsu_app.usecases.limits import UnitLimits
from rsu_app.usecases.readiness import Check, Readiness
from rsu_app.usecases.recall import AcceptedAgain
from rsu_app.usecases.section_friction import FrictionPolicies, SectionFriction
from rsu_app.usecases.unit import RoadSideUnit

__all__ = [
    "AcceptedAgain",
    "Check",
    "FrictionPolicies",
    "Readiness",
    "RoadSideUnit",
    "SectionFriction",
    "Subscription",
    "UnitLimits",
]
