"""What `slipmap diagnose` and `slipmap fit` do with effects, and refuse."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from hidden_effects import tilted_pushes
from report_page import Page

from slipmap.models.effects.registry import effects_named
from slipmap.models.inference.diagnosis.procedure import diagnose
from slipmap.models.measurements import write_dataset

ENDINGS = {"predict": "out.png", "fit": "out.npz"}
EFFECTS = effects_named(["table_tilt", "sensor_latency"])

OWN_EFFECT = """
from slipmap.models.effects import Effect, Parameter


class Fan(Effect):
    name = "fan"
    sentence = "A fan blows along the table."
    parameters = (
        Parameter("blow_x", "1", "share of the weight along x", -0.4, 0.4, 0.03, 0.0),
        Parameter("blow_y", "1", "share of the weight along y", -0.4, 0.4, 0.03, 0.0),
    )

    def force(self, body, p):
        fx, fy = body.weight * p.blow_x, body.weight * p.blow_y
        return fx, fy, body.com_x * fy - body.com_y * fx
"""


@pytest.fixture
def own_effect(tmp_path):
    file = tmp_path / "fan.py"
    file.write_text(OWN_EFFECT)
    return file


def test_fit_and_predict_with_an_effect_of_ones_own(slipmap, tilted_folder, own_effect, tmp_path):
    belief, numbers = tmp_path / "b.npz", tmp_path / "b.json"
    said = slipmap(
        "fit", tilted_folder, "--effect", "fan", "--effect-file", own_effect, "-o", belief,
        "--hypotheses", 2, "--json", numbers,
    )  # fmt: skip
    assert said.code == 0, said.err
    document = json.loads(numbers.read_text())
    assert list(document["effects"]) == ["fan"] and len(document["hypotheses"]) == 2
    assert document["effects"]["fan"]["blow_y"]["value"] == pytest.approx(-0.04, abs=0.004)
    assert "fan: blow_x 0.0" in said.out and "fan: blow_y" in said.out
    said = slipmap("predict", tilted_folder, "--belief", belief, "-o", tmp_path / "p.png")
    assert said.code == 2 and "'fan'" in said.err and "--effect-file" in said.err
    assert "known=(*slipmap.LIBRARY" in said.err
    arguments = ("--belief", belief, "--effect-file", own_effect, "--json", numbers)
    said = slipmap("predict", tilted_folder, *arguments, "-o", tmp_path / "p.png")
    assert said.code == 0, said.err
    assert json.loads(numbers.read_text())["heldout_error_mean"] < 1e-3
    said = slipmap("compare", tilted_folder, *arguments, "-o", tmp_path / "c.html")
    assert said.code == 0, said.err
    assert json.loads(numbers.read_text())["totals"]["heldout"]["model"]["final_add"] < 1e-3


def test_compare_with_an_effect_shows_before_and_after(slipmap, tilted_folder, tmp_path):
    html, numbers = tmp_path / "c.html", tmp_path / "c.json"
    said = slipmap("compare", tilted_folder, "--effect", "table_tilt", "-o", html, "--json", numbers)
    assert said.code == 0, said.err
    document = json.loads(numbers.read_text())
    assert set(document) == {"before", "after", "effects"} and document["effects"] == ["table_tilt"]
    errors = [document[key]["totals"]["heldout"]["model"]["final_add"] for key in ("before", "after")]
    assert errors[1] < 0.2 * errors[0]
    assert "fit, without effects" in said.out and "fit, with table_tilt" in said.out
    assert max(map(len, said.out.splitlines())) <= 80
    assert json.loads(Page(html.read_text()).scripts[0][1])["pushes"]["labels"][1] == "with table_tilt"


def test_fit_weighs_the_effect_that_was_named_and_not_what_a_slope_brings(slipmap, tmp_path):
    few = tilted_pushes()
    folder = write_dataset(replace(few, trials=few.trials[:3], finger_height=0.004), tmp_path / "few")
    options = ("--effect", "table_tilt", "-o", tmp_path / "b.npz", "--hypotheses", 2)
    said = " ".join(slipmap("fit", folder, *options).out.split())
    assert "load_transfer is estimated together with the tilt" in said
    assert "without table_tilt, " in said and "times that without table_tilt (" in said


@pytest.mark.parametrize("command", ["fit", "compare"])
def test_a_slip_of_the_pen_in_a_name(slipmap, tilted_folder, tmp_path, command):
    output = tmp_path / ENDINGS.get(command, "out.html")
    said = slipmap(command, tilted_folder, "--effect", "table_titl", "-o", output)
    assert said.code == 2 and "did you mean table_tilt?" in said.err
    assert len(said.err.strip().splitlines()) == 1 and not output.exists()


@pytest.mark.parametrize("command", ["diagnose", "compare", "fit", "predict"])
@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("x = (", "line 1"),
        ("x = 1", "from slipmap import Effect"),
        ("import math\n" + OWN_EFFECT.replace("body.weight", "math.cos(body.weight)"), "use sympy.cos"),
        (OWN_EFFECT.replace("body.weight", "body.nothing"), "nothing"),
    ],
)
def test_a_faulty_effect_file_is_refused_before_any_work(
    slipmap, tilted_folder, tmp_path, command, text, problem
):
    file, output = tmp_path / "own.py", tmp_path / ENDINGS.get(command, "out.html")
    file.write_text(text)
    more = {"fit": ["--effect", "fan"], "predict": ["--belief", tmp_path / "b.npz"]}.get(command, [])
    said = slipmap(command, tilted_folder, "--effect-file", file, "-o", output, *more)
    assert said.code == 2 and problem in said.err and "own.py" in said.err
    assert "Traceback" not in said.err and len(said.err.strip().splitlines()) == 1
    assert not output.exists()


def test_wrong_use(slipmap, tilted_folder, belief, tmp_path):
    belief.save(tmp_path / "b.npz")
    said = slipmap("fit", tilted_folder, "-o", tmp_path / "o.npz")
    assert said.code == 2 and "--effect" in said.err
    said = slipmap("compare", tilted_folder, "--belief", tmp_path / "b.npz", "--effect", "table_tilt")
    assert said.code == 2 and "exclude each other" in said.err
    said = slipmap(
        "diagnose", tilted_folder, "--draws", 48
    )  # 1/99 is above the level: nothing could be found
    assert said.code == 2 and "--draws" in said.err
    said = slipmap("diagnose", tmp_path / "nowhere", "-o", tmp_path / "r.html")
    assert said.code == 2 and "nowhere" in said.err
    said = slipmap(
        "fit", tilted_folder, "--effect", "table_tilt", "--effect", "table_tilt", "-o", tmp_path / "o.npz"
    )
    assert said.code == 2 and "twice" in said.err
    assert not (tmp_path / "o.npz").exists()


def test_a_quick_look_leaves_a_report_only_where_asked(slipmap, tmp_path, monkeypatch):
    few = tilted_pushes()
    folder = write_dataset(replace(few, trials=few.trials[:3]), tmp_path / "few")
    monkeypatch.chdir(tmp_path)
    said = slipmap("diagnose", folder, "--quick")
    assert said.code == 0 and "ask for one with -o FILE" in said.err
    assert not list(tmp_path.glob("*.html"))
    said = slipmap("diagnose", folder, "--quick", "-o", "diagnosis.html")
    assert said.code == 0 and (tmp_path / "diagnosis.html").exists()


def test_it_is_counted_how_far_asking_every_effect_is():
    few = tilted_pushes()
    told: list[tuple[str, int, int]] = []
    diagnose(
        replace(few, trials=few.trials[:3]),
        effects=EFFECTS,
        quick=True,
        progress=lambda *now: told.append(now),
    )
    asked = [(done, total) for stage, done, total in told if stage == "screening effects"]
    parts = asked[0][1]
    assert parts > 5 and asked == [(done, parts) for done in range(parts + 1)]
