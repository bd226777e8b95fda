"""Pushes made by the arm: plans of its motion and the block that carries them out."""
