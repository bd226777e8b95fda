"""Pushes made by the arm: plans of its motion and the block that carries them out."""

from diagrams.execution.messages import ActivePush, ExecutionStatus

__all__ = ["ActivePush", "ExecutionStatus"]
