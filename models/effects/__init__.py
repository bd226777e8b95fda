"""Physical effects beyond the plain cell-grid model: a library, and the base class for your own."""

from slipmap.models.effects.effect import Effect, EffectError, Parameter, Scene
from slipmap.models.effects.library import LIBRARY
