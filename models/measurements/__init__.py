"""Push measurements: reading, checking, writing and aligning them."""

from models.measurements.alignment import finger_path, pose_times, wrench_samples
from models.measurements.push_dataset import Channel, DatasetError, Noise, PushDataset, Table, Trial
from models.measurements.reading import read_dataset
from models.measurements.writing import write_dataset

__all__ = [
    "Channel",
    "DatasetError",
    "Noise",
    "PushDataset",
    "Table",
    "Trial",
    "finger_path",
    "pose_times",
    "read_dataset",
    "wrench_samples",
    "write_dataset",
]
