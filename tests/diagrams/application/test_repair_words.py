"""What a run with --adapt says of itself at its end."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from slipmap.diagrams.application.commands.explore import _told
from slipmap.diagrams.application.reports.diagnosis_words import repair_headline, repair_story
from slipmap.diagrams.systems.diagnosis import Finding, Repair
from slipmap.diagrams.systems.model_monitor import Judged, Watch

TILT = ("table_tilt",)


def watch(*pushes: tuple[float, tuple[str, ...]]) -> Watch:
    judged = [
        Judged(number, 1.0, 0.5, 1.0, False, error, 0.01, False, effects, 0.1)
        for number, (error, effects) in enumerate(pushes, 1)
    ]
    return Watch(len(pushes) + 1, np.zeros(3), tuple(judged))


def test_it_says_what_was_found_what_was_done_and_how_far_the_error_fell():
    findings = (
        Finding(5, "undecided", "Too little is seen.", (), "pushes on"),
        Finding(6, "effect", "The model lacks one effect: table_tilt.", TILT, "adopts"),
    )
    # An effect that the model had from the start does not count.
    given, both = ("tether",), ("tether", *TILT)
    kept = repair_story(Repair(6, both, 8, findings), watch((0.02, given), (0.03, given), (0.004, both)))[-1]
    assert kept.startswith("Before, 2 pushes") and "with tether and table_tilt, 1 push ended 4.0 mm" in kept
    seen = watch((0.010, ()), (0.024, ()), (0.030, ()), (0.004, TILT), (0.001, TILT), (0.030, TILT))
    first, second, third = repair_story(Repair(6, TILT, 8, findings), seen)
    assert first.startswith("After push 5, diagnosis: Too little is seen.")
    assert first.endswith("made another push to find out.")
    assert second.endswith("lacks one effect: table_tilt. From then on, the model included table_tilt.")
    assert "3 pushes ended 24.0 mm off (median), 24 % of how far they moved the object" in third
    assert "with table_tilt, 3 pushes ended 4.0 mm off (median), 4 % of how" in third


def test_the_headline_names_what_was_added_its_size_and_the_fall_of_the_error():
    sizes = {"table_tilt": "tilt 8.0°", "tether": "a pull of 2 N"}
    seen = watch((0.024, ("tether",)), (0.004, ("tether", *TILT)))
    said = repair_headline(Repair(6, ("tether", *TILT), 8), seen, sizes)
    assert said.startswith("The run added table_tilt (tilt 8.0°). Before, 1 push ended 24.0 mm off")
    assert "with tether and table_tilt, 1 push ended 4.0 mm off" in said
    assert repair_headline(Repair(6, ("tether",), 8), seen, sizes) == ""


def test_an_effect_and_its_rival_are_told_as_one_or_the_other():
    sizes = {"table_tilt": "tilt 8.0°", "tether": "a pull of 2 N"}
    adopted = Finding(5, "effect", "The model lacks table_tilt.", TILT, "adopts", rival="tether")
    repair = Repair(5, TILT, 8, (adopted,), rival="tether")
    # Once one is ruled out, the model that learned has the other alone.
    seen = watch((0.024, ()), (0.004, (*TILT, "tether")), (0.006, ("tether",)), (0.005, TILT))
    first, second = repair_story(repair, seen)
    assert first.endswith("From then on, the model included table_tilt or tether.")
    assert "with table_tilt or tether, 3 pushes ended 5.0 mm off" in second
    headline = repair_headline(repair, seen, sizes)
    assert headline.startswith(
        "The run added table_tilt (tilt 8.0°) or tether (a pull of 2 N). Before, 1 push"
    )


def test_the_report_of_a_run_is_told_what_the_terminal_says():
    repair, seen = Repair(6, TILT, 8), watch((0.024, ()), (0.004, TILT))
    slopes = {
        name: {"unit": "rad", "value": value, "low": value, "high": value}
        for name, value in (("down_x", 0.1), ("down_y", 0.0))
    }
    learned = SimpleNamespace(belief=SimpleNamespace(grid=None), effect_estimates={"table_tilt": slopes})
    run = SimpleNamespace(repair=repair, watch=seen, identification=learned)
    headline, sentences = _told(run)
    assert headline.startswith("The run added table_tilt (tilt 5.7° (5.7 to 5.7), downhill towards 0")
    assert sentences == repair_story(repair, seen)
    assert _told(SimpleNamespace(repair=None)) == ("", [])


def test_pushes_towards_the_edge_are_not_said_to_be_chosen_to_find_out():
    findings = [
        Finding(pushes, "undecided", "Too little is seen.", (), "pushes on", "a from b") for pushes in (4, 5)
    ]
    first, second = repair_story(Repair(5, (), 6, tuple(findings)), watch((0.02, ()), (0.03, ())), 5)
    assert first.endswith("made another push to find out. The next pushes were chosen to tell a from b.")
    assert second.endswith("Too little is seen. The robot continued with the model it had.")


def test_without_an_effect_no_fall_is_claimed():
    assert repair_story(Repair(5), watch((0.01, ()))) == [
        "The model was not repaired: no push gave cause for a diagnosis."
    ]
    dropped = Finding(7, "undecided", "Too little is seen.", (), "drops")
    (said,) = repair_story(Repair(7, (), 7, (dropped,)), watch((0.02, TILT), (0.03, ())))
    assert said.endswith("it did not explain the pushes after all.")


def test_what_has_no_name_widens_intervals_and_that_is_said():
    unknown = Finding(3, "unknown", "No effect explains the pushes.", (), "goes on without")
    seen = watch((0.02, ()), (0.03, ()), (0.02, ()))
    pushes = tuple(replace(push, allowed=0.006 if push.trial < 3 else 0.025) for push in seen.judged)
    said = repair_story(Repair(3, (), 0, (unknown,)), replace(seen, judged=pushes))
    assert said[-1].endswith("count as surprising beyond 25.0 mm (median); before, beyond 6.0 mm.")
    assert len(repair_story(Repair(3, (), 0, (unknown,)), replace(seen, judged=pushes[:2]))) == 1


def test_a_trial_of_an_effect_and_a_diagnosis_that_failed_are_told():
    adopted = Finding(5, "effect", "The model lacks table_tilt.", TILT, "adopts", "table_tilt from no effect")
    tried = Finding(
        7,
        "tried",
        "With table_tilt, 2 pushes were 9.0 mm off on average; without, 4.0 mm.",
        (),
        "drops",
    )
    failed = Finding(8, "failed", "The diagnosis failed: too few pushes.", (), "goes on without")
    first, second, third = repair_story(Repair(8, (), 7, (adopted, tried, failed)), watch((0.02, ())))
    assert first.endswith("The next pushes were chosen to tell table_tilt from no effect.")
    assert second.startswith("After push 7: With table_tilt, 2 pushes were 9.0 mm off")
    assert second.endswith("it did not explain the pushes after all.")
    assert "The diagnosis failed: too few pushes. The robot continued" in third
