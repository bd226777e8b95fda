"""Belief files: whole round trip, and clear words for anything else."""

import dataclasses
import inspect
import pickle

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import slipmap
from slipmap.models.inference import belief
from slipmap.models.inference.belief import Belief, BeliefError
from slipmap.models.inference.prediction import check_same_object
from slipmap.models.measurements import KnownMaps, Table
from slipmap.models.objects import cells_from_polygon
from slipmap.models.physics.rollout import Maps, Smoothing


def example() -> Belief:
    outer = [[0, 0], [0.1, 0], [0.1, 0.1], [0, 0.1]]
    hole = np.array([[0.04, 0.04], [0.06, 0.04], [0.06, 0.06], [0.04, 0.06]])
    grid = cells_from_polygon(outer, [hole], count=24)
    rng = np.random.default_rng(0)
    maps = Maps(
        rng.uniform(0.1, 1, (3, len(grid))), rng.uniform(0.1, 1, (3, len(grid))), np.array([0.1, 0.2, 0.3])
    )
    return Belief(
        grid, 0.005, 9.8, maps, np.array([0.5, 0.3, 0.2]), Smoothing(), "made up", "abc", "gauss-newton", 7,
        {"hypotheses": 3},
    )  # fmt: skip


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    path = tmp_path_factory.mktemp("belief") / "belief.npz"
    example().save(path)
    return path


def test_round_trip_is_exact(saved):
    before, after = example(), Belief.load(saved)
    for name in ("mass", "mu", "mu_finger"):
        assert np.array_equal(getattr(before.maps, name), getattr(after.maps, name))
    assert np.array_equal(before.probability, after.probability)
    assert np.array_equal(before.grid.edges, after.grid.edges)
    for name in (
        "finger_radius",
        "gravity",
        "smoothing",
        "dataset",
        "fingerprint",
        "method",
        "seed",
        "settings",
        "versions",
    ):
        assert getattr(before, name) == getattr(after, name)


@pytest.mark.parametrize(
    "table", [Table("round", (0.1, -0.2), radius=0.5), Table("rectangle", (0.0, 0.0), size=(0.8, 0.6))]
)
def test_the_table_is_kept_and_used(table, tmp_path):
    before = example().on(table)
    before.save(tmp_path / "belief.npz")
    after = Belief.load(tmp_path / "belief.npz")
    assert after.table == table and after.slider.table == table
    assert after.on(None).slider.table is None and example().table is None


def test_a_table_that_is_none_is_refused(tmp_path):
    broken = Table("round", (0.1, -0.2), radius=0.5)
    vars(broken)["radius"] = -1.0
    example().on(broken).save(tmp_path / "belief.npz")
    with pytest.raises(BeliefError, match="radius"):
        Belief.load(tmp_path / "belief.npz")


def test_centre_of_mass_and_friction_by_hand():
    belief = example()
    k = 1
    total = sum(belief.maps.mass[k])
    x = sum(m * r[0] for m, r in zip(belief.maps.mass[k], belief.grid.centers, strict=True)) / total
    assert belief.centers_of_mass[k, 0] == pytest.approx(x)
    friction = sum(m * mu * 9.8 for m, mu in zip(belief.maps.mass[k], belief.maps.mu[k], strict=True))
    assert belief.friction_forces[k] == pytest.approx(friction)


def test_missing_foreign_and_damaged_files_are_named(saved, tmp_path):
    with pytest.raises(BeliefError, match="no belief file"):
        Belief.load(tmp_path / "none.npz")
    np.savez(tmp_path / "foreign.npz", a=np.zeros(3))
    with pytest.raises(BeliefError, match="not a belief file"):
        Belief.load(tmp_path / "foreign.npz")
    (tmp_path / "text.npz").write_text("hello")
    with pytest.raises(BeliefError, match="not a readable belief"):
        Belief.load(tmp_path / "text.npz")


def test_changed_numbers_are_noticed(saved, tmp_path):
    with np.load(saved) as archive:
        arrays = {name: archive[name] for name in archive.files}
    arrays["mass"] = arrays["mass"] * 1.01
    np.savez(tmp_path / "changed.npz", **arrays)
    with pytest.raises(BeliefError, match="checksum"):
        Belief.load(tmp_path / "changed.npz")


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.binary(min_size=1, max_size=8), st.booleans())
def test_any_damage_is_a_belief_error_or_harmless(saved, tmp_path_factory, place, junk, cut):
    whole = saved.read_bytes()
    place %= len(whole)
    broken = whole[:place] if cut else whole[:place] + junk + whole[place + len(junk) :]
    path = tmp_path_factory.mktemp("broken") / "belief.npz"
    path.write_bytes(broken)
    try:
        loaded = Belief.load(path)
    except BeliefError:
        return
    assert np.array_equal(loaded.maps.mass, example().maps.mass)


def test_an_archive_that_unpacks_to_more_than_fits_is_not_unpacked(tmp_path, monkeypatch):
    np.savez_compressed(tmp_path / "bomb.npz", meta=np.zeros(1_000_000))
    assert (tmp_path / "bomb.npz").stat().st_size < 100_000
    monkeypatch.setattr(belief, "LARGEST_FILE", 2**20)
    with pytest.raises(BeliefError, match=r"bomb\.npz: 8 MiB, more than the 1 MiB it may have"):
        Belief.load(tmp_path / "bomb.npz")


def test_a_failed_write_leaves_nothing(tmp_path):
    with pytest.raises(BeliefError, match="cannot write"):
        example().save(tmp_path / "nowhere" / "belief.npz")
    assert list(tmp_path.iterdir()) == []


def test_probabilities_are_checked():
    b = example()
    with pytest.raises(BeliefError, match="probabilities"):
        Belief(b.grid, 0.005, 9.8, b.maps, np.array([0.5, 0.3, 0.3]), b.smoothing, "", "", "paper", 0)


def test_a_belief_and_its_dataset_are_shown_in_a_line() -> None:
    """As the last line of a notebook's cell, too."""
    dataset, _ = slipmap.simulated_hammer(seed=1, fit=2, heldout=1)
    result = slipmap.identify(dataset, hypotheses=2, friction_laws=False)
    assert repr(dataset) == "PushDataset('hammer': 60 cells; 2 pushes to fit, 1 held out)"
    assert repr(result.belief) == "Belief(dataset 'hammer': 2 hypotheses about 60 cells)"
    assert repr(result).startswith(f"Identification({result.belief!r}; mean ADD at the end ")
    assert repr(result).endswith("over 1 heldout pushes)")
    with pytest.raises(ValueError, match="role must be one of fit, heldout, got 'held out'"):
        result.errors("held out")
    with pytest.raises(ValueError, match="of must be one of final_add, no_motion_add, uniform_add, got 'a'"):
        result.errors("fit", "a")
    trial, push = dataset.trials[0], result.pushes[0]
    assert repr(trial).startswith(f"Trial('trials/000.json', fit: {len(trial.object_pose.time)} rows of")
    assert repr(dataset.grid) == "CellGrid(60 cells of 12.5 mm, 8 corners)"
    assert repr(result.belief.maps) == "Maps(2 of 60 cells, 0 parameters of effects)"
    assert repr(push) == f"Prediction('trials/000.json', fit: ends {1e3 * push.final_add:.2f} mm off)"
    known = KnownMaps(np.ones(60), np.where(np.arange(60) < 3, np.nan, 0.3), 0.25)
    given_maps = "mass of 60 of 60 cells, friction of 57 of 60 cells, finger friction 0.25"
    assert repr(known) == f"KnownMaps({given_maps})"
    compared = repr(slipmap.compare(dataset, result.belief, seed=0))
    assert compared.startswith("Comparison('model' on dataset 'hammer'; mean ADD at the end ")
    for thing in (dataset, trial, trial.object_pose, dataset.grid, push, known, compared):
        assert len(repr(thing)) < 200 and "\n" not in repr(thing)


def test_signatures_name_the_library() -> None:
    for function in (slipmap.diagnose, slipmap.effects_named, Belief.load):
        assert "= slipmap.LIBRARY" in str(inspect.signature(function))
    assert repr(slipmap.LIBRARY[4]) == "<effect table_tilt>"
    assert len(pickle.loads(pickle.dumps(slipmap.LIBRARY))) == len(slipmap.LIBRARY)


@pytest.mark.parametrize(("wider", "same"), [(8e-4, True), (2e-3, False)])
def test_an_outline_seen_again_is_that_of_the_same_object(wider, same):
    """Of a bar of 10 by 200 mm; 0.8 mm more width are 8 % of its area, but 0.4 mm on each side."""
    dataset, _ = slipmap.simulated_hammer(seed=1, fit=1, heldout=1)
    bar, seen = (
        cells_from_polygon([[0, -w], [0.2, -w], [0.2, w], [0, w]], count=20)
        for w in (0.005, 0.005 + wider / 2)
    )
    maps = Maps(np.full((1, len(bar)), 0.01), np.full((1, len(bar)), 0.3), np.array([0.2]))
    belief = Belief(
        bar, dataset.finger_radius, 9.8, maps, np.ones(1), Smoothing(), "bar", "abc", "gauss-newton", 0,
        {"known_mass": 0.5},
    )  # fmt: skip
    again = dataclasses.replace(dataset, grid=seen, mass=0.5 if same else 1.0)
    if same:
        check_same_object(belief, again)
    else:
        with pytest.raises(BeliefError, match=r"a different object, bar, .* outlines differ"):
            check_same_object(belief, again)


@pytest.mark.parametrize(
    ("stated", "refusal"),
    [
        ({"mass": 1.0}, "a mass of 0.5 kg, but dataset .* states 1 kg"),
        ({"mass": 0.51}, None),
        ({"mass": None}, None),
        ({"gravity": 1.62}, "gravity of 9.81 m/s², but dataset .* states 1.62"),
        ({"gravity": 9.79}, None),
    ],
)
def test_other_masses_or_gravity_are_of_another_object(stated, refusal):
    dataset, truth = slipmap.simulated_hammer(seed=1, fit=1, heldout=1)
    weighed = dataclasses.replace(dataset, mass=0.5, gravity=9.81)
    slider = slipmap.Slider(weighed.grid, weighed.finger_radius, weighed.gravity)
    belief = Belief.learned(
        weighed, slider, truth, np.ones(1), method="gauss-newton", seed=0, trials=(), settings={}
    )
    other = dataclasses.replace(weighed, **stated)
    if refusal is None:
        check_same_object(belief, other)
    else:
        with pytest.raises(BeliefError, match=refusal):
            check_same_object(belief, other)
