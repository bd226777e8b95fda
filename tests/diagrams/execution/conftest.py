"""Built once: every build of a diagram with Python systems costs memory."""

import pytest
from arm_rig import Rig


@pytest.fixture(scope="session")
def rig():
    return Rig()
