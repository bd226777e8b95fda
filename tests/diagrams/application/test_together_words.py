"""What a diagnosis of several datasets says, to people and to programs."""

import dataclasses
import json
import shlex
from types import SimpleNamespace

import numpy as np
import pytest
from schemas import assert_as_described

import slipmap as slipmap_package
from slipmap.diagrams.application.command_line import slipmap
from slipmap.diagrams.application.commands.options import datasets_typed, load_dataset
from slipmap.diagrams.application.reports.comparison_words import joint_findings
from slipmap.diagrams.application.reports.diagnosis_report import joint_report
from slipmap.diagrams.application.reports.diagnosis_words import (
    errors_of_beliefs,
    joint_ranking,
    show_together,
    where_it_falls,
)
from slipmap.diagrams.application.reports.tables import joint_rows
from slipmap.diagrams.application.terminal import Progress
from slipmap.models.effects.library import LIBRARY
from slipmap.models.inference.comparison import Comparison, JointComparison, totals
from slipmap.models.inference.diagnosis.locked import LockedErrors
from slipmap.models.inference.diagnosis.results import (
    DatasetResult,
    JointCandidate,
    JointDiagnosis,
    JointIdentification,
    ParameterEstimate,
)
from slipmap.models.inference.effect_words import in_the_middle
from slipmap.models.inference.residual_structure import Pattern
from slipmap.models.measurements import write_dataset
from tests.made_predictions import made_prediction


def made(*falls, verdict="effect", ends=1.0):
    """A diagnosis that names a lag, with the falls of the datasets' costs; None where nothing is named.

    `ends` is the error at the end with the lag, over that without it.
    """
    named = verdict == "effect"
    lag = (ParameterEstimate("sensor_latency", "latency", "s", 0.025, 0.02, 0.03),) if named else ()
    errors = LockedErrors(np.array([1e-3, 2e-3]), np.array([4e-3, 6e-3]), np.array([3.0, 5.0]), np.zeros(2))
    after = dataclasses.replace(errors, final=ends * errors.final)
    datasets = tuple(
        DatasetResult(f"set {k}", ("a", "b"), ("c", "d"), k == 0, errors, after if named else None, fall, lag)
        for k, fall in enumerate(falls)
    )
    slope = ParameterEstimate("table_tilt", "down_x", "rad", 0.001, -0.002, 0.004)
    candidates = (
        JointCandidate("sensor_latency", 20.0, 0.005, 25.0, 22.0, named, None),
        JointCandidate("tether", 9.0, 0.4, 12.0, 8.0, False, None),
        JointCandidate("table_tilt", 8.0, 0.6, 6.0, 2.0, False, None, (slope,)),
        JointCandidate("skate", 1.0, 1.0, None, None, False, None),
    )
    return JointDiagnosis(
        verdict, "A sentence.", ("sensor_latency",) if named else (), named, lag, candidates, 0.005, datasets,
        sum(falls) if named else None, {"set 0": (), "set 1": ("frame", "clock")} if named else {}, 1.0, 0,
    )  # fmt: skip


def test_where_locked_pushes_are_not_better_predicted_is_said():
    said = where_it_falls(made(4.0, -1.0, 5.0, ends=0.2))
    assert said.startswith(
        "With sensor_latency, the locked pushes are predicted better in set 0 (5.0 → 1.0 mm off at the end)"
        " and set 2 (5.0 → 1.0 mm), worse in set 1 (5.0 → 1.0 mm). Their total cost falls by 8.0 nats."
    )
    said = where_it_falls(made(-4.0, -1.2, ends=2.0))
    assert "predicted worse in set 0 (5.0 → 10.0 mm off at the end) and set 1 (5.0 → 10.0 mm)." in said
    assert "cost rises by 5.2 nats" in said
    assert where_it_falls(made(None, None, verdict="adequate")) == ""


def test_what_hardly_changes_is_neither_better_nor_worse():
    """A finger that never touches, or poses in mm: the cost changes by 1e-5 nats."""
    said = where_it_falls(made(4.0, 8.8e-6, -0.4, ends=0.2))
    assert "better in set 0 (5.0 → 1.0 mm off at the end), hardly differently in set 1 (" in said
    assert "mm) and set 2 (" in said and "worse" not in said


def test_ends_that_stay_as_far_off_are_told_where_only_the_likelihood_is_better():
    said = where_it_falls(made(4.0, -5.0, ends=0.99))
    assert "predicted better by likelihood, though the ends are as far off, in set 0 (5.0 → " in said
    assert "far off" not in where_it_falls(made(4.0, ends=0.9)).split("Their total")[0].replace("mm off", "")


@pytest.mark.parametrize(
    "line",
    [
        "diagnose 'a b' c --apart 'force sensor'",
        "diagnose my.csv --object block.yaml --maps known.yaml --effect-file 'my fan.py' --effect-file b.py",
        "identify my.csv --object block.yaml -o belief.npz",
        "check my.csv --object rect1 --maps known.yaml",
    ],
)
def test_datasets_are_named_as_they_were_typed(line):
    name, *words = shlex.split(line)
    with slipmap.commands[name].make_context(name, list(words)):
        assert datasets_typed() == line.removeprefix(f"{name} ").removesuffix(" -o belief.npz")


def test_commands_that_know_no_own_effects_are_not_given_their_files():
    where = "my.csv --object block.yaml --effect-file 'my fan.py' --apart table"
    plain = "my.csv --object block.yaml --apart table"
    own = dataclasses.replace(made(4.0, 5.0), effects=("mine",))
    fit = f"`slipmap fit {plain} --effect mine --effect-file 'my fan.py' -o with-mine.npz`"
    assert fit in own.next_step(where)
    assert f"`slipmap fit {plain} --effect sensor_latency -o" in made(4.0, 5.0).next_step(where)


def test_the_file_of_an_own_effect_is_asked_for():
    own = dataclasses.replace(made(4.0, 5.0), effects=("mine",))
    assert "--effect mine --effect-file FILE -o" in own.next_step()
    assert "--effect-file" not in made(4.0, 5.0).next_step()


def test_more_pushes_are_asked_for_where_none_were_locked_away():
    found = made(None, None, verdict="undecided")
    assert "; or name with --apart what they do not share." in found.next_step("A B")
    bare = tuple(dataclasses.replace(one, locked=()) for one in found.datasets)
    said = dataclasses.replace(found, datasets=bare, doubts={}).next_step("A B")
    assert said == "give each dataset three pushes or more, then run `slipmap diagnose A B` again."


def test_what_is_not_shared_is_proposed_where_it_may_help():
    found = dataclasses.replace(made(None, None, verdict="undecided"), owner="force sensor")
    assert found.next_step().endswith(
        "; or, if they do not share the force sensor, add `--apart 'force sensor'`."
    )
    for given in ({"apart": ("force sensor",)}, {"owner": "object"}, {"owner": None, "apart": ("table",)}):
        assert dataclasses.replace(found, **given).next_step().endswith("what only one of them has.")


def test_a_dataset_that_does_not_have_the_effect_may_be_left_out():
    found = dataclasses.replace(made(4.0, 9.0, -1.0), owner="tracker", doubts={})
    step = found.next_step("A B C")
    assert step.startswith(
        "if set 2 does not share the tracker with the others, add `--apart tracker` to `slipmap diagnose A B"
        " C`, or leave set 2 out; otherwise run `slipmap fit A B C --effect sensor_latency -o"
    )
    assert dataclasses.replace(found, shared=False).next_step("A B C").startswith("run `slipmap fit A B C")
    assert (
        dataclasses.replace(made(4.0, 9.0, -0.4), doubts={}).next_step("A").startswith("run `slipmap fit A")
    )


def test_what_check_finds_wrong_with_any_of_the_datasets_comes_first():
    wrong = "correct what `slipmap check` finds wrong with set 1 (frame, clock)"
    found = made(4.0, 5.0)
    assert found.next_step("A B").startswith(
        f"{wrong}; then run `slipmap diagnose A B` again. If nothing can"
    )
    assert found.to_json()["first"] == [wrong]
    weighed = dataclasses.replace(found, first=("measure the finger",))
    assert weighed.to_json()["first"] == ["measure the finger", wrong]
    sound = dataclasses.replace(found, doubts={"set 0": (), "set 1": ()})
    assert sound.next_step("A B").startswith("run `slipmap fit A B --effect sensor_latency -o")
    assert sound.to_json()["first"] == []


def test_a_failed_refit_is_not_taken_for_an_effect_behind_others():
    found = made(4.0, 5.0)
    failed = dataclasses.replace(found.candidates[-1], objection="not refitted")
    assert joint_ranking(dataclasses.replace(found, candidates=(failed,)))[0][-1] == "not refitted"


def test_what_is_printed_names_sizes_and_the_next_command(capsys):
    dataset, _ = slipmap_package.simulated_hammer(seed=1, fit=1, heldout=1)
    show_together(made(4.0, 5.0), [dataset], LIBRARY, "A B --apart table")
    printed = " ".join(capsys.readouterr().out.split())
    for words in (
        "25 ms late (20 to 30)",
        "slipmap fit A B --apart table --effect sensor_latency -o with-sensor_latency.npz",
        "sensor_latency 20.0 0.005 25.0 22.0 not ruled out",
        "12.0 8.0 others explain more",
        "6.0 2.0 explains too little",
        "– – behind others to first order",
        "down_x, rad 0.0010 -0.0020 to 0.0040",
        "set 0 (whole)",
        "5.0",
    ):
        assert words in printed


def two_at_once():
    """A diagnosis that names a lag and lengths that are too long, both needed."""
    one = made(4.0, 5.0)
    scale = ParameterEstimate("tracker_scale", "excess", "1", 0.06, 0.05, 0.07)
    datasets = tuple(dataclasses.replace(d, alone=(*d.alone, scale)) for d in one.datasets)
    second = JointCandidate("tracker_scale", 9.0, 0.4, 12.0, 8.0, True, None)
    return dataclasses.replace(
        one, effects=("sensor_latency", "tracker_scale"), together=True, datasets=datasets,
        parameters=(*one.parameters, scale), candidates=(*one.candidates, second),
    )  # fmt: skip


def test_two_effects_that_are_both_needed_are_told_as_one_answer():
    found = two_at_once()
    standings = {row[0]: row[-1] for row in joint_ranking(found)}
    assert standings["sensor_latency"] == "needed, together with tracker_scale"
    assert standings["tracker_scale"] == "needed, together with sensor_latency"
    assert where_it_falls(found).startswith("With sensor_latency and tracker_scale, the locked pushes are")
    names = "--effect sensor_latency --effect tracker_scale -o with-sensor_latency-tracker_scale.npz"
    assert f"`slipmap fit A B {names}`" in found.next_step("A B")
    assert found.to_json()["together"] and not made(4.0, 5.0).to_json()["together"]
    dataset, _ = slipmap_package.simulated_hammer(seed=1, fit=2, heldout=1)
    text = joint_report(found, [dataset, dataset], LIBRARY, "A B")
    for words in ("is missing: sensor_latency", "is missing: tracker_scale", "excess", "latency, s"):
        assert words in text
    rivals = joint_report(dataclasses.replace(found, together=False), [dataset, dataset], LIBRARY, "A B")
    assert "is missing: tracker_scale" not in rivals


def test_an_answer_that_leaves_locked_pushes_far_off_says_so():
    diagnosed = made(4.0, 5.0)
    # The verdict of a diagnosis tells it, that of a fit does not.
    assert "Even with" not in where_it_falls(diagnosed)
    found = JointIdentification(
        "for", "Yes.", ("sensor_latency",), (), 9.0, 9.0, diagnosed.datasets, (), 1.0, 0
    )
    assert "Even with sensor_latency, the typical locked push is 4 times the sensor noise off" in (
        where_it_falls(found)
    )
    near = tuple(
        dataclasses.replace(d, after=dataclasses.replace(d.after, misfit=np.array([1.5, 2.0])))
        for d in found.datasets
    )
    assert "Even with" not in where_it_falls(dataclasses.replace(found, datasets=near))


def test_a_joint_fit_tells_the_errors_of_its_beliefs_too():
    learned = tuple(
        SimpleNamespace(belief=SimpleNamespace(dataset=name), errors=lambda role, own=own: np.array(own))
        for name, own in (("A", [1e-3, 3e-3]), ("B", []), ("C", [4e-3]))
    )
    found = JointIdentification("for", "Yes.", ("tether",), (), 9.0, 9.0, (), learned, 1.0, 0)
    assert found.to_json()["held_out_errors"] == pytest.approx({"A": 2e-3, "C": 4e-3})
    assert "held-out pushes end 2.0 mm in A and 4.0 mm in C off on average." in errors_of_beliefs(found)
    assert errors_of_beliefs(dataclasses.replace(found, learned=())) == ""


def test_a_turned_tracker_is_also_told_where_the_pushes_are():
    dataset, _ = slipmap_package.simulated_hammer(seed=1, fit=1, heldout=1)
    poses = np.concatenate([t.object_pose.values[:, :2] for t in dataset.trials])
    move = np.append(np.array([0.5, -0.2]) - poses.mean(axis=0), 0.0)
    trials = tuple(
        dataclasses.replace(
            t,
            object_pose=dataclasses.replace(
                t.object_pose,
                values=t.object_pose.values + move,
            ),
        )
        for t in dataset.trials
    )
    moved = dataclasses.replace(dataset, trials=trials)

    def said(low):
        numbers = {"x": (1e-3, 0, 2e-3), "y": (-2.5e-3, -3e-3, -2e-3), "angle": (0.004, low, 0.006)}
        estimates = [ParameterEstimate("tracker_shift", name, "m", *own) for name, own in numbers.items()]
        return in_the_middle("tracker_shift", estimates, [moved])

    # x is 1 mm + 0.004 * 0.2 m off, y -2.5 mm + 0.004 * 0.5 m.
    assert "(x 500 mm, y -200 mm), poses lie 1.80 mm, -0.50 mm (x, y) off" in said(0.002)
    assert said(-0.002) == ""


@pytest.mark.parametrize("diagnosis", [made(4.0, -1.0), made(None, None, verdict="undecided"), two_at_once()])
def test_json_is_as_described(diagnosis):
    document = json.loads(json.dumps(diagnosis.to_json()))
    assert_as_described("diagnose", document)
    assert_as_described("diagnose-together", document)


@pytest.mark.parametrize("falls", [(4.0, -1.0), (None, None)])
def test_the_page_has_every_candidate_and_dataset(falls):
    dataset, _ = slipmap_package.simulated_hammer(seed=1, fit=2, heldout=1)
    verdict = "effect" if falls[0] else "undecided"
    text = joint_report(made(*falls, verdict=verdict), [dataset, dataset], LIBRARY, "A B")
    for words in ("tether", "behind others to first order", "set 0 (whole)", "A sentence."):
        assert words in text
    named = verdict == "effect"
    assert ("latency, s" in text) is named and ("25 ms late" in text) is named


@pytest.mark.parametrize(
    ("command", "more", "option"),
    [
        ("fit", ["--effect", "table_tilt", "-o", "b.npz"], ["--maps", "m.yaml"]),
        ("compare", [], ["--maps", "m.yaml"]),
        ("compare", [], ["--belief", "b.npz"]),
        ("diagnose", [], ["--maps", "m.yaml"]),
        ("diagnose", [], ["--quick"]),
    ],
)
def test_options_of_one_dataset_are_refused_for_several_and_the_other_way_round(
    slipmap, tmp_path, monkeypatch, command, more, option
):
    monkeypatch.chdir(tmp_path)
    said = slipmap(command, "a", "b", *more, *option)
    assert said.code == 2 and f"{option[0]} is for one dataset" in said.err
    said = slipmap(command, "a", "--apart", "table", *more)
    assert said.code == 2 and "give two or more" in said.err


def test_what_effects_do_not_share_needs_effects(slipmap, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = slipmap("compare", "a", "b", "--apart", "table")
    assert said.code == 2 and "add --effect" in " ".join(said.err.split())


def written(folder, *names):
    """Datasets of different pushes, reported 30 ms late."""
    for seed, name in enumerate(names, start=1):
        dataset, _ = slipmap_package.simulated_hammer(seed=seed, fit=2, heldout=1)
        trials = tuple(
            dataclasses.replace(
                t, object_pose=dataclasses.replace(t.object_pose, time=t.object_pose.time + 0.03)
            )
            for t in dataset.trials
        )
        write_dataset(dataclasses.replace(dataset, name=name, trials=trials), folder / name.split("/")[-1])
    return [folder / name.split("/")[-1] for name in names]


def test_a_copy_of_a_dataset_under_another_name_is_refused(slipmap, tmp_path):
    dataset, _ = slipmap_package.simulated_hammer(seed=1, fit=2, heldout=1)
    for name in ("first", "second"):
        write_dataset(dataclasses.replace(dataset, name=name), tmp_path / name)
    for command in (["diagnose"], ["fit", "--effect", "table_tilt", "-o", tmp_path / "b.npz"], ["compare"]):
        said = slipmap(*command, tmp_path / "first", tmp_path / "second")
        assert said.code == 2 and "first and second contain the same push" in " ".join(said.err.split())


def test_warnings_about_several_datasets_name_the_dataset(tmp_path, capsys):
    """A warning about several pushes begins with their names alone."""
    folders = written(tmp_path, "first", "second")
    for folder in folders:
        for file in (folder / "trials").glob("00[01].json"):
            trial = json.loads(file.read_text())
            trial["lamp"] = [1.0]
            file.write_text(json.dumps(trial))
    with Progress() as progress:
        load_dataset(folders[0], None, progress)
        alone = capsys.readouterr().err
        for folder in folders:
            load_dataset(folder, None, progress, named=True)
    assert "warning: trials/000.json; trials/001.json: " in alone
    said = capsys.readouterr().err
    assert f"warning: {folders[0]}: trials/000.json" in said and f"warning: {folders[1]}: trials" in said
    assert said.count(str(folders[0])) == 1


def test_names_that_give_the_same_file_are_refused(slipmap, tmp_path):
    folders = written(tmp_path, "a b", "a/b")
    said = slipmap("fit", *folders, "--effect", "table_tilt", "-o", tmp_path / "belief.npz")
    assert said.code == 2 and "rename one" in said.err


def test_fit_and_compare_learn_of_several_datasets(slipmap, tmp_path):
    folders = written(tmp_path, "first set", "again")
    lag = ["--effect", "sensor_latency"]
    options = ["--hypotheses", "2", "-o", tmp_path / "lag.npz", "--json", tmp_path / "fit.json"]
    said = slipmap("fit", *folders, *lag, *options)
    assert said.code == 0 and "the tracker is" in said.out
    document = json.loads((tmp_path / "fit.json").read_text(encoding="utf-8"))
    beliefs = [tmp_path / f"lag.{name}.npz" for name in ("first-set", "again")]
    assert document["beliefs"] == [str(path) for path in beliefs]
    for path, dataset in zip(beliefs, ("first set", "again"), strict=True):
        belief = slipmap_package.Belief.load(path)
        assert belief.dataset == dataset and belief.effects[0].name == "sensor_latency"
        assert path.with_name(f"{path.stem}.pushes.png").is_file()

    files = ["-o", tmp_path / "page.html", "--json", tmp_path / "compare.json"]
    said = slipmap("compare", *folders, *lag, *files)
    assert said.code == 0 and "first set" in said.out and "with sensor_latency" in " ".join(said.out.split())
    compared = json.loads((tmp_path / "compare.json").read_text(encoding="utf-8"))
    assert compared["fitted"]["parameters"] == document["parameters"]
    assert [one["label"] for one in compared["datasets"][1]] == ["without effects", "with sensor_latency"]
    assert "again" in (tmp_path / "page.html").read_text(encoding="utf-8")


def compared(dataset, p, label="model", error=0.002):
    """A comparison whose remaining error depends on the place with a probability p."""
    pushes = (made_prediction(role="heldout", final_add=error),)
    own = Pattern("table_place", "place on the table", "motion", "x", 0.02, 0.01, 0.03, p, p, 20)
    return Comparison(
        label, dataset, dataset, pushes, {"heldout": totals(pushes)}, None, None, None, (own,), None, 0
    )


def test_what_recurs_in_several_datasets_is_said():
    found = JointComparison(tuple((compared(*one),) for one in (("A", 0.01), ("B", 0.002), ("C", 0.4))), None)
    ((pattern, names),) = found.recurring
    assert names == ("A", "B") and pattern.p_corrected == 0.002
    errors, recurs = joint_findings(found)
    assert "mean over 3 datasets (2.0 in A" in errors and "Without effects" not in errors
    assert "In 2 of 3 datasets (A, B): the error of the motion depends on the place on the table" in recurs
    one = JointComparison(((compared("A", 0.01),), (compared("B", 0.3),)), None)
    assert one.recurring == () and "in more than one dataset" in joint_findings(one)[1]


def test_where_an_effect_does_not_help_is_said():
    after = [compared(name, 0.3, "with tether", error) for name, error in (("A", 0.001), ("B", 0.003))]
    fitted = JointIdentification("for", "Yes.", ("tether",), (), 9.0, 5.0, (), (), 1.0, 0)
    found = JointComparison(tuple((compared(one.dataset, 0.3), one) for one in after), fitted)
    (errors, _) = joint_findings(found)
    assert "the model with tether ends 2.0 mm" in errors and "(1.0 in A to 3.0 in B" in errors
    assert "the error falls in 1 of 2 datasets, not in B." in errors
    worse = JointComparison(tuple((compared(one.dataset, 0.3, error=1e-4), one) for one in after), fitted)
    assert "the error falls in no dataset." in joint_findings(worse)[0]
    columns, rows = joint_rows(found)
    assert columns[2:4] == ["model", "with tether"] and rows[1][2:4] == ["2.0", "3.0"]
