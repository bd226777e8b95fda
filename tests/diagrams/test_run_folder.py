"""The folder of an exploration: what one process records, another goes on with."""

from __future__ import annotations

import errno
import json
import os
import shutil
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from slipmap.diagrams.loops import exploration_run, pregrasp_loop
from slipmap.diagrams.loops.exploration_loop import (
    LoopOptions,
    RecordedRun,
    exploration_loop,
    output_of,
)
from slipmap.diagrams.loops.run_folder import (
    PICTURE,
    PUSHES,
    RUN,
    SCENARIO,
    UNDER_WAY,
    ExplorationFolder,
    PregraspFolder,
    is_complete,
    resumed,
)
from slipmap.diagrams.station.scenario import Scenario
from slipmap.diagrams.systems.diagnosis import Finding, Repair
from slipmap.diagrams.systems.model_monitor import Judged, Watch
from slipmap.models.files import BadInput
from slipmap.models.measurements import Channel, Trial, read_dataset, write_dataset, writing as recording
from slipmap.models.perception.first_look import FirstPicture
from slipmap.models.perception.pinhole_camera import View
from slipmap.planners.action_selection import Choice
from slipmap.planners.table_push import TablePush
from tests.models.perception.conftest import Scene

OPTIONS = LoopOptions(pushes=3, checks=1, cells=20, seed=4)


def scenario() -> Scenario:
    made = Scenario()
    made.object.name = "book"
    made.table.friction = 0.7
    made.camera.width, made.camera.height_pixels = 320, 240  # for speed
    return made


@pytest.fixture(scope="module")
def whole() -> RecordedRun:
    """Four pushes, made up, of an object that a camera saw."""
    scene, camera = Scene(), scenario().camera
    scene.view = View(camera.intrinsics, camera.X_WC.GetAsMatrix4())
    depth = scene.depth(((-0.1, -0.06, 0.1, 0.0, 0.03),), (0.0, 0.0, 0.3))
    blocked = np.zeros(depth.shape, bool)
    first = FirstPicture(depth, scene.view.X_WC, blocked, OPTIONS.cells, noisy=True, missing=0.01)
    time = np.linspace(0.0, 1.0, 11)
    tip = np.column_stack([-0.2 + 0.1 * time, 0 * time])
    trials, choices = [], []
    for number in range(4):
        pose = np.column_stack([0.01 * number + 0.01 * time**2, 0 * time, 0.1 * time])
        force = np.column_stack([time, 0 * time, 0 * time])
        role = "fit" if number < 3 else "heldout"
        channels = (Channel(time, values) for values in (pose, tip, force))
        trials.append(Trial(f"trials/{number:03d}.json", role, *channels))
        push = TablePush([-0.2, 0.0], [-0.1, 0.001 * number], 0.05, creep=0.01)
        choices.append(Choice(push, np.array([-0.1, 0.01 * number]), np.array([1.0, 0.0])))
    places = tuple([0.01 * number, 0.0, 5.7] for number in range(4))
    points = len(first.seen(camera.intrinsics).foot.shape.points)
    rests = tuple(1e-6 * np.round(shift + np.arange(points) % 7) for shift in (20.0, 230.0))
    rests[1][:3] = np.nan
    grid = first.grid(camera.intrinsics, rests)
    return RecordedRun(tuple(trials), tuple(choices), places, grid, first, rests)


def part(whole: RecordedRun, count: int) -> RecordedRun:
    return replace(
        whole, trials=whole.trials[:count], choices=whole.choices[:count], places=whole.places[:count]
    )


def recorded(folder, whole, count, first=0, before=None):
    record = ExplorationFolder(folder, scenario(), OPTIONS, before)
    for number in range(first + 1, count + 1):
        record.keep(part(whole, number))
    return record


def said(error) -> str:
    return str(error.value)


def test_another_process_finds_all_that_it_needs(whole, tmp_path):
    recorded(tmp_path, whole, 2)
    cell, options, before = resumed(tmp_path)
    assert options == OPTIONS
    assert cell.object.pose == whole.places[1]  # the simulated object lies where it was left
    cell.object.pose = scenario().object.pose
    assert cell == scenario()
    assert before.places == whole.places[:2]
    assert np.array_equal(before.grid.centers, whole.grid.centers)
    assert np.array_equal(before.grid.exterior, whole.grid.exterior)
    assert np.array_equal(read_dataset(tmp_path / "pushes").grid.exterior, whole.grid.exterior)
    assert all(map(partial(np.array_equal, equal_nan=True), before.rests, whole.rests))
    assert np.array_equal(before.first.depth, whole.first.depth)
    assert (before.first.noisy, before.first.missing) == (True, 0.01)
    for ours, theirs in zip(before.choices, whole.choices, strict=False):
        assert (ours.push.end == theirs.push.end).all() and ours.push.creep == theirs.push.creep
        assert (ours.contact == theirs.contact).all() and (ours.direction == theirs.direction).all()
    assert [trial.role for trial in before.trials] == ["fit", "fit"]
    assert np.array_equal(before.trials[1].tip_pose.values, whole.trials[1].tip_pose.values)


def test_a_run_of_an_earlier_version_goes_on_with_the_outline_of_its_first_look(whole, tmp_path):
    """It does not hold what was seen of the outline at the places of rest."""
    recorded(tmp_path, whole, 2)
    run = json.loads((tmp_path / RUN).read_text())
    del run["rests"]
    (tmp_path / RUN).write_text(json.dumps(run))
    cell, _, before = resumed(tmp_path)
    assert before.rests == () and len(before.trials) == 2
    assert np.array_equal(before.grid.exterior, whole.first.seen(cell.camera.intrinsics).grid.exterior)


def test_going_on_ends_in_the_same_files_as_going_through(whole, tmp_path):
    for name in ("through", "on"):
        (tmp_path / name).mkdir()
    recorded(tmp_path / "through", whole, 4).end()
    recorded(tmp_path / "on", whole, 2)
    before = resumed(tmp_path / "on")[2]
    recorded(tmp_path / "on", whole, 4, first=2, before=before).end()
    through, on = (
        {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*.*")}
        for folder in (tmp_path / "through", tmp_path / "on")
    )
    runs = [json.loads(files.pop(RUN)) for files in (through, on)]
    for files in (through, on):
        del files[PICTURE]  # a zip file holds the time of day, and the run its digest
    assert through == on
    for run in runs:
        del run["digests"]
    assert runs[0] == runs[1]
    assert runs[0]["ended"]


def test_a_run_that_was_cut_off_is_not_overwritten_and_one_that_ended_may_be(whole, tmp_path):
    record = recorded(tmp_path, whole, 2)
    with pytest.raises(BadInput) as told:
        ExplorationFolder(tmp_path, scenario(), OPTIONS)
    assert "interrupted run with pushes recorded: 2" in said(told) and f"--resume {tmp_path}" in said(told)
    record.end()
    recorded(tmp_path, whole, 1)
    assert len(read_dataset(tmp_path / PUSHES).trials) == 1
    assert len(resumed(tmp_path)[2].trials) == 1


def test_a_run_that_ended_can_be_gone_on_with(whole, tmp_path):
    recorded(tmp_path, whole, 3).end()
    assert len(resumed(tmp_path)[2].trials) == 3


def test_cut_off_between_the_run_file_and_the_push_the_push_did_not_happen(whole, tmp_path, monkeypatch):
    record = recorded(tmp_path, whole, 1)
    judged = Judged(1, 1.2, 0.3, 11.0, True, 0.01, 0.005, True, (), 0.08)
    watch = Watch(2, np.full(3, np.nan), (judged,))

    def cut(*arguments):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(recording.PushRecorder, "keep", cut)
        record.keep(replace(part(whole, 2), watch=watch))
    before = resumed(tmp_path)[2]
    assert len(before.trials) == len(before.choices) == len(before.places) == 1
    assert (before.watch.trials, before.watch.judged) == (1, ())


def killed_at(call, work):
    """Do the work in a process that is killed when it renames something for the given time."""
    replace, calls = os.replace, iter(range(1, 10))

    def killed(part, file):
        if next(calls) >= call:
            os._exit(9)
        replace(part, file)

    child = os.fork()
    if child == 0:
        os.replace = killed
        work()
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 9 << 8


@pytest.mark.parametrize(("older", "call"), [(0, 1), (0, 2), (0, 3), (0, 4), *((3, k) for k in range(1, 6))])
def test_a_run_killed_before_its_first_push_is_written_gives_way(whole, tmp_path, older, call):
    """At each rename: of an older run's pushes, and of run file, scenario, picture and pushes."""
    if older:
        record = recorded(tmp_path, whole, older)
        record.end()
        for name in (SCENARIO, PICTURE):  # as if of another object
            (tmp_path / name).write_bytes(b"")
    killed_at(call, lambda: recorded(tmp_path, whole, 1))
    if call > 1:
        with pytest.raises(BadInput, match=r"no run .* with pushes; start one with --output"):
            resumed(tmp_path)
    recorded(tmp_path, whole, 2)
    assert len(resumed(tmp_path)[2].trials) == 2
    assert {path.name for path in tmp_path.iterdir()} == {PUSHES, RUN, SCENARIO, PICTURE}


def test_what_was_measured_of_the_push_under_way_stays_until_it_is_recorded(whole, tmp_path):
    record = recorded(tmp_path, whole, 1)
    record.note(1, {"tip_pose": ((0.5, 0.1, 0.2, 0.0),)})
    told = json.loads((tmp_path / UNDER_WAY).read_text())
    assert told == {"push": 1, "tip_pose": [[0.5, 0.1, 0.2, 0.0]]}
    assert len(resumed(tmp_path)[2].trials) == 1
    record.keep(part(whole, 2))
    assert not (tmp_path / UNDER_WAY).exists()


def test_a_disk_that_is_full_before_the_push_is_over_is_told_alike(whole, tmp_path, monkeypatch):
    record = recorded(tmp_path, whole, 1)

    def full(*arguments, **options):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch, pytest.raises(BadInput) as told:
        patch.setattr("os.replace", full)
        record.note(1, {"tip_pose": ((0.5, 0.1, 0.2, 0.0),)})
    for words in (f"{UNDER_WAY}: the disk is full; make room", "the earlier push is kept", "--resume"):
        assert words in said(told)
    assert len(resumed(tmp_path)[2].trials) == 1


def test_a_full_disk_names_the_file_and_says_how_to_go_on(whole, tmp_path, monkeypatch):
    record = recorded(tmp_path, whole, 2)
    calls = []

    def full(descriptor):
        calls.append(descriptor)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch, pytest.raises(BadInput) as told:
        patch.setattr(recording.os, "fsync", full)
        record.keep(part(whole, 3))
    assert calls
    words = ("trials/002.json: the disk is full; make room", "the 2 earlier pushes are kept", "--resume")
    assert all(word in said(told) for word in words)
    assert len(resumed(tmp_path)[2].trials) == 2


@pytest.mark.parametrize("name", [SCENARIO, PICTURE, PUSHES, f"{PUSHES}/trials/001.json"])
def test_what_is_missing_is_named(whole, tmp_path, name):
    recorded(tmp_path, whole, 2)
    path = tmp_path / name
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    with pytest.raises(BadInput) as told:
        resumed(tmp_path)
    assert name in said(told)


@pytest.mark.parametrize("name", [SCENARIO, PUSHES])
def test_files_of_two_runs_are_not_mixed(whole, tmp_path, name):
    (tmp_path / "one").mkdir(), (tmp_path / "other").mkdir()
    recorded(tmp_path / "one", whole, 2)
    other = scenario()
    other.table.friction = 0.9
    later = replace(whole, trials=tuple(replace(trial, ft_wrench=None) for trial in whole.trials))
    ExplorationFolder(tmp_path / "other", other, OPTIONS).keep(part(later, 1))
    if name == PUSHES:
        shutil.rmtree(tmp_path / "one" / name)
        shutil.copytree(tmp_path / "other" / name, tmp_path / "one" / name)
    else:
        shutil.copy(tmp_path / "other" / name, tmp_path / "one" / name)
    with pytest.raises(BadInput) as told:
        resumed(tmp_path / "one")
    assert name in said(told) and "not th" in said(told)


@pytest.mark.parametrize(
    "content", [None, "", "[1]", '{"format": "other"}', '{"format": "slipmap-exploration/1"}']
)
def test_a_folder_without_a_run_is_told(tmp_path, content):
    if content is not None:
        (tmp_path / RUN).write_text(content)
    with pytest.raises(BadInput) as told:
        resumed(tmp_path)
    assert str(tmp_path) in said(told)


def test_files_that_are_no_part_of_a_run_are_told_before_it_begins(tmp_path):
    (tmp_path / PUSHES).mkdir()
    (tmp_path / PUSHES / "notes.txt").write_text("mine")
    with pytest.raises(BadInput, match="not a push dataset"):
        ExplorationFolder(tmp_path, scenario(), OPTIONS)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--pushes", 3], ["--resume keeps the options of the run; leave out --pushes"]),
        (["--output", "elsewhere"], ["leave out --output"]),
        (["--hardware"], ["made in simulation; leave out --hardware"]),
    ],
)
def test_what_cannot_be_asked_for_beside_resume_is_told(slipmap, whole, tmp_path, arguments, words):
    recorded(tmp_path, whole, 2)
    said_by = slipmap("explore", "--resume", tmp_path, *arguments)
    assert said_by.code == 2 and "Traceback" not in said_by.err
    assert all(word in said_by.err for word in words)


def test_a_complete_run_has_nothing_left_to_do(slipmap, whole, tmp_path):
    recorded(tmp_path, whole, 4).end(complete=False)  # it gave up
    assert not is_complete(tmp_path)
    record = ExplorationFolder(tmp_path, scenario(), OPTIONS, resumed(tmp_path)[2])
    record.keep(whole)
    assert not json.loads((tmp_path / RUN).read_text())["ended"]  # while it goes on
    record.end()
    for name in ("belief.npz", "report.html"):  # without them there is
        (tmp_path / name).touch()
    before = contents(tmp_path)
    told = slipmap("explore", "--resume", tmp_path)
    assert (told.code, told.out) == (0, "") and contents(tmp_path) == before
    assert f"{tmp_path}: this run is complete, nothing is left to do" in told.err
    assert f"`slipmap explore --after {tmp_path} --output FOLDER` makes more pushes" in told.err


def test_a_run_in_a_real_cell_is_not_gone_on_with_in_simulation(slipmap, whole, tmp_path):
    recorded(tmp_path, replace(whole, places=(None,) * 4), 2)
    told = slipmap("explore", "--resume", tmp_path)
    assert told.code == 2 and "made in a real cell; add --hardware" in told.err


def test_a_run_that_was_cut_off_is_told_by_the_command(slipmap, whole, tmp_path):
    recorded(tmp_path, whole, 2)
    told = slipmap("explore", "--output", tmp_path)
    assert told.code == 2 and f"slipmap explore --resume {tmp_path}" in " ".join(told.err.split())


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def made_by_hand(whole, folder, count=2):
    """A dataset that no run left."""
    recorded(folder / "elsewhere", whole, count)
    return write_dataset(read_dataset(folder / "elsewhere" / PUSHES), folder / PUSHES)


@pytest.mark.parametrize("command", ["explore", "pregrasp"])
@pytest.mark.parametrize("mark", [None, "[", "{}", "other", "cut off", "other pushes"])
def test_pushes_that_no_earlier_run_left_are_not_replaced(slipmap, whole, tmp_path, command, mark):
    (tmp_path / "elsewhere").mkdir()
    made_by_hand(whole, tmp_path)
    ours = {"format": f"slipmap-{'exploration' if command == 'explore' else command}/1", "ended": True}
    marks = {
        "other": {"format": "slipmap-something/1", "ended": True, "pushes": []},
        "cut off": {**ours, "ended": False, "pushes": []},
        "other pushes": {**ours, "pushes": [{"digest": "0"}, {"digest": "1"}]},
    }
    if mark is not None:
        (tmp_path / RUN).write_text(json.dumps(marks[mark]) if mark in marks else mark)
    before = contents(tmp_path)
    told = slipmap(command, "--output", tmp_path, "--pushes", 1)
    assert (told.code, told.out) == (2, "") and "Traceback" not in told.err
    assert f"{tmp_path / PUSHES}: is not from a finished earlier run of `slipmap {command}`" in told.err
    assert "choose another folder with --output" in told.err
    assert contents(tmp_path) == before


def test_a_scenario_of_ones_own_is_not_replaced(slipmap, tmp_path):
    cell = tmp_path / SCENARIO
    cell.write_text("camera: {rate: 5}")
    told = slipmap("explore", "--scenario", cell, "--output", tmp_path)
    assert told.code == 2 and str(cell) in told.err and "--output" in told.err
    assert cell.read_text() == "camera: {rate: 5}"


def test_a_run_of_one_command_does_not_give_way_to_another(whole, tmp_path):
    (tmp_path / "explored").mkdir(), (tmp_path / "taken").mkdir()
    recorded(tmp_path / "explored", whole, 2).end()
    record = PregraspFolder(tmp_path / "taken", scenario())
    record.keep(part(whole, 2))
    record.end()
    for kind, folder in (
        (PregraspFolder, "explored"),
        (lambda f, s: ExplorationFolder(f, s, OPTIONS), "taken"),
    ):
        with pytest.raises(BadInput, match="is not from a finished earlier run"):
            kind(tmp_path / folder, scenario())


@pytest.mark.parametrize("hardware", [False, True])
@pytest.mark.parametrize("command", ["explore", "pregrasp"])
def test_a_run_of_a_real_cell_is_not_replaced(slipmap, whole, tmp_path, command, hardware):
    if command == "explore":
        record = recorded(tmp_path, replace(whole, places=(None,) * 4), 2)
    else:
        record = PregraspFolder(tmp_path, scenario())
        record.keep(part(whole, 2))
    record.end()
    before = contents(tmp_path)
    told = slipmap(command, "--output", tmp_path, "--pushes", 1, *(["--hardware"] if hardware else []))
    assert (told.code, told.out) == (2, "") and "Traceback" not in told.err
    assert f"{tmp_path}: holds an earlier run that may be of a real cell, and pushes recorded: 2" in told.err
    assert "choose another folder with --output" in told.err
    assert contents(tmp_path) == before


@pytest.mark.parametrize("command", ["explore", "pregrasp"])
def test_a_simulated_run_is_replaced_and_the_command_says_so(slipmap, whole, tmp_path, monkeypatch, command):
    def stop(*_, **__):
        raise exploration_run.ExplorationFailed("it stops here")

    monkeypatch.setattr(exploration_run, "explore", stop)
    monkeypatch.setattr(pregrasp_loop, "pregrasp", stop)
    first = slipmap(command, "--output", tmp_path)
    assert first.code == 1 and "replaces" not in first.err
    if command == "explore":
        recorded(tmp_path, whole, 2).end()
    else:
        PregraspFolder(tmp_path, scenario(), repeatable=True).keep(part(whole, 2))
    told = slipmap(command, "--output", tmp_path)
    assert told.code == 1 and "it stops here" in told.err
    said = f"this run replaces the earlier one in {tmp_path} (2 pushes); --output chooses another folder"
    assert said in told.err.splitlines()


@pytest.mark.parametrize("command", ["explore", "pregrasp"])
def test_ctrl_c_before_the_first_push_is_recorded_leaves_nothing(slipmap, tmp_path, monkeypatch, command):
    def stop(*_, record, **__):
        record.note(0, {"tip_pose": ((0.5, 0.1, 0.2, 0.0),)})
        raise exploration_run.ExplorationStopped("stopped after 0 of 3 pushes")

    monkeypatch.setattr(exploration_run, "explore", stop)
    monkeypatch.setattr(pregrasp_loop, "pregrasp", stop)
    told = slipmap(command, "--output", tmp_path / "run")
    assert "nothing half-written is left behind" in told.err
    assert not (tmp_path / "run").exists()


def test_a_pregrasp_in_a_real_cell_that_was_cut_off_does_not_give_way(whole, tmp_path):
    record = PregraspFolder(tmp_path, scenario())
    for number in (1, 2):
        record.keep(part(whole, number))
    with pytest.raises(BadInput, match="earlier run of `slipmap pregrasp`"):
        PregraspFolder(tmp_path, scenario())


@pytest.mark.parametrize("call", [1, 2])
def test_a_simulated_pregrasp_that_was_killed_gives_way(whole, tmp_path, call):
    """At the renames of the run file and of a push."""
    record = PregraspFolder(tmp_path, scenario(), repeatable=True)
    record.keep(part(whole, 1))
    killed_at(call, lambda: record.keep(part(whole, 2)))
    PregraspFolder(tmp_path, scenario(), repeatable=True).keep(part(whole, 2))
    assert len(read_dataset(tmp_path / PUSHES).trials) == 2


@pytest.mark.parametrize("call", [1, 2, 3])
def test_a_pregrasp_killed_before_its_first_push_is_written_gives_way(whole, tmp_path, call):
    """At each rename: of the older run's pushes, of run file and pushes."""
    record = PregraspFolder(tmp_path, scenario(), repeatable=True)
    record.keep(part(whole, 2))
    record.end()
    killed_at(call, lambda: PregraspFolder(tmp_path, scenario()).keep(part(whole, 1)))
    PregraspFolder(tmp_path, scenario()).keep(part(whole, 2))
    assert len(read_dataset(tmp_path / PUSHES).trials) == 2


@pytest.mark.parametrize("command", [("demo", "-o"), ("replay", "nothing.lcmlog", "--output")])
def test_pushes_of_the_robot_are_lost_to_no_other_command(slipmap, whole, tmp_path, command):
    recorded(tmp_path, whole, 2).end()
    before = contents(tmp_path)
    told = slipmap(*command, tmp_path)
    assert told.code == 2 and f"{tmp_path}: holds a run of the robot cell" in told.err
    assert contents(tmp_path) == before


def test_the_repair_and_what_the_monitor_saw_are_found_again(whole, tmp_path):
    """However the model stood when the process ended, another one begins with it."""
    finding = Finding(
        2, "effect", "The model lacks one effect: table_tilt.", ("table_tilt",), "adopts", "a from b"
    )
    repair = Repair(2, ("table_tilt",), 4, (finding,), question=object())
    judged = Judged(1, 1.2, 0.3, 11.0, True, 0.01, 0.005, True, (), 0.08)
    watch = Watch(2, np.full(3, np.nan), (judged,))
    choices = (whole.choices[0], replace(whole.choices[1], why="to tell a from b"))
    record = recorded(tmp_path, whole, 1)
    record.keep(replace(part(whole, 2), choices=choices, watch=watch, repair=repair))
    before = resumed(tmp_path)[2]
    assert before.repair == replace(repair, trials=1, question=None, asks_again=True)
    assert (before.watch.trials, before.watch.judged, before.watch.alarm) == (2, (judged,), True)
    assert [choice.why for choice in before.choices] == ["", "to tell a from b"]
    loop = exploration_loop(scenario(), LoopOptions(pushes=3, cells=20, adapt=True), before=before)
    context = loop.CreateDefaultContext()
    assert output_of(loop, "diagnosis", "effects", context) == ("table_tilt",)
    assert output_of(loop, "model_monitor", "watch", context).alarm
    alone = before.all_to_learn_from()
    assert alone.repair is None and alone.watch is None
