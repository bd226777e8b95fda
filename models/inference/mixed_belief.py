"""A belief whose hypotheses follow several laws of friction, each with its share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from models.effects.effect import Effect
from models.effects.library import LIBRARY
from models.effects.slider import EffectSlider
from models.inference.belief import Belief
from models.inference.friction_laws import Law
from models.inference.hypotheses import Progress, gathered_belief, refits, trusted
from models.measurements import PushDataset
from models.physics.cell_grid import FloatArray
from models.physics.rollout import Maps, RolloutError, Slider


def mixed_belief(
    dataset: PushDataset,
    laws: Sequence[Law],
    hypotheses: int,
    seed: int,
    report: Progress,
    *,
    settings: Mapping[str, Any],
) -> Belief:
    """`refitted_belief` of several laws of friction, each with its share of the hypotheses.

    The hypotheses carry the parameters of all effects that any law has, at their nulls where their own has
    not.
    """
    laws = laws[:hypotheses]
    shares = np.array([law.share for law in laws]) / sum(law.share for law in laws)
    counts = _counts(shares, hypotheses)
    rng = np.random.default_rng(seed)
    of_law = [_effects_of(law) for law in laws]
    parts: list[tuple[Maps, tuple[Effect, ...]]] = []
    probability: list[FloatArray] = []
    kept: dict[str, float] = {}
    done = 0
    for law, effects, count, share in zip(laws, of_law, counts, shares, strict=True):

        def progress(made: int, total: int, done: int = done, count: int = count) -> None:
            report("hypotheses", total * done + count * made, total * hypotheses)

        done += count
        try:
            maps, weights = refits(law.ladder, count, rng, progress, None)
        except (RolloutError, np.linalg.LinAlgError):
            # Refits lead to wilder maps than fits do; the other laws can do without this one.
            if not effects:
                raise
            continue
        parts.append((maps, effects))
        probability.append(share * weights)
        kept[law.name] = float(share)
    if not kept:
        raise RolloutError("no law of friction could be fitted to the pushes weighted at random")
    total = sum(kept.values())
    used = tuple(effect for effect in LIBRARY if any(effect in effects for _, effects in parts))
    carried = [_with_parameters(maps, effects, used) for maps, effects in parts]
    heaviest = laws[0].ladder
    slider: Slider = heaviest[0][0].prior.slider
    common = (slider.gravity, slider.smoothing)
    if used:
        slider = EffectSlider(slider.grid, slider.finger_radius, used, *common)
    else:
        slider = Slider(slider.grid, slider.finger_radius, *common)
    return gathered_belief(
        dataset,
        slider,
        Maps(
            *(
                np.concatenate([getattr(maps, name) for maps in carried])
                for name in ("mass", "mu", "mu_finger", "effects")
            )
        ),
        np.concatenate(probability) / total,
        heaviest,
        seed,
        {
            **settings,
            **trusted(heaviest),
            "friction_laws": {name: share / total for name, share in kept.items()},
        },
    )


def _effects_of(law: Law) -> tuple[Effect, ...]:
    slider = law.ladder[0][0].prior.slider
    return slider.effects if isinstance(slider, EffectSlider) else ()


def _with_parameters(maps: Maps, effects: Sequence[Effect], used: Sequence[Effect]) -> Maps:
    """The maps with parameters of all used effects, at their nulls where they have none of their own."""
    own = np.split(maps.effects, np.cumsum([len(effect.parameters) for effect in effects]), axis=1)
    by_effect = dict(zip(effects, own, strict=False))
    columns = [by_effect.get(effect, np.repeat(effect.nulls[None], len(maps), axis=0)) for effect in used]
    return Maps(
        maps.mass, maps.mu, maps.mu_finger, np.concatenate([np.zeros((len(maps), 0)), *columns], axis=1)
    )


def _counts(shares: FloatArray, hypotheses: int) -> list[int]:
    """How many hypotheses each share gets, at least one; there are no more shares than hypotheses."""
    counts = [max(1, int(share * hypotheses)) for share in shares]
    while sum(counts) > hypotheses:
        counts[int(np.argmax(counts))] -= 1
    while sum(counts) < hypotheses:
        behind = [share * hypotheses - count for share, count in zip(shares, counts, strict=True)]
        counts[int(np.argmax(behind))] += 1
    return counts
