import numpy as np
import pytest
import yaml

from slipmap.models.measurements import finger_path, pose_times, read_dataset

DATASETS = [
    "bullet/book_p9", "bullet/box_p0", "bullet/hammer_p0",
    "effects/public-anisotropic", "effects/public-field", "effects/public-field-linear",
    "effects/public-latency", "effects/public-none", "effects/public-tilt", "effects/public-viscous",
    "real/cpush_square", "real/cube_slides", "real/mcube_aluminium", "real/mcube_steel", "real/mit_abs_rect1",
    "real/mit_plywood_hex",
]  # fmt: skip


@pytest.mark.parametrize("name", DATASETS)
def test_every_shipped_dataset_is_read_without_complaint(shared_data, name):
    dataset = read_dataset(shared_data / name)
    document = yaml.safe_load((shared_data / name / "dataset.yaml").read_text())
    if name == "effects/public-latency":  # whose poses are 60 ms late, as its truth says
        (warning,) = dataset.warnings
        assert "poses stamped 61 ms late" in warning or "poses stamped 60 ms late" in warning
    else:
        assert dataset.warnings == ()
    assert [(t.name, t.role) for t in dataset.trials] == [(t["file"], t["role"]) for t in document["trials"]]
    assert len(dataset.grid) == len(document["object"]["cells"]["centers"])
    for trial in dataset.trials:
        times, path = finger_path(trial)
        assert times[0] == 0.0 and times[-1] == pose_times(trial)[-1] and np.isfinite(path).all()


def test_slides_have_no_finger_and_pushes_have_one(shared_data):
    assert not any(trial.finger_near() for trial in read_dataset(shared_data / "real/cube_slides").trials)
    assert all(trial.finger_near() for trial in read_dataset(shared_data / "real/mcube_steel").trials)
    ends = read_dataset(shared_data / "real/mit_abs_rect1").trials
    assert all(trial.ends_only and trial.ft_wrench is None for trial in ends)


def test_the_force_points_where_the_object_goes(shared_data):
    for name in ("real/mit_plywood_hex", "real/mcube_steel", "bullet/box_p0", "effects/public-none"):
        for trial in read_dataset(shared_data / name).trials:
            assert trial.ft_wrench is not None
            shift = trial.object_pose.at(trial.ft_wrench.time)[:, :2]
            work = np.sum(trial.ft_wrench.values[1:, :2] * np.diff(shift, axis=0))
            assert work > 0.0, (name, trial.name)
