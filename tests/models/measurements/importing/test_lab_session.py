"""Three clocks, two frames, a turned and biased force: a session of a laboratory becomes a dataset that
teaches what is true."""

import numpy as np
import pytest
from lab_session import BIAS, FORCE_CLOCK, ROBOT_CLOCK, lab_session

from slipmap.diagrams.application.demonstration import true_values
from slipmap.models.geometry import rotated
from slipmap.models.inference.identification import identify
from slipmap.models.measurements import read_dataset, write_dataset
from slipmap.models.measurements.dataset_check import check_dataset
from slipmap.models.measurements.importing import import_dataset


def imported_session(folder, seed):
    session = lab_session(folder, seed=seed)
    setup = session.folder / "setup.yaml"
    setup.write_text(session.setup)
    assert len(session.setup.splitlines()) <= 25
    return session, import_dataset(session.sources, setup, tell=lambda text: pytest.fail(text))


@pytest.fixture(scope="module")
def imported(tmp_path_factory):
    return imported_session(tmp_path_factory.mktemp("lab"), 0)[1]


def added(dataset, channel):
    """What was added to a channel's stamps, s."""
    (text,) = (one for one in dataset.provenance if one.startswith(f"{channel}: ") and "s added" in one)
    return float(text.split()[1])


def test_clocks_are_found_by_contact(imported):
    assert added(imported, "tip_pose") == pytest.approx(-ROBOT_CLOCK, abs=3e-3)
    assert added(imported, "ft_wrench") == pytest.approx(-FORCE_CLOCK, abs=3e-3)


def test_the_recording_is_cut_into_its_pushes(imported):
    assert [trial.role for trial in imported.trials] == 6 * ["fit"] + 2 * ["heldout"]
    moved = [np.ptp(trial.object_pose.values, axis=0).max() for trial in imported.trials]
    assert min(moved) > 0.02
    for trial in imported.trials:  # a finger that was lifted over the object is no part of a push
        assert np.hypot(*np.diff(trial.tip_pose.values, axis=0).T).max() < 0.01


def test_the_bias_is_that_of_rows_before_touch(imported):
    (text,) = (one for one in imported.provenance if "bias" in one)
    found = np.array([float(part) for part in text.split("(")[1].split(")")[0].split(",")])
    assert found == pytest.approx(rotated(BIAS, np.radians(45.0)), abs=0.02)


def test_nothing_is_wrong_with_it(imported):
    check = check_dataset(imported)
    assert not check.wrong, check.findings


# Of fifteen sessions, seeds 0 to 2 and 300 to 311, thirteen hold 1 mm (the others 1.2 and 1.3 mm) and all
# hold 0.5 % of the total friction; no clock was off by more than 0.2 ms (finger) and 2.2 ms (force). The same
# pushes recorded on one clock in the table's frame teach no more: the rest is what eight pushes can tell.
@pytest.mark.parametrize("seed", range(3))
def test_what_is_learned_is_true(tmp_path, seed):
    session, imported = imported_session(tmp_path, seed)
    clocks = (("tip_pose", ROBOT_CLOCK), ("ft_wrench", FORCE_CLOCK))
    assert all(added(imported, name) == pytest.approx(-clock, abs=3e-3) for name, clock in clocks)
    belief = identify(imported).belief
    load = belief.maps.mass * belief.maps.mu
    middle = belief.probability @ ((load @ belief.grid.centers) / load.sum(axis=1, keepdims=True))
    truth = true_values(belief, session.maps)
    off = middle - [truth["centre of friction, x"], truth["centre of friction, y"]]
    assert np.hypot(*off) < 1e-3
    assert belief.probability @ belief.friction_forces == pytest.approx(truth["total friction"], rel=0.03)


def test_where_it_came_from_is_kept(tmp_path, imported):
    again = read_dataset(write_dataset(imported, tmp_path / "pushes"))
    assert again.provenance == imported.provenance
    assert not again.warnings
