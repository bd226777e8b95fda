"""The robot cell as one Drake diagram: arm, gripper, table, object, camera."""
