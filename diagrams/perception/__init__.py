"""Perception of the object: the depth camera, its noise, and the pose and cells found in its pictures."""
