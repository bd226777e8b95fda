"""docs/effects.md is what the code says, and its example works: residual, formula, falling error."""

from __future__ import annotations

import re

import numpy as np
import pytest
from effects_page import MAGNET, PAGE, page

from slipmap.models.effects import LIBRARY
from slipmap.models.effects.registry import load_effects
from slipmap.models.inference.identification import identify
from slipmap.models.measurements.simulated import record_pushes
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.rollout import Maps, Slider
from slipmap.planners.exploration import candidate_pushes

TRUE = (0.6, 0.06, -0.04)


def test_the_page_is_up_to_date():
    assert PAGE.read_text(encoding="utf-8") == page(), "run python tests/diagrams/application/effects_page.py"


def test_the_page_holds_every_effect_and_parameter():
    text = PAGE.read_text(encoding="utf-8")
    for effect in LIBRARY:
        (section,) = re.findall(rf"^## {effect.name}\n(.*?)^## ", text, flags=re.M | re.S)
        assert effect.sentence in section
        assert section.count("$$") >= 2
        assert all(f"`{parameter.name}`" in section for parameter in effect.parameters)


@pytest.fixture(scope="module")
def recorded():
    """Pushes of a block over a table with the magnet of the example under it."""
    (magnet,) = load_effects(MAGNET)
    grid = cells_from_polygon(np.array([[-4, -3], [4, -3], [4, 3], [-4, 3]]) * 0.01, width=0.02)
    rng, n = np.random.default_rng(3), len(grid)
    maps = Maps(np.full((1, n), 0.5 / n), np.full((1, n), 0.3), np.array([0.35]), np.array([TRUE]))
    candidates = candidate_pushes(grid, 0.006, rng, 12, length=(0.06, 0.09))
    pushes = [c.push([*rng.uniform(-0.1, 0.1, 2), rng.uniform(-3, 3)], h=4e-3) for c in candidates]
    return record_pushes(Slider(grid, 0.006, effects=[magnet]), maps, pushes, rng, heldout=4, mass=0.5)


def test_the_magnet_is_found_in_pushes_over_it(recorded):
    """The error on pushes held out falls to the noise, and strength and place come out right."""
    (magnet,) = load_effects(MAGNET)
    without = identify(recorded, hypotheses=2, friction_laws=False)
    found = identify(recorded, [magnet], hypotheses=2, friction_laws=False)
    before, after = (result.errors("heldout").mean() for result in (without, found))
    assert before > 2e-3
    assert after < 0.35 * before
    values = found.belief.maps.effects[0]
    assert values[0] == pytest.approx(TRUE[0], rel=0.15)
    assert values[1:] == pytest.approx(TRUE[1:], abs=0.01)


def test_the_fan_of_the_page_on_python_is_an_effect(tmp_path):
    text = (PAGE.parent / "python.md").read_text(encoding="utf-8")
    (code,) = (code for code in re.findall(r"```py\n(.*?)```", text, flags=re.S) if "class Fan" in code)
    file = tmp_path / "fan.py"
    file.write_text("from slipmap.models.effects import Effect, Parameter\n\n\n" + code)
    (fan,) = load_effects(file)
    assert fan.name == "fan"
