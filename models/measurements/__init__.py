"""Push measurements: reading, checking, writing and aligning them."""

from slipmap.models.measurements.push_dataset import KnownMaps, Noise, PushDataset, Table
from slipmap.models.measurements.reading import read_dataset
from slipmap.models.measurements.trial import (
    Channel,
    DatasetError,
    Trial,
    finger_path,
    pose_times,
    wrench_samples,
)
from slipmap.models.measurements.writing import write_dataset
