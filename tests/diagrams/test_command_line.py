"""The command line as a user meets it: help, exit codes, messages, files."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import planners
from diagrams.command_line import slipmap as group
from models.inference.belief import Belief
from models.measurements import read_dataset

COMMANDS = ("demo", "identify", "predict", "compare", "calibrate", "blind-test", "bench")
HEAVY = ("numpy", "scipy", "numba", "matplotlib", "pydrake", "shapely", "cv2", "rich")


def hear_ctrl_c() -> None:
    """For a child process: where the tests run in the background, it would inherit that SIGINT is ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])}


def assert_refused(said, *named):
    """Exit code 2 and one paragraph that names all of `named`."""
    assert said.code == 2
    assert said.out == ""
    *remarks, message = said.err.strip().split("\n")
    assert all(remark.endswith(("…", " s")) for remark in remarks), said.err  # progress before the failure
    assert message.startswith("slipmap: ")
    assert "Traceback" not in said.err
    for name in named:
        assert str(name) in message


def files_in(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def test_help_lists_every_command_with_a_sentence(slipmap):
    said = slipmap("--help")
    assert said.code == 0 and said.err == ""
    for name in COMMANDS:
        (line,) = [line for line in said.out.splitlines() if line.strip().startswith(name + " ")]
        assert len(line.split()) >= 6
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
        "import sys; from diagrams.command_line import run; code = run(['--help']);"
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
    ],
)
def test_wrong_options_are_named_with_a_way_to_help(slipmap, tmp_path, monkeypatch, arguments, named):
    monkeypatch.chdir(tmp_path)
    assert_refused(slipmap(*arguments), named, f"See `slipmap {arguments[0]} --help`.")
    assert files_in(tmp_path) == []


def test_a_missing_dataset_is_named(slipmap, tmp_path):
    said = slipmap("identify", tmp_path / "nowhere", "-o", tmp_path / "belief.npz")
    assert_refused(said, "nowhere", "there is no such file or folder")
    assert files_in(tmp_path) == []


def test_a_broken_trial_is_named_and_nothing_is_written(slipmap, demo_folder, tmp_path):
    dataset = tmp_path / "hammer"
    (dataset / "trials").mkdir(parents=True)
    for name in files_in(demo_folder / "demo" / "pushes"):
        (dataset / name).write_bytes((demo_folder / "demo" / "pushes" / name).read_bytes())
    broken = dataset / "trials" / "001.json"
    broken.write_text(broken.read_text()[:-40])
    before = files_in(tmp_path)
    said = slipmap("identify", dataset, "-o", tmp_path / "belief.npz", "--json", tmp_path / "result.json")
    assert_refused(said, broken, "not valid JSON")
    assert files_in(tmp_path) == before


def test_more_fit_pushes_than_there_are_are_refused(slipmap, demo_folder, tmp_path):
    said = slipmap("identify", demo_folder / "demo" / "pushes", "-o", tmp_path / "b.npz", "--fit-pushes", 9)
    assert_refused(said, "--fit-pushes 9", "3 pushes")


def test_outputs_are_checked_before_any_work(slipmap, demo_folder, tmp_path):
    """Most of these datasets do not exist; it is the output that is complained of."""
    missing = tmp_path / "missing"
    for arguments in (
        ["-o", missing / "belief.npz"],
        ["-o", tmp_path / "belief.npz", "--json", missing / "result.json"],
    ):
        assert_refused(slipmap("identify", tmp_path / "data", *arguments), f"{missing}", "does not exist")
    assert_refused(slipmap("identify", tmp_path / "data", "-o", tmp_path), tmp_path, "is a folder")
    said = slipmap("predict", "data", "--belief", "b.npz", "-o", tmp_path / "picture.txt")
    assert_refused(said, "picture.txt", ".png")
    (tmp_path / "file").write_text("in the way")
    said = slipmap(
        "identify",
        demo_folder / "demo" / "pushes",
        "-o",
        tmp_path / "b.npz",
        "--pictures",
        tmp_path / "file" / "sub",
    )
    assert_refused(said, tmp_path / "file")
    assert_refused(slipmap("demo", "-o", tmp_path / "file"), tmp_path / "file")
    assert files_in(tmp_path) == ["file"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_write_permission_is_refused(slipmap, tmp_path):
    tmp_path.chmod(0o500)
    assert_refused(slipmap("identify", tmp_path / "data", "-o", tmp_path / "belief.npz"), tmp_path)


def test_beliefs_that_are_none_are_refused(slipmap, demo_folder, tmp_path):
    hammer = demo_folder / "demo" / "pushes"
    assert_refused(
        slipmap("predict", hammer, "--belief", tmp_path / "no.npz", "-o", tmp_path / "p.png"), "no.npz"
    )
    for content in (b"", b"not a belief", (demo_folder / "demo" / "belief.npz").read_bytes()[:-500]):
        (tmp_path / "bad.npz").write_bytes(content)
        assert_refused(
            slipmap("predict", hammer, "--belief", tmp_path / "bad.npz", "-o", tmp_path / "p.png"), "bad.npz"
        )
    np.savez(tmp_path / "bad.npz", a=np.zeros(3))
    assert_refused(
        slipmap("predict", hammer, "--belief", tmp_path / "bad.npz", "-o", tmp_path / "p.png"), "bad.npz"
    )
    assert not (tmp_path / "p.png").exists()


def test_a_belief_about_another_object_is_refused(slipmap, demo_folder, belief, tmp_path):
    belief.save(tmp_path / "block.npz")
    hammer = demo_folder / "demo" / "pushes"
    said = slipmap("predict", hammer, "--belief", tmp_path / "block.npz", "-o", tmp_path / "p.png")
    assert_refused(said, "belief", "hammer")


def test_demo_leaves_a_dataset_a_belief_pictures_and_json(demo_folder):
    assert files_in(demo_folder) == [
        "demo.json",
        "demo/belief.maps.png",
        "demo/belief.npz",
        "demo/belief.pushes.png",
        "demo/pushes/dataset.yaml",
        *[f"demo/pushes/trials/{k:03d}.json" for k in range(4)],
    ]
    dataset = read_dataset(demo_folder / "demo" / "pushes")
    assert (len(dataset.fit_trials), len(dataset.heldout_trials)) == (3, 1)
    learnt = Belief.load(demo_folder / "demo" / "belief.npz")
    assert (learnt.fingerprint, len(learnt)) == (dataset.fingerprint, 20)


def test_demo_pictures_show_something(demo_folder):
    for name in ("maps", "pushes"):
        picture = cv2.imread(str(demo_folder / "demo" / f"belief.{name}.png"))
        assert min(picture.shape[:2]) > 500
        ink = (picture.min(axis=2) < 200).mean()
        assert 0.01 < ink < 0.6
        colours = np.ptp(picture.astype(int), axis=2)
        assert (colours > 60).mean() > 0.001


def test_json_of_the_demo(demo_folder):
    text = (demo_folder / "demo.json").read_text()
    result = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert text == json.dumps(result, indent=2, sort_keys=True, ensure_ascii=False) + "\n"
    assert {
        "fit_error_mean",
        "heldout_error_mean",
        "trials",
        "hypotheses",
        "identifiable",
        "seed",
        "truth",
    } <= set(result)
    assert [trial["role"] for trial in result["trials"]] == ["fit"] * 3 + ["heldout"]
    assert sum(hypothesis["probability"] for hypothesis in result["hypotheses"]) == pytest.approx(1)
    assert result["fit_error_mean"] < 0.1 * np.mean([trial["no_motion_add"] for trial in result["trials"]])


def test_demo_compares_with_the_truth_of_the_hammer(demo_folder):
    truth = {entry["name"]: entry for entry in json.loads((demo_folder / "demo.json").read_text())["truth"]}
    steel, wood = 7850 * 0.1 * 0.0375 * 0.025, 700 * 0.025 * 0.225 * 0.02
    assert truth["total mass"]["truth"] == pytest.approx(steel + wood)
    assert truth["total friction"]["truth"] == pytest.approx((0.2 * steel + 0.4 * wood) * 9.81)
    # The head's middle lies at 131.25 - 18.75 mm, the handle's at -131.25 + 112.5 mm.
    middle = (steel * 0.1125 + wood * -0.01875) / (steel + wood)
    assert truth["centre of mass, y"]["truth"] == pytest.approx(middle)
    middle = (0.2 * steel * 0.1125 + 0.4 * wood * -0.01875) / (0.2 * steel + 0.4 * wood)
    assert truth["centre of friction, y"]["truth"] == pytest.approx(middle)
    assert truth["centre of friction, x"]["truth"] == pytest.approx(0, abs=1e-9)
    assert set(truth) >= {"centre of mass, x", "finger friction"}
    for entry in truth.values():
        assert entry["inside"] is (entry["low"] <= entry["truth"] <= entry["high"])


def test_identify_then_predict(slipmap, demo_folder, tmp_path):
    hammer, pictures = demo_folder / "demo" / "pushes", tmp_path / "pictures"
    said = slipmap(
        "identify", hammer, "-o", tmp_path / "one.npz", "--fit-pushes", 1, "--hypotheses", 3,
        "--pictures", pictures, "--json", tmp_path / "one.json",
    )  # fmt: skip
    assert said.code == 0
    assert files_in(tmp_path) == ["one.json", "one.npz", "pictures/one.maps.png", "pictures/one.pushes.png"]
    assert max(map(len, said.out.splitlines())) <= 80
    assert "object does not move" in said.out and "90 % interval" in said.out
    assert str(tmp_path / "one.npz") in said.err
    result = json.loads((tmp_path / "one.json").read_text())
    assert len(result["trials"]) == 2 and len(result["hypotheses"]) == 3

    said = slipmap(
        "predict",
        hammer,
        "--belief",
        tmp_path / "one.npz",
        "-o",
        tmp_path / "p.svg",
        "--json",
        tmp_path / "p.json",
    )
    assert said.code == 0
    assert "<svg" in (tmp_path / "p.svg").read_text()[:1000]
    prediction = json.loads((tmp_path / "p.json").read_text())
    assert [trial["trial"] for trial in prediction["trials"]] == [f"trials/{k:03d}.json" for k in range(4)]
    by_name = {trial["trial"]: trial for trial in result["trials"]}
    for trial in prediction["trials"]:
        assert np.shape(trial["predicted_end_hypotheses"]) == (3, 3)
        mean = np.array(prediction["probability"]) @ np.array(trial["predicted_end_hypotheses"])
        np.testing.assert_allclose(mean, trial["predicted_end"])
        if trial["trial"] in by_name:
            assert trial["final_add"] == pytest.approx(by_name[trial["trial"]]["final_add"])


def test_demo_does_not_overwrite_what_it_did_not_make(slipmap, tmp_path):
    (tmp_path / "pushes").mkdir()
    (tmp_path / "pushes" / "thesis.txt").write_text("years of work")
    assert_refused(slipmap("demo", "-o", tmp_path), tmp_path / "pushes", "no push dataset")
    assert files_in(tmp_path) == ["pushes/thesis.txt"]


def test_calibrate_prints_draws_and_writes_coverage(slipmap, tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    ranks = {"centre of mass, x": rng.uniform(size=25), "total friction": np.full(25, 0.99)}

    def calibrate(*, objects, seed, progress):
        progress("objects", objects, objects)
        coverage = {"centre of mass, x": 0.88, "total friction": 0.0}
        return SimpleNamespace(objects=objects, seed=seed, seconds=1.0, coverage=coverage, ranks=ranks)

    monkeypatch.setattr(planners, "calibration", SimpleNamespace(calibrate=calibrate), raising=False)
    picture, result = tmp_path / "curves.png", tmp_path / "c.json"
    said = slipmap("calibrate", "--objects", 25, "--seed", 3, "-o", picture, "--json", result)
    assert said.code == 0
    rows = [line.split() for line in said.out.splitlines()]
    assert ["total", "friction", "0", "25", "0%", "0%", "to", "14%", "too", "narrow"] in rows
    document = json.loads(result.read_text())
    assert (document["objects"], document["seed"], document["coverage"][0]["inside"]) == (25, 3, 22)
    np.testing.assert_allclose(document["ranks"]["centre of mass, x"], ranks["centre of mass, x"])
    assert cv2.imread(str(picture)).std() > 5


def test_bench_prints_the_table_and_writes_the_numbers(slipmap, tmp_path, monkeypatch):
    def run_benchmark(*, progress):
        progress("rollouts", 1, 1)
        return {"ms": 0.25}

    monkeypatch.setattr("diagrams.benchmark.run_benchmark", run_benchmark)
    monkeypatch.setattr("diagrams.benchmark.format_table", lambda result: f"{result['ms']} ms a rollout")
    said = slipmap("bench", "--json", tmp_path / "bench.json")
    assert (said.code, said.out) == (0, "0.25 ms a rollout\n")
    assert json.loads((tmp_path / "bench.json").read_text()) == {"ms": 0.25}


def fail_with(monkeypatch, error):
    def failing(*args, **kwargs):
        raise error

    monkeypatch.setattr("models.inference.identification.identify", failing)


def test_an_internal_failure_is_told_as_such(slipmap, demo_folder, tmp_path, monkeypatch):
    fail_with(monkeypatch, ArithmeticError("a step did not\nconverge"))
    arguments = ["identify", demo_folder / "demo" / "pushes", "-o", tmp_path / "b.npz"]
    said = slipmap(*arguments)
    assert said.code == 1
    assert "internal failure, ArithmeticError" in said.err and "a step did not converge" in said.err
    assert "Traceback" not in said.err
    monkeypatch.setenv("SLIPMAP_TRACEBACK", "1")
    assert "Traceback" in slipmap(*arguments).err
    assert files_in(tmp_path) == []


def test_ctrl_c_leaves_nothing_behind(slipmap, demo_folder, tmp_path, monkeypatch):
    fail_with(monkeypatch, KeyboardInterrupt())
    said = slipmap(
        "identify", demo_folder / "demo" / "pushes", "-o", tmp_path / "b.npz", "--json", tmp_path / "b.json"
    )
    assert said.code == 130
    assert said.err.splitlines()[-1].startswith("slipmap: stopped")
    assert files_in(tmp_path) == []


def test_a_real_interrupt_ends_with_130(tmp_path):
    command = [sys.executable, "-m", "diagrams.command_line", "demo", "-o", str(tmp_path / "demo")]
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
                process.send_signal(signal.SIGINT)
                break
        rest = process.stderr.read()
        assert process.wait(timeout=60) == 130
    assert "Traceback" not in rest
    assert rest.splitlines()[-1].startswith("slipmap: stopped")
    assert not (tmp_path / "demo" / "belief.npz").exists()
    assert all(name.startswith("demo/pushes/") for name in files_in(tmp_path))
