"""Calls that learn and predict refuse what they cannot use before they compute, and say what they take."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

import slipmap
from slipmap.models.inference.belief import Belief
from slipmap.models.inference.comparison import compare_together
from slipmap.models.inference.diagnosis.several import diagnose_together, fit_together
from slipmap.models.inference.identification import identify
from slipmap.models.measurements import DatasetError, PushDataset


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
        ([type(slipmap.LIBRARY[0])], r"effects must be objects, got the class (\w+); write \1\(\)"),
        (None, "effects must be a list of names or effects, got None"),
    ],
)
def test_effects_are_taken_alike(
    pushes: PushDataset, call: Callable[..., Any], effects: Any, words: str
) -> None:
    with pytest.raises(slipmap.models.effects.effect.EffectError, match=words):
        call(pushes, effects=effects)


GRID, TRUTH = slipmap.hammer()
PUSH = slipmap.Push(0.01, np.zeros((3, 2)), np.zeros(3))
LINE = slipmap.TablePush([-0.06, 0.0], [0.04, 0.0], 0.05)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda dataset: slipmap.Slider(GRID, 0.008).rollout(TRUTH, PUSH),
            r"pushes must be .*\[push\]; .* Push",
        ),
        (
            lambda dataset: slipmap.record_pushes(
                slipmap.Slider(GRID, 0.008), TRUTH, PUSH, np.random.default_rng(0)
            ),
            "recording: pushes must be a list",
        ),
        (
            lambda dataset: slipmap.Slider(GRID, 0.008).rollout(TRUTH, (push for push in [PUSH])),
            r"pushes must be a list, such as \[push\]; got one generator",
        ),
        (lambda dataset: slipmap.FingerPath(LINE, h=0.005), "FingerPath: pushes must be .* one TablePush"),
        (
            lambda dataset: slipmap.push_figures(dataset, dataset),
            r"identify\(dataset\)\.pushes; got one PushD",
        ),
        (
            lambda dataset: slipmap.cells_from_polygon(GRID.exterior, 0.01),
            "rings, got 0.01; give count= or width=",
        ),
    ],
)
def test_one_where_a_list_is_expected(pushes: PushDataset, call: Callable[..., Any], words: str) -> None:
    with pytest.raises(TypeError, match=words):
        call(pushes)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda dataset: slipmap.cells_from_polygon(1e3 * GRID.exterior),
            "must be in m, divide by 1000",
        ),
        (
            lambda dataset: slipmap.Identification(grid=GRID, finger_radius=8),
            "finger_radius is 8 m; no finger",
        ),
        (lambda dataset: replace(dataset, finger_radius=8), "finger radius is 8 m; no finger"),
    ],
)
def test_millimetres_are_told(pushes: PushDataset, call: Callable[..., Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        call(pushes)


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


def test_several_datasets_are_taken_by_other_functions(pushes: PushDataset) -> None:
    with pytest.raises(TypeError, match=r"not several, which diagnose_together, .* take; got a list"):
        slipmap.diagnose([pushes, pushes])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"draws must be a whole number of at least 0, got 250\.5"):
        slipmap.diagnose(pushes, draws=250.5)  # type: ignore[arg-type]
    other = replace(pushes, name="other")
    for datasets, kind, words in (
        (pushes, TypeError, "datasets must be a list of datasets; got one PushDataset"),
        ("tilted", TypeError, "datasets must be a list of datasets; got one str"),
        ([pushes, "tilted"], TypeError, r"datasets\[1\] must be a PushDataset, such as .*; got a str"),
        ([pushes, other], DatasetError, r"hammer and other contain the same push \(trials/000\.json\)"),
    ):
        with pytest.raises(kind, match=words):
            compare_together(datasets)
    for call in (diagnose_together, partial(fit_together, effects=["table_tilt"])):
        with pytest.raises(TypeError, match=r"datasets\[1\] must be a PushDataset"):
            call([pushes, "tilted"])


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
    belief = identify(pushes, hypotheses=2, seed=np.int64(3), friction_laws=False).belief  # type: ignore
    belief.save(tmp_path / "belief.npz")
    assert Belief.load(tmp_path / "belief.npz").seed == 3
