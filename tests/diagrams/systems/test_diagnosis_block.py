"""When pushes are looked into, and what the robot does about the answer."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
from driven_block import DrivenBlock

from slipmap.diagrams.systems import diagnosis
from slipmap.diagrams.systems.diagnosis import PERIOD, Diagnosis, Repair, has_model
from slipmap.diagrams.systems.model_monitor import Judged, Watch
from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.diagnosis import procedure
from slipmap.models.measurements import DatasetError
from slipmap.planners.settings import RepairSettings

SETTINGS = RepairSettings(pushes=4, fewest=5, doubt=10.0, probation=2)
PUSHES = 5  # of exploring
QUESTION = SimpleNamespace(words="table_tilt from tether")


@dataclass(frozen=True)
class Push:
    """All that the block does with a trial is to let it teach."""

    number: int
    role: str = "heldout"


class Robot(DrivenBlock):
    """A block whose diagnoses are what the test says, and which notes what it was asked.

    Pushes are as far off, m, with the tested effects as `push` says, and `without` off with those before:
    along the way, or at the end if `at_end`.
    """

    at_end = True
    gains: ClassVar[dict[str, float]] = {}  # of the effects that explain the pushes

    def __init__(self, monkeypatch, *answers, without: float = 0.03, **given) -> None:
        self.asked: list[int] = []
        waiting = list(answers)

        def diagnose(dataset, *, seed):
            assert all(push.role == "fit" for push in dataset)
            self.asked.append(len(dataset))
            answer = waiting.pop(0)
            if isinstance(answer, Exception):
                raise answer
            verdict, effects, *p = answer
            if verdict == "rivals":
                verdict, rivals = "ambiguous", [effects_named(rival) for rival in effects]
            else:
                named = effects_named(effects)
                rivals = [(one,) for one in named] if verdict == "ambiguous" else [named] if named else []
            rivals = [SimpleNamespace(effects=tuple(rival)) for rival in rivals]
            gains = [("force_latency", 0.01), ("table_tilt", p[0] if p else 0.01), ("tether", 1.0)]
            candidates = [
                SimpleNamespace(
                    name=name, p_value=chance, fitted_gain=self.gains.get(name), explains=name in self.gains
                )
                for name, chance in gains
            ]
            return SimpleNamespace(
                verdict=verdict, rivals=rivals, sentence=f"{verdict}.", candidates=candidates
            )

        monkeypatch.setattr(procedure, "diagnose", diagnose)
        monkeypatch.setattr(
            diagnosis,
            "robots_question",
            lambda found, dataset: (
                QUESTION if found.verdict in ("effect", "ambiguous", "undecided") else None
            ),
        )
        monkeypatch.setattr(
            diagnosis,
            "learning",
            lambda effects, rival: (
                lambda trials, seed: SimpleNamespace(
                    belief=((*effects, f"or {rival}") if rival else effects, len(trials))
                )
            ),
        )
        self.compared: list[tuple[str, ...]] = []
        self.errors: dict[int, float] = {}

        def predict(belief, trials):
            effects, taught = belief
            assert [trial.number for trial in trials] == [taught]  # learned from all pushes before it
            self.compared.append(effects)
            errors = [
                without if len(self.compared) % 2 == 0 else self.errors[trial.number] for trial in trials
            ]
            ways = (0.0, 1.0) if self.at_end else (1.0, 0.0)
            return [
                SimpleNamespace(final_add=ways[1] * error, errors=SimpleNamespace(mean_add=ways[0] * error))
                for error in errors
            ]

        monkeypatch.setattr(diagnosis, "predict", predict)
        block = Diagnosis(lambda trials, grid: trials, SETTINGS, pushes=PUSHES, **given)
        super().__init__(block, trials=(), cell_grid=None, watch=watch(0))
        self.advance(0.5 * PERIOD)

    judged: tuple[Judged, ...] = ()

    def push(self, count: int, error: float = 1e-3, **seen) -> Repair:
        """The repair after so many pushes and what the monitor made of them."""
        self.errors[count - 1] = error
        self.judged = (*self.judged, judged(count, self.read("effects"), **seen))
        self.set(trials=tuple(Push(k) for k in range(count)), watch=Watch(count, np.zeros(3), self.judged))
        self.advance(2 * PERIOD)
        return self.read("repair")


def judged(count, effects=(), evidence=1.0, alarm=False) -> Judged:
    return Judged(count - 1, 1.0, 0.5, evidence, alarm, 1e-3, 5e-3, alarm, tuple(effects), 0.05)


def watch(count: int, **seen) -> Watch:
    return Watch(count, np.zeros(3), (judged(count, **seen),))


def actions(repair: Repair) -> list[str]:
    return [finding.action for finding in repair.findings]


def test_pushes_that_end_as_predicted_are_checked_now_and_then(monkeypatch):
    robot = Robot(monkeypatch, *[("adequate", ())] * 2)
    for count in range(1, 13):
        repair = robot.push(count, evidence=9.0)
        assert (repair.trials, repair.wanted) == (count, 0)
    assert robot.asked == [SETTINGS.fewest, SETTINGS.fewest + SETTINGS.every]
    assert actions(repair) == ["goes on without"] * 2


def test_it_waits_until_the_monitor_has_judged_the_push(monkeypatch):
    robot = Robot(monkeypatch, ("effect", ("table_tilt",)))
    robot.set(trials=tuple(Push(k) for k in range(6)), watch=watch(5, alarm=True))
    robot.advance(2 * PERIOD)
    assert robot.read("repair").trials == 0 and robot.asked == []
    robot.push(6, alarm=True)
    assert robot.asked == [6]


@pytest.mark.parametrize("seen", [{"alarm": True}, {"evidence": 10.0}])
def test_a_named_effect_is_adopted_and_put_to_the_test(monkeypatch, seen):
    repair = Robot(monkeypatch, ("effect", ("table_tilt", "tether"))).push(6, **seen)
    assert repair.effects == ("table_tilt", "tether")
    assert (repair.wanted, actions(repair)) == (6 + SETTINGS.probation, ["adopts"])


def test_of_effects_that_cannot_be_told_apart_the_simplest_is_adopted(monkeypatch):
    repair = Robot(monkeypatch, ("ambiguous", ("tether", "table_tilt"))).push(5, alarm=True)
    assert repair.effects == ("table_tilt",)


def test_what_explains_the_pushes_better_is_the_rival_of_the_simplest(monkeypatch):
    """Near the middle of a table a tether acts like a tilt, so hypotheses have one or the other."""
    both = ("ambiguous", ("tether", "table_tilt"))
    robot = Robot(monkeypatch, both, both, ("effect", ("tether",)))
    robot.gains = {"table_tilt": 38.0, "tether": 42.0}
    repair = robot.push(5, alarm=True)
    assert (repair.effects, robot.read("rival")) == (("table_tilt",), "tether")
    assert repair.model == "table_tilt or tether"
    assert repair.findings[-1].sentence.endswith(
        "tether explains these pushes better than table_tilt, so the model has either."
    )
    assert Repair.of_run(json.loads(json.dumps(repair.to_run()))).rival == "tether"
    # The test of the next pushes is one of both.
    robot.push(6)
    assert robot.push(7).rival == "tether" and set(robot.compared) == {("table_tilt", "or tether"), ()}
    robot.gains = {"table_tilt": 80.0, "tether": 80.0}
    repair = robot.push(8, alarm=True)
    assert (repair.effects, repair.rival, repair.findings[-1].action) == (("table_tilt",), "", "keeps")
    robot.gains = {"table_tilt": 80.0, "tether": 120.0}
    repair = robot.push(9, alarm=True)
    assert (repair.effects, repair.rival, repair.findings[-1].action) == (("tether",), "", "adopts")


def test_a_new_rival_is_on_trial_and_what_was_there_before_comes_back_with_its_own(monkeypatch):
    tilt = ("effect", ("table_tilt",))
    robot = Robot(monkeypatch, tilt, tilt, ("effect", ("tether",)))
    for count in (5, 6, 7):
        robot.push(count, alarm=count == 5)
    robot.gains = {"table_tilt": 38.0, "tether": 42.0}
    repair = robot.push(8, alarm=True)
    assert (repair.effects, repair.rival, repair.findings[-1].action) == (("table_tilt",), "tether", "adopts")
    for count in (9, 10, 11, 12):
        robot.push(count)
    assert set(robot.compared[-4:]) == {("table_tilt", "or tether"), ("table_tilt",)}
    robot.gains = {}
    assert robot.push(13, alarm=True).effects == ("tether",)
    for count in (14, 15):
        repair = robot.push(count, error=0.1)
    assert (repair.effects, repair.rival, repair.findings[-1].action) == (("table_tilt",), "tether", "drops")


def test_a_rival_stays_while_the_answer_is_open(monkeypatch):
    robot = Robot(monkeypatch, ("effect", ("table_tilt",)), ("undecided", ()), ValueError("no"))
    robot.gains = {"table_tilt": 38.0, "tether": 42.0}
    robot.push(5, alarm=True)
    assert robot.push(6, alarm=True).rival == "tether"
    robot.push(7)
    assert robot.push(8, alarm=True).rival == "tether"  # that diagnosis failed
    assert robot.read("repair").findings[-1].verdict == "failed"


def test_a_rival_is_dropped_with_its_effect(monkeypatch):
    robot = Robot(monkeypatch, ("effect", ("table_tilt",)), without=0.0)
    robot.gains = {"table_tilt": 38.0, "tether": 42.0}
    for count in (5, 6, 7):
        repair = robot.push(count, error=0.01, alarm=count == 5)
    assert (repair.effects, repair.rival, actions(repair)) == ((), "", ["adopts", "drops"])


def test_an_effect_that_explains_less_is_no_rival(monkeypatch):
    robot = Robot(monkeypatch, ("ambiguous", ("tether", "table_tilt")))
    robot.gains = {"table_tilt": 38.0, "tether": 37.0}
    assert robot.push(5, alarm=True).rival == ""


def test_a_model_with_a_rival_has_one_or_the_other():
    model = (("viscous_friction", "table_tilt"), "tether")
    assert has_model(("tether", "viscous_friction"), *model)
    assert has_model(("viscous_friction", "table_tilt"), *model)
    assert not has_model(("tether",), *model) and not has_model(("viscous_friction",), *model)
    assert not has_model((), ("table_tilt",), "") and has_model((), (), "")


def test_few_pushes_are_not_diagnosed_but_more_are_made(monkeypatch):
    robot = Robot(monkeypatch)
    repair = robot.push(SETTINGS.fewest - 1, alarm=True)
    assert (robot.asked, repair.wanted, repair.findings) == ([], SETTINGS.fewest, ())


def test_where_the_answer_is_open_another_push_is_asked_for_up_to_the_budget(monkeypatch):
    most = PUSHES + SETTINGS.pushes
    robot = Robot(monkeypatch, *[("undecided", ())] * 5)
    for count in range(PUSHES, most + 1):
        repair = robot.push(count, alarm=True)
        assert repair.wanted == min(count + 1, most)
    assert actions(repair) == ["pushes on"] * (most - PUSHES) + ["goes on without"]
    assert repair.question is None


@pytest.mark.parametrize("verdict", ["unknown", "adequate"])
def test_without_a_name_the_robot_goes_on(monkeypatch, verdict):
    repair = Robot(monkeypatch, (verdict, ())).push(6, alarm=True)
    assert (repair.effects, repair.wanted, actions(repair)) == ((), 0, ["goes on without"])


def test_an_effect_that_does_not_help_is_dropped(monkeypatch):
    robot = Robot(monkeypatch, ("effect", ("tether",)), ("effect", ("table_tilt",)))
    assert robot.push(5, alarm=True).effects == ("tether",)
    assert robot.push(6, error=0.07).effects == ("tether",)
    assert robot.push(7, error=0.07, alarm=True).effects == ()
    repair = robot.push(8, alarm=True)
    assert repair.effects == ("table_tilt",)
    assert actions(repair) == ["adopts", "drops", "adopts"]
    assert robot.asked == [5, 8]
    assert [finding["pushes"] for finding in repair.to_json()["findings"]] == [5, 7, 8]


@pytest.mark.parametrize(("later", "then"), [(0.04, "drops"), (0.01, "keeps")])
def test_a_close_call_is_decided_by_as_many_pushes_again(monkeypatch, later, then):
    robot = Robot(monkeypatch, ("effect", ("tether",)))
    robot.push(5, alarm=True)
    robot.push(6, error=0.04)
    repair = robot.push(7, error=0.04)
    assert (repair.findings[-1].verdict, repair.effects, repair.wanted) == ("close", ("tether",), 9)
    assert repair.findings[-1].sentence.endswith("30.0 mm. That is close, so the test goes on.")
    stored = Repair.of_run(json.loads(json.dumps(repair.to_run())))
    assert robot.push(8, error=later) == replace(repair, trials=8) and stored == repair
    repair = robot.push(9, error=later)
    assert (repair.findings[-1].verdict, actions(repair)) == ("tried", ["adopts", "keeps", then])
    assert repair.tried is None and len(robot.compared) == 2 * (2 + 4)


@pytest.mark.parametrize(("error", "then"), [(0.0035, "keeps"), (0.0045, "drops")])
def test_a_few_millimetres_do_not_end_a_test_at_once(monkeypatch, error, then):
    """A single push that ended 2.1 mm off with a true tilt, and 0.8 mm without, once dropped it."""
    robot = Robot(monkeypatch, ("effect", ("tether",)), without=0.001)
    for count in (5, 6, 7):
        repair = robot.push(count, error=error, alarm=count == 5)
    assert actions(repair) == ["adopts", then]


@pytest.mark.parametrize(("later", "then"), [(0.0105, "keeps"), (0.001, "keeps"), (0.02, "drops")])
def test_pushes_that_decide_nothing_do_not_end_a_test_at_once(monkeypatch, later, then):
    robot = Robot(monkeypatch, ("effect", ("tether",)), without=0.01)
    wanted = robot.push(5, alarm=True).wanted
    for count in (6, 7):
        repair = robot.push(count, error=0.0105)
    assert (repair.findings[-1].verdict, repair.effects, repair.wanted) == ("close", ("tether",), wanted)
    assert repair.findings[-1].sentence.endswith("10.0 mm. That decides nothing, so the test goes on.")
    for count in (8, 9):
        repair = robot.push(count, error=later)
    assert (repair.findings[-1].verdict, actions(repair)) == ("tried", ["adopts", "keeps", then])
    assert repair.findings[-1].sentence.endswith("That decides nothing.") == (later == 0.0105)


@pytest.mark.parametrize("verdict", ["undecided", "unknown"])
@pytest.mark.parametrize(("error", "then"), [(0.001, "keeps"), (0.07, "drops")])
def test_an_open_answer_leaves_an_effect_on_trial_to_its_test(monkeypatch, verdict, error, then):
    robot = Robot(monkeypatch, ("effect", ("tether",)), (verdict, ()))
    robot.push(5, alarm=True)
    repair = robot.push(6, alarm=True, error=error)
    assert repair.effects == ("tether",) and repair.tried == repair.findings[0]
    repair = robot.push(7, error=error)
    assert robot.asked == [5, 6] and robot.compared == [("tether",), ()] * 2
    assert (repair.findings[-1].verdict, repair.findings[-1].action) == ("tried", then)
    assert repair.effects == (("tether",) if then == "keeps" else ())
    assert repair.tried is None


def test_an_effect_on_trial_is_dropped_where_nothing_is_missing(monkeypatch):
    robot = Robot(monkeypatch, ("effect", ("tether",)), ("adequate", ()))
    robot.push(5, alarm=True)
    repair = robot.push(6, alarm=True)
    assert (repair.effects, repair.tried, actions(repair)) == ((), None, ["adopts", "drops"])


@pytest.mark.parametrize(("error", "then"), [(0.001, "keeps"), (0.07, "drops")])
def test_an_effect_that_is_named_again_is_kept_and_still_tested(monkeypatch, error, then):
    robot = Robot(monkeypatch, ("effect", ("table_tilt",)), ("ambiguous", ("tether", "table_tilt")))
    wanted = robot.push(5, alarm=True).wanted
    repair = robot.push(6, alarm=True, error=error)
    assert (repair.effects, actions(repair), repair.wanted) == (("table_tilt",), ["adopts", "keeps"], wanted)
    repair = robot.push(7, error=error)
    assert (repair.findings[-1].verdict, actions(repair)) == ("tried", ["adopts", "keeps", then])


def test_pushes_of_an_earlier_process_are_settled(monkeypatch):
    robot = Robot(monkeypatch, ("effect", ("tether",)), before=Repair(6))
    assert robot.push(6, alarm=True) == Repair(6)
    assert replace(robot.push(7, alarm=True), findings=()).effects == ("tether",)


@pytest.mark.parametrize(("verdict", "kept"), [("unknown", True), ("undecided", True), ("adequate", False)])
def test_an_effect_that_was_tried_and_kept_is_dropped_where_nothing_is_missing_alone(
    monkeypatch, verdict, kept
):
    robot = Robot(monkeypatch, ("effect", ("tether",)), (verdict, ()), without=0.03)
    for count in (5, 6, 7):
        robot.push(count, alarm=count == 5)
    repair = robot.push(8, alarm=True)
    assert repair.effects == (("tether",) if kept else ())
    assert [finding.verdict for finding in repair.findings] == ["effect", "tried", verdict]


def test_effects_that_the_user_gave_are_never_dropped(monkeypatch):
    answers = [("effect", ("tether",)), ("undecided", ()), ("effect", ("table_tilt",))]
    robot = Robot(monkeypatch, *answers, effects=("table_tilt",))
    assert robot.read("effects") == ("table_tilt",)
    assert robot.push(5, alarm=True).effects == ("table_tilt", "tether")
    assert robot.push(6, alarm=True, error=0.07).effects == ("table_tilt", "tether")
    assert robot.push(7, alarm=True, error=0.07).effects == ("table_tilt",)
    repair = robot.push(8, alarm=True)
    assert repair.effects == repair.given == ("table_tilt",)
    assert actions(repair) == ["adopts", "pushes on", "drops", "goes on without"]


def test_an_adopted_effect_beside_a_given_one_is_still_in_the_running(monkeypatch):
    """The simplest answer is the given effect alone; another one, both."""
    answers = [("effect", ("tether", "table_tilt")), ("rivals", (("table_tilt",), ("table_tilt", "tether")))]
    robot = Robot(monkeypatch, *answers, effects=("table_tilt",))
    assert robot.push(5, alarm=True).effects == ("table_tilt", "tether")
    repair = robot.push(6, alarm=True)
    assert (repair.effects, actions(repair)) == (("table_tilt", "tether"), ["adopts", "keeps"])


@pytest.mark.parametrize("effects", [(), ("table_tilt",)])
def test_a_diagnosis_that_fails_is_told_and_the_robot_goes_on(monkeypatch, effects):
    error = DatasetError("dataset recorded has no push left to fit")
    answers = [("effect", effects)] if effects else []
    robot = Robot(monkeypatch, *answers, error, ("effect", ("tether",)))
    for count in range(5, 6 + len(answers)):
        repair = robot.push(count, alarm=True)
    assert (repair.trials, repair.effects) == (count, effects)
    assert actions(repair)[-1] == ("keeps" if effects else "goes on without")
    assert repair.findings[-1].verdict == "failed" and str(error) in repair.findings[-1].sentence
    if effects:  # their test is due
        count += 1
        assert robot.push(count, alarm=True).findings[-1].verdict == "tried"
    assert robot.push(count + 1, alarm=True).effects == ("tether",)  # the next alarm is looked into again


def test_a_test_that_fails_is_told_as_such_and_made_again(monkeypatch):
    robot = Robot(monkeypatch, ("effect", ("tether",)))
    robot.push(5, alarm=True)
    robot.push(6)
    predicts = diagnosis.predict
    monkeypatch.setattr(diagnosis, "predict", lambda *arguments: 1 / 0)
    repair = robot.push(7)
    assert (repair.findings[-1].verdict, repair.effects) == ("failed", ("tether",))
    assert repair.findings[-1].sentence == "The test of the effects failed: division by zero."
    monkeypatch.setattr(diagnosis, "predict", predicts)
    assert robot.push(8).findings[-1].verdict == "tried"


@pytest.mark.parametrize(
    ("errors", "without", "action", "said"),
    [
        ((0.003, 0.005), 0.030, "keeps", "2 pushes were 4.0 mm off on average; without, 30.0 mm."),
        ((0.030, 0.020), 0.010, "drops", "2 pushes were 25.0 mm off on average; without, 10.0 mm."),
        # The first push does not tell, being about as far off with the effect as without.
        ((0.0105, 0.030), 0.010, "drops", "1 push was 30.0 mm off on average; without, 10.0 mm."),
    ],
)
@pytest.mark.parametrize("at_end", [True, False])
def test_an_adopted_effect_has_to_lower_the_error_of_the_next_pushes(
    monkeypatch, errors, without, action, said, at_end
):
    """Along the way too: a late camera does not change where objects come to rest."""
    monkeypatch.setattr(Robot, "at_end", at_end)
    robot = Robot(monkeypatch, ("effect", ("tether",)), without=without)
    robot.push(5, alarm=True)
    for count, error in enumerate(errors, 6):
        repair = robot.push(count, error=error)
    assert actions(repair) == ["adopts", action] and robot.compared == [("tether",), ()] * len(errors)
    assert repair.effects == (("tether",) if action == "keeps" else ())
    assert repair.findings[-1].sentence.endswith(said)
    assert actions(robot.push(8)) == ["adopts", action]  # it was tried once and for all


def test_what_is_left_is_the_question_of_the_next_pushes(monkeypatch):
    robot = Robot(monkeypatch, ("undecided", ()), ("unknown", ()))
    repair = robot.push(5, alarm=True)
    assert repair.question is QUESTION and repair.findings[-1].telling == QUESTION.words
    repair = robot.push(6, alarm=True)
    assert repair.question is None and repair.findings[-1].telling == ""


def test_another_process_goes_on_with_the_effect_and_its_trial(monkeypatch):
    first = Robot(monkeypatch, ("effect", ("tether",))).push(5, alarm=True)
    stored = Repair.of_run(json.loads(json.dumps(first.to_run())))
    robot = Robot(monkeypatch, before=replace(stored, asks_again=False), without=0.0)
    assert robot.read("effects") == ("tether",)
    robot.push(6, error=0.01)
    assert actions(robot.push(7, error=0.01)) == ["adopts", "drops"]


def test_another_process_asks_again_what_tells_about_an_effect_on_trial(monkeypatch):
    answer = ("effect", ("tether",))
    before = Robot(monkeypatch, answer)
    before.push(5, alarm=True)
    first = before.push(6)
    assert first.question is QUESTION
    stored = Repair.of_run(json.loads(json.dumps(first.to_run())))
    # Also where that process ends before it could ask.
    assert Repair.of_run(json.loads(json.dumps(stored.to_run()))) == stored
    robot = Robot(monkeypatch, answer, before=stored)
    assert robot.push(6) == first and robot.asked == [5]
    assert actions(robot.push(7)) == ["adopts", "keeps"]
    # A diagnosis that fails asks nothing, and the trial goes on.
    failing = Robot(monkeypatch, ValueError("no"), before=stored)
    assert failing.push(6) == replace(first, question=None)
    # A test that is due needs no question.
    late = Robot(monkeypatch, before=stored)
    assert actions(late.push(7)) == ["adopts", "keeps"] and late.asked == []


def test_another_process_asks_an_open_question_anew(monkeypatch):
    first = Robot(monkeypatch, ("undecided", ())).push(5, alarm=True)
    robot = Robot(monkeypatch, ("undecided", ()), before=Repair.of_run(first.to_run()))
    assert robot.push(5, alarm=True) == first and robot.asked == [5]


def test_another_process_asks_an_open_question_once_while_an_effect_is_on_trial(monkeypatch):
    answers = [("effect", ("tether",)), ("undecided", ())]
    before = Robot(monkeypatch, *answers)
    before.push(5, alarm=True)
    first = before.push(6, alarm=True)
    assert actions(first) == ["adopts", "pushes on"]
    robot = Robot(monkeypatch, answers[1], before=Repair.of_run(first.to_run()))
    assert robot.push(6, alarm=True) == first and robot.asked == [6]


def test_an_open_answer_that_may_be_chance_is_worth_no_further_push(monkeypatch):
    robot = Robot(monkeypatch, ("undecided", (), 0.4), ("undecided", (), 0.6))
    assert (robot.push(5).wanted, actions(robot.push(5))) == (6, ["pushes on"])
    repair = robot.push(6)
    assert (repair.wanted, actions(repair), repair.question) == (6, ["pushes on", "goes on without"], None)
    robot.push(7)
    assert robot.asked == [5, 6]


@pytest.mark.parametrize(
    ("verdict", "effects", "adopted"),
    [
        ("effect", ("force_latency",), ()),
        ("ambiguous", ("loose_mass", "force_latency"), ()),
        ("effect", ("table_tilt", "force_latency"), ("table_tilt",)),
    ],
)
def test_what_only_the_force_sensor_does_is_not_adopted(monkeypatch, verdict, effects, adopted):
    repair = Robot(monkeypatch, (verdict, effects)).push(5, alarm=True)
    assert (repair.effects, actions(repair)) == (adopted, ["adopts" if adopted else "goes on without"])


@pytest.mark.parametrize(
    "again", [("ambiguous", ("table_tilt", "force_latency")), ("effect", ("force_latency",))]
)
def test_a_confirmed_effect_outlives_a_fault_of_the_force_sensor(monkeypatch, again):
    robot = Robot(monkeypatch, ("effect", ("table_tilt",)), again, without=0.03)
    for count in (5, 6, 7):
        robot.push(count, alarm=count == 5)
    repair = robot.push(8, alarm=True)
    assert (repair.effects, actions(repair)) == (("table_tilt",), ["adopts", "keeps", "keeps"])


def test_an_effect_on_trial_stays_while_it_is_among_those_named(monkeypatch):
    robot = Robot(monkeypatch, ("effect", ("table_tilt",)), ("ambiguous", ("table_tilt", "force_latency")))
    robot.push(5, alarm=True)
    repair = robot.push(6, alarm=True)
    assert (repair.effects, actions(repair)) == (("table_tilt",), ["adopts", "keeps"])


def test_the_test_of_an_effect_comes_before_the_next_check(monkeypatch):
    monkeypatch.setattr(SETTINGS, "every", 1)
    robot = Robot(monkeypatch, ("effect", ("table_tilt",)), without=0.03)
    for count in (5, 6, 7):
        repair = robot.push(count, alarm=count == 5)
    assert [finding.verdict for finding in repair.findings] == ["effect", "tried"]


def test_an_effect_is_tried_against_the_one_that_it_replaced(monkeypatch):
    robot = Robot(monkeypatch, ("effect", ("tether",)), ("effect", ("table_tilt",)), without=0.002)
    robot.push(5, alarm=True)
    robot.push(6, alarm=True)
    robot.push(7, error=0.01)
    repair = robot.push(8, error=0.01)
    assert robot.compared == [("table_tilt",), ("tether",)] * 2
    assert (repair.effects, actions(repair)) == (("tether",), ["adopts", "adopts", "drops"])
