"""The command line as a user meets it: help, wrong use, failures and interrupts."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from refusals import assert_refused, files_in

from slipmap.diagrams.application.command_line import run, slipmap as group
from slipmap.diagrams.perception.renderer import RendererUnavailable
from slipmap.models.files import BadInput

COMMANDS = ("demo", "identify", "predict", "compare", "calibrate", "blind-test", "bench")
HEAVY = (
    "numpy", "scipy", "numba", "matplotlib", "pydrake", "shapely", "cv2", "rich", "sympy", "http.server",
)  # fmt: skip


def hear_ctrl_c() -> None:
    """For a child process: where the tests run in the background, it would inherit that SIGINT is ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[3] / ".src")}


def test_help_lists_every_command_with_a_sentence(slipmap):
    said = slipmap("--help")
    assert said.code == 0 and said.err == ""
    for name in COMMANDS:
        (line,) = [line for line in said.out.splitlines() if line.strip().startswith(name + " ")]
        assert len(line.split()) >= 6
    assert "..." not in said.out.split("Commands:")[1]  # a sentence that is too long for its line
    assert "slipmap demo" in said.out
    assert max(map(len, said.out.splitlines())) <= 80


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_a_command_explains_every_option(slipmap, name):
    said = slipmap(name, "--help")
    assert said.code == 0
    for parameter in group.commands[name].params:
        if parameter.param_type_name == "option":
            assert parameter.opts[0] in said.out
            assert parameter.help, f"{name} {parameter.opts[0]} has no help"


def test_help_loads_nothing_heavy():
    script = (
        "import sys; from slipmap.diagrams.application.command_line import run; code = run(['--help']);"
        f"print('loaded:', *[name for name in {HEAVY!r} if name in sys.modules]); sys.exit(code)"
    )
    result = subprocess.run([sys.executable, "-c", script], env=ENVIRONMENT, capture_output=True, text=True)
    assert result.returncode == 0
    assert result.stdout.splitlines()[-1] == "loaded:"


def test_no_command_shows_help_as_wrong_use(slipmap):
    said = slipmap()
    assert said.code == 2 and said.out == ""
    assert "identify" in said.err and "Usage" in said.err


@pytest.mark.parametrize(
    ("typed", "meant"), [("identfy", "identify"), ("Demo", "demo"), ("calibrat", "calibrate")]
)
def test_a_misspelt_command_is_recognised(slipmap, typed, meant):
    assert_refused(slipmap(typed), f"`{typed}`", f"did you mean `{meant}`?")


def test_an_unknown_command_lists_what_there_is(slipmap):
    assert_refused(slipmap("xyz"), "`xyz`", *COMMANDS)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["identify", "data"], "--output"),
        (["identify", "data", "-o", "b.npz", "--hypotheses", "1"], "--hypotheses"),
        (["identify", "data", "-o", "b.npz", "--method", "magic"], "gauss-newton"),
        (["identify", "data", "-o", "b.npz", "--seed", "-1"], "--seed"),
        (["predict", "data"], "--belief"),
        (["compare", "data", "--seed", "-1"], "--seed"),
        (["demo", "--fit-pushes", "0"], "--fit-pushes"),
        (["calibrate", "--objects", "none"], "--objects"),
        (["bench", "--jsn", "x"], "--jsn"),
        (["compare", "data", "--belief", "a.npz", "--belief=b.npz"], "--belief is given 2 times"),
        (["demo", "-o", "a", "--output", "b", "-o", "a"], "-o/--output is given 3 times"),
        (["explore", "--object"], "--object"),
        (["completion"], "Choose from: bash, zsh, fish."),
    ],
)
def test_wrong_options_are_named_with_a_way_to_help(slipmap, tmp_path, monkeypatch, arguments, named):
    monkeypatch.chdir(tmp_path)
    assert_refused(slipmap(*arguments), named, f"See `slipmap {arguments[0]} --help`.")
    assert files_in(tmp_path) == []


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (["identify", "data", "-o", "b.npz", "--method", "papr"], "Did you mean 'paper'?"),
        (["explore", "--strategy=most-distinct"], "Did you mean 'most-distinctive'?"),
        (["explore", "--object", "hamer"], "did you mean hammer?"),
        (["explore", "--effect", "table_tlt"], "did you mean table_tilt?"),
        (["pregrasp", "--effect", "tether", "--effect", "tether"], "effect tether is given twice"),
        (["effects", "tilt"], "did you mean table_tilt?"),
        (["completion", "bsh"], "Did you mean 'bash'?"),
        (["completion", "--help-me"], "--help"),
    ],
)
def test_a_misspelt_word_is_recognised(slipmap, tmp_path, monkeypatch, arguments, hint):
    monkeypatch.chdir(tmp_path)
    assert_refused(slipmap(*arguments), hint)
    assert files_in(tmp_path) == []


@pytest.mark.parametrize(
    ("command", "loop"),
    [
        ("explore", "slipmap.diagrams.loops.exploration_run.explore"),
        ("pregrasp", "slipmap.diagrams.loops.pregrasp_loop.pregrasp"),
    ],
)
def test_the_robot_is_told_of_effects(slipmap, tmp_path, monkeypatch, command, loop):
    def told(scenario, options, *args, **kwargs):
        exploration = getattr(options, "exploration", options)
        raise BadInput(f"effects are {', '.join(exploration.effects)}")

    monkeypatch.setattr(loop, told)
    effects = ["--effect", "table_tilt", "--effect", "tether"]
    assert_refused(slipmap(command, *effects, "--output", tmp_path), "effects are table_tilt, tether")


def test_nothing_is_proposed_where_nothing_is_near(slipmap, tmp_path):
    said = slipmap("identify", "data", "-o", tmp_path / "b.npz", "--method", "magic")
    assert "Did you mean" not in said.err


@pytest.mark.parametrize(("shell", "part"), [("zsh", "#compdef slipmap"), ("fish", "complete --no-files")])
def test_completion_prints_a_script(slipmap, shell, part):
    said = slipmap("completion", shell)
    assert said.code == 0 and part in said.out


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("ident", ["identify"]),
        ("explore --object h", ["hammer"]),
        ("campaign fig6 --objects s", ["snack", "spray_gun"]),
        ("explore-study --object bo", ["book", "box"]),
        ("fit data --effect table_t", ["table_tilt"]),
    ],
)
def test_the_shell_is_told_words_that_fit(capsys, monkeypatch, words, offered):
    monkeypatch.setenv("_SLIPMAP_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", f"slipmap {words}")
    monkeypatch.setenv("COMP_CWORD", str(len(words.split())))
    with pytest.raises(SystemExit) as ended:
        run([])
    assert ended.value.code == 0
    assert capsys.readouterr().out.split() == [f"plain,{word}" for word in offered]


def test_an_object_off_the_table_is_told_with_the_scenario_it_stands_in(slipmap, tmp_path):
    scenario = tmp_path / "cell.yaml"
    scenario.write_text("object: {pose: [0.4, 0.0, 0.0]}")
    refused = slipmap("explore", "--scenario", scenario, "--output", tmp_path / "run")
    assert_refused(refused, f"{scenario}: object.pose", "does not lie on the table")
    assert files_in(tmp_path) == ["cell.yaml"]


def fail_with(monkeypatch, error):
    def failing(*args, **kwargs):
        raise error

    monkeypatch.setattr("slipmap.models.inference.identification.identify", failing)


def test_an_import_broken_off_by_ctrl_c_is_no_failure(slipmap, tilted_folder, tmp_path, monkeypatch):
    error = ImportError("initialization failed")
    error.__cause__ = KeyboardInterrupt()
    fail_with(monkeypatch, error)
    said = slipmap("identify", tilted_folder, "-o", tmp_path / "b.npz")
    assert said.code == 130
    assert "stopped" in said.err and "internal" not in said.err


def test_an_internal_failure_is_told_as_such(slipmap, tilted_folder, tmp_path, monkeypatch):
    fail_with(monkeypatch, ArithmeticError("a step did not\nconverge"))
    arguments = ["identify", tilted_folder, "-o", tmp_path / "b.npz"]
    said = slipmap(*arguments)
    assert said.code == 1
    assert "internal failure, ArithmeticError" in said.err and "a step did not converge" in said.err
    assert "Traceback" not in said.err
    monkeypatch.setenv("SLIPMAP_TRACEBACK", "1")
    assert "Traceback" in slipmap(*arguments).err
    assert files_in(tmp_path) == []


def test_a_machine_that_cannot_render_is_no_internal_failure(slipmap, tilted_folder, tmp_path, monkeypatch):
    fail_with(monkeypatch, RendererUnavailable("no EGL; install libegl1"))  # as under explore-study
    assert_refused(slipmap("identify", tilted_folder, "-o", tmp_path / "b.npz"), "libegl1")


@pytest.mark.parametrize("arguments", [("--json",), ("--effect-file",), ("tether", "--picture")])
def test_a_name_that_is_too_long_is_no_internal_failure(slipmap, tmp_path, arguments):
    name = 300 * "n" + {"--json": ".json", "--effect-file": ".py"}.get(arguments[-1], ".png")
    assert_refused(slipmap("effects", *arguments, tmp_path / name), name, "is too long")
    assert_refused(slipmap("demo", "-o", tmp_path / name), name, "is too long")
    assert files_in(tmp_path) == []


def test_ctrl_c_leaves_nothing_behind(slipmap, tilted_folder, tmp_path, monkeypatch):
    fail_with(monkeypatch, KeyboardInterrupt())
    said = slipmap("identify", tilted_folder, "-o", tmp_path / "b.npz", "--json", tmp_path / "b.json")
    assert said.code == 130
    assert said.err.splitlines()[-1].startswith("slipmap: stopped")
    assert files_in(tmp_path) == []


LOADING = """
import sys
from slipmap.__main__ import main

class Interrupted:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name == "slipmap.diagrams.application.command_line":
            exec("raise KeyboardInterrupt")

sys.meta_path.insert(0, Interrupted)
main()
"""


def test_ctrl_c_while_the_commands_are_being_loaded(tmp_path):
    """Within `exec`, as while a module makes a dataclass; `python -m` then remembers to end by the signal."""
    (tmp_path / "loading.py").write_text(LOADING)
    command = [sys.executable, "-m", "loading"]
    done = subprocess.run(command, env=ENVIRONMENT, cwd=tmp_path, capture_output=True)
    assert (done.returncode, done.stderr) == (130, b"slipmap: stopped; nothing half-written is left behind\n")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_real_interrupt_ends_with_130(tmp_path, number):
    command = [sys.executable, "-m", "slipmap", "demo", "-o", str(tmp_path / "demo")]
    with subprocess.Popen(
        command,
        env=ENVIRONMENT,
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=hear_ctrl_c,
    ) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if line.startswith("fitting"):
                process.send_signal(number)
                break
        rest = process.stderr.read()
        assert process.wait(timeout=60) == 130
    assert "Traceback" not in rest
    assert rest.splitlines()[-1].startswith("slipmap: stopped")
    assert not (tmp_path / "demo" / "belief.npz").exists()
    assert all(name.startswith("demo/pushes/") for name in files_in(tmp_path))


def test_a_suggested_command_quotes_its_paths(slipmap, tmp_path):
    folder = tmp_path / "two words"
    folder.mkdir()
    (folder / "dataset.yaml").touch()
    said = slipmap("example", "-o", folder)
    assert said.code == 2 and f"`slipmap identify '{folder}' -o belief.npz`" in " ".join(said.err.split())
