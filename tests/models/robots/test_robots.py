"""The constants of the robot and its model files say the same."""

import xml.etree.ElementTree as ElementTree
from itertools import pairwise

import numpy as np
import pytest

from slipmap.models import robots

DRAKE = "{http://drake.mit.edu}"


@pytest.fixture(scope="module")
def arm():
    return ElementTree.parse(robots.IIWA_MODEL).getroot()


@pytest.fixture(scope="module")
def gripper():
    return ElementTree.parse(robots.GRIPPER_MODEL).getroot()


def limits(arm, key):
    joints = {joint.get("name"): joint.find("limit") for joint in arm.findall("joint")}
    return np.array([float(joints[name].get(key)) for name in robots.ARM_JOINTS])


@pytest.mark.parametrize(
    ("key", "sign", "expected"),
    [
        ("lower", -1, robots.POSITION_LIMITS),
        ("upper", 1, robots.POSITION_LIMITS),
        ("velocity", 1, robots.SPEED_LIMITS),
        (f"{DRAKE}acceleration", 1, robots.ACCELERATION_LIMITS),
        ("effort", 1, robots.TORQUE_LIMITS),
    ],
)
def test_limits_are_those_of_the_file(arm, key, sign, expected):
    np.testing.assert_allclose(limits(arm, key), sign * expected, rtol=1e-9)


def test_published_masses(arm):
    masses = {
        link.get("name"): float(link.find("inertial/mass").get("value")) for link in arm.findall("link")
    }
    assert [masses[f"iiwa_link_{i}"] for i in range(8)] == [5.0, 5.76, 6.35, 3.5, 3.5, 3.5, 1.8, 1.2]


def test_motors_reflect_their_rotors_inertia(arm):
    motors = arm.findall("transmission/actuator")
    rotor, gear = (
        np.array([float(motor.find(f"{DRAKE}{tag}").get("value")) for motor in motors])
        for tag in ("rotor_inertia", "gear_ratio")
    )
    # CSG-32-160, -100 and CSG-20-160 gears with ILM 85x23, 70x18 and 50x08 motors.
    np.testing.assert_allclose(rotor * gear**2, [3.38176] * 4 + [1.321] + [1.16224] * 2, rtol=1e-4)


def test_nothing_but_primitive_shapes(arm, gripper):
    for model in (arm, gripper):
        assert not model.findall(".//mesh")
        assert len(model.findall(".//visual")) > 10


def test_both_pins_end_as_the_round_finger(gripper):
    tip = float(gripper.find("frame[@name='tip']").get("xyz").split()[2])
    for side in ("left", "right"):
        spans = []
        for part in gripper.findall(f"link[@name='{side}_finger']/collision"):
            cylinder = part.find("geometry/cylinder")
            x, y, z = map(float, part.find("origin").get("xyz").split())
            length = float(cylinder.get("length"))
            assert (x, y) == (0.0, 0.0)
            spans.append((z - length / 2, z + length / 2, float(cylinder.get("radius"))))
        *thin, end = sorted(spans)
        assert all(end[2] == robots.FINGER_RADIUS > span[2] for span in thin)
        for span, following in pairwise([*thin, end]):
            assert following[0] == pytest.approx(span[1])
        assert end[1] == pytest.approx(tip)
        assert thin[0][0] == pytest.approx(tip - robots.FINGER_LENGTH)


def test_opening_lets_the_box_in(gripper):
    limit = {side: gripper.find(f"joint[@name='{side}_finger_joint']/limit") for side in ("left", "right")}
    opening = float(limit["right"].get("upper")) - float(limit["left"].get("lower"))
    assert opening == pytest.approx(robots.GRIPPER_OPENING)
    assert opening - 2 * robots.FINGER_RADIUS >= 0.09


def test_hand_is_where_planning_takes_it_to_be(gripper):
    tip = float(gripper.find("frame[@name='tip']").get("xyz").split()[2])
    (hand,) = gripper.findall("link[@name='hand']/collision")
    assert float(hand.find(f"geometry/{DRAKE}capsule").get("radius")) == robots.HAND_RADIUS
    assert tip - float(hand.find("origin").get("xyz").split()[2]) == pytest.approx(robots.HAND_DISTANCE)
    for side in ("left", "right"):
        limit = gripper.find(f"joint[@name='{side}_finger_joint']/limit")
        assert float(limit.get("effort")) == robots.GRIP_FORCE
