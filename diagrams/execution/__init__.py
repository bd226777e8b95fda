"""Pushes and grasps by the arm: plans of its motion and the block that executes them."""
