"""Other processes: two commands on one folder, whoever reads the output, workers of a killed command; and
what a command leaves when it is stopped while it writes."""

from __future__ import annotations

import errno
import os
import select
import signal
import subprocess
import sys
from collections import defaultdict
from importlib import import_module
from textwrap import indent
from types import SimpleNamespace

import pytest
from test_command_line import ENVIRONMENT, files_in, hear_ctrl_c

from slipmap.diagrams.application import terminal
from slipmap.diagrams.application.commands import record, studies
from slipmap.diagrams.application.commands.cell_run import CellRun
from slipmap.diagrams.application.outputs import lock_folder
from slipmap.diagrams.application.terminal import printable
from slipmap.diagrams.hardware import child
from slipmap.diagrams.hardware.child import Child
from slipmap.diagrams.hardware.control import stopped_by_ctrl_c
from slipmap.models.files import (
    PART,
    BadInput,
    all_or_nothing,
    replaced_file,
    replaced_folder,
    write_json,
    write_text,
)

HOLDS = """
import sys
from pathlib import Path
from slipmap.diagrams.application.outputs import lock_folder
lock_folder(Path(sys.argv[1]))
print("held", flush=True)
sys.stdin.read()
"""
MASTERS = {
    "campaign": """
from joblib import Parallel
from slipmap.diagrams.application.campaigns.trials import TrialSpec, _in_parallel
trial = TrialSpec("trial", "time:sleep", {"secs": 600}, 0)
Parallel._retrieve = lambda self: end()
list(_in_parallel([trial, trial], 2, []))
""",
    "blind-test": """
from slipmap.diagrams.application.commands import studies
studies.as_completed = lambda futures: end()
list(studies._run_all(["a", "b"], 2))
""",
    "explore": """
from slipmap.diagrams.systems import workers
workers.wait = lambda futures: end()
with workers.workers():
    pass
""",
}
"""Processes that begin workers, and then are killed."""
MASTER = """
import os, signal, time

def end():
    time.sleep(float(os.environ["KILLED_AFTER"]))
    os.kill(os.getpid(), signal.SIGKILL)

if __name__ == "__main__":
"""
BEGIN = """
import os, signal, time
if os.environ.pop("FIRST", None):
    os.environ["MASTER"] = str(os.getpid())
"""
AS_THEY_START = {
    "killed": """
while os.environ.get("MASTER") == str(os.getppid()):
    time.sleep(0.01)
""",
    "Ctrl-C": """
if os.environ.get("MASTER") == str(os.getppid()):
    os.kill(os.getpid(), signal.SIGINT)
""",
}
"""Makes workers begin their own work after their parent is gone, or hear Ctrl-C before it."""


def test_results_appear_together_or_not_at_all(tmp_path):
    first, second = tmp_path / "belief.json", tmp_path / "report.html"
    first.write_text("old")
    with pytest.raises(RuntimeError), all_or_nothing():
        write_json(first, {})
        write_text(second, "new")
        raise RuntimeError
    assert files_in(tmp_path) == ["belief.json"] and first.read_text() == "old"
    with all_or_nothing():
        write_json(first, {})
        write_text(second, "half")
        write_text(second, "new")  # the last word counts
        assert first.read_text() == "old" and not second.exists()
    assert first.read_text() == "{}\n" and second.read_text() == "new"
    assert files_in(tmp_path) == ["belief.json", "report.html"]


@pytest.mark.parametrize("before", [False, True])
def test_a_folder_appears_together_with_files(tmp_path, before):
    pushes, picture = tmp_path / "pushes", tmp_path / "pushes.png"
    if before:
        pushes.mkdir()
        (pushes / "old").write_text("")

    def write():
        write_text(picture, "new")
        with replaced_folder(pushes) as fresh:
            fresh.mkdir()
            (fresh / "new").write_text("")

    there = files_in(tmp_path)
    with pytest.raises(RuntimeError), all_or_nothing():
        write()
        raise RuntimeError
    assert files_in(tmp_path) == there
    with all_or_nothing():
        write()
        assert not picture.exists() and not (pushes / "new").exists()
    assert files_in(tmp_path) == ["pushes.png", "pushes/new"]


def test_what_a_killed_process_left_goes_when_the_next_one_writes(tmp_path):
    gone = subprocess.Popen(["true"])
    gone.wait()
    left = [f"{PART}{gone.pid}.0.belief.json", f"{PART}{gone.pid}.abcd"]
    kept = [f"{PART}{os.getpid()}.9.other.json", f".{gone.pid}.belief.json", ".slipmap.mine"]
    kept += [f"{PART}².json", f".slipmap.{gone.pid}.yaml", f".slipmap.00000000.{gone.pid}.other_host"]
    for name in (left[0], *kept):
        (tmp_path / name).touch()
    (tmp_path / left[1]).mkdir()
    write_json(tmp_path / "belief.json", {})
    assert files_in(tmp_path) == sorted([*kept, "belief.json"]) and not (tmp_path / left[1]).exists()
    (tmp_path / left[0]).touch()
    with all_or_nothing():
        write_json(tmp_path / "belief.json", {})
    assert files_in(tmp_path) == sorted([*kept, "belief.json"])


def test_what_a_killed_campaign_left_goes_with_its_next_trial(tmp_path):
    gone = subprocess.Popen(["true"])
    gone.wait()
    (tmp_path / f"{PART}{gone.pid}.trial.json").touch()
    with replaced_file(tmp_path / "trial.json") as part:
        part.touch()
    assert files_in(tmp_path) == ["trial.json"]


def test_ctrl_c_while_the_latency_of_the_camera_is_estimated_is_heard(monkeypatch):
    """`slipmap replay` would go on without it."""

    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("slipmap.models.inference.camera_lag.camera_lag", stop)
    with pytest.raises(KeyboardInterrupt):
        record._shown_lag(None)


def test_a_part_that_may_not_be_removed_does_not_cost_the_results(tmp_path, monkeypatch):
    gone = subprocess.Popen(["true"])
    gone.wait()
    part = tmp_path / f"{PART}{gone.pid}.0.belief.json"
    part.touch()
    unlink = type(part).unlink

    def refused(path, *_, **__) -> None:
        if path == part:
            raise PermissionError(errno.EPERM, "Operation not permitted")
        unlink(path, missing_ok=True)

    monkeypatch.setattr(type(part), "unlink", refused)
    write_json(tmp_path / "belief.json", {})
    assert (tmp_path / "belief.json").read_text() == "{}\n" and part.exists()


def test_ctrl_c_while_results_appear_waits_until_all_are_there(tmp_path, monkeypatch):
    replace = os.replace

    def interrupted(part, file) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        replace(part, file)

    monkeypatch.setattr(os, "replace", interrupted)
    # A shell that starts tests in the background has SIGINT ignored.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), all_or_nothing():
            write_text(tmp_path / "a", "new")
            write_text(tmp_path / "b", "new")
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert files_in(tmp_path) == ["a", "b"]


def interrupted_at(monkeypatch, name):
    """Let the first call of a function of `os` be preceded by Ctrl-C."""
    function, times = getattr(os, name), []

    def call(*arguments, **options):
        if not times:
            times.append(1)
            os.kill(os.getpid(), signal.SIGINT)
        return function(*arguments, **options)

    monkeypatch.setattr(os, name, call)


@pytest.mark.parametrize("write", ["together", "a folder"])
def test_ctrl_c_while_temporary_files_are_removed_leaves_none(tmp_path, monkeypatch, write):
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    interrupted_at(monkeypatch, "rmdir" if write == "a folder" else "unlink")
    try:
        with pytest.raises((KeyboardInterrupt, BadInput)):
            if write == "a folder":
                (tmp_path / "new").mkdir()
                with replaced_folder(tmp_path / "new") as fresh:
                    fresh.mkdir()
            else:
                with all_or_nothing():
                    write_text(tmp_path / "a", "new")
                    write_text(tmp_path / "b", "new")
                    raise BadInput
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert [path.name for path in tmp_path.iterdir()] == (["new"] if write == "a folder" else [])


def test_ctrl_c_while_a_push_is_written_still_stops_the_arm_first(tmp_path, monkeypatch):
    aborts: list[int] = []
    interrupted_at(monkeypatch, "unlink")
    with stopped_by_ctrl_c(SimpleNamespace(abort=lambda: aborts.append(1))) as pressed:
        with pytest.raises(BadInput), all_or_nothing():
            write_text(tmp_path / "a", "new")
            raise BadInput
        assert pressed() and aborts == [1]


TWO_FILES = """
import os, sys
from pathlib import Path
from slipmap.models import files

replace, flock, who, times = os.replace, files.fcntl.flock, sys.argv[1], []

def halt(part, file):
    replace(part, file)
    if who == "first" and not times:
        times.append(1)
        print("amid", flush=True)
        sys.stdin.readline()

def told(place, how):
    if who == "second":
        print("waits", flush=True)
    flock(place, how)

os.replace, files.fcntl.flock = halt, told
with files.all_or_nothing():
    for name in ("belief", "picture"):
        files.write_text(Path(sys.argv[2]) / name, who)
print("done", flush=True)
"""


def test_files_of_one_result_are_of_one_process(tmp_path):
    """The second begins to rename while the first is amid its two files."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "env": ENVIRONMENT}
    command = [sys.executable, "-c", TWO_FILES]
    with subprocess.Popen([*command, "first", tmp_path], **pipes) as first:
        assert first.stdout.readline() == "amid\n"
        with subprocess.Popen([*command, "second", tmp_path], **pipes) as second:
            second.stdout.readline()  # it waits, or is done
            first.communicate("\n")
            second.communicate()
        assert first.returncode == second.returncode == 0
    assert files_in(tmp_path) == ["belief", "picture"]
    assert {(tmp_path / name).read_text() for name in ("belief", "picture")} == {"second"}


@pytest.mark.parametrize(
    "words",
    [
        ("effects", "table_tilt", "--picture", "tilt.png", "--json", "tilt.json"),
        ("check", "DATASET", "-o", "check.html", "--json", "check.json"),
    ],
)
def test_a_picture_or_page_does_not_appear_without_the_numbers(
    slipmap, tilted_folder, tmp_path, monkeypatch, words
):
    module = import_module(f"slipmap.diagrams.application.commands.{DEFINED[words[0]]}")

    def stop(path, document) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "write_json", stop)
    monkeypatch.chdir(tmp_path)
    said = slipmap(*(tilted_folder if word == "DATASET" else word for word in words))
    assert said.code == 130 and files_in(tmp_path) == []


DEFINED = {"effects": "effects", "check": "datasets"}
"""Module of each command."""


def test_a_folder_has_one_writer_at_a_time(tmp_path):
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", HOLDS, tmp_path], text=True, **pipes) as other:
        assert other.stdout.readline() == "held\n"
        with pytest.raises(BadInput, match="another slipmap is writing a run there"):
            lock_folder(tmp_path)
        other.kill()
    lock_folder(tmp_path)
    assert files_in(tmp_path) == []


def test_an_exploration_is_refused_a_folder_in_use_before_it_writes(slipmap, tmp_path):
    lock_folder(tmp_path)
    said = slipmap("explore", "--pushes", 1, "--checks", 0, "--output", tmp_path)
    assert said.code == 2 and "another slipmap is writing a run there" in said.err
    assert files_in(tmp_path) == []


def test_a_recording_without_room_is_lost_alone(tmp_path):
    """The folder of the recording is gone; so would be room on a disk that is full."""
    cell = CellRun(False, "", False, tmp_path / "gone" / "run.html", tmp_path / "out")
    meshcat = SimpleNamespace(PublishRecording=lambda: None, StaticHtml=lambda: "<html>")
    with pytest.raises(BadInput, match=r"cannot write .*run\.html.*recording is lost.*--resume .*out"):
        cell.keep_recording(meshcat)


@pytest.mark.parametrize("start", [*AS_THEY_START, ""])
@pytest.mark.parametrize("command", MASTERS)
def test_workers_of_a_killed_process_end(command, start, tmp_path):
    """The workers have the pipe of their process, which closes when the last of them is gone."""
    (tmp_path / "master.py").write_text(MASTER + indent(MASTERS[command], "    "))
    (tmp_path / "sitecustomize.py").write_text(BEGIN + AS_THEY_START.get(start, ""))
    path = os.pathsep.join([str(tmp_path), ENVIRONMENT["PYTHONPATH"]])
    more = {"KILLED_AFTER": "0" if start == "killed" else "3", "FIRST": "1", "PYTHONPATH": path}
    with open(tmp_path / "said", "w+b") as said:
        pipes = {"stdout": subprocess.PIPE, "stderr": said}
        with subprocess.Popen(
            [sys.executable, tmp_path / "master.py"], env=ENVIRONMENT | more, **pipes
        ) as master:
            assert select.select([master.stdout], [], [], 60.0)[0] and master.stdout.read() == b""
            assert master.wait() == -signal.SIGKILL
        said.seek(0)
        assert b"KeyboardInterrupt" not in said.read()


IDLE = """
import time
from slipmap.diagrams.hardware.child import Child, be_ready

def idle():
    be_ready()
    time.sleep(600)

if __name__ == "__main__":
    import parent
    Child("a process that is busy for long", parent.idle)
    print("there", flush=True)
    time.sleep(600)
"""


def test_workers_end_where_ctrl_c_comes_before_all_have_their_datasets(tmp_path, monkeypatch):
    ended = []

    class Pool:
        def __init__(self, *workers, **options):
            pass

        def submit(self, *task):
            raise KeyboardInterrupt

        def shutdown(self, **options):
            ended.append(options)

    monkeypatch.setattr(studies, "ProcessPoolExecutor", Pool)
    monkeypatch.setattr(studies, "_stop_workers", ended.append)
    with pytest.raises(KeyboardInterrupt):
        list(studies._run_all([studies._Case(tmp_path, seed) for seed in (1, 2)], 2))
    assert ended == [{"wait": False, "cancel_futures": True}, tmp_path]


def test_a_busy_child_of_a_killed_process_ends(tmp_path):
    """It has the standard error of its parent, which closes when the last of them is gone."""
    (tmp_path / "parent.py").write_text(IDLE)
    command = [sys.executable, "-m", "parent"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, env=ENVIRONMENT, cwd=tmp_path, **pipes) as parent:
        assert parent.stdout.readline() == b"there\n"
        parent.kill()
        assert select.select([parent.stderr], [], [], 60.0)[0] and parent.stderr.read() == b""


def test_ctrl_c_while_a_child_starts_ends_it(monkeypatch):
    class Interrupted(Child):
        @property
        def output(self):
            raise KeyboardInterrupt

    begun, popen = [], subprocess.Popen
    monkeypatch.setattr(
        child.subprocess, "Popen", lambda *words, **how: begun.append(popen(*words, **how)) or begun[0]
    )
    with pytest.raises(KeyboardInterrupt):
        Interrupted("a process that waits", input)
    assert begun[0].returncode == -signal.SIGKILL


@pytest.mark.parametrize("reader", ["gone", "never there"])
def test_an_output_that_is_closed_is_no_failure(reader):
    command = [sys.executable, "-m", "slipmap", "effects"]
    if reader == "gone":
        there, gone = os.pipe()
        os.close(there)
        done = subprocess.run(command, env=ENVIRONMENT, stdout=gone, stderr=subprocess.PIPE)
        os.close(gone)
    else:
        shell = ["sh", "-c", '"$@" >&-', "sh", *command]
        done = subprocess.run(shell, env=ENVIRONMENT, stderr=subprocess.PIPE)
    assert (done.returncode, done.stderr) == (0, b"")


def test_ctrl_c_after_the_end_does_not_spoil_it():
    """Python takes a while to end; what the command wrote is there by then."""
    script = (
        "import atexit, os, signal, sys; from slipmap.diagrams.application.command_line import main;"
        "sys.argv = ['slipmap', 'completion', 'bash'];"
        "atexit.register(lambda: os.kill(os.getpid(), signal.SIGINT)); main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], env=ENVIRONMENT, capture_output=True, preexec_fn=hear_ctrl_c
    )
    assert (done.returncode, done.stderr) == (0, b"") and done.stdout


LOST = """
import os, signal, time
from slipmap.diagrams.application import command_line

class Deleted:
    def __del__(self):
        os.kill(os.getpid(), signal.NAME)
        time.sleep(0.01)

def work(*_, **__):
    Deleted()
    time.sleep(60)

command_line.slipmap.main = work
command_line.main()
"""


def ignore_ctrl_c() -> None:
    """As a shell does for commands in the background."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@pytest.mark.parametrize(("name", "begin"), [("SIGINT", hear_ctrl_c), ("SIGTERM", ignore_ctrl_c)])
def test_a_signal_while_an_object_is_deleted_is_heard(name, begin):
    command = [sys.executable, "-c", LOST.replace("NAME", name)]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, preexec_fn=begin, timeout=50)
    assert (done.returncode, done.stderr) == (130, b"slipmap: stopped; nothing half-written is left behind\n")


BROKEN_OFF = """
import os, signal, time
from contextlib import suppress
from slipmap.diagrams.application import command_line

class HalfMade:
    def __init__(self):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(60)
        self.handle = 1

    def __del__(self):
        self.handle

def half_made(*_, **__):
    HalfMade()

def half_loaded(*_, **__):
    with suppress(KeyboardInterrupt):
        HalfMade.__init__(None)
    raise ImportError("numba._devicearray failed to import")

command_line.slipmap.main = WORK
command_line.main()
"""


@pytest.mark.parametrize("work", ["half_made", "half_loaded"])
def test_what_ctrl_c_breaks_off_in_a_library_is_no_failure(work):
    """Modules in C forget why they could not be loaded, and objects that are half made fail when deleted."""
    command = [sys.executable, "-c", BROKEN_OFF.replace("WORK", work)]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, preexec_fn=hear_ctrl_c, timeout=50)
    assert (done.returncode, done.stderr) == (130, b"slipmap: stopped; nothing half-written is left behind\n")


COMMAND_STOPPED = """
from slipmap.diagrams.application import command_line
command_line.slipmap.main = lambda *_, **__: exec("raise KeyboardInterrupt")
command_line.main()
"""


def test_ctrl_c_within_exec_has_the_usual_exit_code(tmp_path):
    """As while an imported module makes a dataclass; `python -m` then remembers to end by the signal."""
    (tmp_path / "stopped.py").write_text(COMMAND_STOPPED)
    command = [sys.executable, "-m", "stopped"]
    done = subprocess.run(command, env=ENVIRONMENT, cwd=tmp_path, capture_output=True)
    assert (done.returncode, done.stderr) == (130, b"slipmap: stopped; nothing half-written is left behind\n")


TAKEN = """
import os, signal, sys

def press(event, arguments):
    if event == "import" and arguments[0] == "scipy.optimize._minimize":
        os.kill(os.getpid(), signal.SIGINT)

sys.addaudithook(press)
import slipmap.models.objects.meshes
print("gone on")
"""


def test_ctrl_c_is_heard_though_a_library_takes_it_for_a_missing_one():
    command = [sys.executable, "-c", TAKEN]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, preexec_fn=hear_ctrl_c)
    assert b"KeyboardInterrupt" in done.stderr and done.stdout == b""


def test_control_characters_of_names_do_not_reach_the_terminal(capsys):
    evil = "a\x1b]0;title\x07\x9b31m\u202eb\rc"
    assert printable(evil) == r"a\x1b]0;title\x07\x9b31m\u202eb\rc"
    assert printable("µ → 20 %\n\tok") == "µ → 20 %\n\tok"
    terminal.note(evil)
    terminal.paragraph(evil)
    terminal.status(evil)
    terminal.table(evil, ["name"], [[evil]])
    said = capsys.readouterr()
    assert not any(character in said.out + said.err for character in "\x1b\x07\x9b\u202e\r")


def test_the_pace_does_not_count_the_time_of_compiling(monkeypatch):
    from numba.core import event

    now = 0.0
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now)
    monkeypatch.setattr(terminal, "_compiling", [])
    monkeypatch.setattr(event, "_registered", defaultdict(list))
    terminal.prepare_kernels()
    pace = terminal._Pace(0)
    lock = "numba:compiler_lock"
    with event.trigger_event(lock):
        now = 10.0
        with event.trigger_event(lock):
            now = 30.0
    pace.note(1, 100)
    assert pace.left() is None  # one of a hundred says little
    now = 32.0
    pace.note(4, 100)
    assert pace.left() == pytest.approx(96 * 0.5)
    with event.trigger_event(lock):  # as a bar shows it in the meantime
        now = 132.0
        assert pace.left() == pytest.approx(96 * 0.5)


@pytest.mark.parametrize(("before", "lines"), [(1.0, 0), (5.0, 1)])
def test_a_long_wait_for_compiling_is_announced_once_where_some_kernels_are_there(
    tmp_path, capsys, monkeypatch, before, lines
):
    """A dataset with a table, or with effects, needs kernels that others did not."""
    from numba.core import event

    from slipmap.models.physics import compiled

    now = 0.0
    (tmp_path / "step.nbc").touch()
    monkeypatch.setattr(compiled, "CACHE_FOLDER", tmp_path)
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now)
    monkeypatch.setattr(terminal, "_compiling", [])
    monkeypatch.setattr(event, "_registered", defaultdict(list))  # nobody else listens
    terminal.prepare_kernels()
    with event.trigger_event("numba:compiler_lock"):
        now = before
        for _ in range(2):
            with event.trigger_event("numba:compiler_lock"):
                pass
    assert capsys.readouterr().err.count("Compiling what these pushes need for the first time") == lines


def test_formulas_of_effects_are_compiled_under_the_lock_that_the_pace_watches(monkeypatch):
    from numba import cfunc, float64
    from numba.core import event

    monkeypatch.setattr(terminal, "_compiling", [])
    monkeypatch.setattr(event, "_registered", defaultdict(list))
    terminal.prepare_kernels()
    assert terminal._compiling[0].seconds == 0.0
    cfunc(float64(float64))(lambda x: x + 1.0)
    assert terminal._compiling[0].seconds > 0.0


def test_parts_that_come_at_once_do_not_promise_an_early_end(monkeypatch):
    """Fifteen of two hundred are on file; the sixteenth is at work for half a minute."""
    now = 0.0
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now)
    pace = terminal._Pace(0)
    pace.note(15, 200)
    now = 30.0
    assert pace.left() > 300.0
    now = 32.0
    pace.note(16, 200)
    assert pace.left() == pytest.approx(184 * 2.0)
