"""What a diagnosis says where the dataset may be wrong rather than the physics."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.diagnosis.locked import locked_errors
from slipmap.models.inference.diagnosis.outcomes import (
    Outcome,
    doubts_of_check,
    with_other_causes,
    wrong_sizes,
)
from slipmap.models.inference.diagnosis.procedure import diagnose
from slipmap.models.inference.diagnosis.several import diagnose_together, fit_together
from slipmap.models.inference.identifiability import coarse_cells
from slipmap.models.measurements import Channel, PushDataset
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.rollout import Maps, Slider
from slipmap.planners.exploration import candidate_pushes

OUTLINE = [[-0.05, -0.03], [0.05, -0.03], [0.05, 0.03], [-0.05, 0.03]]
RADIUS, MASS = 0.006, 1.0


def recorded(cells: int | None = None) -> PushDataset:
    """Pushes of a block of 1 kg, without any effect."""
    grid = cells_from_polygon(OUTLINE, count=cells)
    n = len(grid)
    maps = Maps(np.full((1, n), MASS / n), np.full((1, n), 0.3), np.array([0.25]))
    rng = np.random.default_rng(1)
    made = [
        candidate.push([0.0, 0.0, rng.uniform(-3.0, 3.0)])
        for candidate in candidate_pushes(grid, RADIUS, rng, 14, length=(0.04, 0.08))
    ]
    return record_pushes(Slider(grid, RADIUS), maps, made, rng, heldout=4, mass=MASS)


@pytest.fixture(scope="module")
def pushes() -> PushDataset:
    return recorded()


def told(dataset: PushDataset, verdict: str, *effects: str, belief: object = None) -> Outcome:
    answer = Outcome(verdict, "The verdict.", None, effects)
    return with_other_causes(answer, dataset, SimpleNamespace(belief=belief), None, None, lambda: None)


@pytest.mark.parametrize(("factor", "size"), [(1.2, "too large"), (0.8, "too small")])
def test_a_wrong_radius_is_named_beside_what_looks_like_it(pushes, factor, size):
    wrong = replace(pushes, finger_radius=factor * RADIUS)
    found = told(wrong, "effect", "finger_compliance")
    assert "finger.radius 6.0 mm rather than" in found.sentence and size in found.sentence
    assert found.first and "measure the finger" in found.first[0]
    assert not told(wrong, "effect", "table_tilt").first
    assert not told(pushes, "effect", "finger_compliance").first
    assert not told(wrong, "adequate").first


def test_wrong_radii_are_named_with_their_datasets(pushes):
    def of(factor, name):
        return replace(pushes, finger_radius=factor * RADIUS, name=name)

    sentences, first = wrong_sizes(["finger_compliance"], [of(1.2, "A"), of(1.0, "B"), of(1.2, "C")])
    (told,) = sentences
    assert told.startswith("In A, C: a wrong finger.radius or outline would look like finger_compliance")
    assert "finger.radius 6.0 mm rather than 7.2 mm" in told
    assert len(first) == 1 and first[0].endswith("correct finger.radius or object.outline of A, C")
    assert wrong_sizes(["table_tilt"], [of(1.2, "A")]) == ([], [])


def reversed_theta(dataset: PushDataset) -> PushDataset:
    """The same pushes with theta counted the other way."""

    def turned(trial):
        pose = trial.object_pose
        return replace(trial, object_pose=Channel(pose.time, pose.values * [1.0, 1.0, -1.0]))

    return replace(dataset, trials=tuple(map(turned, dataset.trials)), name="reversed")


def test_no_effect_is_named_where_the_records_of_one_dataset_contradict_themselves(pushes):
    found = diagnose_together(
        [pushes, reversed_theta(pushes)], effects=effects_named(["finger_compliance"]), draws=0
    )
    assert found.verdict == "undecided" and found.effects == ()
    said = (
        "The records of reversed contradict themselves, so no effect can be identified. reversed: the finger"
    )
    assert found.sentence.startswith(said) and found.sentence.endswith("is theta's sign right?")
    assert [one.objection for one in found.candidates] == ["the records contradict themselves"]
    assert "check` finds wrong with reversed (contact)" in found.next_step()
    fitted = fit_together([pushes, reversed_theta(pushes)], ["finger_compliance"], hypotheses=2)
    unclear = "The datasets do not show whether finger_compliance is present"
    assert (fitted.verdict, fitted.sentence) == ("undecided", f"{unclear}. {found.sentence}")


def test_what_check_finds_wrong_comes_first(pushes):
    wrong = reversed_theta(pushes)
    assert "contact" in told(wrong, "undecided").doubts
    assert told(wrong, "adequate").doubts == () and told(pushes, "undecided").doubts == ()
    mended = replace(pushes, warnings=("trials/001.json, row 3: jumps; left out",))
    assert doubts_of_check(mended) == ()
    doubtful = replace(
        pushes, warnings=("trials/001.json: holds the same as trials/002.json; is one a copy?",)
    )
    assert doubts_of_check(doubtful) == ("reading",)


def test_a_wrong_mass_is_named_beside_the_effect_that_it_imitates():
    effects = effects_named(["loose_mass", "table_tilt"])
    found = diagnose(replace(recorded(20), mass=3.0), effects=effects, quick=True)
    assert found.effects == ("loose_mass",)
    assert "A wrong object.mass would look like loose_mass" in found.sentence
    assert "instead of 3 kg" in found.sentence
    assert "weigh the object" in found.next_step()


def weighed(value: float, low: float, high: float, *misfits: float) -> SimpleNamespace:
    """What is learned, with these misfits of the locked pushes."""
    errors = [SimpleNamespace(mean_add=1e-3, final_add=1e-3, misfit=misfit) for misfit in misfits]
    pushes = [SimpleNamespace(role="heldout", errors=one, spread_misfit=0.0) for one in errors]
    mass = SimpleNamespace(name="total mass", value=value, low=low, high=high)
    return SimpleNamespace(quantities=[mass], belief=None, pushes=pushes)


BETTER = weighed(0.6, 0.3, 0.9, 1.0, 1.1, 1.0, 0.9)


@pytest.mark.parametrize("verdict", ["adequate", "undecided"])
@pytest.mark.parametrize(
    ("without", "free", "contradicted"),
    [
        (weighed(0.95, 0.9, 1.0, 1.8, 1.7, 1.9, 1.8), BETTER, True),
        (weighed(0.95, 0.9, 1.0, 1.1, 1.2, 1.1, 1.0), BETTER, True),
        (weighed(1.0, 0.96, 1.04, 1.8, 1.7, 1.9, 1.8), BETTER, True),
        (weighed(1.0, 0.96, 1.04, 1.1, 1.2, 1.1, 1.0), None, False),  # nothing suggests it
        (weighed(0.95, 0.9, 1.0, 1.8, 1.7, 0.2, 0.2), BETTER, False),  # not better in most pushes
        (weighed(0.95, 0.9, 1.0, 1.8, 1.7, 1.9, 1.8), weighed(0.8, 0.5, 1.2, 1.0, 1.1, 1.0, 0.9), False),
    ],
)  # fmt: skip
def test_a_stated_mass_that_predicts_worse_than_another_is_told(pushes, verdict, without, free, contradicted):
    def relearned():
        assert free is not None, "another fit was made though nothing suggests a wrong mass"
        return free

    answer = Outcome(verdict, "The verdict.", None)
    found = with_other_causes(answer, pushes, without, locked_errors(without), None, relearned)
    assert (
        "object.mass of 1 kg contradicts the pushes: with 0.3 to 0.9 kg" in found.sentence
    ) is contradicted
    assert found.first == (("weigh the object, and correct object.mass",) if contradicted else ())


def test_a_mass_stated_three_times_too_large_does_not_pass():
    made = recorded(20)
    trials = (replace(trial, role="fit" if k < 7 else "heldout") for k, trial in enumerate(made.trials))
    wrong = replace(made, mass=3.0, trials=tuple(trials))
    found = diagnose(wrong, effects=effects_named(["table_tilt"]), quick=True)
    assert not found.effects and "stated object.mass of 3 kg contradicts the pushes" in found.sentence
    assert found.next_step().startswith("weigh the object, and correct object.mass")


def test_cells_wider_than_the_base_are_named_where_nothing_explains_the_pushes(pushes):
    grid = pushes.grid

    def believed(near: float) -> SimpleNamespace:
        inside = np.hypot(*(grid.centers - [0.01, 0.0]).T) < near
        mass = np.where(inside, 1.0, 1e-6)[None]
        return SimpleNamespace(
            grid=grid, maps=Maps(mass, np.full_like(mass, 0.3), np.ones(1)), probability=np.ones(1)
        )

    few = believed(0.009)
    assert "cells are" in coarse_cells(few) and coarse_cells(believed(1.0)) is None
    found = told(pushes, "unknown", belief=few)
    assert "Cells that are too coarse would look like this too" in found.sentence
    assert "finer cells" in found.first[0]
    assert not told(pushes, "undecided", belief=few).first
