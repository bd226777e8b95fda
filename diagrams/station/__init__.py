"""The robot's cell as one Drake diagram: arm, gripper, table, object, camera."""
