"""`slipmap effects`: the list, one effect explained, effects from files, and the picture."""

from __future__ import annotations

import json

import pytest
from matplotlib.image import imread

from slipmap.models.effects import LIBRARY

OWN = """\
from slipmap.models.effects import Effect, Parameter


class Fan(Effect):
    name = "fan"
    sentence = "A fan blows along x."
    parameters = (Parameter("thrust", "N", "of the air", -5.0, 5.0, 0.2, 0.0),)

    def force(self, body, p):
        return p.thrust, 0, -body.com_y * p.thrust
"""


def test_the_list_holds_every_effect_within_80_columns(slipmap, tmp_path):
    said = slipmap("effects", "--json", tmp_path / "effects.json")
    assert said.code == 0
    told = json.loads((tmp_path / "effects.json").read_text())
    assert [effect["name"] for effect in told["effects"]] == [effect.name for effect in LIBRARY]
    for effect in LIBRARY:
        assert effect.name in said.out
        assert effect.sentence.split()[-1] in said.out
    assert max(map(len, said.out.splitlines())) <= 80


@pytest.mark.parametrize("effect", LIBRARY, ids=lambda effect: effect.name)
def test_one_effect_is_explained_within_80_columns(slipmap, effect, tmp_path):
    said = slipmap("effects", effect.name, "--json", tmp_path / "effect.json")
    assert said.code == 0
    assert max(map(len, said.out.splitlines())) <= 80
    for parameter in effect.parameters:
        assert parameter.unit in said.out
        assert parameter.meaning.split()[0] in said.out
    assert " = " in said.out


def test_an_effect_of_ones_own_is_explained_and_drawn(slipmap, tmp_path):
    file, picture, document = tmp_path / "fan.py", tmp_path / "fan.png", tmp_path / "fan.json"
    file.write_text(OWN)
    said = slipmap("effects", "fan", "--effect-file", file, "--picture", picture, "--json", document)
    assert said.code == 0, said.err
    assert "F_x = thrust" in said.out
    assert "at its centre of mass, which gives its torque about the origin:" in " ".join(said.out.split())
    image = imread(picture)
    assert image.shape[1] > 1000
    assert image[..., :3].std() > 0.05
    told = json.loads(document.read_text())
    assert told["name"] == "fan"
    assert told["formulas"][0]["latex"] == r"F_{x} = \mathrm{thrust}"
    assert told["parameters"][0]["unit"] == "N"
    assert "fan" in slipmap("effects", "--effect-file", file).out


def test_mistakes_are_told(slipmap, tmp_path):
    said = slipmap("effects", "tehter")
    assert said.code == 2
    assert "did you mean tether?" in said.err
    assert slipmap("effects", "--picture", tmp_path / "all.png").code == 2
    assert not list(tmp_path.iterdir())
    broken = tmp_path / "broken.py"
    broken.write_text(OWN.replace('"N"', '"kilopond"'))
    said = slipmap("effects", "fan", "--effect-file", broken)
    assert said.code == 2
    assert "broken.py, line 4" in said.err
