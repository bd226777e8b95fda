"""What the visualizer puts into Meshcat, and what a recording keeps of it."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib import colormaps, image
from moving_blocks import Player, block, block_belief, seen
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder

from slipmap.diagrams.systems.belief_visualizer import (
    BOARD,
    HYPOTHESIS,
    MAP,
    MAPS,
    VIEW,
    BeliefVisualizer,
    legend,
    shown,
)
from slipmap.diagrams.systems.look import MAP_COLORS
from slipmap.diagrams.systems.model_monitor import Judged, Watch
from slipmap.diagrams.systems.notice import NOTICE
from slipmap.diagrams.systems.unlit_meshes import tiles
from slipmap.models.inference.belief import Belief
from slipmap.models.physics.rollout import Maps
from slipmap.planners.table_push import TablePush

FIRST = block_belief(4)
SECOND = replace(FIRST, maps=Maps(FIRST.maps.mass[:, ::-1], FIRST.maps.mu, FIRST.maps.mu_finger))
PUSHES = [
    TablePush(np.array([-0.2, 0.0]), np.array([-0.1, 0.0]), 0.05),
    TablePush(np.zeros(2), np.ones(2), 0.05),
]
AHEAD = np.array([0.004, -0.003, 0.02])
CHANGE = 0.45
"""s at which the belief changes."""
LOOKED = 0.25
"""s at which the object's height gets known."""


def belief_at(time: float) -> Belief | None:
    return None if time < 0.15 else (FIRST if time < CHANGE else SECOND)


def observed_at(time: float) -> Any:
    return seen(np.array([0.1 * time, 0.0, time]))


def seen_object_at(time: float) -> Any:
    return None if time < LOOKED else SimpleNamespace(cell_heights=np.array([0.012, 0.031, 0.02]))


def watch_at(time: float) -> Any:
    usual = Judged(5, 1.0, 0.5, 1.0, False, 2e-3, 5e-3, False)
    off = Judged(6, 9.0, 1e-6, 40.0, True, 22e-3, 2e-3, True)
    judged = () if time < 0.35 else (usual,) if time < 0.55 else (usual, off) if time < 0.75 else (off, usual)
    return Watch(len(judged), np.zeros(3), judged)


def predicted_at(time: float) -> np.ndarray:
    return np.full(3, np.nan) if time < 0.3 else observed_at(time).pose + AHEAD


class Recorder:
    """A Meshcat, and all that was set in it."""

    def __init__(self, meshcat: Meshcat) -> None:
        self.meshcat = meshcat
        self.properties: list[tuple[str, str, Any, float | None]] = []
        self.transforms: list[tuple[str, Any, float | None]] = []

    def SetProperty(self, path: str, name: str, value: Any, time: float | None = None) -> None:
        self.properties.append((path, name, value, time))
        self.meshcat.SetProperty(path, name, value, time)

    def SetTransform(self, path: str, pose: Any, time: float | None = None) -> None:
        self.transforms.append((path, pose, time))
        self.meshcat.SetTransform(path, pose, time)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.meshcat, name)

    def visible(self) -> set[str]:
        """Paths that were made visible last."""
        last = {path: value for path, name, value, _ in self.properties if name == "visible"}
        return {path.removeprefix("/belief/") for path, value in last.items() if value}


@pytest.fixture(scope="module")
def drawn() -> Iterator[tuple[Recorder, Diagram]]:
    recorder = Recorder(Meshcat())
    builder = DiagramBuilder()
    player = builder.AddSystem(
        Player(
            {"predicted_pose": (3, predicted_at)},
            {
                "belief": belief_at,
                "object_pose": observed_at,
                "push": lambda t: PUSHES[int(t > CHANGE)],
                "seen_object": seen_object_at,
                "watch": watch_at,
            },
        )
    )
    visualizer = BeliefVisualizer(recorder, period=0.1)  # type: ignore[arg-type]
    builder.AddNamedSystem("belief_visualizer", visualizer)
    for port in ("belief", "object_pose", "predicted_pose", "push", "seen_object", "watch"):
        builder.Connect(player.GetOutputPort(port), visualizer.GetInputPort(port))
    yield recorder, builder.Build()


@pytest.fixture
def played(drawn: tuple[Recorder, Diagram]) -> tuple[Recorder, Simulator]:
    recorder, diagram = drawn
    recorder.SetSliderValue(HYPOTHESIS, 0)
    recorder.SetSliderValue(MAP, 0)
    diagram.GetSubsystemByName("belief_visualizer").delete()
    recorder.properties.clear()
    recorder.transforms.clear()
    return recorder, Simulator(diagram)


def test_it_begins_with_an_empty_board(played: tuple[Recorder, Simulator]) -> None:
    recorder, simulator = played
    simulator.AdvanceTo(0.05)
    assert recorder.visible() == {"board/0", "push/1"}
    simulator.AdvanceTo(0.25)
    assert {path for path in recorder.visible() if path.startswith("board")} == {"board/1/mass"}


def test_the_tiles_lie_just_over_the_highest_cell_once_it_is_known(
    played: tuple[Recorder, Simulator],
) -> None:
    recorder, simulator = played
    simulator.AdvanceTo(0.45)
    heights = [
        (time, pose.translation()[2])
        for path, pose, time in recorder.transforms
        if path == "/belief/observed"
    ]
    assert [time < LOOKED for time, _ in heights] == [True, False, False]
    before, *after = (height for _, height in heights)
    assert before == pytest.approx(0.05)
    assert after == pytest.approx([0.033] * len(after))


def test_what_is_there(played: tuple[Recorder, Simulator]) -> None:
    recorder, simulator = played
    simulator.AdvanceTo(0.15)
    assert not recorder.HasPath("/belief/observed")
    assert "observed" not in recorder.visible()
    simulator.AdvanceTo(0.45)
    for name in ("observed/outline", "predicted/outline", "residuals/0", "push/1", "board/1/mass"):
        assert recorder.HasPath(f"/belief/{name}"), name
    assert {
        "observed/maps/1/mass/0",
        "board/1/mass",
        "observed/centers of mass/1",
        "push/1",
        "observed",
        "predicted",
    } <= (recorder.visible())
    simulator.AdvanceTo(0.65)
    maps = {path for path in recorder.visible() if path.startswith(("observed/maps", "board", "push"))}
    assert maps == {"observed/maps/2/mass/0", "board/2/mass", "push/2"}


def test_a_simulation_that_starts_again_shows_nothing_of_the_one_before(
    played: tuple[Recorder, Simulator],
) -> None:
    recorder, simulator = played
    simulator.AdvanceTo(0.65)
    again = Simulator(simulator.get_system())
    again.AdvanceTo(0.05)
    assert recorder.visible() == {"board/0", "push/3"}
    again.AdvanceTo(0.45)
    assert {"observed", "predicted", "observed/maps/3/mass/0", "board/3/mass"} <= recorder.visible()
    assert "board/0" not in recorder.visible()


def test_sliders_choose_hypothesis_and_map(played: tuple[Recorder, Simulator]) -> None:
    recorder, simulator = played
    simulator.AdvanceTo(0.25)
    recorder.SetSliderValue(HYPOTHESIS, 3)
    recorder.SetSliderValue(MAP, 2)
    simulator.AdvanceTo(0.35)
    assert {"observed/maps/1/mass x friction/3", "board/1/mass x friction"} <= recorder.visible()
    assert "observed/maps/1/mass/0" not in recorder.visible()
    recorder.SetSliderValue(HYPOTHESIS, 12)
    simulator.AdvanceTo(0.45)
    assert "observed/maps/1/mass x friction/4" in recorder.visible(), "there are four hypotheses"


def test_a_recording_changes_with_the_belief(played: tuple[Recorder, Simulator], tmp_path: Path) -> None:
    recorder, simulator = played
    recorder.StartRecording()
    simulator.AdvanceTo(0.75)
    recorder.StopRecording()
    recorder.PublishRecording()
    switches = {
        name: [
            (time, value)
            for path, what, value, time in recorder.properties
            if path == f"/belief/observed/maps/{name}" and what == "visible"
        ]
        for name in ("1/mass/0", "2/mass/0")
    }
    assert switches["1/mass/0"][0] == (0.0, False)
    assert [(pytest.approx(t), v) for t, v in switches["1/mass/0"][1:]] == [(0.2, True), (0.5, False)]
    assert [(pytest.approx(t), v) for t, v in switches["2/mass/0"]] == [(0.0, False), (0.5, True)]
    page = tmp_path / "belief.html"
    page.write_text(recorder.StaticHtml())
    # Meshcat alone is 2.2 MB; 2 beliefs of 5 maps each of 3 kinds lie in it too.
    assert page.stat().st_size > 2.4e6
    recorder.DeleteRecording()


def test_residual_arrows_point_from_predicted_to_observed_cells(played: tuple[Recorder, Simulator]) -> None:
    recorder, simulator = played
    simulator.AdvanceTo(0.45)
    place = {path: pose for path, pose, _ in recorder.transforms}["/belief/residuals/0"]
    scale = [
        value
        for path, name, value, _ in recorder.properties
        if (path, name) == ("/belief/residuals/0", "scale")
    ]
    cell = block().centers[np.argmin(np.linalg.norm(block().centers - block().centers.mean(axis=0), axis=1))]
    seen_pose, told = observed_at(0.4).pose, predicted_at(0.4)
    begin, end = (
        pose[:2] + np.array([[np.cos(pose[2]), -np.sin(pose[2])], [np.sin(pose[2]), np.cos(pose[2])]]) @ cell
        for pose in (told, seen_pose)
    )
    assert np.allclose(place.translation()[:2], begin)
    direction = place.rotation().matrix()[:2, 0]
    assert np.allclose(direction, (end - begin) / np.linalg.norm(end - begin), atol=1e-6)
    assert scale[-1][0] == pytest.approx(5 * np.linalg.norm(end - begin))


def test_a_sign_is_up_while_the_last_push_is_one_that_surprised(
    played: tuple[Recorder, Simulator],
) -> None:
    recorder, simulator = played
    for until, signs in ((0.45, set()), (0.65, {"notice/1"}), (0.9, set())):
        simulator.AdvanceTo(until)
        assert {path for path in recorder.visible() if path.startswith("notice")} == signs
    X_WN = next(pose for path, pose, _ in recorder.transforms if path == "/belief/notice")
    corners = 0.5 * np.array([[x * NOTICE[0], 0.0, z * NOTICE[1]] for x in (-1, 1) for z in (-1, 1)])
    place = on_screen(np.array([X_WN.multiply(corner) for corner in corners]))
    assert (np.abs(place) < [4 / 3, 1.0]).all(), "a window of 4:3 holds it"


def test_tiles_have_the_colours_of_their_values() -> None:
    what = shown(FIRST, 2)
    assert list(what.hypotheses) == [3, 2]
    mean = 1e3 * FIRST.probability @ FIRST.maps.mass
    assert np.allclose(what.values[0, 0], mean)
    assert np.allclose(what.values[2, 1], 1e3 * 9.81 * FIRST.maps.mass[3] * FIRST.maps.mu[3])
    assert what.tops[0] >= np.quantile(1e3 * FIRST.maps.mass[2:], 0.97)
    colors = what.colors(0, 0)
    assert np.allclose(colors, colormaps[MAP_COLORS[0]](np.clip(mean / what.tops[0], 0, 1))[:, :3])
    mesh = tiles(block(), colors).source().in_memory().mesh_file.contents()
    tree = json.loads(mesh)
    data = base64.b64decode(tree["buffers"][0]["uri"].split(",")[1])
    view = tree["bufferViews"][2]
    linear = np.frombuffer(data, "<f4", view["byteLength"] // 4, view["byteOffset"]).reshape(-1, 12, 3)
    back = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.allclose(back[:, 0], colors, atol=1e-6)
    place = np.frombuffer(data, "<f4", tree["bufferViews"][0]["byteLength"] // 4).reshape(-1, 12, 3)
    # glTF has y upwards.
    assert np.allclose(place[:, :4, [0, 2]].mean(axis=1) * [1, -1], block().centers, atol=1e-7)


def on_screen(points: np.ndarray) -> np.ndarray:
    """(n, 2) of points (n, 3), as a camera at `VIEW` sees them; the window is 75° high, from -1 to 1."""
    eye, target = map(np.array, VIEW)
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    seen_from = (points - eye) @ np.column_stack([right, np.cross(right, forward), forward])
    return seen_from[:, :2] / seen_from[:, 2:] / np.tan(np.radians(37.5))


def test_the_view_holds_table_and_board_and_is_near(played: tuple[Recorder, Simulator]) -> None:
    recorder, simulator = played
    simulator.AdvanceTo(0.2)
    X_WB = next(pose for path, pose, _ in recorder.transforms if path == "/belief/board")
    corners = 0.5 * np.array([[x * BOARD[0], 0.0, z * BOARD[1]] for x in (-1, 1) for z in (-1, 1)])
    board = on_screen(np.array([X_WB.multiply(corner) for corner in corners]))
    around = np.linspace(0.0, 2.0 * np.pi, 60)
    table = on_screen(0.5 * np.column_stack([np.cos(around), np.sin(around), np.zeros(60)]))
    for points in (table, board):
        assert (np.abs(points) < [4 / 3, 1.0]).all(), "a window of 4:3 holds both"
    assert np.ptp(table[:, 0]) > 1.4 and np.ptp(board[:, 0]) > 0.6


@pytest.mark.parametrize("which", range(len(MAPS)))
def test_the_legend_shows_the_scale_in_its_colours(which: int) -> None:
    picture = image.imread(io.BytesIO(legend(FIRST, shown(FIRST, 4), which, "of a block")))[:, :, :3]
    assert picture.shape[1] / picture.shape[0] == pytest.approx(BOARD[0] / BOARD[1], rel=0.01)
    for share in (0.02, 0.5, 0.98):
        wanted = colormaps[MAP_COLORS[which]](share)[:3]
        assert np.abs(picture - wanted).max(axis=2).min() < 0.02
