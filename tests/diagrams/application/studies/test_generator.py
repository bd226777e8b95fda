"""Datasets from seeds: the same each time, readable without remarks, as noisy as they say."""

import json
import pickle

import numpy as np
import pytest

from slipmap.diagrams.application.studies.blind import generator
from slipmap.diagrams.application.studies.blind.generator import (
    Truth,
    _draw_effect,
    generate,
    truth_file,
)
from slipmap.diagrams.application.studies.blind.objects import random_object
from slipmap.diagrams.application.studies.blind.secret_effects import (
    LIBRARY,
    OUTSIDE,
    PLAIN,
    force_frame,
    sensor_latency,
    table_tilt,
)
from slipmap.diagrams.application.studies.blind.world import World
from slipmap.models.measurements import read_dataset

EVERY = LIBRARY + OUTSIDE
KINDS = {kind.make: kind for kind in EVERY}


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Three pushes without an effect."""
    folder = tmp_path_factory.mktemp("plain") / "quiet"
    return folder, generate(4, folder, effect=PLAIN, pushes=3)


@pytest.fixture(scope="module")
def motions():
    """Motions of the pushes without an effect that `plain_pushes_once` has simulated."""
    return {}


@pytest.fixture
def plain_pushes_once(motions, monkeypatch):
    """The generator simulates a push without an effect once: its motion is the same each time, as the test of
    files to the last bit shows, which goes without this."""

    class Remembering(World):
        def push(self, plan, **number):
            if self._effect.parameters:
                return super().push(plan, **number)
            key = pickle.dumps((self._thing, plan))
            if key not in motions:
                motions[key] = super().push(plan, **number)
            return motions[key]

    monkeypatch.setattr(generator, "World", Remembering)


def test_a_seed_gives_the_same_files_to_the_last_bit(plain, tmp_path):
    folder, truth = plain
    again = tmp_path / "quiet"
    assert generate(4, again, effect=PLAIN, pushes=3) == truth
    names = [path.relative_to(folder) for path in sorted(folder.rglob("*")) if path.is_file()]
    assert len(names) == 4
    for name in names:
        assert (again / name).read_bytes() == (folder / name).read_bytes()
    assert truth_file(again).read_bytes() == truth_file(folder).read_bytes()
    other = tmp_path / "other" / "quiet"
    generate(5, other, effect=PLAIN, pushes=1)
    assert (other / "dataset.yaml").read_bytes() != (folder / "dataset.yaml").read_bytes()


def test_the_reader_has_nothing_to_remark(plain):
    dataset = read_dataset(plain[0])
    assert dataset.warnings == ()
    assert [trial.role for trial in dataset.trials].count("heldout") == 1
    assert dataset.noise.position == 2.5e-4 and dataset.noise.force == 0.05
    thing = random_object(np.random.default_rng([4, 1]))
    np.testing.assert_allclose(dataset.grid.centers, thing.centers, atol=1e-8)
    assert dataset.grid.polygon.symmetric_difference(thing.footprint).area < 1e-9


def test_noise_at_rest_is_what_the_dataset_promises(plain):
    dataset = read_dataset(plain[0])
    before = [trial.object_pose.values[:5] for trial in dataset.trials]
    assert 0 < np.concatenate([rows - rows[0] for rows in before]).std() < 4e-3
    for trial in dataset.trials:
        assert trial.ft_wrench is not None
        pose, wrench = trial.object_pose, trial.ft_wrench
        rest = np.abs(wrench.values[:, :2]).max(axis=1) < 0.25  # the finger has not touched, or lets go
        assert wrench.values[rest, :2].std() == pytest.approx(0.05, rel=0.6)
        rough = np.diff(pose.values, n=3, axis=0).std(axis=0) / np.sqrt(20)
        assert 2e-4 < rough[0] < 4e-4 and 2e-4 < rough[1] < 4e-4
        assert 2e-3 < rough[2] < 4e-3
        assert len({pose.time[0], wrench.time[0], trial.tip_pose.time[0]}) == 3


def test_half_a_percent_of_the_rows_is_lost(plain):
    lost, rows = 0, 0
    for path in (plain[0] / "trials").iterdir():
        for channel in json.loads(path.read_text()).values():
            values = np.array(channel)
            assert np.isfinite(values[:, 0]).all()
            lost, rows = lost + np.isnan(values[:, 1:]).all(axis=1).sum(), rows + len(values)
    assert 0.001 < lost / rows < 0.01


def test_the_truth_lies_beside_and_tells_how_much_the_effect_changed(plain, tmp_path):
    folder, quiet = plain
    assert Truth.read(truth_file(folder)) == quiet
    assert quiet.verdict == "none" and quiet.effect is None
    assert quiet.final_change_mm["max"] == 0.0 and quiet.force_change_rms == 0.0
    tilted = generate(4, tmp_path / "tilted", effect=KINDS[table_tilt], strength="clear", pushes=1)
    assert tilted.effect == "table_tilt" and tilted.strength == "clear"
    assert 0.03 < tilted.parameters["tilt"] < 0.07
    assert tilted.final_change_mm["max"] > 0.5
    assert tilted.force_change_rms > 0.02
    assert Truth.read(truth_file(tmp_path / "tilted")) == tilted
    # The plan is the same: the finger starts and moves alike.
    one, other = (read_dataset(path).trials[0].tip_pose.values for path in (folder, tmp_path / "tilted"))
    assert np.abs(one - other).max() < 1e-3


def test_a_late_tracker_changes_poses_and_no_forces(plain, tmp_path):
    late = generate(4, tmp_path / "late", effect=KINDS[sensor_latency], strength="clear", pushes=1)
    assert late.force_change_rms == 0.0 and late.largest_change_mm > 1.0
    one, other = (
        json.loads((path / "trials/000.json").read_text()) for path in (plain[0], tmp_path / "late")
    )
    assert all(repr(one[key]) == repr(other[key]) for key in ("ft_wrench", "tip_pose"))  # NaN is NaN
    assert repr(one["object_pose"]) != repr(other["object_pose"])


def test_a_force_sensor_that_lies_changes_forces_and_no_poses(plain, tmp_path):
    turned = generate(4, tmp_path / "turned", effect=KINDS[force_frame], strength="clear", pushes=1)
    assert turned.largest_change_mm == 0.0 and turned.force_change_rms > 0.05
    one, other = (
        json.loads((path / "trials/000.json").read_text()) for path in (plain[0], tmp_path / "turned")
    )
    assert all(repr(one[key]) == repr(other[key]) for key in ("object_pose", "tip_pose"))  # NaN is NaN
    true, said = (np.array(record["ft_wrench"], dtype=float)[:, 1:3] for record in (one, other))
    size = np.hypot(*true.T)
    assert np.nanmax(np.abs(np.hypot(*said.T) - size)) < 0.3 < np.nanmax(size)  # noise apart
    assert np.nanmax(np.abs(said - true)) > 0.3


@pytest.mark.usefixtures("plain_pushes_once")
@pytest.mark.parametrize("effect", EVERY, ids=lambda effect: effect.make.__name__)
def test_every_effect_can_be_drawn_simulated_and_read(effect, tmp_path):
    truth = generate(32, tmp_path / "set", effect=effect, strength="clear", pushes=1)
    assert truth.effect == effect.name and truth.in_library == (effect in LIBRARY)
    assert truth.parameters and truth.largest_change_mm + 10 * truth.force_change_rms > 0.05
    # What moves the finger or the tracked object apart from their records is seen as depth in the outline.
    warnings = read_dataset(tmp_path / "set").warnings
    apart = effect.name in (
        "finger_compliance", "sensor_latency", "tracker_scale", "tracker_offset", "tracker_shift",
    )  # fmt: skip
    seen = ("the finger goes", "the finger starts") if apart else ("the force",) * effect.name.count("force_")
    assert all(any(words in warning for words in seen) for warning in warnings)


@pytest.mark.usefixtures("plain_pushes_once")
def test_weak_effects_are_weaker(tmp_path):
    clear, weak = (
        generate(21, tmp_path / strength, effect=KINDS[table_tilt], strength=strength, pushes=1)
        for strength in ("clear", "weak")
    )
    assert weak.parameters["tilt"] < 0.5 * clear.parameters["tilt"]
    assert weak.largest_change_mm < 0.7 * clear.largest_change_mm


def test_seeds_hide_nothing_a_third_of_the_time_and_everything_else_in_turn():
    drawn = [_draw_effect(np.random.default_rng([seed, 0x51EB])) for seed in range(600)]
    share = np.mean([effect is PLAIN for effect, _ in drawn])
    assert 0.24 < share < 0.36
    assert {effect for effect, _ in drawn} == {PLAIN, *EVERY}
    assert 0.28 < np.mean([strength == "weak" for _, strength in drawn]) < 0.42
