"""The compared methods of the paper (section VI.B): all plan alike, each with another belief."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.inference.belief import Belief
from models.inference.prediction import uniform_maps
from models.physics.maps import Maps
from planners.strategies import METHODS

__all__ = ["METHODS", "planning_belief"]


def planning_belief(
    method: str, belief: Belief, rng: np.random.Generator, truth: Maps | None = None
) -> Belief:
    """The belief with which a method plans; the planner itself knows nothing of methods.

    Args:
        method: one of `METHODS`.
        belief: what was identified.
        rng: source of the draw of `deterministic`.
        truth: the true maps, one hypothesis; only `true` looks at them.

    Raises:
        ValueError: an unknown method, or `true` without one true map.
    """
    if method == "probabilistic":
        return belief
    if method == "deterministic":
        k = int(rng.choice(len(belief), p=belief.probability / belief.probability.sum()))
        return _alone(belief, belief.maps[k : k + 1], method)
    if method == "uniform":
        even = uniform_maps(belief)
        effects = (belief.probability @ belief.maps.effects)[None]
        return _alone(belief, Maps(even.mass, even.mu, even.mu_finger, effects), method)
    if method == "true":
        if truth is None or len(truth) != 1:
            raise ValueError("method 'true' needs the true maps, exactly one hypothesis")
        known = belief if truth.effects.shape[1] else replace(belief, maps=_plain(belief.maps), effects=())
        return _alone(known, truth, method)
    raise ValueError(f"unknown method {method!r}; choose one of {', '.join(METHODS)}")


def _alone(belief: Belief, maps: Maps, method: str) -> Belief:
    settings = {**belief.settings, "planning": method}
    return replace(belief, maps=maps, probability=np.ones(1), settings=settings)


def _plain(maps: Maps) -> Maps:
    return Maps(maps.mass, maps.mu, maps.mu_finger)
