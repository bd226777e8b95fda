"""The whole way: a model is seen to fail, the effect that it misses is named and added, and errors fall."""

from __future__ import annotations

import json

import pytest
from report_page import assert_alone
from tilted_table import TILT


def test_from_a_model_that_fails_to_one_that_has_the_effect(slipmap, tilted_folder, tmp_path):
    def numbers(*arguments):
        file = tmp_path / "numbers.json"
        said = slipmap(*arguments, "--json", file)
        assert said.code == 0, said.err
        assert max(map(len, said.out.splitlines())) <= 80
        return said, json.loads(file.read_text())

    html = tmp_path / "report.html"
    _, before = numbers("compare", tilted_folder, "-o", html)
    error = before["totals"]["heldout"]["model"]["final_add"]
    assert error > 10 * before["noise_floor"]["add"]

    said, found = numbers("diagnose", tilted_folder, "--draws", 49, "-o", html)
    assert (found["verdict"], found["effect"], found["calibrated"]) == ("effect", "table_tilt", True)
    assert found["p_value"] == pytest.approx(1 / 50)
    for name, value in TILT.items():
        assert found["parameters"]["table_tilt"][name]["value"] == pytest.approx(value, abs=0.003)
    assert found["heldout_error_after"] < 0.2 * found["heldout_error_before"]
    assert found["next_push"]["sentence"] in " ".join(said.out.split())
    assert said.out.startswith("Verdict: effect. The data miss one effect: table_tilt.")
    assert "tilt 2.9" in said.out and "downhill towards -53" in said.out  # hypot 0.05 rad, atan2(-0.04, 0.03)
    assert "asking every effect: done" in said.err and f"report: {html}" in said.err
    page = assert_alone(html.read_text())
    assert page.text.index(found["sentence"]) < page.text.index("Locked pushes")
    assert page.rows == 18

    belief = tmp_path / "belief.npz"
    said, fitted = numbers("fit", tilted_folder, "--effect", "table_tilt", "-o", belief)
    assert "table_tilt: tilt 2.9" in said.out
    for name, value in TILT.items():
        told = fitted["effects"]["table_tilt"][name]
        assert told["low"] < told["value"] < told["high"] and told["pinned"] and told["unit"] == "rad"
        assert told["value"] == pytest.approx(value, abs=0.003)
    assert (tmp_path / "belief.maps.png").exists() and (tmp_path / "belief.pushes.png").exists()

    _, after = numbers("compare", tilted_folder, "--belief", belief, "-o", html)
    assert after["totals"]["heldout"]["model"]["final_add"] < 0.2 * error
    assert after["totals"]["heldout"]["model"]["final_add"] == pytest.approx(fitted["heldout_error_mean"])
