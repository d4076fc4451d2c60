"""Quality of service."""

from dataclasses import dataclass
from enum import Enum


class DurabilityPolicy(Enum):
    VOLATILE = 1
    TRANSIENT_LOCAL = 2


@dataclass
class QoSProfile:
    depth: int
    durability: DurabilityPolicy = DurabilityPolicy.VOLATILE
