"""Hidden effects: one small class each, with strengths drawn by chance.

Most of them are in slipmap's library too and were written here without it; five are in no library.
"""

from blind.effects.bodies import FingerCompliance, LooseMassInside, Skate
from blind.effects.effect import Blade, Effect, Instant, LooseMass, Strength
from blind.effects.forces import Gusts, MovingTable, TableTilt, Tether, ViscousFriction
from blind.effects.friction import (
    Ageing,
    AnisotropicObject,
    AnisotropicTable,
    FrictionDrift,
    LoadTransfer,
    StribeckFriction,
)
from blind.effects.places import LinearFrictionField, Magnet, PatchFrictionField, StickyLine
from blind.effects.sensors import SensorLatency, TrackerOffset, TrackerScale

__all__ = [
    "LIBRARY",
    "OUTSIDE",
    "Ageing",
    "AnisotropicObject",
    "AnisotropicTable",
    "Blade",
    "Effect",
    "FingerCompliance",
    "FrictionDrift",
    "Gusts",
    "Instant",
    "LinearFrictionField",
    "LoadTransfer",
    "LooseMass",
    "LooseMassInside",
    "Magnet",
    "MovingTable",
    "PatchFrictionField",
    "SensorLatency",
    "Skate",
    "StickyLine",
    "Strength",
    "StribeckFriction",
    "TableTilt",
    "Tether",
    "TrackerOffset",
    "TrackerScale",
    "ViscousFriction",
]

LIBRARY: tuple[type[Effect], ...] = (
    TableTilt, Tether, ViscousFriction, StribeckFriction, AnisotropicTable, AnisotropicObject,
    LinearFrictionField, PatchFrictionField, FrictionDrift, FingerCompliance, LooseMassInside, LoadTransfer,
    Skate, SensorLatency, TrackerOffset, TrackerScale,
)  # fmt: skip
OUTSIDE: tuple[type[Effect], ...] = (Gusts, Magnet, StickyLine, Ageing, MovingTable)
