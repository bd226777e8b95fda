"""`slipmap view`: what is in the scene, the page it becomes, and that nothing stays behind."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import umsgpack
from browser import WINDOWS, assert_legible, colours
from matplotlib import image
from meshcat.servers.tree import find_node
from test_command_line import ENVIRONMENT, assert_refused, files_in, hear_ctrl_c

from slipmap.diagrams.application.figures import maps_figure
from slipmap.diagrams.application.figures.belief_scene import MOST, belief_scene, scale
from slipmap.diagrams.systems.belief_visualizer import MAPS, shown
from slipmap.models.physics.rollout import Maps

PACKED = {0x16: "<u4", 0x17: "<f4"}
SCENE = """(({labels, ...maps}) => labels.children.title ? Object.keys(maps) : null)(
    viewer.scene_tree.children.meshcat.children)"""
"""Names of what a page shows, once that is there."""
NAMESPACE = "http://www.w3.org/"


def drawn(scene: Any, path: str) -> tuple[dict[str, Any], np.ndarray]:
    """Geometry and transform (4, 4) of what lies at a path."""
    node = find_node(scene.window.tree, ["meshcat", *path.split("/")])
    geometry = umsgpack.unpackb(node.object)["object"]["geometries"][0] if node.object else {}
    place = umsgpack.unpackb(node.transform)["matrix"] if node.transform else np.eye(4)
    return geometry, np.reshape(place, (4, 4)).T


def corners(geometry: dict[str, Any], attribute: str = "position") -> np.ndarray:
    packed = geometry["data"]["attributes"][attribute]["array"]
    return np.frombuffer(packed.data, PACKED[packed.type]).reshape(-1, 3)


def tops(scene: Any, path: str, cells: int) -> np.ndarray:
    """(n,) heights of the prisms."""
    return corners(drawn(scene, path)[0]).reshape(cells, -1, 3)[:, :, 2].max(axis=1)


@pytest.mark.parametrize("which", range(len(MAPS)))
def test_prisms_are_as_high_as_their_values(belief, which):
    scene = belief_scene(belief)
    maps = belief.maps
    values = (maps.mass, maps.mu, maps.mass * maps.mu)[which]
    order = np.argsort(-belief.probability)
    wanted = [belief.probability @ values, *values[order]]
    names = ["mean", *(f"hypothesis {k}" for k in range(1, 5))]
    scale = set()
    for name, value in zip(names, wanted, strict=True):
        heights = tops(scene, f"{MAPS[which]}/{name}/cells", len(belief.grid))
        scale.add(round(float(np.ptp(heights / value) / np.mean(heights / value)), 4))
        scale.add(
            round(
                float(
                    heights[0] / value[0] / (tops(scene, f"{MAPS[which]}/mean/cells", 24)[0] / wanted[0][0])
                ),
                4,
            )
        )
    assert scale == {0.0, 1.0}, "one scale for all hypotheses of a map"


def test_the_pin_stands_on_the_centre_of_mass(belief):
    scene = belief_scene(belief)
    for name in MAPS:
        _, place = drawn(scene, f"{name}/hypothesis 1/center of mass/stem")
        assert np.allclose(place[:2, 3], belief.centers_of_mass[1], atol=1e-9)
        _, mean = drawn(scene, f"{name}/mean/center of mass/stem")
        total = belief.probability @ belief.maps.mass
        assert np.allclose(mean[:2, 3], total @ belief.grid.centers / total.sum(), atol=1e-9)


def test_scales_are_those_of_the_picture(belief):
    """Of friction alike, of mass and force but for the unit."""
    picture = maps_figure(belief, hypotheses=MOST)
    norms = [c.norm for axes in picture.axes for c in axes.collections if c.get_array() is not None][:3]
    ends = [norm.vmax * factor for norm, factor in zip(norms, (1.0, 1.0, 1e3), strict=True)]
    np.testing.assert_allclose(shown(belief, MOST).tops, ends)


@pytest.mark.parametrize("which", range(len(MAPS)))
def test_the_numbers_of_a_scale_end_inside_its_panel(belief, which):
    wide = replace(shown(belief, MOST), tops=np.array([0.5, 0.5, 0.5]))  # the first number is 0.00
    ink = image.imread(BytesIO(scale(wide, which, np.array([2.0, 1.0]))))[:, :, 3]
    assert ink[:, :4].max() == ink[:, -4:].max() == 0.0


def test_the_last_row_is_hardly_smaller_than_the_first(belief):
    scene = belief_scene(belief)
    camera = find_node(scene.window.tree, ["Cameras", "default", "rotated", "<object>"])
    (eye, near, far) = (
        next(
            umsgpack.unpackb(p)["value"] for p in camera.properties if umsgpack.unpackb(p)["property"] == name
        )
        for name in ("position", "near", "far")
    )
    _, whole = drawn(scene, "")
    away = []
    for which in MAPS:
        for name in ("mean", "hypothesis 4"):
            _, place = drawn(scene, f"{which}/{name}")
            x, y, z = place[:3, 3] + whole[:3, 3]
            away.append(np.linalg.norm(np.array([x, z, -y]) - eye))
    assert max(away) < 1.12 * min(away)
    assert near < 0.1 * min(away) and far > 1.5 * max(away)


def test_objects_do_not_overlap(belief):
    scene = belief_scene(belief)
    boxes = []
    for which in MAPS:
        for name in ("mean", "hypothesis 1", "hypothesis 2", "hypothesis 3", "hypothesis 4"):
            _, place = drawn(scene, f"{which}/{name}")
            points = corners(drawn(scene, f"{which}/{name}/cells")[0])[:, :2] + place[:2, 3]
            boxes.append((points.min(axis=0), points.max(axis=0)))
    for k, (low, high) in enumerate(boxes):
        for other_low, other_high in boxes[:k]:
            assert (other_low > high).any() or (other_high < low).any()


def test_many_hypotheses_are_cut_to_the_most_probable(belief):
    many = 3 * MOST
    some = np.arange(many) % 4
    maps = Maps(belief.maps.mass[some], belief.maps.mu[some], belief.maps.mu_finger[some])
    scene = belief_scene(replace(belief, maps=maps, probability=np.full(many, 1 / many)))
    shown = find_node(scene.window.tree, ["meshcat", "mass"])
    assert sorted(shown) == sorted(["mean", "scale", *(f"hypothesis {k}" for k in range(1, MOST + 1))])


def test_a_page_is_written_that_needs_no_network(slipmap, belief, tmp_path, monkeypatch):
    def refuse(*args: object, **kwargs: object) -> None:
        raise AssertionError("no process and no port is needed for a page")

    belief.save(tmp_path / "block.npz")
    monkeypatch.setattr(subprocess, "Popen", refuse)
    monkeypatch.setattr("socket.socket.bind", refuse, raising=False)
    said = slipmap("view", tmp_path / "block.npz", "--html", tmp_path / "block.html")
    assert said.code == 0 and said.out == ""
    assert "block.html" in said.err
    assert files_in(tmp_path) == ["block.html", "block.npz"]
    page = (tmp_path / "block.html").read_text()
    assert page.count('fetch("data:application/octet-binary;base64,') > 3 * 5 * 4
    assert not re.findall(r"<(?:script|link|img|iframe)[^>]*\b(?:src|href)=", page)
    assert {url for url in re.findall(r"(?:https?|wss?)://[\w.-]+/?", page)} <= {NAMESPACE}
    assert "viewer.connect()" not in page


def test_the_page_shows_the_scene_in_a_browser(belief, browser, tmp_path):
    page = tmp_path / "block.html"
    page.write_text(belief_scene(belief).static_html(), encoding="utf-8")
    seen = browser.opened(page, SCENE)
    assert_legible(seen, page)
    assert sorted(seen.answer) == sorted(MAPS)
    for width, height in WINDOWS.items():
        assert seen.shown[width].canvas == [width, height]
        assert colours(seen.pictures[width]) > 200, "prisms and scales are drawn"


def test_bad_input_is_refused_and_nothing_is_written(slipmap, belief, tmp_path):
    belief.save(tmp_path / "block.npz")
    whole = (tmp_path / "block.npz").read_bytes()
    (tmp_path / "bad.npz").write_bytes(whole[:-300])
    page = tmp_path / "page.html"
    assert_refused(slipmap("view", tmp_path / "bad.npz", "--html", page), "bad.npz")
    assert_refused(slipmap("view", tmp_path / "no.npz", "--html", page), "no.npz")
    assert_refused(slipmap("view", tmp_path / "block.npz", "--html", tmp_path / "page.png"), "page.png")
    assert_refused(
        slipmap("view", tmp_path / "block.npz", "--html", tmp_path / "no" / "p.html"), "does not exist"
    )
    assert files_in(tmp_path) == ["bad.npz", "block.npz"]


@pytest.mark.parametrize(("end", "code"), [("enter", 0), ("interrupt", 130)])
def test_the_page_is_served_until_it_is_ended(belief, tmp_path: Path, end: str, code: int):
    belief.save(tmp_path / "block.npz")
    command = [sys.executable, "-m", "slipmap", "view", str(tmp_path / "block.npz")]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(
        command, env=ENVIRONMENT, text=True, start_new_session=True, preexec_fn=hear_ctrl_c, **pipes
    ) as process:
        assert process.stdin is not None and process.stderr is not None
        (address,) = re.findall(r"http://localhost:\d+/", process.stderr.readline())
        with urllib.request.urlopen(address, timeout=10) as answer:
            assert "MeshCat" in answer.read().decode()
        elsewhere = urllib.request.Request(address, headers={"Host": "elsewhere.example"})
        with pytest.raises(urllib.error.HTTPError, match="421"):
            urllib.request.urlopen(elsewhere, timeout=10)
        assert process.poll() is None
        if end == "enter":
            process.stdin.write("\n")
            process.stdin.flush()
        else:
            process.send_signal(signal.SIGINT)
        assert process.wait(timeout=30) == code
        assert "Traceback" not in process.stderr.read()
    with pytest.raises(ProcessLookupError):
        os.killpg(process.pid, 0)
