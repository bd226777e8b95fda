"""Learning as a block: when it learns, from what, and what comes out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from driven_block import DrivenBlock
from hidden_effects import TILT, tilted_pushes

from slipmap.diagrams.systems.identification import PERIOD, Identification
from slipmap.models.effects import EffectError
from slipmap.models.inference.identification import identify
from slipmap.models.measurements import Noise
from slipmap.models.measurements.push_dataset import dataset_of

K, SEED = 4, 7


class Learner(DrivenBlock):
    """A block that keeps account of what it was asked to learn from, and of the beliefs that it told of."""

    def __init__(self) -> None:
        self.asked: list[tuple[list[str], object]] = []
        self.told: list[tuple[object, int]] = []
        self.orders: list[int | None] = []
        block = Identification(
            self._dataset,
            friction_laws=False,
            hypotheses=K,
            seed=SEED,
            learned=lambda belief, count: self.told.append((belief, count)),
        )
        super().__init__(block, trials=(), cell_grid=None)
        self.advance(0.5 * PERIOD)

    def _dataset(self, trials, grid):
        self.asked.append(([trial.name for trial in trials], grid))
        self.orders = [trial.order for trial in trials]
        return replace(tilted_pushes(), trials=tuple(trials))

    def step(self, **inputs) -> tuple[object, int]:
        self.set(**inputs)
        self.advance(PERIOD)
        return self.read("belief"), self.read("learned")


def fit():
    return tilted_pushes().fit_trials[:2]


def heldout():
    return tilted_pushes().heldout_trials[:1]


@pytest.fixture(scope="module")
def history():
    """The block's outputs as trials come in, and the block."""
    learner = Learner()
    outputs = [learner.step(cell_grid=tilted_pushes().grid)]
    for trials in (fit()[:1], fit()[:1], fit(), fit() + heldout()):
        outputs.append(learner.step(trials=trials))
    return outputs, learner


def test_it_learns_when_a_push_to_learn_from_is_recorded(history):
    outputs, learner = history
    assert outputs[0] == (None, 0)
    assert [count for _, count in outputs] == [0, 1, 1, 2, 2]
    beliefs = [belief for belief, _ in outputs]
    assert beliefs[1] is beliefs[2] and beliefs[3] is beliefs[4] and beliefs[1] is not beliefs[3]
    names = [trial.name for trial in fit()]
    assert [asked for asked, _ in learner.asked] == [names[:1], names]
    assert all(np.array_equal(grid.centers, tilted_pushes().grid.centers) for _, grid in learner.asked)
    assert learner.told == [(beliefs[1], 1), (beliefs[3], 2)]


def test_pushes_that_judge_do_not_teach():
    learner = Learner()
    assert learner.step(cell_grid=tilted_pushes().grid, trials=heldout()) == (None, 0)
    assert learner.asked == []


def test_pushes_that_judge_count_as_places_in_the_experiment():
    learner = Learner()
    made = [replace(trial, order=None) for trial in (*heldout(), *fit())]
    learner.step(cell_grid=tilted_pushes().grid, trials=tuple(made))
    assert learner.orders == [1, 2]


def test_its_belief_is_that_of_the_command(history):
    outputs, _ = history
    expected = identify(
        replace(tilted_pushes(), trials=fit()), hypotheses=K, seed=SEED, friction_laws=False
    ).belief
    belief = outputs[-1][0]
    assert len(belief) == K
    assert np.array_equal(belief.maps.mass, expected.maps.mass)
    assert np.array_equal(belief.maps.mu, expected.maps.mu)
    assert np.array_equal(belief.probability, expected.probability)


def test_without_further_arguments_it_answers_as_identify_does():
    trials, grid = tilted_pushes().fit_trials[:4], tilted_pushes().grid
    learner = DrivenBlock(Identification(grid=grid, mass=0.7, finger_radius=0.01), trials=trials)
    learner.advance(0.5 * PERIOD)
    belief = learner.read("belief")
    same = dataset_of(trials, grid, name="recorded", finger_radius=0.01, noise=Noise(), mass=0.7)
    expected = identify(same).belief
    assert len(belief.settings["friction_laws"]) > 1
    assert belief.settings["known_mass"] == 0.7
    assert np.array_equal(belief.maps.mass, expected.maps.mass)
    assert np.array_equal(belief.maps.mu, expected.maps.mu)


def test_a_model_that_is_given_an_effect_learns_it_with_the_maps():
    trials = tilted_pushes().fit_trials[:6]
    block = Identification(
        lambda trials, grid: replace(tilted_pushes(), trials=tuple(trials)),
        effects=["table_tilt"],
        friction_laws=False,
        hypotheses=2,
    )
    learner = DrivenBlock(block, trials=trials, cell_grid=tilted_pushes().grid)
    learner.advance(0.5 * PERIOD)
    belief = learner.read("belief")
    assert [effect.name for effect in belief.effects] == ["table_tilt"]
    downhill = belief.probability @ belief.maps.effects
    assert downhill == pytest.approx(list(TILT.values()), abs=0.01)


def test_an_unknown_effect_is_refused_before_anything_is_pushed():
    with pytest.raises(EffectError, match="table_tilt"):
        Identification(lambda trials, grid: tilted_pushes(), effects=["table_tlit"])


def test_other_effects_are_learnt_with_at_once():
    learner = Learner()
    plain, count = learner.step(cell_grid=tilted_pushes().grid, trials=fit(), effects=())
    assert count == 2 and not plain.slider.effects
    learner.set(effects=("table_tilt",))
    assert (learner.read("belief"), learner.read("learned")) == (plain, 0)
    tilted, count = learner.step()
    assert count == 2 and [effect.name for effect in tilted.slider.effects] == ["table_tilt"]
    assert learner.step() == (tilted, 2) and len(learner.asked) == 2
