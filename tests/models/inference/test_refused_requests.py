"""Calls that learn and predict refuse what they cannot use before they compute, and say what they take."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

import slipmap
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.identification import identify
from slipmap.models.measurements import PushDataset


@pytest.fixture(scope="module")
def pushes() -> PushDataset:
    return slipmap.simulated_hammer(seed=1, fit=1, heldout=1)[0]


@pytest.mark.parametrize("seed", [None, -1, 1.5, True])
@pytest.mark.parametrize("call", ["identify", "fit", "diagnose", "compare", "simulated_hammer"])
def test_a_seed_that_no_file_could_record(pushes: PushDataset, call: str, seed: Any) -> None:
    given = {"simulated_hammer": (), "fit": (pushes, ["table_tilt"])}.get(call, (pushes,))
    with pytest.raises(ValueError, match=f"seed must be a whole number of at least 0, got {seed}"):
        getattr(slipmap, call)(*given, seed=seed)


@pytest.mark.parametrize("call", [slipmap.identify, slipmap.diagnose, slipmap.fit])
@pytest.mark.parametrize(
    ("effects", "words"),
    [
        ("table_tilt", r"must be a list of names, got 'table_tilt'; write \['table_tilt'\]"),
        ([None], "must be names or objects of a class of Effect, got None"),
        (["tabletilt"], "unknown effect 'tabletilt'; did you mean table_tilt"),
        (["tether", "tether"], "effect tether is given twice"),
        (None, "effects must be a list of names or effects, got None"),
    ],
)
def test_effects_are_taken_alike(
    pushes: PushDataset, call: Callable[..., Any], effects: Any, words: str
) -> None:
    with pytest.raises(slipmap.models.effects.effect.EffectError, match=words):
        call(pushes, effects=effects)


def test_a_diagnosis_needs_a_candidate(pushes: PushDataset) -> None:
    with pytest.raises(ValueError, match="name at least one candidate"):
        slipmap.diagnose(pushes, effects=[])


@pytest.mark.parametrize(
    "call",
    [
        lambda: slipmap.identify("tilted"),
        lambda: slipmap.fit(None, ["tether"]),
        lambda: slipmap.diagnose("tilted"),
        lambda: slipmap.compare("tilted"),
    ],
)
def test_a_dataset_is_not_its_path(call: Callable[[], Any]) -> None:
    with pytest.raises(TypeError, match=r"dataset must be a PushDataset, such as slipmap.read_dataset"):
        call()


def test_what_identify_returns_is_taken_as_its_belief(pushes: PushDataset) -> None:
    found = identify(pushes, hypotheses=2, friction_laws=False)
    assert len(slipmap.predict(found, pushes)) == 2
    assert slipmap.maps_figure(found, hypotheses=1).axes
    for call in (slipmap.predict, slipmap.maps_figure):
        with pytest.raises(TypeError, match=r"belief must be a Belief, such as .* got a PushDataset"):
            call(*((pushes, found.belief) if call is slipmap.predict else (pushes,)))
    with pytest.raises(TypeError, match="dataset must be a PushDataset"):
        slipmap.compare(found.belief, pushes)
    other = slipmap.tilted_block()
    with pytest.raises(ValueError, match=r"tilted block has no push trials/000.json; give the dataset"):
        slipmap.push_figures(found.pushes, other)
    truth = slipmap.Maps([[0.1] * 18], [[0.3] * 18], [0.3])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="one model of the belief's 60 cells, got 1 of 18"):
        slipmap.maps_figure(found.belief, truth=truth)
    with pytest.raises(ValueError, match="hypotheses must be a whole number of at least 0, got -1"):
        slipmap.maps_figure(found.belief, hypotheses=-1)


def test_a_seed_of_numpy_can_be_saved(pushes: PushDataset, tmp_path: Any) -> None:
    import numpy as np

    belief = identify(pushes, hypotheses=2, seed=np.int64(3), friction_laws=False).belief  # type: ignore
    belief.save(tmp_path / "belief.npz")
    assert Belief.load(tmp_path / "belief.npz").seed == 3
