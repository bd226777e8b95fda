"""What the notice above the board says, and how it looks."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from matplotlib import image
from moving_blocks import block_belief

from slipmap.diagrams.systems.diagnosis import CLOSE, TRIED, Finding, Repair
from slipmap.diagrams.systems.loop_messages import LoopStatus
from slipmap.diagrams.systems.model_monitor import Judged, Watch
from slipmap.diagrams.systems.notice import ALARMING, NOTICE, Words, notice, words_of
from slipmap.models.effects.registry import effects_named

EXPLORING = LoopStatus("choosing", 2, of=5)
USUAL = Judged(1, 1.0, 0.5, 1.0, False, 2e-3, 5e-3, False)
OFF = Judged(2, 9.0, 1e-6, 40.0, True, 22e-3, 2e-3, True)
TILT = ("table_tilt",)


def watch(*judged: Judged) -> Watch:
    return Watch(3, np.zeros(3), judged)


def repaired(verdict: str, action: str, effects: tuple[str, ...] = (), **more: str) -> Repair:
    return Repair(3, effects, 5, (Finding(3, verdict, "In a sentence.", effects, action, **more),))


def tilted() -> object:
    """A belief of two hypotheses whose table is tilted by 8° towards 90°."""
    belief = block_belief(2)
    down = np.tile([0.0, np.sin(np.radians(8.0))], (2, 1))
    return replace(belief, maps=replace(belief.maps, effects=down), effects=effects_named(TILT))


@pytest.mark.parametrize(
    ("status", "doing"),
    [
        (LoopStatus("looking", 0, of=5), "Exploring: push 1 of 5"),
        (LoopStatus("learning", 4, of=7), "Exploring: push 5 of 7"),
        (LoopStatus("diagnosing", 4, of=7), "Diagnosing what the model lacks"),
        (LoopStatus("pushing", 7), "To the edge: push 8"),
        (LoopStatus("held", 7), "Holding it"),
        (LoopStatus("failed", 7, reason="the camera does not see the object: no picture"),
         "Stopped: the camera does not see the …"),
    ],
)  # fmt: skip
def test_it_says_what_the_robot_is_doing(status, doing):
    said = words_of(status, None, None, None)
    assert said == Words(doing, "", "")
    assert len(said.doing) <= 41


def test_a_surprise_is_said_with_its_size_until_a_diagnosis_has_examined_it():
    assert words_of(EXPLORING, watch(USUAL), None, None).heading == "No surprise so far"
    said = words_of(EXPLORING, watch(USUAL, OFF), None, None)
    assert said.alarming and said.heading == "Last push ended 22.0 mm off"
    assert said.reason.startswith("2.0 mm at most were expected. ALARM: ")
    after = words_of(EXPLORING, watch(USUAL, OFF), repaired("adequate", "goes on without"), None)
    assert not after.alarming and after.reason == "In a sentence."


def test_a_surprise_is_not_forgotten_where_nothing_examines_it():
    calm = replace(USUAL, alarm=True)
    cases = (((OFF, calm), "The alarm is still on"), ((OFF, USUAL), "The last push did not surprise"))
    for judged, heading in cases:
        said = words_of(EXPLORING, watch(*judged), None, None)
        assert said.heading == heading and said.reason.startswith("1 of 2 pushes ended outside")


@pytest.mark.parametrize(
    ("verdict", "action", "before", "after"),
    [
        ("effect", "adopts", ("Added: table_tilt", "The next pushes test it."),
         ("Added: tilt 8.0°", "tilt 8.0°, downhill towards 90°. The next pushes test it.")),
        (TRIED, "keeps", ("Kept: table_tilt", "In a sentence."), ("Kept: tilt 8.0°", "In a sentence.")),
        (CLOSE, "keeps", ("Kept: table_tilt", "In a sentence."), ("Kept: tilt 8.0°", "In a sentence.")),
        ("effect", "keeps", ("Kept: table_tilt", "In a sentence."),
         ("Kept: tilt 8.0°", "tilt 8.0°, downhill towards 90°.")),
    ],
)  # fmt: skip
def test_effects_are_given_by_name_and_by_size_once_it_is_known(verdict, action, before, after):
    for belief, wanted in ((None, before), (block_belief(2), before), (tilted(), after)):
        said = words_of(EXPLORING, watch(USUAL), repaired(verdict, action, TILT), belief)
        assert (said.heading, said.reason) == wanted


def test_an_effect_and_its_rival_are_both_named():
    for belief in (None, tilted()):
        said = words_of(EXPLORING, watch(USUAL), repaired("effect", "adopts", TILT, rival="tether"), belief)
        assert (said.heading, len(said.heading) <= 33) == ("Added: table_tilt or tether", True)
        assert said.reason == "Pushes so far fit either of them. The next pushes test it."


@pytest.mark.parametrize(
    ("action", "heading"), [("drops", "Dropped again"), ("goes on without", "Nothing to add to the model")]
)
def test_effects_that_the_model_has_anyway_are_not_said_to_be_dropped(action, heading):
    said = words_of(EXPLORING, watch(USUAL), repaired("unknown", action, TILT), tilted())
    assert (said.heading, said.reason) == (heading, "In a sentence.")


def test_the_next_push_tells_models_apart():
    repair = repaired("undecided", "pushes on", telling="table_tilt from tether")
    said = words_of(EXPLORING, watch(USUAL), repair, None)
    assert said.heading == "Undecided: one more push"
    assert said.reason == "The next push tells table_tilt from tether."


def test_on_the_way_to_the_edge_no_push_is_said_to_tell_models_apart():
    repair = repaired("undecided", "pushes on", telling="table_tilt from tether")
    said = words_of(LoopStatus("pushing", 7), watch(USUAL), repair, None)
    assert (said.heading, said.reason) == ("Nothing to add to the model", "In a sentence.")


def test_without_a_loop_only_surprises_and_findings_are_said():
    assert words_of(None, None, None, None) is None
    assert words_of(None, watch(USUAL), None, None) is None
    assert words_of(None, watch(OFF), None, None).alarming


@pytest.mark.parametrize("alarming", [False, True])
def test_the_picture_has_the_shape_of_the_notice_and_bars_beside_the_longest_words(alarming):
    words = Words("Exploring: push 15 of 15", "W" * 60, "many words " * 40, alarming)
    picture = image.imread(io.BytesIO(notice(words, [3e-2, 2e-3])))[:, :, :3]
    plain = image.imread(io.BytesIO(notice(words, [])))[:, :, :3]
    assert picture.shape[1] / picture.shape[0] == pytest.approx(NOTICE[0] / NOTICE[1], rel=0.01)
    bars = slice(int(0.795 * plain.shape[1]), int(0.97 * plain.shape[1]))
    below = slice(int(0.4 * plain.shape[0]), int(0.85 * plain.shape[0]))
    assert (plain[below, bars] > 0.9).all(), "words end before the bars begin"
    assert (picture[below, bars] < 0.9).any()
    reds = np.abs(picture - ALARMING).max(axis=2) < 0.05
    assert reds.any() == alarming
