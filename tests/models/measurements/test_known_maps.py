"""What a description says is known of an object's maps, read and written."""

import dataclasses

import numpy as np
import pytest
import yaml
from straight_pushes import straight_pushes

from slipmap.models.measurements import DatasetError, KnownMaps, read_dataset, write_dataset
from slipmap.models.measurements.known_maps import with_known_maps

CELLS = 25  # of the example, 5 by 5 of 20 mm; 1.2 kg


def read(example, known):
    example.document["known"] = known
    return read_dataset(example.write(), tell=lambda warning: None)


def test_regions_lie_over_the_whole_and_over_each_other(example):
    known = read(
        example,
        {
            "friction": 0.3,
            "spread": 0.02,
            "regions": [
                {"polygon": [[0.01, -0.05], [0.05, -0.05], [0.05, 0.05], [0.01, 0.05]], "friction": 0.5},
                {
                    "disc": {"center": [0.04, 0.04], "radius": 0.005}, "friction": 0.1, "mass": 0.4,
                    "spread": 0.2,
                },
            ],
        },
    ).known  # fmt: skip
    x, y = read(example, {"friction": 0.3}).grid.centers.T
    corner = (x > 0.03) & (y > 0.03)
    np.testing.assert_array_equal(known.friction, np.where(corner, 0.1, np.where(x > 0.01, 0.5, 0.3)))
    np.testing.assert_array_equal(known.friction_spread, np.where(corner, 0.2, 0.02))
    assert known.mass[corner] == pytest.approx(0.4) and np.isnan(known.mass[~corner]).all()
    assert not known.complete


def test_a_mass_is_shared_by_the_cells_of_its_region(example):
    half = [[-0.05, -0.05], [0.0, -0.05], [0.0, 0.05], [-0.05, 0.05]]
    known = read(example, {"regions": [{"polygon": half, "mass": 0.6}]}).known
    assert np.nansum(known.mass) == pytest.approx(0.6)
    assert len(set(known.mass[~np.isnan(known.mass)])) == 1


def test_a_region_smaller_than_a_cell_is_the_cell_that_it_lies_on(example):
    known = read(example, {"regions": [{"disc": {"center": [0.011, 0.009], "radius": 0.001}, "mass": 0.1}]})
    (cell,) = np.flatnonzero(~np.isnan(known.known.mass))
    assert known.grid.centers[cell] == pytest.approx([0.02, 0.0])


def test_a_uniform_plate_is_known_but_for_its_size(example):
    known = read(example, {"mass": "uniform", "friction": {"value": "uniform", "spread": 0.03}}).known
    assert known.complete and known.mass_ratios and known.friction_ratios
    assert np.ptp(known.friction) == 0 and known.friction_spread == pytest.approx(0.03)
    assert known.mass_spread == pytest.approx(0.05)


def test_what_is_written_is_read_again(example, tmp_path):
    mass, friction = np.full(CELLS, 0.04), np.linspace(0.1, 0.6, CELLS)
    mass[3] = friction[7] = np.nan
    for known in (
        KnownMaps(mass, friction, 0.2, np.linspace(0.01, 0.2, CELLS), 0.03, 0.1),
        KnownMaps(friction=np.ones(CELLS), friction_ratios=True),
        KnownMaps(finger_friction=0.4),
    ):
        dataset = dataclasses.replace(read_dataset(example.write()), known=known)
        again = read_dataset(write_dataset(dataset, tmp_path / "copy", overwrite=True)).known
        for field in dataclasses.fields(KnownMaps):
            one, other = getattr(known, field.name), getattr(again, field.name)
            if not (field.name.endswith("_spread") and getattr(known, field.name[:-7], None) is None):
                np.testing.assert_array_equal(one, other, err_msg=field.name)


def test_a_file_says_it_instead_of_the_description(example, tmp_path):
    example.document["known"] = {"friction": 0.3}
    (tmp_path / "maps.yaml").write_text(yaml.safe_dump({"mass": "uniform"}), encoding="utf-8")
    known = read_dataset(example.write(), maps=tmp_path / "maps.yaml").known
    assert known.friction is None and known.mass is not None


@pytest.mark.parametrize(
    ("known", "words"),
    [
        ({}, ["known: states nothing known"]),
        (3, ["known: must be a mapping"]),
        ({"friction": [0.3, 0.2]}, ["known: friction: has 2 values for 25 cells", "object.cells.centers"]),
        ({"friction": -0.3}, ["known: friction: must be positive, got -0.3"]),
        ({"friction": {"spread": 0.1}}, ["known: friction: `value` is missing"]),
        ({"friction": 0.3, "spread": 2}, ["known: spread: ", "deviation must lie between 0.001 and 1"]),
        ({"mass": 1.2}, ["known: mass: must be `uniform` or a list", "object.mass"]),
        ({"mass": [1.0] * CELLS}, ["known: the masses add up to 25 kg, but the object weighs 1.2 kg"]),
        ({"finger_friction": "uniform"}, ["known: finger_friction must be a number, got 'uniform'"]),
        ({"finger_friction": {"value": 0.2, "ratios": True}}, ["finger_friction is a single number"]),
        ({"frction": 0.3}, ["known: states nothing known", "under `known`", "did you mean friction?"]),
        ({"regions": [{"mass": 1}]}, ["known: regions, row 0: give either a disc or a polygon"]),
        (
            {"regions": [{"disc": {"center": [0, 0], "radius": 0.01}}]},
            ["regions, row 0: states nothing known"],
        ),
        (
            {"regions": [{"disc": {"center": [9, 0], "radius": 0.01}, "friction": 0.1}]},
            ["regions, row 0: lies outside the object"],
        ),
        (
            {"mass": "uniform", "regions": [{"disc": {"center": [0, 0], "radius": 0.01}, "mass": 0.1}]},
            ["regions, row 0.mass: cannot be combined with a mass map that is given as ratios"],
        ),
        (
            {"regions": [{"polygon": [[-1, -1], [1, 1], [1, -1], [-1, 1]], "friction": 0.1}]},
            ["row 0.polygon: crosses itself"],
        ),
    ],
)  # fmt: skip
def test_faults_name_the_key_and_what_to_do(example, known, words):
    with pytest.raises(DatasetError) as caught:
        read(example, known)
    for word in ("dataset.yaml", *words):
        assert word in str(caught.value), caught.value


def test_maps_of_another_object_are_refused(example):
    dataset = read_dataset(example.write())
    with pytest.raises(DatasetError, match="friction has 3 values for 25 cells"):
        dataclasses.replace(dataset, known=KnownMaps(friction=np.ones(3)))


def test_a_file_of_maps_may_begin_as_a_dataset_does(tmp_path):
    dataset = straight_pushes(2)
    under, bare = tmp_path / "under.yaml", tmp_path / "bare.yaml"
    under.write_text("known: {friction: 0.3}\n")
    bare.write_text("friction: 0.3\n")
    assert np.array_equal(with_known_maps(dataset, under).known.friction, np.full(len(dataset.grid), 0.3))
    assert np.array_equal(with_known_maps(dataset, bare).known.friction, np.full(len(dataset.grid), 0.3))
    under.write_text("known: {friction: -1}\n")
    with pytest.raises(DatasetError, match=r"under\.yaml: known: friction"):
        with_known_maps(dataset, under)
    under.write_text("known: {friction: 0.3}\nfriction: 0.5\n")
    with pytest.raises(DatasetError, match="not both"):
        with_known_maps(dataset, under)
