"""Files appear whole or not at all; progress in a log file; tables and remarks."""

from __future__ import annotations

import fcntl
import json
import os
import re
import struct
import subprocess
import sys
import termios
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import click
import numpy as np
import pytest
from scipy.stats import binomtest

from slipmap.diagrams.application import terminal as console
from slipmap.diagrams.application.commands.identify import _chosen, _Learning, show
from slipmap.diagrams.application.demonstration import tilted_block
from slipmap.diagrams.application.reports.comparison_words import surprises
from slipmap.diagrams.application.reports.tables import (
    doubts,
    is_doubted,
    named,
    remark,
    show_errors,
    shown,
)
from slipmap.diagrams.application.terminal import Progress, table
from slipmap.models.effects.registry import effects_named
from slipmap.models.files import BadInput, whole_file, write_json
from slipmap.models.inference.comparison import compare
from slipmap.models.inference.identification import identify
from slipmap.models.inference.results import Quantity
from slipmap.models.measurements import Noise
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.objects import cells_from_polygon
from slipmap.models.objects.benchmark_objects import hammer
from slipmap.models.physics.rollout import Slider
from slipmap.planners.exploration import candidate_pushes
from tests.made_predictions import made_prediction as prediction


def recorded_by(noise):
    """A dataset of a square, as far as its sensors go."""
    square = cells_from_polygon([[0, 0], [0.1, 0], [0.1, 0.1], [0, 0.1]], count=9)
    return SimpleNamespace(noise=noise, grid=square, trials=())


def test_json_knows_numpy_and_has_no_nan(tmp_path):
    document = {
        "b": np.float64(1.5),
        "a": np.array([[1, 2]]),
        "flag": np.bool_(True),
        "nan": float("nan"),
        "t": (np.inf, "µ"),
    }
    write_json(tmp_path / "x.json", document)
    text = (tmp_path / "x.json").read_text(encoding="utf-8")
    assert json.loads(text) == {"a": [[1, 2]], "b": 1.5, "flag": True, "nan": None, "t": [None, "µ"]}
    assert text.startswith('{\n  "a"') and text.endswith("}\n")


def test_the_longest_name_that_a_disk_takes_can_be_written(tmp_path):
    name = "a" * 250 + ".json"
    write_json(tmp_path / name, {})
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_failure_while_writing_leaves_the_old_file(tmp_path):
    target = tmp_path / "x.json"
    target.write_text("old")
    with pytest.raises(RuntimeError), whole_file(target) as part:
        part.write_text("new, half")
        raise RuntimeError
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_a_folder_that_vanished_is_bad_input(tmp_path):
    with pytest.raises(BadInput, match="gone"):
        write_json(tmp_path / "gone" / "x.json", {})


def test_progress_in_a_log_file_is_a_line_a_stage(capsys, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    with Progress() as progress:
        for done in range(5):
            progress("fitting", done, 4)
            now[0] += 10.0
        progress("drawing", 0, 1)
        now[0] += 1.0
    assert capsys.readouterr().err.splitlines() == [
        "fitting …",
        "fitting: 2 of 4, about 20 s left",
        "fitting: done in 50.0 s",
        "drawing …",
        "drawing: done in 1.0 s",
    ]


def test_progress_of_a_run_says_in_a_log_file_what_is_being_done_now_and_then(capsys, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    with Progress() as progress:
        for push in range(3):
            for _ in range(100):
                for doing in ("looking", "pushing"):
                    progress(f"exploring: {doing}", push, 3)
                    now[0] += 0.1
        progress("to the edge: planning", 0, 0)
        now[0] += 20.0
        progress("to the edge: push 1, pushing", 0, 0)
    assert capsys.readouterr().err.splitlines() == [
        "exploring …",
        "exploring: 0 of 3; pushing",
        "exploring: 1 of 3, about 40 s left; looking",
        "exploring: 1 of 3, about 25 s left; looking",
        "exploring: 2 of 3, about 20 s left; looking",
        "exploring: 2 of 3, about 5 s left; looking",
        "exploring: done in 60.0 s",
        "to the edge …",
        "to the edge: 20 s so far; push 1, pushing",
        "to the edge: done in 20.0 s",
    ]


def on_a_terminal(code: str, columns: int) -> list[str]:
    """Lines that code draws on a terminal, the last state of each."""
    ours, its = os.openpty()
    fcntl.ioctl(its, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    environment = {k: v for k, v in os.environ.items() if k not in ("COLUMNS", "NO_COLOR")}
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stderr=its, env={**environment, "TERM": "xterm"}) as process:
        os.close(its)
        drawn = b""
        with suppress(OSError):  # the terminal is gone when the process has ended
            while part := os.read(ours, 4096):
                drawn += part
    os.close(ours)
    assert process.returncode == 0
    return [line.rstrip() for line in re.split(r"[\r\n]+", re.sub(r"\x1b\[[\d;?]*\w", "", drawn.decode()))]


@pytest.mark.parametrize("columns", [80, 60])
def test_bars_on_a_terminal_have_one_line_each_and_tell_the_time_left(columns):
    lines = on_a_terminal(
        """if True:
        import time
        from slipmap.diagrams.application.terminal import Progress
        with Progress() as progress:
            for push in range(3):
                for doing in ("looking at the object", "pushing"):
                    progress(f"exploring: {doing}", push, 3)
                    time.sleep(0.15)
            progress("looking for patterns, with anisotropic_table and more", 999, 1000)
            progress("drawing", 0, 1)
            time.sleep(0.15)
        """,
        columns,
    )
    assert max(map(len, lines)) <= columns
    told = [" ".join(re.sub("[━╸╺]+", "", line).split()) for line in lines]
    assert "exploring: looking at the object 1/3 0:00:00 0:00:01 left" in told
    assert "exploring: pushing 0/3 0:00:00" in told  # nothing is known of the time yet
    assert told.count("exploring 3/3 0:00:00") > 0
    assert any(
        re.fullmatch("looking for patterns, with aniso[a-z_]*… 1000/1000 0:00:00", line) for line in told
    )
    assert "drawing 0:00:00" in told and not any(line.startswith("drawing 0/1") for line in told)


def test_progress_does_not_call_a_failed_stage_done(capsys):
    with pytest.raises(RuntimeError), Progress() as progress:
        progress("fitting", 0, 4)
        raise RuntimeError
    assert capsys.readouterr().err.splitlines() == ["fitting …"]


@pytest.mark.parametrize("width", [80, 60])
def test_tables_break_no_word_on_a_narrow_terminal(capsys, monkeypatch, width):
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    columns = ["pushes", "", "this belief", "uniform object", "object does not move"]
    table("Error", columns, [["4 held out", "median", "0.5", "64.9", "91.4"]], numbers=(2, 3, 4))
    lines = click.unstyle(capsys.readouterr().out).splitlines()
    assert max(map(len, lines)) <= width
    assert ["4", "held", "out", "median", "0.5", "64.9", "91.4"] in [line.split() for line in lines]
    assert {word for name in columns for word in name.split()} <= {
        word for line in lines for word in line.split()
    }


def test_a_push_near_to_balance_gets_a_remark():
    assert remark(prediction(start_sensitivity=9.9)) == ""
    assert remark(prediction(start_sensitivity=float("nan"))) == ""
    assert "0.5 mm at the start moves the end by 12 mm" in remark(prediction(start_sensitivity=24.0))
    assert "12 mm" in remark(prediction(start_sensitivity=24.0))


def test_error_table_averages_by_role_against_both_baselines(capsys):
    pushes = [
        prediction("trials/000.json", "fit", final_add=0.001, uniform_add=0.02, no_motion_add=0.03),
        prediction("trials/001.json", "fit", final_add=0.003, uniform_add=0.04, no_motion_add=0.09),
        prediction("trials/002.json", "heldout", final_add=0.0071, start_sensitivity=30.0),
    ]
    show_errors(pushes, recorded_by(Noise()), "pushes")
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["2", "fit", "mean", "2.0", "30.0", "60.0"] in lines
    assert ["1", "held", "out", "median", "7.1", "50.0", "100.0"] in lines
    assert ["000", "fit", "1.0", "2.0", "20.0", "30.0"] in lines


@pytest.mark.parametrize(("hypotheses", "warned"), [(3, True), (9, True), (10, False)])
def test_few_hypotheses_give_no_intervals_to_trust(monkeypatch, capsys, hypotheses, warned):
    monkeypatch.setattr("slipmap.diagrams.application.commands.identify.prepare_kernels", lambda: None)
    _Learning(Path("belief.npz"), hypotheses, 0, None, None, None, None).prepare()
    said = capsys.readouterr().err
    assert (f"warning: {hypotheses} hypotheses are too few for the 90 % intervals" in said) is warned
    assert ("give --hypotheses 10 or more" in said) is warned


def test_a_uniform_object_with_effects_is_not_taken_for_a_plain_one(capsys):
    held = [prediction(role="heldout")]
    show_errors(held, recorded_by(Noise()), "pushes")
    assert "uniform object has" not in capsys.readouterr().out
    show_errors(held, recorded_by(Noise()), "pushes", effects_named(["table_tilt", "tether"]))
    said = " ".join(capsys.readouterr().out.split())
    assert "mean distance of the cells; the uniform object has table_tilt, tether, too)" in said


@pytest.mark.parametrize(
    ("error", "noise", "said"),
    [
        (0.0035, Noise(), False),
        (0.0045, Noise(), True),
        (0.0045, Noise(position=2e-3, angle=0.0), False),
        (0.0085, Noise(position=2e-3, angle=0.0), True),
    ],
)
def test_errors_beyond_spread_and_noise_are_told(error, noise, said):
    """2 mm of spread, and where the sensors err by 2 mm each way, 2.5 mm (Rayleigh's mean) of noise."""
    held = [prediction(role="heldout", final_add=error) for _ in range(3)]
    found = doubts(held, recorded_by(noise))
    assert len(found) == said == is_doubted(held, recorded_by(noise))
    if said:
        assert "slipmap diagnose" in found[0]
    assert doubts(held[:2], recorded_by(noise)) == []


@pytest.mark.parametrize(("error", "said"), [(0.04, False), (0.1, True)])
def test_the_largest_model_error_that_is_tried_may_be_larger(belief, capsys, error, said):
    far_off = replace(belief, settings={"model_errors": [0.005, error]})
    result = SimpleNamespace(
        belief=far_off, pushes=[], seconds=1.0, friction_laws={}, share_of_known=None, quantities=()
    )
    dataset = SimpleNamespace(name="block", grid=belief.grid, trials=(), fit_trials=(), heldout_trials=())
    show(result, dataset, None)
    assert ("off by 10 % or more of the distance" in " ".join(capsys.readouterr().out.split())) == said


def identified_without_noise(dataset):
    """The dataset with its noise not declared, and the doubts about what was learned from it."""
    silent = replace(dataset, noise=Noise())
    return silent, identify(silent, hypotheses=6, friction_laws=False)


def test_errors_that_a_noisy_sensor_explains_are_no_doubt_though_it_does_not_declare_its_noise():
    grid, truth = hammer()
    rng = np.random.default_rng(1)
    tracker = Noise(position=2e-3, angle=6e-3, tip=5e-5, force=0.05)
    pushes = [
        one.push([0.0, 0.0, turn])
        for one, turn in zip(candidate_pushes(grid, 0.008, rng, 8), np.arange(8.0), strict=True)
    ]
    dataset = record_pushes(Slider(grid, 0.008), truth, pushes, rng, noise=tracker, heldout=4)
    silent, learned = identified_without_noise(dataset)
    assert not is_doubted(learned.pushes, silent)
    floor = compare(silent, learned).floor
    assert floor.source == "estimated noise"
    assert floor.add == pytest.approx(compare(dataset, learned).floor.add, rel=0.3)


def test_errors_of_a_wrong_model_are_told_though_no_noise_is_declared():
    silent, learned = identified_without_noise(tilted_block())
    said = doubts(learned.pushes, silent)[0]
    assert "the spread of the hypotheses and the sensors' noise, estimated from the poses, explain" in said


def test_noise_that_nobody_knows_is_not_said_to_explain_anything():
    held = [prediction(role="heldout", final_add=0.0045) for _ in range(3)]
    (said,) = doubts(held, recorded_by(Noise()))
    assert "what the spread of the hypotheses explains; the sensors' noise is not known" in said


def test_one_push_that_misses_by_more_than_its_interval_is_told(capsys):
    """A single held-out push is enough; what to do is told with the folder that the pushes are in."""
    usual = prediction("trials/000.json", "fit", excess=3.0)
    wrong = prediction("trials/001.json", "heldout", final_add=0.022, excess=10.0)
    show_errors([usual, wrong], recorded_by(Noise()), "demo/pushes")
    out = capsys.readouterr().out
    said = " ".join(out.split())
    assert "SURPRISING: push 001 ended 22.0 mm from its prediction" in said
    assert "95 % of such pushes should end within 2.2 mm" in said
    assert "`slipmap diagnose demo/pushes`" in said
    assert "SURPRISING: at most 2.2 mm expected" in remark(wrong)
    show_errors([usual, prediction(role="heldout")], recorded_by(Noise()), "demo/pushes")
    assert "diagnose" not in capsys.readouterr().out


def test_two_held_out_pushes_that_a_uniform_object_predicts_as_well_send_to_diagnose(capsys):
    """Ten pushes leave two to judge by: too few for a doubt, but no reason to be silent."""
    for uniform, told in ((0.0045, True), (0.0055, False)):
        held = [prediction(role="heldout", final_add=0.004, uniform_add=uniform) for _ in range(2)]
        show_errors(held, recorded_by(Noise()), "demo/pushes")
        said = " ".join(capsys.readouterr().out.split())
        assert ("end 4.0 mm off (a uniform object: 4.5 mm); they are too few" in said) == told
        assert ("`slipmap diagnose demo/pushes`" in said) == told


def test_as_many_surprises_as_chance_has_send_nobody_to_diagnose():
    usual = [prediction(f"trials/{k:03d}.json", "heldout") for k in range(29)]
    barely = prediction("trials/030.json", "heldout", final_add=0.004, excess=1.05)
    found = surprises([*usual, barely])
    assert not found.beyond_chance and "With a correct model, 2 of 30 pushes may" in found.text
    far = prediction("trials/030.json", "heldout", final_add=0.004, excess=2.0)
    assert surprises([*usual, far]).beyond_chance
    assert surprises([*usual[:10], *[barely] * 3]).beyond_chance
    assert surprises(usual).text == ""


def test_a_belief_no_better_than_a_uniform_object_is_told():
    held = [prediction(role="heldout", final_add=0.004, uniform_add=0.0045) for _ in range(3)]
    (said,) = doubts(held, recorded_by(Noise()))
    assert "4.5 mm; the belief 4.0 mm" in said
    better = [prediction(role="heldout", final_add=0.004, uniform_add=0.0055) for _ in range(3)]
    assert doubts(better, recorded_by(Noise())) == []


def test_many_pushes_are_cut_to_the_worst(capsys):
    pushes = [prediction(f"trials/{k:03d}.json", final_add=1e-3 * (k % 50)) for k in range(50)]
    show_errors(pushes, recorded_by(Noise()), "pushes")
    out = capsys.readouterr().out
    assert "30 worst of 50 pushes" in out
    rows = [line.split()[0] for line in out.splitlines() if " fit " in line and line[:3].isdigit()]
    assert rows == [f"{k:03d}" for k in range(49, 19, -1)]


@pytest.mark.parametrize(
    ("unit", "value", "low", "high", "texts"),
    [
        ("m", 0.0891234, 0.0888, 0.0895, ("89.12", "88.80 to 89.50")),
        ("kg", 164.2, 159.1, 170.4, ("164", "159 to 170")),
        ("-", 0.2981, 0.2931, 0.3039, ("0.298", "0.293 to 0.304")),
        ("m", 0.0941, 0.00152, 6.04, ("94", "1.5 to 6040")),
    ],
)
def test_numbers_have_the_digits_that_the_interval_supports(unit, value, low, high, texts):
    quantity = Quantity("thing", unit, value, low, high, True, "")
    assert shown(quantity, value) == texts
    assert named(quantity) == {"m": "thing, mm", "kg": "thing, kg", "-": "thing"}[unit]


def test_compiling_is_announced_once_where_kernels_are_new(tmp_path, capsys, monkeypatch):
    from slipmap.models.physics import compiled

    monkeypatch.setattr(compiled, "CACHE_FOLDER", tmp_path / "kernels")
    console.prepare_kernels()
    assert capsys.readouterr().err.startswith("Compiling the kernels for this machine, once")
    (tmp_path / "kernels" / "step.nbc").touch()
    console.prepare_kernels()
    assert capsys.readouterr().err == ""
    (tmp_path / "file").touch()
    monkeypatch.setattr(compiled, "CACHE_FOLDER", tmp_path / "file" / "kernels")
    with pytest.raises(BadInput, match="SLIPMAP_CACHE"):
        console.prepare_kernels()


def test_coverage_comes_with_its_range_and_verdict():
    from slipmap.diagrams.application.commands.studies import coverage_rows

    ranks = {"a": np.full(40, 0.5), "b": np.r_[np.full(20, 0.5), np.full(20, 0.999)], "c": np.full(400, 0.5)}
    result = SimpleNamespace(objects=40, ranks=ranks, coverage={"a": 1.0, "b": 0.5, "c": 1.0})
    a, b, c = coverage_rows(result)
    assert (a["inside"], a["of"], a["high"]) == (40, 40, 1.0)
    assert a["low"] == pytest.approx(0.025 ** (1 / 40))  # Clopper and Pearson, all inside
    assert (c["inside"], c["of"]) == (400, 400)
    assert c["low"] == pytest.approx(a["low"])  # ten pushes of one object are one draw
    low, high = binomtest(20, 40).proportion_ci(0.95, method="exact")
    assert (b["low"], b["high"]) == pytest.approx((low, high))
    assert [row["verdict"] for row in (a, b, c)] == ["too wide", "too narrow", "too wide"]


def test_of_many_pushes_a_dozen_that_judge_is_drawn_from_the_best_to_the_worst():
    few = [prediction(f"{k}") for k in range(48)]
    assert _chosen(few) is few
    many = [prediction(f"{k}", "heldout" if k % 2 else "fit", final_add=1e-3 * k) for k in range(100)]
    shown = [int(push.trial) for push in _chosen(many)]
    assert len(shown) == 12 and shown == sorted(shown) and all(k % 2 for k in shown)
    assert (shown[0], shown[-1]) == (1, 99)
