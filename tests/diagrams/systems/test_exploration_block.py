"""Choosing a push as a block: when it chooses, what it passes on, and what its draws depend on."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
from driven_block import DrivenBlock, seen_at

from slipmap.diagrams.systems import exploration
from slipmap.diagrams.systems.exploration import PERIOD, Exploration
from slipmap.diagrams.systems.loop_messages import ExplorationPlan, LoopStatus
from slipmap.models.objects import cells_from_polygon
from slipmap.models.perception.seen_object import ObservedPose
from slipmap.planners.action_selection import Choice
from slipmap.planners.settings import PokeSettings
from tests.planners.cell_world import belief_about, with_effects

GRID = cells_from_polygon(np.array([[-6, -2], [6, -2], [6, 2], [-6, 2]]) * 0.01, width=0.01)
SEEN = SimpleNamespace(grid=GRID, cell_heights=np.full(len(GRID), 0.05))
POSE = (0.02, -0.03, 0.4)
RADIUS = 0.008


def any_push(obstacle, push) -> bool:
    return True


class Chooser(DrivenBlock):
    def __init__(self, strategy="random", *, fit=9, seed=3, allowed=any_push, settings=None) -> None:
        block = Exploration(strategy, fit, RADIUS, settings or PokeSettings(), allowed, seed)
        looking = LoopStatus("looking", 0)
        super().__init__(block, belief=None, object_pose=seen_at(*POSE), seen_object=SEEN, status=looking)
        self.advance(0.5 * PERIOD)

    def step(self, **inputs) -> ExplorationPlan | None:
        self.set(**inputs)
        self.advance(PERIOD)
        return self.read("plan")

    def choose(self, push: int, attempt: int = 0) -> Choice:
        request = self.step(status=LoopStatus("choosing", push, attempt))
        assert request is not None and request.number == LoopStatus("choosing", push, attempt).number
        assert request.choice is not None
        return request.choice


def same(a: Choice, b: Choice) -> bool:
    return all(
        np.array_equal(x, y)
        for x, y in ((a.push.begin, b.push.begin), (a.push.end, b.push.end), (a.contact, b.contact))
    )


@pytest.mark.parametrize("mode", ["looking", "pushing", "recording", "learning", "finished", "failed"])
def test_it_waits_until_a_push_is_to_be_chosen(mode):
    assert Chooser().step(status=LoopStatus(mode, 0)) is None


def test_it_waits_until_the_object_is_seen():
    chooser = Chooser()
    status = LoopStatus("choosing", 0)
    assert chooser.step(status=status, object_pose=ObservedPose.unseen("occluded")) is None
    assert chooser.step(object_pose=seen_at(*POSE)).number == 0


def test_a_request_stands_until_another_is_wanted():
    chooser = Chooser()
    first = chooser.choose(0)
    for mode in ("choosing", "pushing", "recording", "learning", "looking"):
        for _ in range(2):
            assert chooser.step(status=LoopStatus(mode, 0), object_pose=seen_at(0.1, 0, 0)).choice is first
    assert chooser.choose(1) is not first


def test_with_a_shifted_tracker_the_arm_is_asked_about_the_object_where_it_is():
    even, obstacles = np.full(len(GRID), 0.01), []
    thing = SimpleNamespace(grid=GRID, mass=even, mu=30.0 * even, mu_finger=0.3)
    shift = np.array([0.03, 0.02, 0.0])
    chooser = Chooser(allowed=lambda obstacle, push: obstacles.append(obstacle.pose) or True)
    shifted = with_effects(belief_about(thing, hypotheses=4), ["tracker_shift"], shift)
    chooser.set(belief=shifted, object_pose=seen_at(*(POSE + shift)))
    chooser.choose(0)
    assert np.array(obstacles) == pytest.approx(np.tile(POSE, (len(obstacles), 1)))


def test_the_push_reaches_the_object_where_it_is():
    """The finger's way enters the block's rectangle, wherever the block lies, and begins outside of it."""
    chooser = Chooser()
    for number, pose in enumerate([POSE, (-0.05, 0.06, 2.5), (0.0, 0.0, -1.2)]):
        chooser.set(object_pose=seen_at(*pose))
        push = chooser.choose(number).push
        c, s = np.cos(pose[2]), np.sin(pose[2])
        way = push.begin + np.linspace(0, 1, 200)[:, None] * (push.end - push.begin)
        inside = (way - pose[:2]) @ np.array([[c, -s], [s, c]])
        distance = np.linalg.norm(np.maximum(np.abs(inside) - [0.06, 0.02], 0), axis=1)
        assert distance[0] > RADIUS + 1e-3
        assert distance.min() < RADIUS - 1e-3


def test_another_attempt_is_another_candidate():
    chooser = Chooser()
    tried = [chooser.choose(0, attempt) for attempt in range(4)]
    assert not any(same(a, b) for k, a in enumerate(tried) for b in tried[:k])


def test_only_pushes_that_the_arm_can_make_are_asked_for():
    asked = []

    def allowed(obstacle, push):
        asked.append((obstacle, push))
        return len(asked) == 3

    choice = Chooser(allowed=allowed).choose(0)
    obstacle, push = asked[-1]
    assert len(asked) == 3 and choice.push is push
    assert np.array_equal(obstacle.grid.centers, GRID.centers) and obstacle.pose == pytest.approx(POSE)
    assert obstacle.heights == pytest.approx(SEEN.cell_heights)


def test_it_says_why_there_is_no_push():
    request = Chooser(allowed=lambda obstacle, push: False).step(status=LoopStatus("choosing", 2, 1))
    assert request.choice is None and request.number == LoopStatus("choosing", 2, 1).number
    assert "the robot can make none" in request.reason


def test_draws_depend_on_the_seed_and_the_pushs_number_alone():
    plain, refused = Chooser(), Chooser()
    plain.choose(0)
    refused.choose(0)
    refused.choose(0, 1)
    assert same(plain.choose(1), refused.choose(1))
    assert not same(plain.choose(2), refused.choose(3))
    assert not same(Chooser(seed=3).choose(0), Chooser(seed=4).choose(0))


@dataclass
class Spied:
    """What the block handed to Algorithm 2."""

    calls: list[dict] = field(default_factory=list)


@pytest.fixture
def spied(monkeypatch):
    spy, real = Spied(), exploration.choose_push

    def select(grid, pose, finger_radius, **rest):
        spy.calls.append({"grid": grid, "pose": pose, "finger_radius": finger_radius, **rest})
        return real(grid, pose, finger_radius, **rest)

    monkeypatch.setattr(exploration, "choose_push", select)
    return spy


def test_everything_known_is_handed_on(spied, belief):
    settings = PokeSettings(longest=0.06)
    chooser = Chooser("most-different", settings=settings)
    chooser.set(belief=belief)
    chooser.choose(0)
    (call,) = spied.calls
    assert np.array_equal(call["grid"].centers, GRID.centers)
    assert np.array_equal(call["belief"].maps.mass, belief.maps.mass)
    assert call["settings"] is settings
    assert call["pose"] == pytest.approx(POSE) and call["finger_radius"] == RADIUS
    assert call["strategy"] == "most-different"


def test_pushes_that_judge_are_random(spied):
    chooser = Chooser("most-different", fit=2)
    for push in range(4):
        chooser.choose(push)
    assert [call["strategy"] for call in spied.calls] == ["most-different"] * 2 + ["random"] * 2


def test_a_push_that_the_arm_refused_is_no_past_push(spied):
    chooser = Chooser("most-different")
    made = chooser.choose(0)
    for attempt in range(3):
        last = chooser.choose(1, attempt)
    chooser.choose(2)
    assert [len(call["past"]) for call in spied.calls] == [0, 1, 1, 1, 2]
    assert spied.calls[-1]["past"] == (made, last)
