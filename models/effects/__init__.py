"""Physical effects beyond the plain cell-grid model: a library, and the means to write one's own."""

from models.effects.effect import Effect, EffectError, Parameter, Scene
from models.effects.library import LIBRARY
from models.effects.slider import EffectSlider

__all__ = ["LIBRARY", "Effect", "EffectError", "EffectSlider", "Parameter", "Scene"]
