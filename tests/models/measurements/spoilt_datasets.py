"""What reading a spoilt dataset says."""

import pytest

from slipmap.models.measurements import DatasetError, read_dataset


def refused(example, *words):
    with pytest.raises(DatasetError) as caught:
        read_dataset(example.write())
    for word in words:
        assert word in str(caught.value), f"{word!r} is not in: {caught.value}"


def warned(example, *words):
    warnings = read_dataset(example.write()).warnings
    assert len(warnings) == 1, warnings
    for word in words:
        assert word in warnings[0], f"{word!r} is not in: {warnings[0]}"


def record(example, index=1):
    return example.records[f"trials/{index:03d}.json"]
