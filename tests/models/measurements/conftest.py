"""A small push dataset for every test that asks for it."""

from __future__ import annotations

from pathlib import Path

import pytest
from example_dataset import Example, example_in


@pytest.fixture
def example(tmp_path: Path) -> Example:
    return example_in(tmp_path / "example")
